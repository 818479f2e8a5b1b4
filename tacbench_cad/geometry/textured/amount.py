"""The volume between a face and its texture, by integration of the formula. It does not use the patches."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Protocol

import numpy as np
from numpy.polynomial.legendre import leggauss

from tacbench_cad.geometry.textured.field import Height
from tacbench_cad.geometry.textured.frame import Frame
from tacbench_cad.spec.waves import WaveSum
from tacbench_cad.util.types import Floats

#: The number of points of Gauss' rule on each interval.
_POINTS = 8
#: The intervals for each of the finest waves.
_PER_WAVE = 2.0
#: The points of the uniform grid on the length of a fade, or on the finest wave.
_PER_FADE = 16.0
#: The largest number of values in one array operation.
_AT_A_TIME = 1_000_000


class OutlineCurve(Protocol):
    """A piece of an outline: a curve with a parameter from ``first`` to ``last``."""

    @property
    def kind(self) -> str:
        """``line`` for a straight piece."""
        ...

    @property
    def first(self) -> float:
        """The smallest parameter."""
        ...

    @property
    def last(self) -> float:
        """The largest parameter."""
        ...

    @property
    def forward(self) -> bool:
        """Whether the outline runs along increasing parameters."""
        ...

    @property
    def samples(self) -> Floats:
        """Points along the outline, shape (n, 2)."""
        ...

    def at(self, parameters: Floats, /) -> Floats:
        """Return the points at some parameters, shape (n, 2)."""
        ...


class OutlinedRegion(Protocol):
    """A region with an outline in local coordinates. The region is on the left of the outline."""

    @property
    def frame(self) -> Frame:
        """The local coordinates."""
        ...

    @property
    def is_rectangle(self) -> bool:
        """Whether the region is a rectangle along s and t, or a band around a cylinder."""
        ...

    @property
    def loops(self) -> Sequence[Sequence[OutlineCurve]]:
        """The outline: one or more closed loops of curves."""
        ...


def added_volume_mm3(region: OutlinedRegion, height: Height) -> float:
    """Return the volume that a texture adds to the part; negative for a sunk texture, in mm^3.

    On a rectangle, this is a sum of Gauss' rule over both axes. For another outline without a fade, it is the integral
    along the outline of the integral along s (Green's theorem). With a fade, the texture joins the constant height
    outside of the outline smoothly, so a sum over a uniform grid is accurate.
    """
    if region.is_rectangle:
        s, weight_s = _rule(_breaks(height, 0, 0.0, height.size_mm[0]))
        t, weight_t = _rule(_breaks(height, 1, 0.0, height.size_mm[1]))
        h = height.grid(s, t)
        radius = region.frame.radius_mm
        if radius is not None:
            h = h + region.frame.side * h**2 / (2.0 * radius)
        return float(weight_s @ h @ weight_t)
    if height.fade.inside is None:
        return _along_outline(region, height, partial(_along_s, height))
    s, t = (_uniform(height, axis) for axis in (0, 1))
    step = float((s[1] - s[0]) * (t[1] - t[0]))
    above = (height.grid(s, t) - height.start_mm)[height.fade.inside(s, t)]
    return height.start_mm * _along_outline(region, height, lambda points: points[:, 0]) + float(above.sum()) * step


def _along_outline(region: OutlinedRegion, height: Height, along_s: Callable[[Floats], Floats]) -> float:
    """Return the integral along the outline, over dt, of a function of its points."""
    total = 0.0
    for loop in region.loops:
        for edge in loop:
            length = float(np.linalg.norm(np.diff(edge.samples, axis=0), axis=1).sum())
            finest = max(max(height.surface.highest_frequency), 1e-9)
            steps = max(1 if edge.kind == "line" else 16, math.ceil(length * finest / math.tau * _PER_WAVE))
            at, weight = _rule(np.linspace(edge.first, edge.last, steps + 1))
            points = edge.at(at)
            small = 1e-4 * (edge.last - edge.first) / steps
            inner = np.clip(at, edge.first + small, edge.last - small)
            slope = (edge.at(inner + small)[:, 1] - edge.at(inner - small)[:, 1]) / (2.0 * small)
            if np.max(np.abs(slope)) < 1e-12:
                continue
            total += (1.0 if edge.forward else -1.0) * float(weight * slope @ along_s(points))
    return total


def _uniform(height: Height, axis: int) -> Floats:
    """Return the middles of equal intervals along an axis, at least 32, because a fade takes at most half of it."""
    shortest = min(math.tau / max(height.surface.highest_frequency[axis], 1e-9), height.fade.length_mm)
    count = math.ceil(height.size_mm[axis] / shortest * _PER_FADE)
    return np.asarray((np.arange(count) + 0.5) * (height.size_mm[axis] / count), dtype=np.float64)


def _along_s(height: Height, points: Floats) -> Floats:
    """Return the integral of the height along s from 0 to each of some points, shape (n,)."""
    if isinstance(height.surface, WaveSum):
        s, t = points.T
        total = (height.start_mm - height.factor * height.zero_mm) * s
        for amplitude, f, g, phase in height.surface.table:
            mean = np.sin(f * s / 2.0 + g * t + phase) * np.sinc(f * s / math.tau)
            total += height.factor * amplitude * s * mean
        return np.asarray(total)
    unit, weight = _rule(np.linspace(0.0, 1.0, len(_breaks(height, 0, 0.0, height.size_mm[0]))))
    result = np.empty(len(points))
    step = max(1, _AT_A_TIME // len(unit))
    for start in range(0, len(points), step):
        s, t = points[start : start + step].T
        result[start : start + step] = s * (height.at(np.multiply.outer(s, unit), t[:, None]) @ weight)
    return result


def _breaks(height: Height, axis: int, low: float, high: float) -> Floats:
    finest = max(height.surface.highest_frequency[axis], 1e-9)
    count = max(4, math.ceil(abs(high - low) * finest / math.tau * _PER_WAVE))
    breaks = np.linspace(low, high, count + 1)
    fade = height.fade
    if fade.length_mm and fade.sides is not None and fade.sides[axis]:
        breaks = np.sort(np.append(breaks, [fade.length_mm, height.size_mm[axis] - fade.length_mm]))
    return breaks


def _rule(breaks: Floats) -> tuple[Floats, Floats]:
    points, weights = leggauss(_POINTS)
    middle, half = (breaks[:-1] + breaks[1:]) / 2.0, np.diff(breaks) / 2.0
    return (middle[:, None] + half[:, None] * points).ravel(), (half[:, None] * weights).ravel()
