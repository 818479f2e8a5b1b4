"""A robot arm as a stage, by dexterousrobot's package cri: driver = "cri_robot:CriRobot".

Install cri from https://github.com/dexterousrobot/cri. (The package named cri in the Python Package Index is another
one.) Homing does not move the robot, since an arm knows its position. Turn the tool straight down before the run, with
its z axis along the sensor and away from the robot. This example was tried with an emulated robot only.
"""

import contextlib
import math

from tacbench_cad.lab import Closing, RigError
from tacbench_cad.lab.rig import DeviceLostError, PositionLostError

#: The longest piece of a move, in s. A stop may take this long, because cri cannot interrupt a move.
PIECE_S = 0.2


class CriRobot(Closing):
    """A robot that cri drives. x, y and z are those of the tool centre point in the robot's base frame, in mm.

    Args:
        port: The address of the robot in the network.
        controller: The class of the module cri.controller, such as RTDEController or ABBController.
        tcp: The tool centre point in the frame of the flange: x, y, z in mm, and three angles in degrees.
        tolerance_mm: The allowed distance of the tool from its target.
    """

    simulated = ""

    def __init__(self, port, controller="RTDEController", tcp=(0, 0, 0, 0, 0, 0), tolerance_mm=0.1):
        from cri import controller as controllers
        from cri.robot import SyncRobot

        self.name, self.tolerance_mm = f"cri robot at {port}", tolerance_mm
        self.stopped, self.robot = False, None
        try:
            self.robot = SyncRobot(getattr(controllers, controller)(ip=port))
            self.robot.axes, self.robot.tcp = "sxyz", tcp
            self.orientation = tuple(self.robot.pose)[3:]
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
                raise RigError(f"{self.name}: the move was stopped on request")
        at = self.position()
        if math.dist(at, target_mm) > self.tolerance_mm:
            raise RigError(f"{self.name}: stands at {at} instead of {tuple(target_mm)}")
        return at

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
