"""A simulated stage, which moves the sensor in time, without firmware, port or faults.

It is in the same process as its user. Other threads may ask for the position while it moves.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

from annotated_types import Interval

from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.errors import DeviceLostError, OutOfRangeError, PositionLostError, RigError
from tacbench_cad.lab.rig.registry import Driver
from tacbench_cad.lab.rig.stage import Closing, Limits, no_report
from tacbench_cad.lab.study.spec import Point, StageSettings
from tacbench_cad.util.convert import from_plain

#: The space in which the summit can move, on each axis, in mm, unless the settings say something else.
REACH_MM: Limits = ((0.0, 200.0), (0.0, 200.0), (0.0, 100.0))
#: The speed of homing in mm/s.
HOME_MM_S = 50.0
#: The longest pause between two looks at the clock during a motion, in s of real time.
POLL_S = 0.02


@dataclass(frozen=True, kw_only=True)
class _Options:
    speed: Annotated[float, Interval(ge=0.1, le=1000.0)] = 1.0
    waits: bool = True


class SimulatedStage(Closing):
    """A simulated stage. See :class:`tacbench_cad.lab.rig.stage.Stage`.

    Args:
        clock: The rig's time.
        reach_mm: The space in which the summit can move. The home position is at the middle of x and y, and at the top.
    """

    def __init__(self, clock: Clock | None = None, reach_mm: Limits = REACH_MM) -> None:
        self.identity, self.simulated = "simulated stage", "simulated stage"
        self.clock, self._reach_mm = clock or Clock(), reach_mm
        (west, east), (south, north), (_, top) = reach_mm
        self._home_mm: Point = ((west + east) / 2.0, (south + north) / 2.0, top)
        self._start_mm = self._end_mm = self._home_mm
        self._began_s = self._ends_s = 0.0
        self._stopped = self._closed = False
        self._report: Callable[[Point], None] = no_report

    @classmethod
    def open(cls, settings: StageSettings) -> SimulatedStage:
        """Open the stage of a study's ``[stage]``.

        Raises:
            InputError: An option is not allowed.
        """
        options = from_plain(_Options, dict(settings.options), "[stage.options] ")
        return cls(Clock(speed=options.speed if options.waits else math.inf), settings.limits_mm)

    def home(self) -> None:
        """Move up, and then to the home position."""
        self._require_open()
        self._stopped = False
        x, y, _ = self.position()
        self._move((x, y, self._home_mm[2]), HOME_MM_S)
        self._move(self._home_mm, HOME_MM_S)

    def move(self, target_mm: Point, speed_mm_s: float) -> Point:
        """See :class:`~tacbench_cad.lab.rig.stage.Stage`."""
        self._require_startable(target_mm)
        self._move(target_mm, speed_mm_s)
        return self.position()

    def position(self) -> Point:
        """See :class:`~tacbench_cad.lab.rig.stage.Stage`."""
        self._require_open()
        now_s = self.clock.now_s()
        if now_s >= self._ends_s:
            return self._end_mm
        fraction = (now_s - self._began_s) / (self._ends_s - self._began_s)
        x, y, z = (a + fraction * (b - a) for a, b in zip(self._start_mm, self._end_mm, strict=True))
        return (x, y, z)

    def report_to(self, receive: Callable[[Point], None]) -> None:
        """See :class:`~tacbench_cad.lab.rig.stage.Stage`."""
        self._report = receive

    def stop(self) -> None:
        """See :class:`~tacbench_cad.lab.rig.stage.Stage`."""
        self._stopped = True
        self._stand()

    def close(self) -> None:
        """Close the stage."""
        self._closed = True

    def _stand(self) -> None:
        self._start_mm = self._end_mm = self.position()
        self._ends_s = 0.0

    def _move(self, target_mm: Point, speed_mm_s: float) -> None:
        """Begin a motion and wait for its end.

        Raises:
            RigError: The stage was stopped.
        """
        start, began_s = self.position(), self.clock.now_s()
        ends_s = began_s + math.dist(start, target_mm) / speed_mm_s
        self._start_mm, self._end_mm, self._began_s, self._ends_s = start, target_mm, began_s, ends_s
        while (left_s := ends_s - self.clock.now_s()) > 0.0 and not self._stopped:
            self.clock.sleep(min(left_s, POLL_S * self.clock.speed))
            self._report(self.position())
        if self._stopped:
            self._stand()
            raise RigError("simulated stage: the motion was stopped on request; home the stage first")

    def _require_open(self) -> None:
        if self._closed:
            raise DeviceLostError("simulated stage: is closed")

    def _require_startable(self, target_mm: Point) -> None:
        self._require_open()
        if self._stopped:
            raise PositionLostError("simulated stage: was stopped on request; home the stage first")
        if not all(low <= value <= high for value, (low, high) in zip(target_mm, self._reach_mm, strict=True)):
            shown = "x {:.3f}, y {:.3f}, z {:.3f} mm".format(*target_mm)
            raise OutOfRangeError(f"simulated stage: {shown} is beyond its reach; nothing moved")


#: The driver ``simulated`` of a stage.
DRIVER = Driver(
    open=lambda settings, context: SimulatedStage.open(settings),
    summary="simulated stage",
    simulated=True,
    defaults={"origin_mm": (80.0, 80.0, 40.0), "limits_mm": ((0.0, 200.0), (0.0, 200.0), (0.0, 100.0))},
    unrecorded=("speed", "waits"),
)
