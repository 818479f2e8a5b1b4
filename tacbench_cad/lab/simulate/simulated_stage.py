"""A simulated stage, which moves and turns the sensor in time, without firmware, port or faults.

It is in the same process as its user. Other threads may ask for the position and the angles while it moves.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.errors import DeviceLostError, NotThereError, OutOfRangeError, PositionLostError
from tacbench_cad.lab.rig.registry import Driver
from tacbench_cad.lab.rig.stage import Closing, no_report
from tacbench_cad.lab.study.rotation import UPRIGHT, Turn
from tacbench_cad.lab.study.spec import Angles, Point, StageSettings
from tacbench_cad.util.convert import Bounds, from_plain

#: The space in which the summit can move, on each axis, in mm.
REACH_MM = ((0.0, 200.0), (0.0, 200.0), (0.0, 130.0))
#: The summit after homing, and the speeds of homing in mm/s and degrees/s.
HOME_MM: Point = (100.0, 100.0, 100.0)
HOME_MM_S, HOME_DEG_S = 50.0, 30.0
#: The longest pause between two looks at the clock during a motion, in s of real time.
POLL_S = 0.02


@dataclass(frozen=True, kw_only=True)
class _Options:
    speed: Annotated[float, Bounds(0.1, 1000.0)] = 1.0


@dataclass(frozen=True, kw_only=True)
class _Motion:
    """A motion: the summit and the angles at a fraction of it, and its times in s of rig time."""

    at: Callable[[float], tuple[Point, Angles]]
    began_s: float
    ends_s: float


class SimulatedStage(Closing):
    """A simulated stage. See :class:`tacbench_cad.lab.rig.stage.RotatingStage`.

    Args:
        clock: The rig's time.
        summit_mm: The summit at the start.
        angles_deg: The angles at the start: a stage that was left tilted is still tilted when it is opened again.
    """

    def __init__(self, clock: Clock | None = None, summit_mm: Point = HOME_MM, angles_deg: Angles = UPRIGHT) -> None:
        self.identity, self.simulated = "simulated stage", "simulated stage"
        self.clock = clock or Clock()
        self._motion = _Motion(at=lambda fraction: (summit_mm, angles_deg), began_s=0.0, ends_s=0.0)
        self._stopped = self._closed = False
        self._report: Callable[[Point], None] = no_report
        self._report_turn: Callable[[Angles], None] = no_report

    @classmethod
    def open(cls, settings: StageSettings) -> SimulatedStage:
        """Open the stage of a study's ``[stage]``.

        Raises:
            InputError: An option is not allowed.
        """
        options = from_plain(_Options, dict(settings.options), "[stage.options] ")
        return cls(Clock(speed=options.speed))

    def home(self) -> None:
        """Move up, turn upright, and move to the home position."""
        self._require_open()
        self._stopped = False
        x, y, _ = self.position()
        self._move((x, y, HOME_MM[2]), HOME_MM_S)
        self.turn(UPRIGHT, HOME_DEG_S)
        self._move(HOME_MM, HOME_MM_S)

    def move(self, target_mm: Point, speed_mm_s: float) -> Point:
        """See :class:`~tacbench_cad.lab.rig.stage.Stage`."""
        self._require_startable(target_mm)
        self._move(target_mm, speed_mm_s)
        return self.position()

    def turn(
        self,
        angles_deg: Angles,
        speed_deg_s: float,
        *,
        above_mm: float = 0.0,
        by_mm: Point = (0.0, 0.0, 0.0),
    ) -> Angles:
        """See :class:`~tacbench_cad.lab.rig.stage.RotatingStage`."""
        summit, angles = self._pose()
        turn = Turn(summit_mm=summit, from_deg=angles, to_deg=angles_deg, above_mm=above_mm, by_mm=by_mm)
        self._require_startable(turn.at(1.0)[0])
        self._run(turn.at, turn.angle_deg / speed_deg_s)
        return self.rotation()

    def position(self) -> Point:
        """See :class:`~tacbench_cad.lab.rig.stage.Stage`."""
        self._require_open()
        return self._pose()[0]

    def rotation(self) -> Angles:
        """See :class:`~tacbench_cad.lab.rig.stage.RotatingStage`."""
        self._require_open()
        return self._pose()[1]

    def report_to(self, receive: Callable[[Point], None]) -> None:
        """See :class:`~tacbench_cad.lab.rig.stage.Stage`."""
        self._report = receive

    def report_turns_to(self, receive: Callable[[Angles], None]) -> None:
        """See :class:`~tacbench_cad.lab.rig.stage.RotatingStage`."""
        self._report_turn = receive

    def stop(self) -> None:
        """See :class:`~tacbench_cad.lab.rig.stage.Stage`."""
        self._stopped = True
        self._stand()

    def close(self) -> None:
        """Close the stage."""
        self._closed = True

    def _pose(self) -> tuple[Point, Angles]:
        motion, now_s = self._motion, self.clock.now_s()
        if now_s >= motion.ends_s:
            return motion.at(1.0)
        return motion.at((now_s - motion.began_s) / (motion.ends_s - motion.began_s))

    def _stand(self) -> None:
        pose = self._pose()
        self._motion = _Motion(at=lambda fraction: pose, began_s=0.0, ends_s=0.0)

    def _move(self, target_mm: Point, speed_mm_s: float) -> None:
        start, angles = self._pose()

        def at(fraction: float) -> tuple[Point, Angles]:
            if fraction >= 1.0:
                return target_mm, angles
            x, y, z = (a + fraction * (b - a) for a, b in zip(start, target_mm, strict=True))
            return (x, y, z), angles

        self._run(at, math.dist(start, target_mm) / speed_mm_s)

    def _run(self, at: Callable[[float], tuple[Point, Angles]], seconds: float) -> None:
        """Begin a motion and wait for its end.

        Raises:
            NotThereError: The stage was stopped.
        """
        began_s = self.clock.now_s()
        self._motion = _Motion(at=at, began_s=began_s, ends_s=began_s + seconds)
        while (left_s := began_s + seconds - self.clock.now_s()) > 0.0 and not self._stopped:
            self.clock.sleep(min(left_s, POLL_S * self.clock.speed))
            summit, angles = self._pose()
            self._report(summit)
            self._report_turn(angles)
        if self._stopped:
            self._stand()
            raise NotThereError("simulated stage: the motion was stopped on request; home the stage first")

    def _require_open(self) -> None:
        if self._closed:
            raise DeviceLostError("simulated stage: is closed")

    def _require_startable(self, target_mm: Point) -> None:
        self._require_open()
        if self._stopped:
            raise PositionLostError("simulated stage: was stopped on request; home the stage first")
        if not all(low <= value <= high for value, (low, high) in zip(target_mm, REACH_MM, strict=True)):
            shown = "x {:.3f}, y {:.3f}, z {:.3f} mm".format(*target_mm)
            raise OutOfRangeError(f"simulated stage: {shown} is beyond its reach; nothing moved")


#: The driver ``simulated`` of a stage.
DRIVER = Driver(
    open=lambda settings, context: SimulatedStage.open(settings),
    summary="simulated stage, which can also turn the sensor",
    simulated=True,
    turns=True,
    defaults={"origin_mm": (80.0, 80.0, 40.0), "limits_mm": ((0.0, 200.0), (0.0, 200.0), (0.0, 100.0))},
    unrecorded=("speed",),
)
