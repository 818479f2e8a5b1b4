"""The carriage of a virtual stage: three motors, their end stops, and the step counters.

Strokes are straight, from rest to rest, with constant acceleration (trapezoids, without look-ahead over corners). The
*counted* position is the one that the firmware has stepped to; the *true* position is that of the carriage. They differ
after the counters are cleared, after the carriage runs into the end of an axis, and after a motor slips or stalls.
"""

from __future__ import annotations

import math
import random
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from tacbench_cad.lab.study import Point
from tacbench_cad.util.errors import InputError

#: The axes by their letters.
AXES = "xyz"


def replaced(point: Point, axis: int, value: float) -> Point:
    """Return a point with another coordinate on one axis."""
    x, y, z = (value if i == axis else coordinate for i, coordinate in enumerate(point))
    return (x, y, z)


def along_path(start: Point, end: Point, limits: Sequence[float]) -> float:
    """Return the largest speed (or acceleration) along a path within each axis's limit; 0 for a path of length 0."""
    length = math.dist(start, end)
    return min(
        (limit * length / abs(b - a) for a, b, limit in zip(start, end, limits, strict=True) if a != b), default=0.0
    )


@dataclass(frozen=True, kw_only=True)
class MotorAxis:
    """One axis, in the frame that the firmware has after an ideal homing.

    Args:
        low_mm: The lower end of the working range.
        high_mm: The upper end of the working range.
        home: -1 if the end stop is at the lower end, 1 if it is at the upper end.
        switch_mm: The distance beyond the working range at which the end stop closes.
        slack_mm: The distance that the carriage can move beyond the switch, and beyond the other end, before it hits
            the frame of the machine.
        steps_per_mm: The motor steps per mm.
    """

    low_mm: float
    high_mm: float
    home: int
    switch_mm: float
    steps_per_mm: float
    slack_mm: float = 2.0

    @property
    def switch_at_mm(self) -> float:
        """The position at which the end stop closes."""
        return self.high_mm + self.switch_mm if self.home > 0 else self.low_mm - self.switch_mm

    @property
    def ends_mm(self) -> tuple[float, float]:
        """The positions at which the carriage hits the frame of the machine."""
        low = self.low_mm - self.slack_mm - (self.switch_mm if self.home < 0 else 0.0)
        high = self.high_mm + self.slack_mm + (self.switch_mm if self.home > 0 else 0.0)
        return low, high

    def within(self, value_mm: float) -> float:
        """Return a position limited to the ends of the axis."""
        low, high = self.ends_mm
        return min(high, max(low, value_mm))

    @property
    def travel_mm(self) -> float:
        """The length of the working range."""
        return self.high_mm - self.low_mm

    def stepped(self, value_mm: float) -> float:
        """Return the position in whole steps nearest to ``value_mm``."""
        return round(value_mm * self.steps_per_mm) / self.steps_per_mm


@dataclass(frozen=True, kw_only=True)
class Stroke:
    """A straight motion that ends at rest.

    Args:
        start: The counted position at the start, in mm.
        end: The counted position at the end, in mm.
        peak_mm_s: The highest speed.
        acceleration_mm_s2: The acceleration and deceleration.
        begin_s: The time of the start.
        entry_mm_s: The speed at the start (above 0 only for the rest of a stroke that is being stopped).
    """

    start: Point
    end: Point
    peak_mm_s: float
    acceleration_mm_s2: float
    begin_s: float
    entry_mm_s: float = 0.0

    @property
    def length_mm(self) -> float:
        """The length of the path."""
        return math.dist(self.start, self.end)

    def _profile(self) -> tuple[float, float, float, float]:
        """Return the top speed, and the durations of acceleration, cruise and deceleration: v^2 = v0^2 + 2 a s."""
        a, v0, length = self.acceleration_mm_s2, self.entry_mm_s, self.length_mm
        top = max(v0, min(self.peak_mm_s, math.sqrt((2.0 * a * length + v0 * v0) / 2.0)))
        ramps = (2.0 * top * top - v0 * v0) / (2.0 * a)
        cruise = max(0.0, length - ramps) / top if top > 0.0 else 0.0
        return top, (top - v0) / a, cruise, top / a

    @property
    def end_s(self) -> float:
        """The time of the end."""
        _, up, cruise, down = self._profile()
        return self.begin_s + up + cruise + down

    def travelled_mm(self, now_s: float) -> float:
        """Return the length travelled at a time, from 0 to :attr:`length_mm`."""
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
        """Return the speed at a time."""
        top, up, cruise, down = self._profile()
        t = now_s - self.begin_s
        if t < 0.0 or t >= up + cruise + down:
            return 0.0
        if t < up:
            return self.entry_mm_s + self.acceleration_mm_s2 * t
        return min(top, self.acceleration_mm_s2 * (up + cruise + down - t))

    def at(self, now_s: float) -> Point:
        """Return the counted position at a time, in mm."""
        length = self.length_mm
        part = self.travelled_mm(now_s) / length if length > 0.0 else 1.0
        if part >= 1.0:
            return self.end
        x, y, z = (a + (b - a) * part for a, b in zip(self.start, self.end, strict=True))
        return (x, y, z)

    def when_s(self, travelled_mm: float) -> float:
        """Return the time at which a length has been travelled, by bisection (the length increases with time)."""
        low, high = self.begin_s, self.end_s
        for _ in range(60):
            middle = (low + high) / 2.0
            if self.travelled_mm(middle) < travelled_mm:
                low = middle
            else:
                high = middle
        return high


class VirtualCarriage:
    """Three axes that are moved by counted steps.

    Args:
        axes: The axes x, y, z.
        true_mm: The true position at power-on; the counters are then 0, 0, 0.
        random_: The source of the end stops' scatter.
        switch_scatter_mm: The largest deviation of an end stop from its nominal position, in mm.
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
        #: The axes whose end stop stays closed wherever the carriage is.
        self.stuck_switches: set[int] = set()

    # Position

    def counted(self, now_s: float) -> Point:
        """Return the position of the step counters in mm, in whole steps. The last step is made at the stroke's end."""
        if not self._queue:
            return self._counted
        stroke = self._queue[0]
        raw = stroke.at(now_s)
        if raw == stroke.end:
            return stroke.end
        # Only whole steps count, so the position is rounded back towards the start of the stroke.
        x, y, z = (
            (math.floor if value >= start else math.ceil)(value * axis.steps_per_mm) / axis.steps_per_mm
            for axis, value, start in zip(self.axes, raw, stroke.start, strict=True)
        )
        return (x, y, z)

    def true(self, now_s: float) -> Point:
        """Return the true position of the carriage in mm."""
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
        """Return the axes whose end stop is closed."""
        true = self.true(now_s)
        # A switch closes within its scatter, and the counters know only whole steps.
        return tuple(
            i
            for i, axis in enumerate(self.axes)
            if i in self.stuck_switches
            or (true[i] - axis.switch_at_mm) * axis.home >= -(self._scatter_mm + 1.0 / axis.steps_per_mm)
        )

    # Motion

    @property
    def moving(self) -> bool:
        """Whether a stroke is running or waiting."""
        return bool(self._queue)

    @property
    def queued(self) -> int:
        """The number of strokes that are running or waiting."""
        return len(self._queue)

    def speed_mm_s(self, now_s: float) -> float:
        """Return the speed along the path."""
        return self._queue[0].speed_mm_s(now_s) if self._queue else 0.0

    @property
    def planned(self) -> Point:
        """The counted position after the last queued stroke."""
        return self._queue[-1].end if self._queue else self._counted

    def go(self, target: Point, speed_mm_s: float, acceleration_mm_s2: float, now_s: float) -> bool:
        """Queue a stroke. It starts after the earlier ones have ended.

        Args:
            target: The counted target in mm; it is rounded to whole steps.
            speed_mm_s: The speed along the path.
            acceleration_mm_s2: The acceleration along the path.
            now_s: The rig time.

        Returns:
            Whether there is a distance to move.
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
        """Decelerate to a stop.

        Returns:
            The unfinished strokes, in order.
        """
        if not self._queue:
            return []
        stroke = self._queue[0]
        unfinished = list(self._queue)
        self._queue.clear()
        here, speed = stroke.at(now_s), stroke.speed_mm_s(now_s)
        stretch = speed * speed / (2.0 * stroke.acceleration_mm_s2)
        left = stroke.length_mm - stroke.travelled_mm(now_s)
        # A stroke that has almost ended continues to its end. A stroke that has not begun stays unchanged.
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
        """Stop at once and clear the queue. The counters keep the steps that were made."""
        self._rest_at(self.counted(now_s))

    def _rest_at(self, counted: Point) -> None:
        # Read before the queue is cleared: a carriage at its mechanical end stays there while the counters continued.
        true = self._true_of(counted)
        self._queue.clear()
        self._switch = None
        self._counted = counted
        self._anchor_counted, self._anchor_true = counted, true

    def count_as(self, counted: Point) -> None:
        """Set the step counters without motion. Allowed only at rest."""
        true = self._true_of(self._counted)
        self._counted = self._anchor_counted = counted
        self._anchor_true = true

    def slip(self, axis: int, by_mm: float, now_s: float) -> None:
        """Let a motor slip: the carriage moves, but the counters do not change."""
        self._anchor(now_s)
        self._anchor_true = replaced(self._anchor_true, axis, self.axes[axis].within(self._anchor_true[axis] + by_mm))
        self._find_switch()

    def turn_only(self, axis: int, fraction: float, now_s: float) -> None:
        """Let a motor make only a fraction of its steps from now on: 1 is normal, 0 is stalled."""
        self._anchor(now_s)
        self._gain[axis] = fraction
        self._find_switch()

    def _anchor(self, now_s: float) -> None:
        counted = self._queue[0].at(now_s) if self._queue else self._counted
        self._anchor_true = self._true_of(counted)
        self._anchor_counted = counted

    # Events

    def next_event_s(self) -> float | None:
        """Return the time at which a stroke ends or an end stop closes next; None at rest."""
        if not self._queue:
            return None
        end = self._queue[0].end_s
        return end if self._switch is None else min(end, self._switch[0])

    def advance(self, now_s: float) -> int | None:
        """Continue the present stroke, at most to the next event.

        Returns:
            The axis whose end stop closed at this event, if any.
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
        """Find the first time, after a given one, at which the present stroke closes an end stop."""
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
