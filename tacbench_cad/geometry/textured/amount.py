"""The volume between a face and its texture, by integration of the formula. It does not use the patches."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.polynomial.legendre import leggauss

from tacbench_cad.geometry.textured.height import Height
from tacbench_cad.util.types import Floats

#: The number of points of Gauss' rule on each interval.
_POINTS = 8
#: The intervals for each of the finest waves.
_PER_WAVE = 2.0
#: The points of the uniform grid on the length of a fade, or on the finest wave.
_PER_FADE = 16.0
#: The largest number of values in one array operation.
_AT_A_TIME = 1_000_000


def added_volume_mm3(height: Height) -> float:
    """Return the volume that a texture adds to the part; negative for a sunk texture, in mm^3.

    On a rectangle, this is a sum of Gauss' rule over both axes. For another outline without a fade, it is the integral
    along the outline of the integral along s (Green's theorem). With a fade, the texture joins the constant height
    outside of the outline smoothly, so a sum over a uniform grid is accurate.
    """
    frame = height.area.frame
    if height.area.is_rectangle:
        s, weight_s = _rule(_breaks(height, 0))
        t, weight_t = _rule(_breaks(height, 1))
        h = height.grid(s, t)
        if frame.radius_mm is not None:
            h = h + frame.side * h**2 / (2.0 * frame.radius_mm)
        return float(weight_s @ h @ weight_t)
    if height.fading is not None:
        return _along_outline(height, partial(_along_s, height))
    s, t = (_uniform(height, axis) for axis in (0, 1))
    step = float((s[1] - s[0]) * (t[1] - t[0]))
    above = (height.grid(s, t) - height.start_mm)[height.area.inside(s[:, None], t[None, :])]
    return height.start_mm * float(height.area.polygon.area) + float(above.sum()) * step


def _along_outline(height: Height, along_s: Callable[[Floats], Floats]) -> float:
    """Return the integral along the outline, over dt, of a function of its points."""
    finest = max(max(height.surface.highest_frequency), 1e-9)
    total = 0.0
    for ring in height.area.rings:
        for start, end in zip(ring, np.roll(ring, -1, axis=0), strict=True):
            if abs(end[1] - start[1]) < 1e-12:
                continue
            steps = max(1, math.ceil(float(np.linalg.norm(end - start)) * finest / math.tau * _PER_WAVE))
            at, weight = _rule(np.linspace(0.0, 1.0, steps + 1))
            total += float(end[1] - start[1]) * float(weight @ along_s(start + at[:, None] * (end - start)))
    return total


def _uniform(height: Height, axis: int) -> Floats:
    """Return the middles of equal intervals along an axis, at least 32, because a fade takes at most half of it."""
    size = height.area.size_mm[axis]
    shortest = min(math.tau / max(height.surface.highest_frequency[axis], 1e-9), height.fade_mm)
    count = math.ceil(size / shortest * _PER_FADE)
    return np.asarray((np.arange(count) + 0.5) * (size / count), dtype=np.float64)


def _along_s(height: Height, points: Floats) -> Floats:
    """Return the integral of the height along s from 0 to each of some points, shape (n,)."""
    if (waves := height.surface.plane_waves) is not None:
        s, t = points.T
        total = (height.start_mm - height.factor * height.zero_mm) * s
        for wave in waves:
            mean = np.sin(wave.f * s / 2.0 + wave.g * t + wave.phase) * np.sinc(wave.f * s / math.tau)
            total += height.factor * wave.amplitude * s * mean
        return np.asarray(total)
    unit, weight = _rule(np.linspace(0.0, 1.0, len(_breaks(height, 0))))
    result = np.empty(len(points))
    step = max(1, _AT_A_TIME // len(unit))
    for start in range(0, len(points), step):
        s, t = points[start : start + step].T
        result[start : start + step] = s * (height(np.multiply.outer(s, unit), t[:, None]) @ weight)
    return result


def _breaks(height: Height, axis: int) -> Floats:
    """Return the ends of short intervals along an axis, in which the height is smooth."""
    size, finest = height.area.size_mm[axis], max(height.surface.highest_frequency[axis], 1e-9)
    count = max(4, math.ceil(size * finest / math.tau * _PER_WAVE))
    return np.unique(np.concatenate([np.linspace(0.0, size, count + 1), height.breaks(axis)]))


def _rule(breaks: Floats) -> tuple[Floats, Floats]:
    points, weights = leggauss(_POINTS)
    middle, half = (breaks[:-1] + breaks[1:]) / 2.0, np.diff(breaks) / 2.0
    return (middle[:, None] + half[:, None] * points).ravel(), (half[:, None] * weights).ravel()
