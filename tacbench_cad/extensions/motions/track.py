"""The positions of a stage during one move, by time.

Most drivers wait in ``move`` until the carriage has arrived, and some firmware cannot say where the carriage is before
that. A track collects what a driver reports during the move, and computes the positions between the reports. Without
reports on the way it assumes that the carriage moved at the requested speed until the driver reported the target. The
carriage accelerates and brakes, so the error on the way is about ``speed^2 / acceleration`` plus the speed times the
delay of the report.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from tacbench_cad.lab.rig import Clock, LimitedStage, Stage, inner, no_report
from tacbench_cad.lab.study import Point
from tacbench_cad.util.types import Floats


class StageTrack:
    """A move from one position to another, in mm of the stage's frame.

    One thread moves the stage and calls :meth:`begin`, :meth:`report` and :meth:`end`. Any thread may read.

    Args:
        start_mm: The position before the move.
        end_mm: The target.
        speed_mm_s: The speed along the line.
        clock: The rig's time.
    """

    def __init__(self, start_mm: Point, end_mm: Point, speed_mm_s: float, clock: Clock) -> None:
        self.start_mm, self.end_mm, self.speed_mm_s = start_mm, end_mm, speed_mm_s
        self.length_mm = math.dist(start_mm, end_mm)
        self._clock = clock
        self._seen: list[tuple[float, Point]] = []
        self._ended_s = math.inf

    @property
    def is_reported(self) -> bool:
        """Whether the stage has reported its position between the start and the end."""
        return any(at not in (self.start_mm, self.end_mm) for _, at in self._seen[1:])

    def is_early(self) -> bool:
        """Return whether the move has not begun yet."""
        return not self._seen

    def begin(self) -> None:
        """Record that the move begins now."""
        self._seen = [(self._clock.now_s(), self.start_mm)]

    def report(self, at_mm: Point) -> None:
        """Record a position that the stage reports now."""
        if self._seen and self._ended_s == math.inf:
            self._seen.append((self._clock.now_s(), at_mm))

    def end(self) -> None:
        """Record that the stage has arrived."""
        self._ended_s = self._clock.now_s()

    def now_mm(self) -> Point:
        """Return the estimated position at this moment."""
        now_s = self._clock.now_s()
        if not self._seen:
            return self.start_mm
        if now_s >= self._ended_s:
            return self.end_mm
        seen_s, at = self._seen[-1]
        left_mm = math.dist(at, self.end_mm)
        fraction = min(1.0, (now_s - seen_s) * self.speed_mm_s / left_mm) if left_mm else 1.0
        x, y, z = (a + fraction * (b - a) for a, b in zip(at, self.end_mm, strict=True))
        return (x, y, z)

    def at_mm(self, times_s: Floats) -> Floats:
        """Return the positions at some times after the end of the move, shape (n, 3)."""
        times = [seen_s for seen_s, _ in self._seen] + [self._ended_s]
        points = [at for _, at in self._seen] + [self.end_mm]
        if not self.is_reported:
            # The firmware may begin late, so the time of arrival counts.
            arrived_s = next((seen_s for seen_s, at in self._seen[1:] if at == self.end_mm), self._ended_s)
            begun_s = max(times[0], arrived_s - self.length_mm / self.speed_mm_s)
            times, points = [begun_s, arrived_s], [self.start_mm, self.end_mm]
        columns = [np.interp(times_s, times, [point[axis] for point in points]) for axis in range(3)]
        return np.stack(columns, axis=1)


@contextmanager
def tracked(stage: Stage, track: StageTrack) -> Iterator[None]:
    """Send what a stage reports while it moves to a track, and show the track to the devices that follow the stage."""
    report_to = getattr(inner(stage), "report_to", lambda receive: None)
    if isinstance(stage, LimitedStage):
        stage.moving_mm = track.now_mm
    report_to(track.report)
    try:
        yield
    finally:
        if isinstance(stage, LimitedStage):
            stage.moving_mm = None
        report_to(no_report)
