"""Finite sums of plane waves, from which everything else is computed.

A texture is a surface ``z(u, v) = sum A sin(f u + g v + phase)``. For such sums this module computes values,
derivatives, bounds of any derivative, integrals in closed form, and extremes with a proved error. A sum states whether
its numbers are lengths in mm, or have no unit as in the paper.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike

from tacbench_cad.spec.extremes import Extremes, Footprint, search_rectangle
from tacbench_cad.spec.outlines import Corners, LoopRegion, Polygons
from tacbench_cad.spec.sines import EXTREMES_ERROR, Sines, Wave
from tacbench_cad.spec.surface import Surface, Unit
from tacbench_cad.util.types import Floats

#: The largest error of the extremes of all other sums, as a fraction of the sum of the amplitudes.
EXTREMES_FRACTION = 1e-7


@dataclass(frozen=True)
class WaveSum(Surface):
    """A finite sum of plane waves.

    Args:
        waves: The waves. A sum without waves is zero.
        unit: The unit of u, v and the height.
    """

    waves: tuple[Wave, ...]
    unit: Unit = "units"

    def __str__(self) -> str:
        """Return the formula as text with at most three waves: ``0.6 sin(2u + v) + sin(2u - v)``.

        Of waves in mm, the text has wavelengths and directions: ``0.4 mm sine of 2 mm at 0, 60, 120 degrees``.
        """
        shown = [w for w in self.waves if w.amplitude != 0.0]
        if self.unit == "mm":
            return _in_words(shown)
        text = _joined([(w.amplitude, _sine(w)) for w in shown[:3]]) or "0"
        return text + (f" + {len(shown) - 3} more waves" if len(shown) > 3 else "")

    @cached_property
    def table(self) -> Floats:
        """The waves as rows ``amplitude, f, g, phase``; shape (n, 4)."""
        rows = [(w.amplitude, w.f, w.g, w.phase) for w in self.waves]
        return np.array(rows, dtype=np.float64).reshape(-1, 4)

    @property
    def plane_waves(self) -> tuple[Wave, ...]:
        """The waves."""
        return self.waves

    @cached_property
    def amplitude_sum(self) -> float:
        """The sum of the absolute amplitudes, which is an upper bound of ``|z|``."""
        return float(np.sum(np.abs(self.table[:, 0])))

    @cached_property
    def highest_frequency(self) -> tuple[float, float]:
        """The largest ``|f|`` and the largest ``|g|`` of the waves whose amplitude is not zero."""
        used = self.table[self.table[:, 0] != 0.0]
        if len(used) == 0:
            return (0.0, 0.0)
        return (float(np.max(np.abs(used[:, 1]))), float(np.max(np.abs(used[:, 2]))))

    @property
    def is_flat(self) -> bool:
        """Whether all heights are equal."""
        return all(w.amplitude == 0.0 or (w.f, w.g) == (0.0, 0.0) for w in self.waves)

    @cached_property
    def is_separable(self) -> bool:
        """Whether ``z = p(u) + q(v)``, that is, every wave runs along one of the axes."""
        return all(w.f == 0.0 or w.g == 0.0 or w.amplitude == 0.0 for w in self.waves)

    @cached_property
    def along_u(self) -> Sines:
        """The part ``p(u)`` of a separable sum, including the constant terms."""
        return Sines.of((w.amplitude, w.f, w.phase) for w in self.waves if w.g == 0.0 and w.amplitude != 0.0)

    @cached_property
    def along_v(self) -> Sines:
        """The part ``q(v)`` of a separable sum."""
        return Sines.of(
            (w.amplitude, w.g, w.phase) for w in self.waves if w.f == 0.0 and w.g != 0.0 and w.amplitude != 0.0
        )

    @cached_property
    def _common_direction(self) -> tuple[float, float] | None:
        """The unit direction along which all waves run; None if their directions differ."""
        moving = self.table[(self.table[:, 0] != 0.0) & np.any(self.table[:, 1:3] != 0.0, axis=1), 1:3]
        if not len(moving):
            return None
        length = np.linalg.norm(moving, axis=1)
        c, s = (moving[0] / length[0]).tolist()
        return (c, s) if np.all(np.abs(moving[:, 0] * s - moving[:, 1] * c) <= 1e-15 * length) else None

    def __call__(self, u: ArrayLike, v: ArrayLike, order: tuple[int, int] = (0, 0)) -> Floats:
        """Return the value or a partial derivative at the points ``(u, v)``.

        Args:
            u: The coordinates u, with any shape that broadcasts with ``v``.
            v: The coordinates v.
            order: The orders of the derivative along u and along v.

        Returns:
            The values, with the broadcast shape.
        """
        uu, vv = np.asarray(u, dtype=np.float64), np.asarray(v, dtype=np.float64)
        total = np.zeros(np.broadcast_shapes(uu.shape, vv.shape))
        turn = (order[0] + order[1]) * (math.pi / 2.0)
        for a, f, g, phase in self.table:
            weight = a * f ** order[0] * g ** order[1]
            if weight != 0.0:
                total += weight * np.sin(f * uu + g * vv + (phase + turn))
        return total

    def _at_few_coordinates(self, u: ArrayLike, v: ArrayLike, order: tuple[int, int] = (0, 0)) -> Floats:
        """Return the same for a separable sum, faster if many of the points have the same u or the same v."""
        total = np.zeros(np.shape(u))
        for sines, t, own, other in ((self.along_u, u, order[0], order[1]), (self.along_v, v, order[1], order[0])):
            if other == 0:
                coordinates, which = np.unique(t, return_inverse=True)
                total += sines(coordinates, own)[which].reshape(total.shape)
        return total

    def grid(self, u: Floats, v: Floats, order: tuple[int, int] = (0, 0)) -> Floats:
        """Return the values or a partial derivative on a grid. This is much faster than a call with a mesh grid.

        Args:
            u: The coordinates along u, shape (n,).
            v: The coordinates along v, shape (m,).
            order: The orders of the derivative along u and along v.

        Returns:
            The values, shape (n, m).
        """
        if self.is_separable and order == (0, 0):
            return self.along_u(u)[:, None] + self.along_v(v)[None, :]
        amplitude, f, g, phase = self.table.T
        weight = amplitude * f ** order[0] * g ** order[1]
        turn = (order[0] + order[1]) * (math.pi / 2.0)
        along_u, along_v = np.outer(u, f) + (phase + turn), np.outer(v, g)
        first = (weight * np.sin(along_u)) @ np.cos(along_v).T
        return np.asarray(first + (weight * np.cos(along_u)) @ np.sin(along_v).T, dtype=np.float64)

    def bound(self, order_u: int, order_v: int) -> float:
        """Return an upper bound of ``|d^(i+j) z / du^i dv^j|`` over the whole plane: ``sum |A| |f|^i |g|^j``.

        Args:
            order_u: The order i along u.
            order_v: The order j along v.
        """
        a, f, g = np.abs(self.table[:, 0]), np.abs(self.table[:, 1]), np.abs(self.table[:, 2])
        return float(np.sum(a * f**order_u * g**order_v))

    def cell_bounds(self, u: Floats, v: Floats, order: tuple[int, int]) -> Floats:
        """Return an upper bound of the absolute value of a partial derivative on each cell of a grid.

        A function with the values w at the corners of a cell with the sides a and b is at most the largest ``|w|``
        plus ``(a^2 M_uu + b^2 M_vv) / 8``, where M bounds its second derivatives over the whole plane.

        Args:
            u: The lines along u, ascending, shape (n,).
            v: The lines along v, ascending, shape (m,).
            order: The orders of the derivative along u and v.

        Returns:
            The bounds, shape (n - 1, m - 1).
        """
        value = np.abs(self.grid(u, v, order))
        rows = np.maximum(value[:-1], value[1:])
        a, b = np.diff(u)[:, None], np.diff(v)[None, :]
        remainder = self.bound(order[0] + 2, order[1]) * a**2 + self.bound(order[0], order[1] + 2) * b**2
        corners = np.maximum(rows[:, :-1], rows[:, 1:])
        return np.asarray(np.minimum(corners + remainder / 8.0, self.bound(*order)))

    def integral(self, u: tuple[float, float], v: tuple[float, float]) -> float:
        """Return the integral over a rectangle in closed form.

        Args:
            u: The lower and upper end along u.
            v: The lower and upper end along v.
        """
        a, f, g, phase = self.table.T
        mid_u, half_u = (u[0] + u[1]) / 2.0, (u[1] - u[0]) / 2.0
        mid_v, half_v = (v[0] + v[1]) / 2.0, (v[1] - v[0]) / 2.0
        shrink = np.sinc(f * half_u / math.pi) * np.sinc(g * half_v / math.pi)
        return float(4.0 * half_u * half_v * np.sum(a * np.sin(f * mid_u + g * mid_v + phase) * shrink))

    def integral_triangle(self, corners: Sequence[tuple[float, float]]) -> float:
        """Return the integral over a triangle in closed form.

        By the Hermite-Genocchi formula, the mean of ``exp(i s)`` over a triangle with the phases ``s0, s1, s2`` at its
        corners is twice the divided difference ``exp[i s0, i s1, i s2]``.

        Args:
            corners: The three corners ``(u, v)``, in any order.
        """
        (u0, v0), (u1, v1), (u2, v2) = corners
        area = abs((u1 - u0) * (v2 - v0) - (u2 - u0) * (v1 - v0)) / 2.0
        total = 0.0
        for a, f, g, phase in self.table:
            total += a * _mean_sine(*(f * u + g * v + phase for u, v in corners))
        return area * total

    def extremes(self, u: tuple[float, float], v: tuple[float, float], region: Footprint | None = None) -> Extremes:
        """Find the lowest and the highest value over a rectangle, with a proved error.

        The error is at most ``EXTREMES_ERROR`` if the sum is separable or all waves are parallel. Otherwise it is
        at most :data:`EXTREMES_FRACTION` times the sum of the amplitudes. Points are ``(u, v)``.

        Args:
            u: The lower and upper end along u.
            v: The lower and upper end along v.
            region: A region to which the rectangle is cut; None for the whole rectangle.
        """
        return _extremes(self, (u[0], u[1]), (v[0], v[1]), region)

    def mapped(
        self,
        per_unit: tuple[float, float],
        height_per_unit: float,
        origin: tuple[float, float] = (0.0, 0.0),
        unit: Unit | None = None,
    ) -> WaveSum:
        """Return the same surface in other coordinates: ``x = (u - origin_u) * per_unit_x``, and y likewise.

        Args:
            per_unit: The new length units per unit along u and v.
            height_per_unit: The new length units per unit of height.
            origin: The point (u, v) that becomes (0, 0).
            unit: The new unit; None keeps it.
        """
        return WaveSum(
            tuple(
                Wave(
                    amplitude=w.amplitude * height_per_unit,
                    f=w.f / per_unit[0],
                    g=w.g / per_unit[1],
                    phase=w.phase + w.f * origin[0] + w.g * origin[1],
                )
                for w in self.waves
            ),
            unit or self.unit,
        )


# A study has many blocks of few textures, and each block asks for the same.
@lru_cache(maxsize=256)
def _extremes(waves: WaveSum, u: tuple[float, float], v: tuple[float, float], region: Footprint | None) -> Extremes:
    if region is None and waves.is_separable:
        return _sum_of(
            waves.along_u.extremes(u[0], u[1], EXTREMES_ERROR / 2.0),
            waves.along_v.extremes(v[0], v[1], EXTREMES_ERROR / 2.0),
        )
    direction = waves._common_direction
    if direction is not None and (region is None or isinstance(region, LoopRegion)):
        region = region or Polygons((Corners(((u[0], v[0]), (u[1], v[0]), (u[1], v[1]), (u[0], v[1]))),))
        along = Sines.of((w.amplitude, w.f * direction[0] + w.g * direction[1], w.phase) for w in waves.waves)
        line = along.extremes(*region.span(direction))
        at_low, at_high = (region.point_at(direction, at[0]) for at in (line.at_low, line.at_high))
        return Extremes(line.low, line.high, at_low, at_high, line.error)
    bounds = (waves.bound(2, 0), waves.bound(1, 1), waves.bound(0, 2))
    function = waves._at_few_coordinates if waves.is_separable else waves
    return search_rectangle(function, bounds, u, v, EXTREMES_FRACTION * waves.amplitude_sum, region)


def _sum_of(first: Extremes, second: Extremes) -> Extremes:
    return Extremes(
        first.low + second.low,
        first.high + second.high,
        (first.at_low[0], second.at_low[0]),
        (first.at_high[0], second.at_high[0]),
        first.error + second.error,
    )


def _mean_sine(s0: float, s1: float, s2: float) -> float:
    """Return the mean of ``sin`` over a triangle, for a linear phase with these values at the corners."""
    low, mid, high = sorted((s0, s1, s2))
    if high - low < 0.05:  # the divided difference would cancel: expand about the mean phase instead
        centre = (low + mid + high) / 3.0
        a, b, c = low - centre, mid - centre, high - centre
        e2, e3 = a * b + b * c + c * a, a * b * c
        even = 1.0 + e2 / 12.0 + e2 * e2 / 360.0
        odd = -e3 / 60.0 - e2 * e3 / 1260.0
        return math.sin(centre) * even + math.cos(centre) * odd

    def first_difference(a: float, b: float) -> complex:
        half, centre = (b - a) / 2.0, (a + b) / 2.0
        return complex(math.cos(centre), math.sin(centre)) * float(np.sinc(half / math.pi))

    difference = (first_difference(mid, high) - first_difference(low, mid)) / (1j * (high - low))
    return 2.0 * difference.imag


def _sine(wave: Wave) -> str:
    """Write a wave without its amplitude: ``sin u``, ``sin(2u - v + 0.5)``."""
    inner = _joined([(wave.f, "u"), (wave.g, "v"), (wave.phase, "")]) or "0"
    return f"sin {inner}" if inner in ("u", "v") else f"sin({inner})"


def _in_words(waves: Sequence[Wave]) -> str:
    """Write waves in mm by amplitude, wavelength and direction, at most three different ones."""
    angles: dict[str, list[str]] = {}
    for wave in waves:
        frequency = math.hypot(wave.f, wave.g)
        if not frequency:
            angles[f"{wave.amplitude * math.sin(wave.phase):.4g} mm"] = []
            continue
        phase = f" with phase {wave.phase:.4g}" if wave.phase else ""
        kind = f"{wave.amplitude:.4g} mm sine of {2.0 * math.pi / frequency:.4g} mm{phase} at "
        angles.setdefault(kind, []).append(f"{math.degrees(math.atan2(wave.g, wave.f)) + 0.0:.4g}")
    texts = [kind + (f"{', '.join(each)} degrees" if each else "") for kind, each in angles.items()]
    rest = sum(max(1, len(each)) for each in list(angles.values())[3:])
    return " + ".join(texts[:3] or ["0"]) + (f" + {rest} more waves" if rest else "")


def _joined(terms: Sequence[tuple[float, str]]) -> str:
    """Write a sum of multiples without those that are zero: ``2u - v + 0.5``."""
    text = ""
    for factor, what in terms:
        if factor == 0.0:
            continue
        size = "" if what and abs(factor) == 1.0 else f"{abs(factor):g}"
        gap = " " if size and len(what) > 1 else ""
        sign = (" - " if factor < 0.0 else " + ") if text else ("-" if factor < 0.0 else "")
        text += f"{sign}{size}{gap}{what}"
    return text
