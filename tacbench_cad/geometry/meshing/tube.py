"""The path with the fewest straight links inside a tube, for one axis of a textured top.

The tube is given by samples. Between samples its walls are straight. The greedy path of Imai and Iri (1986) has the
fewest links. Each of its links is the line that stays in the tube for the longest distance. A link leaves the tube
through one wall. The next link must cross it between its last contact with the other wall and the point where it leaves
the tube. The line of each link is found sample by sample with the two hulls of O'Rourke (1981). The total time is
linear.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tacbench_cad.util.types import Floats

#: A line, given by the abscissa and the height of a point on it, and by its slope.
Line = tuple[float, float, float]


def fewest_links(t: Floats, low: Floats, high: Floats) -> tuple[Floats, Floats]:
    """Find a continuous piecewise-linear function with the fewest links between two walls.

    Args:
        t: The abscissae of the samples, strictly ascending, shape (n,). There must be at least two.
        low: The lower wall at the samples, shape (n,).
        high: The upper wall at the samples, nowhere below the lower wall, shape (n,).

    Returns:
        The abscissae and the heights of the vertices, including both ends, shape (links + 1,) each.
    """
    lines, windows = _furthest_lines(t.tolist(), low.tolist(), high.tolist())
    at, height = [float(t[0])], [_value(lines[0], float(t[0]))]
    for first, second, (start, end) in zip(lines[:-1], lines[1:], windows, strict=True):
        place = _crossing(first, second, start, end)
        at.append(place)
        height.append(_value(first, place))
    at.append(float(t[-1]))
    height.append(_value(lines[-1], float(t[-1])))
    return np.array(at), np.array(height)


def _value(line: Line, t: float) -> float:
    return line[1] + line[2] * (t - line[0])


def _crossing(first: Line, second: Line, start: float, end: float) -> float:
    """Return the abscissa where two lines cross. It is limited to the window, because of rounding."""
    turn = first[2] - second[2]
    if turn == 0.0:
        return end
    place = first[0] + (second[1] - first[1] + second[2] * (first[0] - second[0])) / turn
    return min(max(place, start), end)


def _furthest_lines(
    t: Sequence[float], low: Sequence[float], high: Sequence[float]
) -> tuple[list[Line], list[tuple[float, float]]]:
    """Return the lines of the greedy path, and for each pair of neighbours the window (start, end) where they cross.

    Every link is computed in a frame in which the previous line leaves through the upper wall. If it leaves through the
    lower wall, all heights are negated.
    """
    count = len(t)
    walls = {1.0: (low, high), -1.0: ([-h for h in high], [-v for v in low])}
    lines: list[Line] = []
    windows: list[tuple[float, float]] = []
    sign = 1.0
    lo, hi = walls[sign]
    below, above = [(t[0], lo[0])], [(t[0], hi[0])]
    steepest: Line = (t[0], lo[0], math.inf)
    at = 1
    while True:
        line, stop, contact, upward = _one_link(t, lo, hi, at, below, above, steepest)
        x, z, slope = line
        lines.append((x, sign * z, sign * slope))
        if stop == count:
            return lines, windows
        wall = hi if upward else lo
        place = _leaves(line, t[stop - 1], wall[stop - 1], t[stop], wall[stop])
        windows.append((t[contact], place))
        if not upward:
            sign = -sign
            lo, hi = walls[sign]
            line = (x, -z, -slope)
        below = [(t[contact], lo[contact])]
        for i in range(contact + 1, stop):
            _push_upper(below, t[i], lo[i])
        steepest = (t[contact], lo[contact], line[2])
        above = [(place, _value(line, place))]
        at = stop


def _leaves(line: Line, t0: float, z0: float, t1: float, z1: float) -> float:
    """Return the abscissa where a line crosses a wall between two samples."""
    gap0, gap1 = _value(line, t0) - z0, _value(line, t1) - z1
    if gap0 == gap1:
        return t0
    return t0 + (t1 - t0) * min(max(gap0 / (gap0 - gap1), 0.0), 1.0)


def _push_upper(hull: list[tuple[float, float]], x: float, z: float) -> None:
    """Add a point at the right end of an upper hull."""
    while len(hull) > 1:
        (x0, z0), (x1, z1) = hull[-2], hull[-1]
        if (z1 - z0) * (x - x1) > (z - z1) * (x1 - x0):
            break
        hull.pop()
    hull.append((x, z))


def _one_link(
    t: Sequence[float],
    lo: Sequence[float],
    hi: Sequence[float],
    at: int,
    below: list[tuple[float, float]],
    above: list[tuple[float, float]],
    steepest: Line,
) -> tuple[Line, int, int, bool]:
    """Find the line that stays in the tube for the most samples from sample ``at`` on.

    Args:
        t: The abscissae of all samples.
        lo: The lower wall.
        hi: The upper wall.
        at: The first sample.
        below: The upper hull of the earlier points of the lower wall.
        above: The lower hull of the earlier points of the upper wall.
        steepest: The steepest line that these points allow.

    Returns:
        The line, the first sample where it is outside of the tube (or the number of samples), the sample of its last
        contact with the wall through which it does not leave, and whether it leaves through the upper wall.
    """
    count = len(t)
    first_below = first_above = 0
    x_max, z_max, max_slope = steepest
    x_min, z_min, min_slope = above[0][0], above[0][1], -math.inf
    max_contact = min_contact = at - 1
    while at < count:
        x, low, high = t[at], lo[at], hi[at]
        top = z_max + max_slope * (x - x_max)
        bottom = z_min + min_slope * (x - x_min)
        if bottom > high:
            return (x_min, z_min, min_slope), at, min_contact, True
        if top < low:
            return (x_max, z_max, max_slope), at, max_contact, False
        if top > high:  # the steepest line now goes through this upper point and touches the lower hull
            x0, z0 = below[first_below]
            max_slope = (high - z0) / (x - x0)
            while first_below + 1 < len(below):
                x0, z0 = below[first_below + 1]
                slope = (high - z0) / (x - x0)
                if slope > max_slope:
                    break
                max_slope = slope
                first_below += 1
            x_max, z_max, max_contact = x, high, at
        if bottom < low:
            x0, z0 = above[first_above]
            min_slope = (low - z0) / (x - x0)
            while first_above + 1 < len(above):
                x0, z0 = above[first_above + 1]
                slope = (low - z0) / (x - x0)
                if slope < min_slope:
                    break
                min_slope = slope
                first_above += 1
            x_min, z_min, min_contact = x, low, at
        while len(below) > first_below + 1:
            (x0, z0), (x1, z1) = below[-2], below[-1]
            if (z1 - z0) * (x - x1) > (low - z1) * (x1 - x0):
                break
            below.pop()
        below.append((x, low))
        while len(above) > first_above + 1:
            (x0, z0), (x1, z1) = above[-2], above[-1]
            if (z1 - z0) * (x - x1) < (high - z1) * (x1 - x0):
                break
            above.pop()
        above.append((x, high))
        at += 1
    if math.isinf(min_slope):
        return (x_max, z_max, max_slope), count, max_contact, True
    # all lines between the two extreme lines are allowed: use the line in the middle
    x = t[count - 1]
    top, bottom = z_max + max_slope * (x - x_max), z_min + min_slope * (x - x_min)
    return (x, (top + bottom) / 2.0, (max_slope + min_slope) / 2.0), count, max_contact, True
