"""The carriage of a virtual stage: three motors, their end stops, and what the step counters believe.

Strokes are straight, from rest to rest, with constant acceleration (trapezoids; no look-ahead over corners). The
*counted* position is what the firmware has stepped; the *true* one is where the carriage is. They part company when
the counters are cleared, when the carriage runs into the end of an axis, and when a motor slips or stalls.
"""

from __future__ import annotations

import math
import random
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from tacbench_cad.lab.study.spec import Point
from tacbench_cad.util.errors import InputError

#: The axes by their letters.
AXES = "xyz"


def replaced(point: Point, axis: int, value: float) -> Point:
    """A point with another coordinate on one axis."""
    x, y, z = (value if i == axis else coordinate for i, coordinate in enumerate(point))
    return (x, y, z)


def along_path(start: Point, end: Point, limits: Sequence[float]) -> float:
    """The speed (or acceleration) along a straight path at which no axis exceeds its own limit; 0 without a path."""
    length = math.dist(start, end)
    return min(
        (limit * length / abs(b - a) for a, b, limit in zip(start, end, limits, strict=True) if a != b), default=0.0
    )


@dataclass(frozen=True, kw_only=True)
class MotorAxis:
    """One axis, in the frame that the firmware has after a flawless homing.

    Args:
        low_mm: Lower end of the working range.
        high_mm: Upper end.
        home: -1 if the end stop is at the lower end, 1 if at the upper one.
        switch_mm: The end stop closes so far beyond the working range.
        slack_mm: Behind the switch, and behind the other end, the carriage can go so far before it hits something.
        steps_per_mm: Motor steps for a millimetre.
    """

    low_mm: float
    high_mm: float
    home: int
    switch_mm: float
    steps_per_mm: float
    slack_mm: float = 2.0

    @property
    def switch_at_mm(self) -> float:
        """Where the end stop closes."""
        return self.high_mm + self.switch_mm if self.home > 0 else self.low_mm - self.switch_mm

    @property
    def ends_mm(self) -> tuple[float, float]:
        """Where the carriage hits the frame of the machine."""
        low = self.low_mm - self.slack_mm - (self.switch_mm if self.home < 0 else 0.0)
        high = self.high_mm + self.slack_mm + (self.switch_mm if self.home > 0 else 0.0)
        return low, high

    def within(self, value_mm: float) -> float:
        """The position itself, or the end that it lies beyond."""
        low, high = self.ends_mm
        return min(high, max(low, value_mm))

    @property
    def travel_mm(self) -> float:
        """Length of the working range."""
        return self.high_mm - self.low_mm

    def stepped(self, value_mm: float) -> float:
        """The position that whole steps can hold, nearest to ``value_mm``."""
        return round(value_mm * self.steps_per_mm) / self.steps_per_mm


@dataclass(frozen=True, kw_only=True)
class Stroke:
    """A straight motion that ends at rest.

    Args:
        start: Counted position at the start, in mm.
        end: Counted position at the end.
        peak_mm_s: Speed that is not exceeded.
        acceleration_mm_s2: Of speeding up and slowing down.
        begin_s: When it starts.
        entry_mm_s: Speed at the start (above 0 only for the rest of a stroke that is being stopped).
    """

    start: Point
    end: Point
    peak_mm_s: float
    acceleration_mm_s2: float
    begin_s: float
    entry_mm_s: float = 0.0

    @property
    def length_mm(self) -> float:
        """Length of the path."""
        return math.dist(self.start, self.end)

    def _profile(self) -> tuple[float, float, float, float]:
        """Top speed, and the durations of speeding up, cruising and slowing down: v^2 = v0^2 + 2 a s."""
        a, v0, length = self.acceleration_mm_s2, self.entry_mm_s, self.length_mm
        top = max(v0, min(self.peak_mm_s, math.sqrt((2.0 * a * length + v0 * v0) / 2.0)))
        ramps = (2.0 * top * top - v0 * v0) / (2.0 * a)
        cruise = max(0.0, length - ramps) / top if top > 0.0 else 0.0
        return top, (top - v0) / a, cruise, top / a

    @property
    def end_s(self) -> float:
        """When it ends."""
        _, up, cruise, down = self._profile()
        return self.begin_s + up + cruise + down

    def travelled_mm(self, now_s: float) -> float:
        """Length travelled at a time, from 0 to :attr:`length_mm`."""
        top, up, cruise, down = self._profile()
        t = now_s - self.begin_s
        if t <= 0.0:
            return 0.0
        if t >= up + cruise + down:
            return self.length_mm
        a = self.acceleration_mm_s2
        if t < up:
            return self.entry_mm_s * t + a * t * t / 2.0
        if t < up + cruise:
            return (top * top - self.entry_mm_s**2) / (2.0 * a) + top * (t - up)
        left = up + cruise + down - t
        return max(0.0, self.length_mm - a * left * left / 2.0)

    def speed_mm_s(self, now_s: float) -> float:
        """Speed at a time."""
        top, up, cruise, down = self._profile()
        t = now_s - self.begin_s
        if t < 0.0 or t >= up + cruise + down:
            return 0.0
        if t < up:
            return self.entry_mm_s + self.acceleration_mm_s2 * t
        return min(top, self.acceleration_mm_s2 * (up + cruise + down - t))

    def at(self, now_s: float) -> Point:
        """Counted position at a time, in mm."""
        length = self.length_mm
        part = self.travelled_mm(now_s) / length if length > 0.0 else 1.0
        if part >= 1.0:
            return self.end
        x, y, z = (a + (b - a) * part for a, b in zip(self.start, self.end, strict=True))
        return (x, y, z)

    def when_s(self, travelled_mm: float) -> float:
        """The time at which so much is travelled, by bisection (the length grows with time)."""
        low, high = self.begin_s, self.end_s
        for _ in range(60):
            middle = (low + high) / 2.0
            if self.travelled_mm(middle) < travelled_mm:
                low = middle
            else:
                high = middle
        return high


class Carriage:
    """Three axes that are moved by counted steps.

    Args:
        axes: The axes x, y, z.
        true_mm: Where the carriage stands when the power comes on; the counters then say 0, 0, 0.
        random_: Source of the end stops' scatter.
        switch_scatter_mm: The end stops close within so much of their place.
    """

    def __init__(
        self, axes: Sequence[MotorAxis], true_mm: Point, random_: random.Random, switch_scatter_mm: float = 0.001
    ) -> None:
        self.axes = tuple(axes)
        for name, axis, value in zip(AXES, self.axes, true_mm, strict=True):
            low, high = axis.ends_mm
            if not low <= value <= high:
                raise InputError(f"start {name}", value, f"must be from {low:g} to {high:g} mm")
        self._random = random_
        self._scatter_mm = switch_scatter_mm
        self._now_s = 0.0
        self._counted: Point = (0.0, 0.0, 0.0)
        self._anchor_counted: Point = self._counted
        self._anchor_true: Point = true_mm
        self._gain = [1.0, 1.0, 1.0]
        self._queue: deque[Stroke] = deque()
        self._switch: tuple[float, int] | None = None

    # Where it is

    def counted(self, now_s: float) -> Point:
        """What the step counters say, in mm, whole steps; the last step is made when the stroke ends."""
        if not self._queue:
            return self._counted
        stroke = self._queue[0]
        raw = stroke.at(now_s)
        if raw == stroke.end:
            return stroke.end
        # Only whole steps count: rounded back towards where the stroke came from.
        x, y, z = (
            (math.floor if value >= start else math.ceil)(value * axis.steps_per_mm) / axis.steps_per_mm
            for axis, value, start in zip(self.axes, raw, stroke.start, strict=True)
        )
        return (x, y, z)

    def true(self, now_s: float) -> Point:
        """Where the carriage is, in mm."""
        counted = self._queue[0].at(now_s) if self._queue else self._counted
        return self._true_of(counted)

    def _true_of(self, counted: Point) -> Point:
        x, y, z = (
            axis.within(true + gain * (now - then))
            for axis, true, gain, now, then in zip(
                self.axes, self._anchor_true, self._gain, counted, self._anchor_counted, strict=True
            )
        )
        return (x, y, z)

    def pressed(self, now_s: float) -> tuple[int, ...]:
        """Axes whose end stop is closed."""
        true = self.true(now_s)
        # A switch closes within the scatter, and the counters know whole steps only.
        return tuple(
            i
            for i, axis in enumerate(self.axes)
            if (true[i] - axis.switch_at_mm) * axis.home >= -(self._scatter_mm + 1.0 / axis.steps_per_mm)
        )

    # Motion

    @property
    def moving(self) -> bool:
        """Whether a stroke is under way or waits."""
        return bool(self._queue)

    @property
    def queued(self) -> int:
        """Number of strokes under way or waiting."""
        return len(self._queue)

    def speed_mm_s(self, now_s: float) -> float:
        """Speed along the path."""
        return self._queue[0].speed_mm_s(now_s) if self._queue else 0.0

    @property
    def planned(self) -> Point:
        """Counted position after the last queued stroke."""
        return self._queue[-1].end if self._queue else self._counted

    def go(self, target: Point, speed_mm_s: float, acceleration_mm_s2: float, now_s: float) -> bool:
        """Queue a stroke; it starts when the ones before it have ended.

        Args:
            target: Counted position in mm; rounded to whole steps.
            speed_mm_s: Speed along the path.
            acceleration_mm_s2: Along the path.
            now_s: Rig time.

        Returns:
            Whether there is anything to move.
        """
        x, y, z = (axis.stepped(value) for axis, value in zip(self.axes, target, strict=True))
        if (x, y, z) == self.planned:
            return False
        begin = self._queue[-1].end_s if self._queue else now_s
        self._queue.append(
            Stroke(
                start=self.planned,
                end=(x, y, z),
                peak_mm_s=speed_mm_s,
                acceleration_mm_s2=acceleration_mm_s2,
                begin_s=begin,
            )
        )
        if len(self._queue) == 1:
            self._find_switch()
        return True

    def slow_down(self, now_s: float) -> list[Stroke]:
        """Stop by slowing down.

        Returns:
            The strokes that are not finished, in order.
        """
        if not self._queue:
            return []
        stroke = self._queue[0]
        unfinished = list(self._queue)
        self._queue.clear()
        here, speed = stroke.at(now_s), stroke.speed_mm_s(now_s)
        stretch = speed * speed / (2.0 * stroke.acceleration_mm_s2)
        left = stroke.length_mm - stroke.travelled_mm(now_s)
        # A stroke that has all but ended goes to its end; one that has not begun stays.
        rest = min(1.0, stretch / left) if speed > 0.0 and left > 0.0 else float(speed > 0.0)
        target = [a + (b - a) * rest for a, b in zip(here, stroke.end, strict=True)]
        if rest < 1.0:
            target = [axis.stepped(value) for axis, value in zip(self.axes, target, strict=True)]
        stop = (target[0], target[1], target[2])
        if math.dist(here, stop) == 0.0:
            self._rest_at(stop)
            return unfinished
        self._queue.append(
            Stroke(
                start=here,
                end=stop,
                peak_mm_s=speed,
                acceleration_mm_s2=max(stroke.acceleration_mm_s2, speed * speed / (2.0 * math.dist(here, stop))),
                begin_s=now_s,
                entry_mm_s=speed,
            )
        )
        self._find_switch()
        return unfinished

    def halt(self, now_s: float) -> None:
        """Stop at once; what was queued is forgotten. The counters keep the steps that were made."""
        self._rest_at(self.counted(now_s))

    def _rest_at(self, counted: Point) -> None:
        # Taken before the queue is cleared: a carriage that ran into its end stays there while the counters ran on.
        true = self._true_of(counted)
        self._queue.clear()
        self._switch = None
        self._counted = counted
        self._anchor_counted, self._anchor_true = counted, true

    def count_as(self, counted: Point) -> None:
        """Set the step counters without moving. Only at rest."""
        true = self._true_of(self._counted)
        self._counted = self._anchor_counted = counted
        self._anchor_true = true

    def slip(self, axis: int, by_mm: float, now_s: float) -> None:
        """A motor slips: the carriage stands elsewhere, the counters don't know."""
        self._anchor(now_s)
        self._anchor_true = replaced(self._anchor_true, axis, self.axes[axis].within(self._anchor_true[axis] + by_mm))
        self._find_switch()

    def turn_only(self, axis: int, fraction: float, now_s: float) -> None:
        """From now on a motor makes only a fraction of its steps: 1 is healthy, 0 stalled."""
        self._anchor(now_s)
        self._gain[axis] = fraction
        self._find_switch()

    def _anchor(self, now_s: float) -> None:
        counted = self._queue[0].at(now_s) if self._queue else self._counted
        self._anchor_true = self._true_of(counted)
        self._anchor_counted = counted

    # Events

    def next_event_s(self) -> float | None:
        """When a stroke ends or an end stop closes next; None at rest."""
        if not self._queue:
            return None
        end = self._queue[0].end_s
        return end if self._switch is None else min(end, self._switch[0])

    def advance(self, now_s: float) -> int | None:
        """Let the present stroke go on, at most to the next event.

        Returns:
            The axis whose end stop closed at this event.
        """
        closed = None
        if self._switch is not None and now_s >= self._switch[0]:
            after_s, closed = self._switch
            self._find_switch(after_s)
        if self._queue and now_s >= self._queue[0].end_s:
            later = list(self._queue)[1:]
            self._rest_at(self._queue[0].end)
            self._queue.extend(later)
            self._find_switch()
        return closed

    def _find_switch(self, after_s: float = -math.inf) -> None:
        """Work out when the present stroke closes an end stop, the first after a time."""
        self._switch = None
        if not self._queue:
            return
        stroke = self._queue[0]
        for i, axis in enumerate(self.axes):
            reach = (stroke.end[i] - stroke.start[i]) * axis.home * self._gain[i]
            if reach <= 0.0:
                continue
            scatter = self._random.uniform(-self._scatter_mm, self._scatter_mm)
            start_true = self._anchor_true[i] + self._gain[i] * (stroke.start[i] - self._anchor_counted[i])
            ahead = (axis.switch_at_mm + scatter - start_true) * axis.home
            if 0.0 < ahead <= reach:
                when = stroke.when_s(ahead / reach * stroke.length_mm)
                if when > after_s and (self._switch is None or when < self._switch[0]):
                    self._switch = (when, i)
