"""Lowest and highest values of a function with a proved error, by branch and bound.

The domain is divided into cells. In each cell, the function is bounded by its Taylor polynomial about the centre; the
remainder follows from bounds of the second derivatives. Cells that cannot contain a better value are dropped and the
others are halved, until the proved error is below the requested one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from tacbench_cad.util.types import Floats

#: The largest number of cells at a time. Beyond it the search stops and reports the error proved so far.
MAX_CELLS = 2_000_000
#: The largest number of halvings. After more of them, rounding errors would exceed the differences.
MAX_ROUNDS = 120


@dataclass(frozen=True)
class Extremes:
    """The lowest and the highest value of a function over a domain.

    Attributes:
        low: The lowest computed value. The true minimum is not below ``low - error``.
        high: The highest computed value. The true maximum is not above ``high + error``.
        at_low: A point at which the function has the value ``low``.
        at_high: A point at which the function has the value ``high``.
        error: The proved error.
    """

    low: float
    high: float
    at_low: tuple[float, ...]
    at_high: tuple[float, ...]
    error: float


class Footprint(Protocol):
    """A bounded and connected part of the plane, such as the inside of an outline."""

    def __hash__(self) -> int:
        """Return the hash, because results of searches are cached."""
        ...

    def distance(self, u: ArrayLike, v: ArrayLike) -> Floats:
        """Return the distances of points from the region. Points inside have negative distances."""
        ...

    def inner_points(self, u: Floats, v: Floats) -> tuple[Floats, Floats]:
        """Return the points themselves, or for points that are not inside the nearest points of the region."""
        ...


class Function2D(Protocol):
    """A function of two variables with partial derivatives."""

    def __call__(self, u: ArrayLike, v: ArrayLike, order: tuple[int, int] = (0, 0)) -> Floats:
        """Return the partial derivative of the given orders at ``(u, v)``, with the broadcast shape."""
        ...


def search_rectangle(
    function: Function2D,
    second: tuple[float, float, float],
    u: tuple[float, float],
    v: tuple[float, float],
    error: float,
    region: Footprint | None = None,
) -> Extremes:
    """Find the extremes of a function of two variables over a rectangle, or over its part in a region.

    Args:
        function: The function. It is called with arrays.
        second: Bounds of ``|f_uu|``, ``|f_uv|``, ``|f_vv|``.
        u: The lower and upper end along u.
        v: The lower and upper end along v. The rectangle may be a line.
        error: The error to prove.
        region: The region to which the search is limited; None for the whole rectangle.
    """
    lines = tuple(
        np.linspace(low, high, 2 if low == high else int(np.clip((high - low) * np.sqrt(most), 8, 100)) + 1)
        for (low, high), most in ((u, second[0]), (v, second[2]))
    )
    shape = (len(lines[0]) - 1, len(lines[1]) - 1)
    unknown = np.full(shape, np.inf)
    bounds = [np.full(shape, each) for each in second]
    return search_cells(function, (lines[0], lines[1]), bounds, (-unknown, unknown), error, region)


def search_cells(
    function: Function2D,
    lines: tuple[Floats, Floats],
    second: Sequence[Floats],
    limits: tuple[Floats, Floats],
    error: float,
    region: Footprint | None = None,
) -> Extremes:
    """Find the extremes of a function over a grid of cells, each of which has bounds of its own.

    Args:
        function: The function. It is called with arrays.
        lines: The lines of the grid along u, shape (n,), and along v, shape (m,).
        second: Bounds of ``|f_uu|``, ``|f_uv|``, ``|f_vv|`` on each cell, shape (n - 1, m - 1) each.
        limits: A lower and an upper bound of the function on each cell.
        error: The error to prove. It can become larger, because there are at most :data:`MAX_CELLS` cells.
        region: The region to which the search is limited; None for the whole rectangle.
    """
    top, at_top, gap_top = _highest(function, 1.0, lines, second, limits[1], error, region)
    bottom, at_bottom, gap_bottom = _highest(function, -1.0, lines, second, -limits[0], error, region)
    return Extremes(-bottom, top, at_bottom, at_top, max(gap_top, gap_bottom))


def _highest(
    function: Function2D,
    sign: float,
    lines: tuple[Floats, Floats],
    second: Sequence[Floats],
    limit: Floats,
    error: float,
    region: Footprint | None,
) -> tuple[float, tuple[float, float], float]:
    """Highest value of ``sign * function``, where it is taken, and the proved gap."""
    u, v = np.meshgrid(*lines, indexing="ij")
    best, place = _best_of(function, sign, u.ravel(), v.ravel(), sign * function(u.ravel(), v.ravel()), region)
    best, place = _polished(function, sign, best, place, lines, region)
    centres = (u[1:, 1:] + u[:-1, 1:]) / 2.0, (v[1:, 1:] + v[1:, :-1]) / 2.0
    halves = (u[1:, 1:] - u[:-1, 1:]) / 2.0, (v[1:, 1:] - v[1:, :-1]) / 2.0
    chosen = limit > best + error
    # the rows: centre u, v; half sides; bounds of the second derivatives; limit
    cells = np.stack([part[chosen] for part in (*centres, *halves, *second, limit)])
    gap = np.inf
    for _ in range(MAX_ROUNDS):
        if region is not None:
            cells = cells[:, region.distance(cells[0], cells[1]) <= np.hypot(cells[2], cells[3])]
        if cells.shape[1] == 0:
            return best, place, error
        cu, cv, hu, hv, uu, uv, vv, limit = cells
        value = sign * function(cu, cv)
        better, at = _best_of(function, sign, cu, cv, value, region)
        if better > best:
            best, place = _polished(function, sign, better, at, lines, region)
        upper = value + np.abs(function(cu, cv, (1, 0))) * hu + np.abs(function(cu, cv, (0, 1))) * hv
        upper += 0.5 * uu * hu**2 + uv * hu * hv + 0.5 * vv * hv**2
        cells[7] = np.minimum(upper, limit)
        gap = max(float(cells[7].max()) - best, 0.0)
        alive = cells[7] > best + error
        if gap <= error or 2 * np.count_nonzero(alive) > MAX_CELLS:
            break
        parts = []
        cells = cells[:, alive]
        wide = cells[4] * cells[2] ** 2 >= cells[6] * cells[3] ** 2
        for mask, centre, half in ((wide, 0, 2), (~wide, 1, 3)):
            some = cells[:, mask]
            some[half] /= 2.0
            for way in (-1.0, 1.0):
                moved = some.copy()
                moved[centre] += way * moved[half]
                parts.append(moved)
        cells = np.concatenate(parts, axis=1)
    return best, place, gap


def _best_of(
    function: Function2D, sign: float, u: Floats, v: Floats, value: Floats, region: Footprint | None
) -> tuple[float, tuple[float, float]]:
    """Return the highest value at points, or at those of the region that are nearest to them, and its place."""
    if region is not None:
        inner_u, inner_v = region.inner_points(u, v)
        moved = (inner_u != u) | (inner_v != v)
        u, v, value = inner_u, inner_v, value.copy()
        value[moved] = sign * function(u[moved], v[moved])
    i = int(value.argmax())
    return float(value[i]), (float(u[i]), float(v[i]))


def _polished(
    function: Function2D,
    sign: float,
    best: float,
    place: tuple[float, float],
    lines: tuple[Floats, Floats],
    region: Footprint | None,
) -> tuple[float, tuple[float, float]]:
    """Move uphill by Newton steps inside the rectangle and the region; the result is never worse."""
    a, b = place
    for _ in range(3):
        slope = np.array([float(function(a, b, (1, 0))), float(function(a, b, (0, 1)))])
        mixed = float(function(a, b, (1, 1)))
        hessian = np.array([[float(function(a, b, (2, 0))), mixed], [mixed, float(function(a, b, (0, 2)))]])
        if np.linalg.eigvalsh(sign * hessian)[1] > 0.0:
            break
        # along a ridge, the second derivative is zero, and there is no step
        step = np.linalg.lstsq(hessian, slope)[0]
        a, b = (float(np.clip(at - by, each[0], each[-1])) for at, by, each in zip((a, b), step, lines, strict=True))
        value = sign * float(function(a, b))
        if value <= best or (region is not None and float(region.distance(a, b)) > 0.0):
            break
        best, place = value, (a, b)
    return best, place
