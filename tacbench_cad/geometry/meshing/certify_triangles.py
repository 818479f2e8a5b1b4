"""Proved bounds for any triangles over a surface.

On a triangle, the deviation ``e = fit - f`` is compared with the quadratic polynomial through its values at the three
corners and the three middles of the sides. The polynomial's largest value is known in closed form. The rest follows
from Taylor's formula about the six points, ``rest = sum L_i(x) D^3 f(a_i - x) / 6`` with the Lagrange polynomials L, so
it is at most :data:`REST` times the largest third derivative along vectors of the size of the triangle's box. Where the
third derivatives are large, the second derivatives give another bound. A triangle whose bound is above the tolerance is
divided into four, and each of them is bounded again.

The bounds of the derivatives are the largest values of all cells of a grid that the triangle's box touches.
"""

from __future__ import annotations

import numpy as np

from tacbench_cad.spec.surface import Surface
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Bools, Floats

#: The largest value of ``sum |L_i(x)| t_i(x)^3 / 6`` on a triangle, 0.033929, rounded up. Here ``t_i`` is the length of
#: ``a_i - x``, relative to the longest vector in its direction between two points of the triangle.
REST = 0.03394
#: How many times a triangle is divided at most.
MAX_DIVISIONS = 6
#: The number of triangles that are evaluated together.
CHUNK = 20_000
#: The number of triangles from which the number of parts of a large mesh is estimated, and the fraction of the limit
#: that the rest may have on a part.
SAMPLE, RESTS_FRACTION = 1000, 0.3
#: The largest number of triangles and parts of triangles that are bounded for one mesh. It takes about a minute.
MAX_PARTS = 30_000_000
_SECOND = ((2, 0), (1, 1), (0, 2))
_THIRD = ((3, 0), (2, 1), (1, 2), (0, 3))


class DerivativeBounds:
    """Bounds of the second and third derivatives of a surface over any boxes.

    Args:
        surface: The surface.
        x: The borders of cells along x, ascending, shape (n,). Creases are among them. A spline has its knots between
            the first and the last border instead.
        y: The borders of cells along y.
    """

    def __init__(self, surface: Surface, x: Floats, y: Floats) -> None:
        #: The number of triangles and parts of triangles that have been bounded so far.
        self.used = 0
        self._lines = (_cells(x, surface.breaks[0]), _cells(y, surface.breaks[1]))
        x, y = self._lines
        self._creases = surface.creases
        bounds = np.stack([surface.cell_bounds(x, y, order) for order in (*_SECOND, *_THIRD)], axis=-1)
        for axis, kinks in enumerate((self._kinks(surface, 0), self._kinks(surface, 1))):
            bounds.swapaxes(0, axis)[kinks, :, len(_SECOND) :] = np.inf
        # level 0 has single cells; level k > 0 has blocks of 2^(k - 1) by 2^(k - 1) cells, and each of its entries
        # covers its own block and the three blocks after it
        self._levels = [bounds]
        while True:
            self._levels.append(_with_next(bounds))
            if max(bounds.shape[:2]) <= 1:
                break
            bounds = _halved(bounds)

    def _kinks(self, surface: Surface, axis: int) -> Bools:
        """Return the cells with a border, other than a crease, along which a second derivative is not continuous."""
        lines = self._lines[axis]
        middles, ends = (lines[:-1] + lines[1:]) / 2.0, self._lines[1 - axis][[0, -1]]
        order = (3, 0) if axis == 0 else (0, 3)
        across = surface.cell_bounds(*((middles, ends) if axis == 0 else (ends, middles)), order).ravel()
        kinks = np.append(~np.isfinite(across) & ~np.isin(lines[1:-1], surface.creases[axis]), False)
        return np.asarray(kinks | np.append(False, kinks[:-1]))

    def around(self, low: Floats, high: Floats, by: float) -> tuple[Floats, Floats, Floats]:
        """Return the distances of boxes from creases and from the sides, and larger boxes that end there.

        Args:
            low: The lower corners of the boxes, shape (2, m). No crease runs through their inside.
            high: The upper corners.
            by: The distance by which the boxes grow.

        Returns:
            The distances, shape (m,), and the lower and the upper corners of the larger boxes.
        """
        room, larger = np.full(low.shape[1], np.inf), []
        for lines, creases, first, last in zip(self._lines, self._creases, low, high, strict=True):
            inner = creases[(creases > lines[0]) & (creases < lines[-1])]
            ends = np.concatenate([lines[:1], inner, lines[-1:]])
            after = np.clip(np.searchsorted(ends, (first + last) / 2.0), 1, len(ends) - 1)
            start, end = ends[after - 1], ends[after]
            room = np.minimum(room, np.minimum(first - start, end - last))
            larger.append((np.maximum(first - by, start), np.minimum(last + by, end)))
        (left, right), (lower, upper) = larger
        return np.maximum(room, 0.0), np.stack([left, lower]), np.stack([right, upper])

    def bend(self, low: Floats, high: Floats) -> Floats:
        """Return the bounds over boxes of the second derivative along any direction, shape (m,)."""
        xx, xy, yy = self.over(low, high)[:3]
        with np.errstate(invalid="ignore"):
            bend = (xx + yy) / 2.0 + np.hypot((xx - yy) / 2.0, xy)
        return np.asarray(np.where(np.isnan(bend), np.inf, bend))

    def over(self, low: Floats, high: Floats) -> Floats:
        """Return the bounds over boxes: the derivatives xx, xy, yy, xxx, xxy, xyy and yyy.

        Args:
            low: The lower corners of the boxes, shape (2, m).
            high: The upper corners.

        Returns:
            The bounds, shape (7, m). They are infinite if a crease runs through the inside of a box.
        """
        first, last = [], []
        for axis in range(2):
            lines = self._lines[axis]
            first.append(np.searchsorted(lines[1:-1], low[axis], "right"))
            # a box that only touches a border of cells from inside does not reach the next cell
            cell = np.searchsorted(lines[1:-1], high[axis], "right")
            last.append(np.maximum(cell - (high[axis] <= lines.take(cell)), 0))
        span = np.maximum(last[0] - first[0], last[1] - first[1])
        level = np.where(span == 0, 0, np.ceil(np.log2(np.maximum(span, 1))).astype(np.int64) + 1)
        level = np.minimum(level, len(self._levels) - 1)
        shift = np.maximum(level - 1, 0)
        bounds = np.empty((len(span), 7))
        for k in np.unique(level):
            rows = np.flatnonzero(level == k)
            bounds[rows] = self._levels[k][first[0][rows] >> shift[rows], first[1][rows] >> shift[rows]]
        for axis, creases in enumerate(self._creases):
            crossed = np.searchsorted(creases, high[axis], "left") > np.searchsorted(creases, low[axis], "right")
            bounds[crossed] = np.inf
        return bounds.T


def prove(
    surface: Surface, bounds: DerivativeBounds, points: Floats, limit: float, divisions: int = MAX_DIVISIONS
) -> Floats:
    """Bound the deviation of triangles from a surface.

    Args:
        surface: The surface.
        bounds: The bounds of its derivatives.
        points: The corners of the triangles, shape (m, 3, 3). Their z counts from the surface's zero.
        limit: The allowed distance.
        divisions: How many times a triangle is divided at most.

    Returns:
        The bounds of the distance to the nearest point of the surface and of the vertical distance, shape (2, m). The
        first one is infinite if it could not be proved to be at most the limit.

    Raises:
        InputError: The proofs of the mesh have more than :data:`MAX_PARTS` parts.
    """
    proof = np.empty((2, len(points)))
    for start in range(0, len(points), CHUNK):
        part = slice(start, start + CHUNK)
        corners = points[part].transpose(2, 1, 0)
        proof[:, part] = _prove(surface, bounds, corners, corners[2] - surface(*corners[:2]), limit, divisions)
    return proof


def _prove(
    surface: Surface, bounds: DerivativeBounds, corners: Floats, deviation: Floats, limit: float, divisions: int
) -> tuple[Floats, Floats]:
    """Bound triangles.

    Args:
        surface: The surface.
        bounds: The bounds of its derivatives.
        corners: The corners, shape (3 coordinates, 3 corners, m).
        deviation: The deviations at the corners, shape (3, m).
        limit: The allowed distance.
        divisions: How many times a triangle is divided at most.
    """
    bounds.used += corners.shape[2]
    _refuse_too_rough(bounds.used)
    middles = (corners + corners[:, [1, 2, 0]]) / 2.0
    deviation = np.concatenate([deviation, middles[2] - surface(*middles[:2])])
    low, high = corners[:2].min(axis=1), corners[:2].max(axis=1)
    most, (w, h) = bounds.over(low, high), high - low
    xx, xy, yy = most[:3]
    third = _rest(most, w, h)
    second = (xx * w**2 + 2.0 * xy * w * h + yy * h**2) / 8.0
    vertical = np.minimum(_largest_quadratic(deviation) + third, np.abs(deviation[:3]).max(axis=0) + second)
    distance = vertical.copy()
    # no distance is larger than the vertical deviation, so the slope only matters where that is not enough
    rows = np.flatnonzero(~(vertical <= limit))
    if len(rows) == 0:
        return distance, vertical
    slopes = _slopes(surface, corners[:, :, rows], most[:, rows], w[rows], h[rows])
    distance[rows] = _nearest(bounds, low[:, rows], high[:, rows], vertical[rows], slopes, limit)
    failed = rows[~(distance[rows] <= limit)]
    above = (np.abs(deviation[:, failed]) > limit).any(axis=0)
    lost = failed[above]
    # no division helps where the bound for a single point is above the limit
    points = np.concatenate([corners[:2, :, lost], middles[:2, :, lost]], axis=1).reshape(2, -1)
    slope = np.hypot(*surface.gradient(*points)) * (1.0 + 1e-9)
    single = _nearest(bounds, points, points, np.abs(deviation[:, lost]).ravel(), (slope, slope), limit)
    hopeless = (single > limit).reshape(6, -1).any(axis=0)
    distance[lost[hopeless]] = np.inf
    failed = np.concatenate([failed[~above], lost[~hopeless]])
    if divisions == 0 or len(failed) == 0:
        distance[failed] = np.inf
        return distance, vertical
    (a, b, c), (p, q, r) = (part[:, :, failed].transpose(1, 0, 2) for part in (corners, middles))
    children = np.concatenate([np.stack(t, axis=1) for t in ((a, p, r), (p, b, q), (r, q, c), (p, q, r))], axis=2)
    values = deviation[:, failed]
    known = np.concatenate([values[[0, 3, 5]], values[[3, 1, 4]], values[[5, 4, 2]], values[[3, 4, 5]]], axis=1)
    count = children.shape[2]
    inner = np.empty((2, count))
    for start in range(0, count, CHUNK):
        part = slice(start, start + CHUNK)
        inner[:, part] = _prove(surface, bounds, children[:, :, part], known[:, part], limit, divisions - 1)
    distance[failed], vertical[failed] = inner.reshape(2, 4, -1).max(axis=1)
    return distance, vertical


def refuse_long_proof(bounds: DerivativeBounds, x: Floats, y: Floats, limit: float) -> None:
    """Refuse triangles whose proof would need too many parts, by an estimate from some of them.

    Args:
        bounds: The bounds of the surface's derivatives.
        x: The coordinates x of the corners, shape (m, 3).
        y: The coordinates y.
        limit: The allowed distance.

    Raises:
        InputError: The estimate is above :data:`MAX_PARTS`.
    """
    some = slice(None, None, max(1, len(x) // SAMPLE))
    low, high = (
        np.stack([x[some].min(axis=1), y[some].min(axis=1)]),
        np.stack([x[some].max(axis=1), y[some].max(axis=1)]),
    )
    rest = _rest(bounds.over(low, high), *(high - low))
    # each division makes the rest eight times smaller
    divisions = np.clip(
        np.ceil(np.log(np.maximum(rest / (RESTS_FRACTION * limit), 1.0)) / np.log(8.0)), 0, MAX_DIVISIONS
    )
    _refuse_too_rough(float((4.0**divisions).mean()) * len(x))


def _rest(most: Floats, w: Floats, h: Floats) -> Floats:
    """Bound the difference from the quadratic polynomial, for boxes with the sides w and h."""
    xxx, xxy, xyy, yyy = most[3:]
    return np.asarray(REST * (xxx * w**3 + 3.0 * xxy * w**2 * h + 3.0 * xyy * w * h**2 + yyy * h**3))


def _refuse_too_rough(parts: float) -> None:
    """Refuse proofs with too many parts."""
    if parts > MAX_PARTS:
        reason = f"the surface is too rough, so its proof would need more than {MAX_PARTS:,} parts"
        advice = "use a larger tolerance, a smaller block or a sample grid (--grid), or smooth a height map (smooth_mm)"
        raise InputError("tolerance", None, f"{reason}; {advice}")


def _nearest(
    bounds: DerivativeBounds, low: Floats, high: Floats, vertical: Floats, slopes: tuple[Floats, Floats], limit: float
) -> Floats:
    """Bound the distance of triangles to the nearest point of the surface, where it is at most a limit.

    A point is ``e`` above the surface, which has the slope g there. Towards the surface, a straight path leads uphill
    by h and down by ``e - g h``. On a plane it would end there. Since the second derivative along the path is at most
    M, it ends after at most ``k = 2 / (1 + sqrt(1 - 2 M h^2 / e))`` times its length. The best choice is
    ``h = e g / (1 + g^2)``; then ``h^2 / e`` is ``e g^2 / (1 + g^2)^2``. A smaller h keeps the path away from creases
    and from the sides of the rectangle, because k is at most 2.

    Args:
        bounds: The bounds of the surface's derivatives.
        low: The lower corners of the boxes around the triangles, shape (2, m).
        high: The upper corners.
        vertical: The bounds of the vertical deviation, shape (m,).
        slopes: The bounds of the slope from below and from above, shape (m,) each.
        limit: The allowed distance.
    """
    least, most = slopes
    room, low, high = bounds.around(low, high, limit)
    with np.errstate(invalid="ignore"):  # across a crease the bend is infinite, and the vertical distance counts
        bend = bounds.bend(low, high) * leaning(least, most)
    return shortest(vertical, least, room, bend)


def leaning(least: Floats, most: Floats) -> Floats:
    """Return the largest value of ``g^2 / (1 + g^2)^2`` for slopes g between two bounds."""
    nearest = np.clip(1.0, least, most)
    return np.asarray((nearest / (1.0 + nearest**2)) ** 2)


def shortest(vertical: Floats, slope: Floats, room: Floats, bend: Floats) -> Floats:
    """Return the length of the path to a surface; see ``_nearest``.

    Args:
        vertical: The vertical distance from the surface.
        slope: The slope of the surface.
        room: The largest horizontal length of the path.
        bend: The second derivative of the surface, times :func:`leaning`.
    """
    with np.errstate(invalid="ignore"):  # without a bound of the bend or of the distance, the length is not a number
        longer = 2.0 / (1.0 + np.sqrt(1.0 - 2.0 * bend * vertical))
        uphill = np.minimum(vertical * slope / (1.0 + slope**2), room / 2.0)
        length = longer * np.hypot(uphill, vertical - slope * uphill)
    return np.asarray(np.fmin(vertical, length))


def _slopes(surface: Surface, corners: Floats, most: Floats, w: Floats, h: Floats) -> tuple[Floats, Floats]:
    """Return a lower and an upper bound of the length of the gradient on triangles.

    With a unit vector n, the gradient is at least as long as ``n gradient``. On a triangle, this differs from its
    linear interpolation by at most a sixth of its second derivative along the sides.
    """
    slope = np.stack(surface.gradient(*corners[:2]))
    normal = slope.mean(axis=1)
    normal /= np.maximum(np.hypot(*normal), 1e-300)
    xxx, xxy, xyy, yyy = np.where(np.isfinite(most[3:]), most[3:], 1e150)
    bend = np.stack([xxx * w**2 + 2.0 * xxy * w * h + xyy * h**2, xxy * w**2 + 2.0 * xyy * w * h + yyy * h**2]) / 6.0
    least = (normal[:, None] * slope).sum(axis=0).min(axis=0) - (np.abs(normal) * bend).sum(axis=0)
    return np.maximum(least, 0.0), np.hypot(*slope).max(axis=0) + np.hypot(*bend)


def _largest_quadratic(values: Floats) -> Floats:
    """Return the largest absolute value of quadratic polynomials on triangles.

    Args:
        values: The values at the corners a, b, c and at the middles of ab, bc and ca, shape (6, m).
    """
    a, b, c, ab, bc, ca = values
    largest = np.abs(values).max(axis=0)
    for start, middle, end in ((a, ab, b), (b, bc, c), (c, ca, a)):
        bend = 2.0 * (start + end - 2.0 * middle)
        slope = 4.0 * middle - 3.0 * start - end
        inside = (slope * bend < 0.0) & (np.abs(slope) < 2.0 * np.abs(bend))
        summit = start - slope**2 / np.where(bend == 0.0, 1.0, 4.0 * bend)
        largest = np.maximum(largest, np.where(inside, np.abs(summit), 0.0))
    # q(s, t) = a + u s + v t + (ss s^2 + tt t^2) / 2 + st s t, with s towards b and t towards c
    u, v = 4.0 * ab - 3.0 * a - b, 4.0 * ca - 3.0 * a - c
    ss, tt, st = 4.0 * (a + b - 2.0 * ab), 4.0 * (a + c - 2.0 * ca), 4.0 * (a - ab - ca + bc)
    det = ss * tt - st**2
    safe = np.where(det == 0.0, 1.0, det)
    s, t = (st * v - tt * u) / safe, (st * u - ss * v) / safe
    inside = (det != 0.0) & (s > 0.0) & (t > 0.0) & (s + t < 1.0)
    return np.asarray(np.maximum(largest, np.where(inside, np.abs(a + (u * s + v * t) / 2.0), 0.0)))


def _cells(lines: Floats, breaks: Floats) -> Floats:
    """Return the borders of cells: the breaks of a surface, if it has any, between the first and the last line."""
    if len(breaks) == 0:
        return lines
    return np.concatenate([lines[:1], breaks[(breaks > lines[0]) & (breaks < lines[-1])], lines[-1:]])


def _halved(values: Floats) -> Floats:
    """Return the largest values of blocks of 2 by 2 cells."""
    n, m = values.shape[:2]
    padded = np.pad(values, ((0, n % 2), (0, m % 2), (0, 0)), constant_values=-np.inf)
    return np.asarray(padded.reshape((n + 1) // 2, 2, (m + 1) // 2, 2, -1).max(axis=(1, 3)))


def _with_next(values: Floats) -> Floats:
    """Return the largest value of each entry and its next neighbours along both axes."""
    result = values.copy()
    result[:-1] = np.maximum(result[:-1], values[1:])
    rows = result.copy()
    result[:, :-1] = np.maximum(rows[:, :-1], rows[:, 1:])
    return result
