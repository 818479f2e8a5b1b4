"""Tensor-product B-splines as surfaces: height maps, sampled functions, and textures with creases.

A B-spline lies between its smallest and its largest pole, and its derivatives are B-splines as well. All bounds of this
module follow from the poles of the derivatives, so they are proved. Along a crease, a knot has as many copies as the
degree; the surface is continuous there, but its slope is not.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from tacbench_cad.spec.extremes import Extremes, Footprint, search_cells
from tacbench_cad.spec.surface import Ends, Surface, Unit
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Bools, Floats, Ints

#: The largest error of the extremes, as a fraction of the height of the surface; at least a tenth of its own error.
EXTREMES_FRACTION = 1e-6
#: Two knots that are nearer than this fraction of the length of the axis are the same knot.
_SAME = 1e-12


def greville(knots: Floats, degree: int) -> Floats:
    """Return the Greville abscissae of knots. With these poles, the spline is the function ``t``."""
    windows = np.lib.stride_tricks.sliding_window_view(knots[1:-1], degree)
    return np.asarray(windows.mean(axis=1), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class SplineAxis:
    """The knots of a spline along one axis.

    Args:
        knots: The knots, ascending, with ``degree + 1`` equal knots at each end.
        degree: The polynomial degree.
        repeats: Whether the spline repeats beyond its ends.
    """

    knots: Floats
    degree: int
    repeats: bool = False

    @property
    def count(self) -> int:
        """The number of poles."""
        return len(self.knots) - self.degree - 1

    @property
    def ends(self) -> tuple[float, float]:
        """The ends of the domain, or of one period."""
        return float(self.knots[0]), float(self.knots[-1])

    @cached_property
    def breaks(self) -> Floats:
        """The different knots, ascending."""
        return np.asarray(self.knots[np.append(True, np.diff(self.knots) > 0.0)])

    @cached_property
    def creases(self) -> Floats:
        """The inner knots at which the slope may change suddenly."""
        inner = self.breaks[1:-1]
        times = np.searchsorted(self.knots, inner, "right") - np.searchsorted(self.knots, inner, "left")
        return np.asarray(inner[times >= self.degree])

    @cached_property
    def greville(self) -> Floats:
        """The Greville abscissae, shape (count,). With these poles, the spline is the function ``t``."""
        return np.asarray(np.clip(greville(self.knots, self.degree), *self.ends), dtype=np.float64)

    def inside(self, t: Floats) -> Floats:
        """Move coordinates into the domain: by whole periods, or to the nearest end."""
        low, high = self.ends
        return np.asarray(low + np.mod(t - low, high - low) if self.repeats else np.clip(t, low, high))

    def span(self, t: Floats, left: bool = False) -> Ints:
        """Return the index of the knot at the beginning of the span of each coordinate.

        Args:
            t: The coordinates.
            left: At a knot, return the span on its left; otherwise the span on its right.
        """
        found = np.searchsorted(self.knots, t, "left" if left else "right") - 1
        return np.asarray(np.clip(found, self.degree, self.count - 1))

    def local(self, t: Floats) -> tuple[Ints, Floats]:
        """Return the ``degree + 1`` functions that are not zero at ``t``.

        Returns:
            The index of the first of these functions, shape (len(t),), and their values, shape (degree + 1, len(t)).
        """
        from scipy.interpolate import BSpline

        matrix, shape = BSpline.design_matrix(t, self.knots, self.degree, extrapolate=True), (len(t), self.degree + 1)
        return np.asarray(matrix.indices.reshape(shape)[:, 0]), np.asarray(matrix.data.reshape(shape).T)

    def derived(self, poles: Floats) -> tuple[SplineAxis, Floats]:
        """Return the derivative along the first axis of the poles."""
        width = self.knots[self.degree + 1 : -1] - self.knots[1 : -self.degree - 1]
        factor = np.divide(self.degree, width, out=np.zeros_like(width), where=width > 0.0)
        shaped = factor.reshape(-1, *([1] * (poles.ndim - 1)))
        return SplineAxis(self.knots[1:-1], self.degree - 1, self.repeats), np.diff(poles, axis=0) * shaped

    def inserted(self, poles: Floats, at: float, times: int) -> tuple[SplineAxis, Floats]:
        """Insert a knot until it has the given number of copies. The surface does not change."""
        from scipy.interpolate import BSpline

        near = np.abs(self.knots - at) <= _SAME * (self.knots[-1] - self.knots[0])
        missing = times - int(np.count_nonzero(near))
        if missing <= 0:
            return self, poles
        at = float(self.knots[near][0]) if near.any() else at
        spline = BSpline(self.knots, poles, self.degree).insert_knot(at, missing)
        return SplineAxis(spline.t, self.degree, self.repeats), np.asarray(spline.c)

    def tiled(self, poles: Floats, low: float, high: float) -> tuple[SplineAxis, Floats]:
        """Return as many periods as are needed to cover an interval."""
        start, end = self.ends
        period = end - start
        first = math.floor((low - start) / period + _SAME)
        last = max(math.ceil((high - start) / period - _SAME), first + 1)
        inner = self.knots[1 : -self.degree - 1]
        runs = [inner + period * i for i in range(first, last)]
        knots = np.concatenate([[runs[0][0]], *runs, np.full(self.degree + 1, end + period * (last - 1))])
        tiles = [poles[:-1]] * (last - first)
        return SplineAxis(knots, self.degree), np.concatenate([*tiles, poles[-1:]])

    def cut(self, poles: Floats, low: float, high: float) -> tuple[SplineAxis, Floats]:
        """Return the part between two coordinates, which lie inside the domain."""
        axis: SplineAxis = self
        for at in (low, high):
            axis, poles = axis.inserted(poles, at, axis.degree)
        near = _SAME * (self.knots[-1] - self.knots[0])
        first = int(np.flatnonzero(axis.knots <= low + near)[-1]) - axis.degree
        last = int(np.flatnonzero(axis.knots >= high - near)[0])
        inner = axis.knots[first + axis.degree + 1 : last]
        ends = [np.full(axis.degree + 1, end) for end in (low, high)]
        return SplineAxis(np.concatenate([ends[0], inner, ends[1]]), axis.degree), poles[first:last]


@dataclass(frozen=True, eq=False)
class SplineSurface(Surface):
    """A tensor-product B-spline surface.

    Args:
        u: The axis along u.
        v: The axis along v.
        poles: The poles, shape (u.count, v.count).
        error: The largest vertical distance of the spline from the function that it represents; 0 if the spline itself
            is the definition of the surface.
        evidence: Whether ``error`` is ``proved`` or only ``measured`` at many points.
        unit: The unit of u, v and the height.
    """

    u: SplineAxis
    v: SplineAxis
    poles: Floats
    error: float = 0.0
    evidence: Literal["proved", "measured"] = "proved"
    unit: Unit = "units"
    _derived: dict[tuple[int, int], SplineSurface] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        if self.poles.shape != (self.u.count, self.v.count):
            raise InputError("spline poles", self.poles.shape, f"must have the shape ({self.u.count}, {self.v.count})")
        if not np.isfinite(self.poles).all():
            raise InputError("spline poles", None, "must be finite numbers")

    def __str__(self) -> str:
        return f"a spline with {self.u.count} x {self.v.count} poles"

    @cached_property
    def digest(self) -> str:
        """The SHA-256 of the knots and the poles."""
        arrays = (self.u.knots, self.v.knots, self.poles)
        return hashlib.sha256(b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)).hexdigest()

    @cached_property
    def _key(self) -> tuple[object, ...]:
        return (self.digest, self.poles.shape, self.u.repeats, self.v.repeats, self.error, self.evidence, self.unit)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, SplineSurface) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    @property
    def is_flat(self) -> bool:
        """Whether all heights are equal."""
        return bool(np.ptp(self.poles) == 0.0)

    @property
    def creases(self) -> tuple[Floats, Floats]:
        """The lines along which the slope changes suddenly: positions along u, and positions along v."""
        return self.u.creases, self.v.creases

    @property
    def breaks(self) -> tuple[Floats, Floats]:
        """The different knots along u and along v. Between them, the surface is a polynomial."""
        return self.u.breaks, self.v.breaks

    @property
    def amplitude_sum(self) -> float:
        """The largest absolute value of a pole, which is an upper bound of ``|z|``."""
        return float(np.abs(self.poles).max())

    @cached_property
    def highest_frequency(self) -> tuple[float, float]:
        """The frequencies of sine waves with the same height and the same largest second derivatives."""
        half = float(np.ptp(self.poles)) / 2.0
        return tuple(math.sqrt(self.bound(*order) / half) if half else 0.0 for order in ((2, 0), (0, 2)))  # type: ignore[return-value]

    def derivative(self, order: tuple[int, int]) -> SplineSurface:
        """Return a partial derivative. It is zero if an order is larger than the degree."""
        if order == (0, 0):
            return self
        if order not in self._derived:
            axes, poles = [self.u, self.v], self.poles
            for which in (0, 1):
                for _ in range(order[which]):
                    if axes[which].degree == 0:
                        poles = np.zeros_like(poles)
                        continue
                    axes[which], turned = axes[which].derived(np.moveaxis(poles, which, 0))
                    poles = np.moveaxis(turned, 0, which)
            self._derived[order] = SplineSurface(axes[0], axes[1], np.ascontiguousarray(poles))
        return self._derived[order]

    def __call__(self, u: ArrayLike, v: ArrayLike, order: tuple[int, int] = (0, 0)) -> Floats:
        """Return the value or a partial derivative at the points ``(u, v)``, with the broadcast shape.

        Outside of the domain, the value at the nearest point of the domain is returned, unless the surface repeats.
        """
        uu, vv = np.broadcast_arrays(np.asarray(u, dtype=np.float64), np.asarray(v, dtype=np.float64))
        points = np.stack([self.u.inside(uu), self.v.inside(vv)], axis=-1)
        return np.asarray(self._function(points, nu=order))

    @cached_property
    def _function(self) -> Callable[..., Floats]:
        from scipy.interpolate import NdBSpline

        function: Callable[..., Floats] = NdBSpline(
            (self.u.knots, self.v.knots), self.poles, (self.u.degree, self.v.degree)
        )
        return function

    def grid(self, u: Floats, v: Floats, order: tuple[int, int] = (0, 0)) -> Floats:
        """Return the values or a partial derivative on a grid of lines, shape (n, m)."""
        from scipy.interpolate import BSpline

        rows = BSpline(self.u.knots, self.poles, self.u.degree)(self.u.inside(np.asarray(u)), order[0])
        return np.asarray(BSpline(self.v.knots, rows, self.v.degree, axis=1)(self.v.inside(np.asarray(v)), order[1]))

    def bound(self, order_u: int, order_v: int) -> float:
        """Return an upper bound of the absolute value of a partial derivative over the domain, except on creases."""
        return float(np.abs(self.derivative((order_u, order_v)).poles).max())

    def cell_bounds(self, u: Floats, v: Floats, order: tuple[int, int]) -> Floats:
        """Return an upper bound of the absolute value of a partial derivative on each cell of a grid.

        The bound is infinite if a crease runs through the inside of a cell, and the derivative is not bounded there.

        Args:
            u: The lines along u, ascending, shape (n,).
            v: The lines along v, ascending, shape (m,).
            order: The orders of the derivative along u and v.

        Returns:
            The bounds, shape (n - 1, m - 1).
        """
        surface = self.derivative(order)
        largest = surface._largest(np.abs(surface.poles), u, v)
        for which, (axis, lines) in enumerate(((self.u, u), (self.v, v))):
            through = _through(axis, order[which], lines)
            if through.any():
                largest[through if which == 0 else (slice(None), through)] = np.inf
        return largest

    def cell_limits(self, u: Floats, v: Floats) -> tuple[Floats, Floats]:
        """Return a lower and an upper bound of the surface on each cell of a grid, shape (n - 1, m - 1) each."""
        return -self._largest(-self.poles, u, v), self._largest(self.poles, u, v)

    def _largest(self, values: Floats, u: Floats, v: Floats) -> Floats:
        """Return the largest of the values that belong to the poles of each cell."""
        for which, (axis, lines) in enumerate(((self.u, u), (self.v, v))):
            if axis.repeats:
                raise InputError("surface", str(self), "repeats; call over() first")
            first = axis.span(lines[:-1]) - axis.degree
            last = axis.span(lines[1:], left=True) + 1
            values = _range_max(np.moveaxis(values, which, 0), first, np.maximum(last, first + 1))
            values = np.moveaxis(values, 0, which)
        return values

    def integral(self, u: tuple[float, float], v: tuple[float, float]) -> float:
        """Return the integral over a rectangle inside the domain."""
        from scipy.interpolate import BSpline

        columns = BSpline(self.u.knots, self.poles, self.u.degree).integrate(*u)
        return float(BSpline(self.v.knots, columns, self.v.degree).integrate(*v))

    def integral_triangle(self, corners: Sequence[tuple[float, float]]) -> float:
        """Return the integral over a triangle with these corners ``(u, v)``.

        By Green's theorem, it is the integral of ``-F du`` around the triangle, where F is the integral of the surface
        along v. Between two knots, F is a polynomial along a straight side, so Gauss' rule is exact.
        """
        width = (self.v.knots[self.v.degree + 1 :] - self.v.knots[: -self.v.degree - 1]) / (self.v.degree + 1)
        poles = np.concatenate([np.zeros((self.u.count, 1)), np.cumsum(self.poles * width, axis=1)], axis=1)
        knots = np.concatenate([self.v.knots[:1], self.v.knots, self.v.knots[-1:]])
        rising = SplineSurface(self.u, SplineAxis(knots, self.v.degree + 1), poles)
        at, weight = np.polynomial.legendre.leggauss((self.u.degree + self.v.degree + 1) // 2 + 1)
        total = 0.0
        for (u0, v0), (u1, v1) in zip(corners, [*corners[1:], corners[0]], strict=True):
            if u0 == u1:
                continue
            t = [np.array([0.0, 1.0])]
            t += [(axis.breaks - a) / (b - a) for axis, a, b in ((self.u, u0, u1), (self.v, v0, v1)) if a != b]
            ends = np.unique(np.clip(np.concatenate(t), 0.0, 1.0))
            half = np.diff(ends)[:, None] / 2.0
            along = (ends[:-1, None] + half * (1.0 + at)).ravel()
            values = rising(u0 + (u1 - u0) * along, v0 + (v1 - v0) * along)
            total -= (u1 - u0) * float(values @ (half * weight).ravel())
        return math.copysign(1.0, _area(corners)) * total

    def extremes(self, u: tuple[float, float], v: tuple[float, float], region: Footprint | None = None) -> Extremes:
        """Find the lowest and the highest value over a rectangle, or over its part in a region.

        The error is at most :data:`EXTREMES_FRACTION` times the height of the surface, and it is proved.
        """
        return _extremes(self, (u[0], u[1]), (v[0], v[1]), region)

    def mapped(
        self,
        per_unit: tuple[float, float],
        height_per_unit: float,
        origin: tuple[float, float] = (0.0, 0.0),
        unit: Unit | None = None,
    ) -> SplineSurface:
        """Return the same surface in other coordinates: ``x = (u - origin_u) * per_unit_x``, and y likewise."""
        u, v = (
            replace(axis, knots=(axis.knots - start) * factor)
            for axis, start, factor in zip((self.u, self.v), origin, per_unit, strict=True)
        )
        poles, error = self.poles * height_per_unit, self.error * abs(height_per_unit)
        return replace(self, u=u, v=v, poles=poles, error=error, unit=unit or self.unit)

    @property
    def spline(self) -> SplineSurface:
        """The surface itself."""
        return self

    @property
    def ends(self) -> Ends:
        """The ends of the domain along u and along v; None along an axis along which the surface repeats."""
        return None if self.u.repeats else self.u.ends, None if self.v.repeats else self.v.ends

    @property
    def period_u(self) -> float | None:
        """The period along u; None if the surface does not repeat along u."""
        return self.u.ends[1] - self.u.ends[0] if self.u.repeats else None

    def repeated(self, along: tuple[bool, bool] = (True, True)) -> SplineSurface:
        """Return a spline that repeats beyond its ends.

        Args:
            along: Whether it repeats along u and along v.

        Raises:
            InputError: The heights at opposite ends differ, so there would be a step.
        """
        poles, axes = self.poles, []
        for which, (axis, wanted) in enumerate(zip((self.u, self.v), along, strict=True)):
            first, last = np.moveaxis(poles, which, 0)[[0, -1]]
            step = float(np.abs(first - last).max())
            if wanted and step > 1e-9 * float(np.ptp(poles)):
                advice = "make it seamless with fit_waves, or fade it out with windowed"
                raise InputError("repeat", "uv"[which], f"there would be a step of {step:.3g} at the joint; {advice}")
            axes.append(replace(axis, repeats=wanted or axis.repeats))
        return replace(self, u=axes[0], v=axes[1])

    def over(self, u: tuple[float, float], v: tuple[float, float]) -> SplineSurface:
        """Return the part of the surface over a rectangle. It does not repeat.

        Positions of creases are rounded to float32 values, because the vertices of a mesh have such coordinates. The
        effect of the rounding is added to ``error``.

        Raises:
            InputError: The rectangle is larger than the domain.
        """
        axes, poles, slack = [], self.poles, 0.0
        for which, (axis, (low, high)) in enumerate(((self.u, u), (self.v, v))):
            turned = np.moveaxis(poles, which, 0)
            if axis.repeats:
                axis, turned = axis.tiled(turned, low, high)
            start, end = axis.ends
            near = 1e-9 * (end - start)
            if low < start - near or high > end + near:
                raise InputError(
                    "domain",
                    f"{'uv'[which]} {low:.6g} to {high:.6g}",
                    f"is larger than the surface, which is known from {start:.6g} to {end:.6g}; choose a smaller part",
                )
            axis, turned = axis.cut(turned, max(low, start), min(high, end))
            rounded, moved = _rounded(axis, low, high)
            slack += moved * self.bound(1 - which, which)
            axes.append(rounded)
            poles = np.moveaxis(turned, 0, which)
        return replace(self, u=axes[0], v=axes[1], poles=np.ascontiguousarray(poles), error=self.error + slack)


def _rounded(axis: SplineAxis, low: float, high: float) -> tuple[SplineAxis, float]:
    """Set the ends exactly, round the creases to float32 values, and return the largest change."""
    knots = axis.knots.copy()
    knots[: axis.degree + 1], knots[-axis.degree - 1 :] = low, high
    moved = 0.0
    for at in axis.creases:
        place = float(np.float32(at))
        knots[knots == at] = place
        moved = max(moved, abs(place - float(at)))
    return SplineAxis(knots, axis.degree), moved


def _through(axis: SplineAxis, order: int, lines: Floats) -> Bools:
    """Return the intervals between lines that have a knot inside where the derivative of an order is not bounded."""
    inner = axis.breaks[1:-1]
    times = np.searchsorted(axis.knots, inner, "right") - np.searchsorted(axis.knots, inner, "left")
    sharp = inner[times > axis.degree + 1 - order]
    first, last = np.searchsorted(sharp, lines[:-1], "right"), np.searchsorted(sharp, lines[1:], "left")
    return np.asarray(last > first)


def _range_max(values: Floats, first: Ints, last: Ints) -> Floats:
    """Return the largest value of ``values[first:last]`` along the first axis for each pair."""
    padded = np.concatenate([values, np.full((1, *values.shape[1:]), -np.inf)])
    pairs = np.stack([first, last], axis=1).ravel()
    return np.asarray(np.maximum.reduceat(padded, pairs, axis=0)[::2])


def _area(corners: Sequence[tuple[float, float]]) -> float:
    (u0, v0), (u1, v1), (u2, v2) = corners
    return (u1 - u0) * (v2 - v0) - (u2 - u0) * (v1 - v0)


@lru_cache(maxsize=64)
def _extremes(
    surface: SplineSurface, u: tuple[float, float], v: tuple[float, float], region: Footprint | None
) -> Extremes:
    part = surface if (surface.u.ends, surface.v.ends) == (u, v) else surface.over(u, v)
    lines = part.u.breaks, part.v.breaks
    second = [part.cell_bounds(*lines, order) for order in ((2, 0), (1, 1), (0, 2))]
    error = max(EXTREMES_FRACTION * float(np.ptp(part.poles)), surface.error / 10.0)
    return search_cells(part, lines, second, part.cell_limits(*lines), error, region)
