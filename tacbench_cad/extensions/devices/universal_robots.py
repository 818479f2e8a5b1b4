"""An arm of Universal Robots as a stage, by the package ur-rtde.

Frame: x, y and z are those of the tool centre point in the robot's base frame, in mm, with z upwards if the base stands
upright. Set the tool centre point to the summit of the sensor, with the z axis of the tool along the sensor's axis and
away from the robot. A move keeps the orientation of the tool, so turn the tool down before the run.

Proof of a move: the robot must be at rest, and the measured position of the tool must be at the target.
An arm knows its position at all times. :meth:`UniversalRobot.home` therefore does not move: it only makes the arm ready
again after a stop. A run then lifts the tool after a fault or a signal. With ``home = false`` in ``[stage]``, it has to
be lifted by hand.

``stop()`` decelerates the tool in a straight line. For emergencies, use the robot's own button.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Annotated, Any

from annotated_types import Interval

from tacbench_cad.lab.rig import (
    AlarmError,
    Clock,
    Closing,
    Context,
    DeviceLostError,
    Driver,
    NoAnswerError,
    OutOfRangeError,
    PositionLostError,
    RigError,
    no_report,
)
from tacbench_cad.lab.study import Point, StageSettings
from tacbench_cad.util.convert import from_plain
from tacbench_cad.util.errors import InputError, one_line

#: The pause between two questions while the arm moves, in s.
POLL_S = 0.01
#: The largest acceleration of a stop, in m/s^2.
STOP_M_S2 = 10.0
#: A move may take this many times its distance divided by its speed, in addition to the timeout.
SLOWNESS = 3.0


@dataclass(frozen=True, kw_only=True)
class RobotOptions:
    """The options of an arm in ``[stage.options]``.

    Args:
        acceleration_mm_s2: The acceleration of the tool.
        tolerance_mm: The allowed distance of the tool from its target. The repeatability of an UR3e or UR5e is 0.03 mm.
    """

    acceleration_mm_s2: Annotated[float, Interval(ge=1.0, le=5000.0)] = 200.0
    tolerance_mm: Annotated[float, Interval(ge=0.001, le=5.0)] = 0.05


class UniversalRobot(Closing):
    """An arm. See :class:`tacbench_cad.lab.rig.stage.Stage` and the module's description.

    Args:
        address: The name or the number of the robot in the network.
        options: See :class:`RobotOptions`.
        clock: The rig's time.
        timeout_s: The longest wait for the end of a move, in addition to its duration.

    Raises:
        DeviceLostError: The robot cannot be reached.
        AlarmError: The robot is stopped or not switched on.
    """

    simulated = ""

    def __init__(
        self,
        address: str,
        options: RobotOptions | None = None,
        *,
        clock: Clock | None = None,
        timeout_s: float = StageSettings.timeout_s,
    ) -> None:
        import rtde_control
        import rtde_receive

        self._name, self._timeout_s = f"arm at {address}", timeout_s
        self._options, self._clock = options or RobotOptions(), clock or Clock()
        self._report: Callable[[Point], None] = no_report
        self._stopped = self._closed = False
        try:
            self._state: Any = rtde_receive.RTDEReceiveInterface(address)
            self._arm: Any = rtde_control.RTDEControlInterface(address)
        except RuntimeError as error:
            raise DeviceLostError(f"{self._name}: {one_line(error, 200)}; switch remote control on") from None
        self.identity = f"ur: Universal Robots arm at {address}"
        try:
            self._require_ready()
            self._orientation = self._pose()[3:]
        except BaseException:
            self.close()
            raise

    def home(self) -> None:
        """Make the arm ready again after a stop. It does not move.

        Raises:
            AlarmError: The robot is stopped or not switched on.
        """
        self._require_ready()
        if not self._arm.isProgramRunning() and not self._arm.reuploadScript():
            raise AlarmError(f"{self._name}: does not run the program that moves it; switch remote control on")
        self._stopped = False

    def move(self, target_mm: Point, speed_mm_s: float) -> Point:
        """Move the tool in a straight line; finished when the arm is at rest at the target.

        Raises:
            OutOfRangeError: The target is beyond the reach or the safety limits of the arm.
            RigError: The move was stopped, or ended at another position.
            AlarmError: The robot has stopped itself.
            NoAnswerError: The arm does not come to rest.
        """
        self._require_startable()
        start = self.position()
        pose = self._reachable(target_mm)
        acceleration = self._options.acceleration_mm_s2 / 1000.0
        with self._halting():
            if not self._arm.moveL(pose, speed_mm_s / 1000.0, acceleration, True):
                raise AlarmError(f"{self._name}: refuses the move; look at its panel")
            self._arrive(target_mm, math.dist(start, target_mm) / speed_mm_s)
        return self.position()

    def position(self) -> Point:
        """Return the measured position of the tool centre point in mm."""
        x, y, z = (1000.0 * float(value) for value in self._pose()[:3])
        return (x, y, z)

    def report_to(self, receive: Callable[[Point], None]) -> None:
        """See :class:`tacbench_cad.lab.rig.stage.Stage`."""
        self._report = receive

    def stop(self) -> None:
        """Stop the tool in a straight line. Never raises."""
        self._stopped = True
        self._halt()

    def close(self) -> None:
        """End the program on the robot and disconnect. Never raises; a second call has no effect."""
        if self._closed:
            return
        self._closed = True
        for end in (self._arm.stopScript, self._arm.disconnect, self._state.disconnect):
            with contextlib.suppress(Exception):
                end()

    def _arrive(self, target_mm: Point, seconds: float) -> None:
        """Wait until the arm is at rest at a target.

        Args:
            target_mm: The target.
            seconds: The expected duration.
        """
        give_up_s = self._clock.now_s() + SLOWNESS * seconds + self._timeout_s * self._clock.speed
        while True:
            self._clock.sleep(POLL_S)
            self._require_ready()
            # Rest is asked for before the position, so that the position is that of an arm at rest.
            at_rest = self._arm.isSteady()
            at = self.position()
            self._report(at)
            off_mm = max(abs(a - b) for a, b in zip(at, target_mm, strict=True))
            if self._stopped:
                raise RigError(f"{self._name}: the move was stopped on request; home the stage first")
            if at_rest and off_mm <= self._options.tolerance_mm:
                return
            if self._clock.now_s() > give_up_s:
                if at_rest:
                    raise RigError(f"{self._name}: is at rest {off_mm:.3f} mm away from its target")
                raise NoAnswerError(f"{self._name}: does not come to rest; look at its panel")

    def _reachable(self, target_mm: Point) -> list[float]:
        """Return the pose of the tool at a target in m and radians.

        Raises:
            OutOfRangeError: The pose is beyond the reach or the safety limits of the arm.
        """
        pose = [value / 1000.0 for value in target_mm] + self._orientation
        if not self._arm.isPoseWithinSafetyLimits(pose):
            shown = "x {:.3f}, y {:.3f}, z {:.3f} mm".format(*target_mm)
            raise OutOfRangeError(f"{self._name}: {shown} is beyond its reach or its safety limits; nothing moved")
        return pose

    @contextlib.contextmanager
    def _halting(self) -> Iterator[None]:
        """Stop the arm if the body fails."""
        try:
            yield
        except BaseException:
            self._halt()
            raise

    def _require_startable(self) -> None:
        self._require_ready()
        if self._stopped:
            raise PositionLostError(f"{self._name}: was stopped on request; home the stage first")

    def _halt(self) -> None:
        with contextlib.suppress(Exception):
            self._arm.stopL(STOP_M_S2)

    def _pose(self) -> list[float]:
        self._require_connected()
        return [float(value) for value in self._state.getActualTCPPose()]

    def _require_connected(self) -> None:
        if self._closed or not self._state.isConnected():
            raise DeviceLostError(f"{self._name}: is not connected; look at the network and the robot")

    def _require_ready(self) -> None:
        self._require_connected()
        if self._state.isEmergencyStopped():
            raise AlarmError(f"{self._name}: its emergency stop is pressed; release it and start the robot again")
        if self._state.isProtectiveStopped():
            raise AlarmError(f"{self._name}: is in a protective stop; look at its panel, then release the stop")


def _open(settings: StageSettings, context: Context) -> UniversalRobot:
    if settings.port is None:
        raise InputError("[stage] port", None, "is missing; write the address of the robot in the network")
    options = from_plain(RobotOptions, dict(settings.options), "[stage.options] ")
    return UniversalRobot(settings.port, options, clock=context.clock, timeout_s=settings.timeout_s)


DRIVER = Driver(
    open=_open,
    summary="arms of Universal Robots (e-series, CB3)",
    connection="network",
    modules=("rtde_control", "rtde_receive"),
    install="pip install ur-rtde",
)
