"""A robot arm as a stage, by dexterousrobot's package cri: driver = "cri_robot:CriRobot".

Install cri from https://github.com/dexterousrobot/cri. (The package named cri in the Python Package Index is another
one.) Homing does not move the robot, since an arm knows its position. Turn the tool straight down before the run, with
its z axis along the sensor and away from the robot. This example was tried with an emulated robot only.
"""

import contextlib
import math

from tacbench_cad.lab import Closing, DeviceLostError, NotThereError, PositionLostError
from tacbench_cad.lab.study.rotation import Turn, angle_between, angles_of, leaning, matrix

#: The longest piece of a move or a turn, in s. A stop may take this long, because cri cannot interrupt a move.
PIECE_S = 0.2


class CriRobot(Closing):
    """A robot that cri drives. x, y and z are those of the tool centre point in the robot's base frame, in mm.

    Args:
        port: The address of the robot in the network.
        controller: The class of the module cri.controller, such as RTDEController or ABBController.
        tcp: The tool centre point in the frame of the flange: x, y, z in mm, and three angles in degrees.
        tolerance_mm: The allowed distance of the tool from its target.
        tolerance_deg: The allowed angle between the tool and its target after a turn.
    """

    simulated = ""

    def __init__(self, port, controller="RTDEController", tcp=(0, 0, 0, 0, 0, 0), tolerance_mm=0.1, tolerance_deg=0.1):
        from cri import controller as controllers
        from cri.robot import SyncRobot

        self.name, self.tolerance_mm, self.tolerance_deg = f"cri robot at {port}", tolerance_mm, tolerance_deg
        self.stopped, self.robot = False, None
        try:
            self.robot = SyncRobot(getattr(controllers, controller)(ip=port))
            self.robot.axes, self.robot.tcp = "sxyz", tcp
            self.orientation = tuple(self.robot.pose)[3:]
            tool = matrix(self.orientation)
            # The tool that points straight down, also if a program has left the robot tilted.
            self.upright = leaning(-tool[:, 2]).T @ tool
            self.identity = f"{self.robot.info} at {port}"
        except Exception as error:
            self.close()
            raise DeviceLostError(f"{self.name}: cannot be reached: {error}") from error

    def home(self):
        self.stopped = False

    def move(self, target_mm, speed_mm_s):
        if self.stopped:
            raise PositionLostError(f"{self.name}: was stopped on request; home the stage first")
        start = self.position()
        count = max(1, math.ceil(math.dist(start, target_mm) / speed_mm_s / PIECE_S))
        self._call(lambda: setattr(self.robot, "linear_speed", speed_mm_s))
        for i in range(1, count + 1):
            place = [a + i / count * (b - a) for a, b in zip(start, target_mm, strict=True)]
            self._call(lambda place=place: self.robot.move_linear((*place, *self.orientation)))
            if self.stopped:
                raise NotThereError(f"{self.name}: the move was stopped on request")
        at = self.position()
        if math.dist(at, target_mm) > self.tolerance_mm:
            raise NotThereError(f"{self.name}: stands at {at} instead of {tuple(target_mm)}")
        return at

    def turn(self, angles_deg, speed_deg_s, *, above_mm=0.0, by_mm=(0.0, 0.0, 0.0)):
        if self.stopped:
            raise PositionLostError(f"{self.name}: was stopped on request; home the stage first")
        start, angles = self.position(), self.rotation()
        turn = Turn(summit_mm=start, from_deg=angles, to_deg=angles_deg, above_mm=above_mm, by_mm=by_mm)
        seconds = max(turn.angle_deg / speed_deg_s, 0.001)
        count = max(1, math.ceil(seconds / PIECE_S))
        self._call(lambda: setattr(self.robot, "angular_speed", speed_deg_s))
        for i in range(1, count + 1):
            place, angles = turn.at(i / count)
            length = math.dist(self.position(), place)
            # The tip moves during a roll, by its own speed.
            self._call(lambda length=length: setattr(self.robot, "linear_speed", max(length * count / seconds, 1.0)))
            self.orientation = angles_of(matrix(angles) @ self.upright)
            self._call(lambda place=place: self.robot.move_linear((*place, *self.orientation)))
            if self.stopped:
                raise NotThereError(f"{self.name}: the turn was stopped on request")
        if math.dist(self.position(), place) > self.tolerance_mm:
            raise NotThereError(f"{self.name}: stands at {self.position()} instead of {place}")
        if angle_between(self.rotation(), angles_deg) > self.tolerance_deg:
            raise NotThereError(f"{self.name}: has turned to {self.rotation()} instead of {tuple(angles_deg)}")
        return self.rotation()

    def rotation(self):
        orientation = self._call(lambda: self.robot.pose)[3:]
        return angles_of(matrix(orientation) @ self.upright.T)

    def position(self):
        return tuple(float(value) for value in self._call(lambda: self.robot.pose)[:3])

    def stop(self):
        self.stopped = True

    def close(self):
        robot, self.robot = self.robot, None
        with contextlib.suppress(Exception):
            robot.close()

    def _call(self, do):
        if self.robot is None:
            raise DeviceLostError(f"{self.name}: is closed")
        try:
            return do()
        except Exception as error:
            raise DeviceLostError(f"{self.name}: {type(error).__name__}: {error}; look at its panel") from error
