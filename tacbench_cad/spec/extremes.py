"""Lowest and highest values of a function with a proved error, by branch and bound.

Both searches divide the domain into cells. In each cell they bound the function by its Taylor polynomial about the
centre; the remainder follows from bounds of the second derivatives over the whole domain. Cells that cannot contain a
better value are dropped and the others are halved, until the proved error is below the requested one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from tacbench_cad.util.types import Bools, Floats

#: The largest number of cells at a time. Beyond it the search stops and reports the error proved so far.
MAX_CELLS = 2_000_000
#: The largest number of halvings. After more of them, rounding errors would exceed the differences.
MAX_ROUNDS = 60


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


@dataclass(frozen=True)
class HalfPlane:
    """The half-plane of all points with ``a u + b v <= c``.

    Args:
        a: The coefficient of u.
        b: The coefficient of v.
        c: The bound.
    """

    a: float
    b: float
    c: float

    def excess(self, u: ArrayLike, v: ArrayLike) -> Floats:
        """Return ``a u + b v - c``, which is zero or negative inside."""
        return np.asarray(self.a * np.asarray(u) + self.b * np.asarray(v) - self.c, dtype=np.float64)

    def distance(self, u: ArrayLike, v: ArrayLike) -> Floats:
        """Return the distances of points from the half-plane. Points inside have negative distances."""
        return self.excess(u, v) / math.sqrt(self.a**2 + self.b**2)

    def meets(self, u: Floats, v: Floats, half_u: float | Floats, half_v: float | Floats) -> Bools:
        """Return which cells have points inside: those whose corner that lies deepest in the half-plane is inside."""
        return np.asarray(self.excess(*self._deepest(u, v, half_u, half_v)) <= 0.0)

    def inner_points(
        self, u: Floats, v: Floats, half_u: float | Floats, half_v: float | Floats
    ) -> tuple[Floats, Floats]:
        """Return the centres of cells, or the deepest corners of cells whose centres are not inside."""
        corner_u, corner_v = self._deepest(u, v, half_u, half_v)
        outside = self.excess(u, v) > 0.0
        return np.where(outside, corner_u, u), np.where(outside, corner_v, v)

    def _deepest(self, u: Floats, v: Floats, half_u: float | Floats, half_v: float | Floats) -> tuple[Floats, Floats]:
        return u - np.sign(self.a) * half_u, v - np.sign(self.b) * half_v


class Area(Protocol):
    """A bounded and connected part of the plane, such as the inside of an outline."""

    def __hash__(self) -> int:
        """Return the hash, because results of searches are cached."""
        ...

    def excess(self, u: ArrayLike, v: ArrayLike) -> Floats:
        """Return a number for each point that is zero or negative inside."""
        ...

    def distance(self, u: ArrayLike, v: ArrayLike) -> Floats:
        """Return the distances of points from the inside. Points inside have negative distances."""
        ...

    def meets(self, u: Floats, v: Floats, half_u: float | Floats, half_v: float | Floats) -> Bools:
        """Return which cells can have points inside. Cells are given by their centres and half sides."""
        ...

    def inner_points(
        self, u: Floats, v: Floats, half_u: float | Floats, half_v: float | Floats
    ) -> tuple[Floats, Floats]:
        """Return a point inside for each cell that has points inside. It is the centre if that is inside."""
        ...

    def ends(self, direction: tuple[float, float]) -> list[tuple[float, float]]:
        """Return the points that lie furthest along a unit vector, in both ways."""
        ...

    def point_on(self, start: tuple[float, float], direction: tuple[float, float]) -> tuple[float, float]:
        """Return the point inside that is nearest to a point, on the line through it at right angles to a direction."""
        ...


#: A part of the plane to which a search is limited.
Region = HalfPlane | Area


def clipped_rectangle(
    u: tuple[float, float], v: tuple[float, float], keep: HalfPlane | None
) -> list[tuple[float, float]]:
    """Return the corners of the part of a rectangle that lies in a half-plane, in order (all four without one)."""
    corners = [(u[0], v[0]), (u[1], v[0]), (u[1], v[1]), (u[0], v[1])]
    if keep is None:
        return corners
    kept = []
    for (u0, v0), (u1, v1) in zip(corners, corners[1:] + corners[:1], strict=True):
        e0, e1 = float(keep.excess(u0, v0)), float(keep.excess(u1, v1))
        if e0 <= 0.0:
            kept.append((u0, v0))
        if (e0 < 0.0 < e1) or (e1 < 0.0 < e0):
            fraction = e0 / (e0 - e1)
            kept.append((u0 + fraction * (u1 - u0), v0 + fraction * (v1 - v0)))
    return kept


class Function1D(Protocol):
    """A function of one variable with derivatives."""

    def __call__(self, t: ArrayLike, order: int = 0) -> Floats:
        """Return the derivative of the given order at ``t``, with the same shape."""
        ...


class Function2D(Protocol):
    """A function of two variables with partial derivatives."""

    def __call__(self, u: ArrayLike, v: ArrayLike, order: tuple[int, int] = (0, 0)) -> Floats:
        """Return the partial derivative of the given orders at ``(u, v)``, with the broadcast shape."""
        ...


class Surface2D(Function2D, Protocol):
    """A function of two variables that is fast on a grid."""

    def grid(self, u: Floats, v: Floats, order: tuple[int, int] = (0, 0)) -> Floats:
        """Return the partial derivative of the given orders on a grid of lines, shape (n, m)."""
        ...


def search_interval(function: Function1D, second: float, low: float, high: float, error: float) -> Extremes:
    """Find the extremes of a function of one variable over ``[low, high]``.

    Args:
        function: The function. It is called with arrays.
        second: A bound of ``|f''|``.
        low: The lower end.
        high: The upper end.
        error: The error to prove.
    """
    top, at_top, gap_top = _highest_1d(function, 1.0, second, low, high, error)
    bottom, at_bottom, gap_bottom = _highest_1d(function, -1.0, second, low, high, error)
    return Extremes(-bottom, top, (at_bottom,), (at_top,), max(gap_top, gap_bottom))


def search_rectangle(
    function: Surface2D,
    second: tuple[float, float, float],
    u: tuple[float, float],
    v: tuple[float, float],
    error: float,
    keep: Region | None = None,
) -> Extremes:
    """Find the extremes of a function of two variables over a rectangle, or over its part in a region.

    Args:
        function: The function. It is called with arrays.
        second: Bounds of ``|f_uu|``, ``|f_uv|``, ``|f_vv|``.
        u: The lower and upper end along u.
        v: The lower and upper end along v.
        error: The error to prove.
        keep: The region to which the search is limited; None for the whole rectangle.
    """
    lines = tuple(
        np.linspace(ends[0], ends[1], int(np.clip((ends[1] - ends[0]) * np.sqrt(most), 8, 400)) + 1)
        for ends, most in ((u, second[0]), (v, second[2]))
    )
    shape = (len(lines[0]) - 1, len(lines[1]) - 1)
    unknown = np.full(shape, np.inf)
    bounds = [np.full(shape, each) for each in second]
    return search_cells(function, (lines[0], lines[1]), bounds, (-unknown, unknown), error, keep)


def search_cells(
    surface: Surface2D,
    lines: tuple[Floats, Floats],
    second: Sequence[Floats],
    limits: tuple[Floats, Floats],
    error: float,
    keep: Region | None = None,
) -> Extremes:
    """Find the extremes of a surface over a grid of cells, each of which has bounds of its own.

    Args:
        surface: The surface.
        lines: The lines of the grid along u, shape (n,), and along v, shape (m,).
        second: Bounds of ``|f_uu|``, ``|f_uv|``, ``|f_vv|`` on each cell, shape (n - 1, m - 1) each.
        limits: A lower and an upper bound of the surface on each cell.
        error: The error to prove. It can become larger, because there are at most :data:`MAX_CELLS` cells.
        keep: The region to which the search is limited; None for the whole rectangle.
    """
    top, at_top, gap_top = _highest_in_cells(surface, 1.0, lines, second, limits[1], error, keep)
    bottom, at_bottom, gap_bottom = _highest_in_cells(surface, -1.0, lines, second, -limits[0], error, keep)
    return Extremes(-bottom, top, at_bottom, at_top, max(gap_top, gap_bottom))


def _highest_in_cells(
    surface: Surface2D,
    sign: float,
    lines: tuple[Floats, Floats],
    second: Sequence[Floats],
    limit: Floats,
    error: float,
    keep: Region | None,
) -> tuple[float, tuple[float, float], float]:
    """Highest value of ``sign * surface``, where it is taken, and the proved gap."""
    u, v = lines
    corners = sign * surface.grid(u, v)
    if keep is not None:
        corners[keep.excess(u[:, None], v[None, :]) > 0.0] = -np.inf
    i, j = np.unravel_index(int(corners.argmax()), corners.shape)
    best, place, gap = float(corners[i, j]), (float(u[i]), float(v[j])), np.inf
    ends = (float(u[0]), float(u[-1])), (float(v[0]), float(v[-1]))
    if np.isfinite(best):
        best, place = _polish_2d(surface, sign, best, place, *ends, keep)
    shape = limit.shape
    columns = np.broadcast_to(((u[1:] + u[:-1]) / 2.0)[:, None], shape), np.broadcast_to((v[1:] + v[:-1]) / 2.0, shape)
    halves = np.broadcast_to((np.diff(u) / 2.0)[:, None], shape), np.broadcast_to(np.diff(v) / 2.0, shape)
    chosen = limit > best + error
    # the columns: centre u, v; half sides; bounds of the second derivatives; limit
    cells = np.stack([part[chosen] for part in (*columns, *halves, *second, limit)])
    for _ in range(2 * MAX_ROUNDS):
        if keep is not None:
            cells = cells[:, keep.meets(*cells[:4])]
        if cells.shape[1] == 0:
            return best, place, error
        cu, cv, hu, hv, uu, uv, vv, limit = cells
        value = sign * surface(cu, cv)
        best, place = _best_point(surface, sign, best, place, value, cu, cv, hu, hv, keep)
        best, place = _polish_2d(surface, sign, best, place, *ends, keep)
        upper = value + np.abs(surface(cu, cv, (1, 0))) * hu + np.abs(surface(cu, cv, (0, 1))) * hv
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


def _highest_1d(
    function: Function1D, sign: float, second: float, low: float, high: float, error: float
) -> tuple[float, float, float]:
    """Highest value of ``sign * function``, where it is taken, and the proved gap."""
    ends = np.array([low, high])
    values = sign * function(ends)
    best, place = float(values.max()), float(ends[int(values.argmax())])
    if high <= low or second == 0.0:
        return best, place, 0.0
    cells = int(np.clip(4.0 * (high - low) * np.sqrt(second), 16, 20_000))
    half = (high - low) / (2 * cells)
    centre = np.asarray(low + half * (2 * np.arange(cells) + 1), dtype=np.float64)
    gap = 0.0
    for _ in range(MAX_ROUNDS):
        value = np.asarray(sign * function(centre), dtype=np.float64)
        best, place = _better(best, place, value, centre)
        best, place = _polish_1d(function, sign, best, place, low, high)
        upper = value + np.abs(function(centre, 1)) * half + 0.5 * second * half * half
        gap = float(upper.max()) - best if len(upper) else 0.0
        if gap <= error:
            return best, place, max(gap, 0.0)
        centre = centre[upper > best + error]
        if 2 * len(centre) > MAX_CELLS:
            break
        half /= 2.0
        centre = np.concatenate([centre - half, centre + half])
    return best, place, gap


def _better(best: float, place: float, value: Floats, centre: Floats) -> tuple[float, float]:
    if len(value) == 0:
        return best, place
    i = int(value.argmax())
    return (float(value[i]), float(centre[i])) if value[i] > best else (best, place)


def _polish_1d(
    function: Function1D, sign: float, best: float, place: float, low: float, high: float
) -> tuple[float, float]:
    """Move uphill from ``place`` by Newton steps; the result is never worse than ``place``."""
    t = np.array(place)
    for _ in range(3):
        curve = float(function(t, 2))
        if sign * curve >= 0.0:
            break
        t = np.clip(t - function(t, 1) / curve, low, high)
        value = sign * float(function(t))
        if value <= best:
            break
        best, place = value, float(t)
    return best, place


def _best_point(
    function: Function2D,
    sign: float,
    best: float,
    place: tuple[float, float],
    value: Floats,
    cu: Floats,
    cv: Floats,
    half_u: float | Floats,
    half_v: float | Floats,
    keep: Region | None,
) -> tuple[float, tuple[float, float]]:
    """Return the best of ``best`` and those points of the cells that lie in the region."""
    if keep is not None:
        inner_u, inner_v = keep.inner_points(cu, cv, half_u, half_v)
        outside = (inner_u != cu) | (inner_v != cv)
        cu, cv = inner_u, inner_v
        value = np.where(outside, sign * function(cu, cv), value)
    i = int(value.argmax())
    return (float(value[i]), (float(cu[i]), float(cv[i]))) if value[i] > best else (best, place)


def _polish_2d(
    function: Function2D,
    sign: float,
    best: float,
    place: tuple[float, float],
    u: tuple[float, float],
    v: tuple[float, float],
    keep: Region | None,
) -> tuple[float, tuple[float, float]]:
    """Move uphill by Newton steps inside the rectangle and the region; the result is never worse."""
    a, b = place
    for _ in range(3):
        slope = np.array([float(function(a, b, (1, 0))), float(function(a, b, (0, 1)))])
        mixed = float(function(a, b, (1, 1)))
        hessian = np.array([[float(function(a, b, (2, 0))), mixed], [mixed, float(function(a, b, (0, 2)))]])
        if np.linalg.eigvalsh(sign * hessian)[1] >= 0.0:
            break
        step = np.linalg.solve(hessian, slope)
        a, b = min(max(a - float(step[0]), u[0]), u[1]), min(max(b - float(step[1]), v[0]), v[1])
        value = sign * float(function(a, b))
        if value <= best or (keep is not None and float(keep.excess(a, b)) > 0.0):
            break
        best, place = value, (a, b)
    return best, place
