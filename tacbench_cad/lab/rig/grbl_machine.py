"""What the numbered settings of GRBL say about its machine: travel, limits, rates, switches and resolution."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from tacbench_cad.lab.rig.errors import RigError
from tacbench_cad.lab.rig.serial_stage import duration_s
from tacbench_cad.lab.rig.stage import Limits
from tacbench_cad.lab.study.spec import Point
from tacbench_cad.util.errors import InputError

#: The value of ``$1`` that keeps the motors powered at rest.
ALWAYS_ON = 255
#: The allowed distance of a reported position from the straight line to the target, in mm.
ASIDE_MM = 0.05


@dataclass(frozen=True, kw_only=True)
class GrblMachine:
    """The machine behind a GRBL.

    Args:
        name: The name of the device, for error messages.
        settings: The firmware's numbered settings.
        options: The letters of the build's options, for example ``VZ``; None if unknown.
    """

    name: str
    settings: Mapping[int, float]
    options: str | None

    @property
    def counts_from_switch(self) -> bool | None:
        """Whether a coordinate is 0 at the switch, and not after homing (a build with the option Z); None: unknown."""
        return None if self.options is None else "Z" not in self.options

    @property
    def pull_off_mm(self) -> float:
        """The distance from a switch at which homing ends (``$27``)."""
        return self.settings.get(27, 1.0)

    def homes_downwards(self, axis: int) -> bool:
        """Return whether the switch of an axis is at its lowest coordinate (``$23``)."""
        return bool(int(self.settings.get(23, 0.0)) >> axis & 1)

    def require_pressable(self) -> None:
        """Refuse settings with which the sensor must not press.

        Raises:
            RigError: The firmware reports inches, switches its motors off at rest, or has homing without soft
                limits.
        """
        if int(self.settings.get(22, 0.0)) & 1 and self.settings.get(20) == 0.0:
            raise RigError(
                f"{self.name}: has no soft limits ($20=0); send it $20=1, and $21=1 so that the end stops stop moves"
            )
        if self.settings.get(13, 0.0) != 0.0:
            raise RigError(f"{self.name}: reports inches; send it $13=0")
        if (delay_ms := self.settings.get(1, ALWAYS_ON)) != ALWAYS_ON:
            raise RigError(
                f"{self.name}: switches its motors off {delay_ms:g} ms after each move ($1={delay_ms:g}), so "
                f"the sensor would press without power; send it $1={ALWAYS_ON} once with a serial terminal"
            )

    @property
    def top_mm(self) -> float:
        """The highest z in mm that the stage reaches without closing the end stop of z."""
        has_limits = self.settings.get(21, 0.0) != 0.0
        is_limited = not self.homes_downwards(2) and has_limits and self.counts_from_switch
        return -self.pull_off_mm if is_limited else math.inf

    @property
    def travel_mm(self) -> tuple[tuple[float, float] | None, ...]:
        """The lowest and highest coordinate that the firmware's soft limits allow; None for an axis without them."""
        if self.settings.get(20, 0.0) == 0.0 or self.counts_from_switch is None:
            return (None, None, None)
        ranges: list[tuple[float, float] | None] = []
        for axis in range(3):
            travel_mm = self.settings.get(130 + axis)
            if travel_mm is None:
                ranges.append(None)
            else:
                is_positive = self.homes_downwards(axis) and not self.counts_from_switch
                ranges.append((0.0, travel_mm) if is_positive else (-travel_mm, 0.0))
        return tuple(ranges)

    def kept_limits_mm(self, limits_mm: Limits) -> Limits:
        """Return the limits of a study file, shortened so that no end stop is reached.

        Raises:
            InputError: The limits reach beyond the travel at which the firmware stops.
        """
        for axis, (low, high), allowed in zip("xyz", limits_mm, self.travel_mm, strict=True):
            if allowed is not None and not allowed[0] <= low <= high <= allowed[1]:
                raise InputError(
                    f"[stage] limits_mm {axis}",
                    [low, high],
                    f"reaches beyond the travel that the firmware allows, {allowed[0]:g} to {allowed[1]:g} mm "
                    f"(its settings $20 and ${130 + 'xyz'.index(axis)})",
                )
        x, y, (low, high) = limits_mm
        return (x, y, (low, min(high, self.top_mm)))

    def resolution_mm(self, axis: int) -> float:
        """Return half a motor step plus the rounding of reports, in mm."""
        steps_per_mm = self.settings.get(100 + axis, 0.0)
        return 0.5 / steps_per_mm + 0.0015 if steps_per_mm > 0.0 else 0.01

    @property
    def _rates_mm_s(self) -> tuple[float, ...]:
        return tuple(self.settings.get(110 + axis, 0.0) / 60.0 for axis in range(3))

    def travel_s(self, start: Point, target: Point, speed_mm_s: float) -> float:
        """Return the expected duration of a move in s, with acceleration (``$120`` to ``$122``)."""
        accelerations = [
            self.settings.get(120 + axis, 0.0) * math.dist(start, target) / abs(b - a)
            for axis, (a, b) in enumerate(zip(start, target, strict=True))
            if a != b
        ]
        seconds = duration_s(start, target, speed_mm_s, self._rates_mm_s)
        if not seconds or min(accelerations) <= 0.0:
            return seconds
        length, acceleration = math.dist(start, target), min(accelerations)
        ramp_s = length / seconds / acceleration
        return seconds + ramp_s if seconds > ramp_s else 2.0 * math.sqrt(length / acceleration)

    def is_at_ends(self, at: Point) -> bool:
        """Return whether every coordinate is the pull-off distance of homing away from an end of the travel."""
        near = 2.0 * self.pull_off_mm + 0.1
        ends = [(0.0, self.settings.get(130 + axis, 0.0)) for axis in range(3)]
        return all(min(abs(abs(a) - end) for end in pair) <= near for a, pair in zip(at, ends, strict=True))


def is_aside(at: Point, start: Point, target: Point) -> bool:
    """Return whether a position is off the straight line from start to target."""
    way = [b - a for a, b in zip(start, target, strict=True)]
    off = [b - a for a, b in zip(start, at, strict=True)]
    length2 = sum(a * a for a in way)
    fraction = sum(a * b for a, b in zip(way, off, strict=True)) / length2 if length2 > 0.0 else 0.0
    fraction = min(max(fraction, 0.0), 1.0)
    return math.dist(off, [fraction * a for a in way]) > ASIDE_MM
