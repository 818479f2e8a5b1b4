"""The distance of points from a surface along its normal."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tacbench_cad.util.types import Bools, Floats, Ints

#: Heights and slopes along x and y at points, each of shape (n,).
Heights = Callable[[Floats, Floats], tuple[Floats, Floats, Floats]]

#: Points that are farther from the surface after the first steps, in mm, are also compared with flanks beside them.
_NEAR_MM = 0.04
#: The numbers of steps along the slope from below the point, and from a flank.
_STEPS, _FLANK_STEPS = 4, 8
#: The numbers of samples in a direction, and of bisections between two samples.
_SAMPLES, _BISECTIONS = 3, 4


def distance_along_normal(points_mm: Floats, surface: Heights) -> Floats:
    """Return the signed distance of points from a surface, positive above it; shape (n,).

    The foot of the perpendicular is found by steps along the slope from the point below. On the plateau beside a steep
    flank, the slope says nothing about the flank. Therefore, the search starts again from where the surface passes the
    height of the point, in four directions. Of all places tried, the nearest counts.

    Args:
        points_mm: The points, shape (n, 3).
        surface: The surface.
    """
    x, y, z = points_mm.T
    side = np.sign(z - surface(x, y)[0])
    distance = _nearest(points_mm, surface, x, y, _STEPS)
    far = np.flatnonzero(distance > _NEAR_MM)
    every = np.arange(len(far))
    x, y, z, own = x[far], y[far], z[far], side[far]
    reach, foot_x, foot_y = distance[far], x.copy(), y.copy()

    def is_passed(which: Ints, along: Floats, direction: tuple[int, int]) -> Bools:
        height = surface(x[which] + direction[0] * along, y[which] + direction[1] * along)[0]
        return np.asarray(own[which] * (z[which] - height) <= 0.0)

    for direction in ((1, 0), (0, 1), (-1, 0), (0, -1)):
        low, high = np.zeros(len(far)), np.full(len(far), np.inf)
        for sample in range(1, _SAMPLES + 1):
            along = reach * sample / _SAMPLES
            high = np.where(np.isinf(high) & is_passed(every, along, direction), along, high)
            low = np.where(np.isinf(high), along, low)
        passed = np.flatnonzero(np.isfinite(high))
        low, high = low[passed], high[passed]
        for _ in range(_BISECTIONS):
            middle = (low + high) / 2.0
            beyond = is_passed(passed, middle, direction)
            low, high = np.where(beyond, low, middle), np.where(beyond, middle, high)
        reach[passed] = high
        foot_x[passed], foot_y[passed] = x[passed] + direction[0] * high, y[passed] + direction[1] * high
    beside = _nearest(points_mm[far], surface, foot_x, foot_y, _FLANK_STEPS)
    distance[far] = np.minimum(distance[far], beside)
    return np.asarray(side * distance)


def _nearest(points: Floats, surface: Heights, px: Floats, py: Floats, steps: int) -> Floats:
    """Return the smallest distance of points from places of a surface, from the first places (px, py) along the slope.

    The steps are those of Gauss and Newton for the squared distance. Where a step leads away, the next one is shorter.
    """
    x, y, z = points.T
    best, length = np.full(len(x), np.inf), np.ones(len(x))
    at = [x] * 5  # the place with the smallest distance, and the height and the slopes there
    for _ in range(steps):
        new = (px, py, *surface(px, py))
        distance = np.sqrt((x - px) ** 2 + (y - py) ** 2 + (z - new[2]) ** 2)
        nearer = distance < best
        best = np.minimum(best, distance)
        at = [np.where(nearer, value, old) for value, old in zip(new, at, strict=True)]
        length = np.where(nearer, np.minimum(2.0 * length, 1.0), 0.3 * length)
        foot_x, foot_y, height, gx, gy = at
        rx, ry = x - foot_x + (z - height) * gx, y - foot_y + (z - height) * gy
        dot = (rx * gx + ry * gy) / (1.0 + gx * gx + gy * gy)
        px, py = foot_x + length * (rx - gx * dot), foot_y + length * (ry - gy * dot)
    return best
