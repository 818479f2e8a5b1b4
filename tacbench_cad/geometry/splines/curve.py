"""One-dimensional B-splines of sines, with a proved error.

The surface of a block is a sum of plane waves, and a plane wave is a product of two complex exponentials, one along
each axis. A spline surface can therefore be made from splines of ``exp(i k t)`` along an axis. An axis is divided into
patches. All patches have the same clamped basis with equal spans, which is scaled to the patch.

The spline of a function has the same value and the same slope as the function at both ends of the patch, so neighbours
join with C1. Otherwise it is the least-squares projection of the function. On two patches of the same width, the
splines of an exponential only differ by a constant factor of modulus one. A bound for one patch therefore holds for
all patches of this width.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from tacbench_cad.spec.sines import Sines
from tacbench_cad.spec.spline import greville
from tacbench_cad.util.types import Bools, Complexes, Floats

#: In the proof, a wave is replaced by its interpolant. The degree of the interpolant is at least this much higher than
#: the degree of the basis.
_EXTRA_DEGREE = 8
#: The number of nodes for each degree in the proof. With 6, the bound is at most 3.5 % above the error at the nodes,
#: because the factor is ``1 / cos(pi / 12)``.
_NODES_PER_DEGREE = 6
# The products below use einsum. They are small, and on a busy machine a threaded BLAS takes ten times as long.
#: The number of waves in one array operation. It limits the memory for a long series.
_WAVES_AT_A_TIME = 256


@dataclass(frozen=True)
class Basis:
    """A clamped B-spline basis on [0, 1] with equal spans. Get it from :func:`basis`, which caches the bases.

    Args:
        degree: The polynomial degree, at least 3.
        spans: The number of spans.
    """

    degree: int
    spans: int

    @property
    def count(self) -> int:
        """The number of poles."""
        return self.degree + self.spans

    @cached_property
    def breaks(self) -> Floats:
        """The ends of the spans, shape (spans + 1,)."""
        return np.arange(self.spans + 1) / self.spans

    @cached_property
    def knots(self) -> Floats:
        """The knots, with ``degree + 1`` knots at each end, shape (spans + 1 + 2 degree,)."""
        return np.concatenate([np.zeros(self.degree), self.breaks, np.ones(self.degree)])

    @cached_property
    def greville(self) -> Floats:
        """The Greville abscissae, shape (count,). With these poles, the spline is the function ``t``."""
        return greville(self.knots, self.degree)

    def values(self, t: Floats) -> Floats:
        """Return all basis functions at ``t`` in [0, 1], shape (len(t), count)."""
        return np.asarray(self._matrix(t).toarray())

    def _matrix(self, t: Floats) -> Any:
        from scipy.interpolate import BSpline

        return BSpline.design_matrix(t, self.knots, self.degree)

    def nodes(self, count: int) -> Floats:
        """Return ``count`` Chebyshev nodes in each span, ascending, shape (spans * count,)."""
        in_span = (1.0 - np.cos((np.arange(count) + 0.5) * (math.pi / count))) / 2.0
        places: Floats = (np.arange(self.spans)[:, None] + in_span) / self.spans
        return places.ravel()

    @cached_property
    def _projection(self) -> tuple[Floats, Floats, Floats]:
        """The nodes, the basis values at the nodes, and the matrix from values at the nodes to the inner poles."""
        t = self.nodes(2 * (self.degree + 1))
        values = self.values(t)
        solve: Floats = np.linalg.pinv(values[:, 2:-2]).astype(np.float64)
        return t, values, solve

    def poles(self, turn: Floats) -> Complexes:
        """Return the poles of the splines of ``exp(i turn t)``.

        Args:
            turn: The phase change of each wave on [0, 1], in radians, shape (n,).

        Returns:
            The poles, shape (count, n).
        """
        end = np.exp(1j * turn)
        step = 1j * turn / (self.degree * self.spans)
        poles = np.zeros((self.count, len(turn)), dtype=np.complex128)
        poles[0], poles[1], poles[-2], poles[-1] = 1.0, 1.0 + step, end * (1.0 - step), end
        if self.count > 4:
            t, values, solve = self._projection
            ends = [0, 1, -2, -1]
            rest = np.exp(1j * np.outer(t, turn)) - np.einsum("tk,kn->tn", values[:, ends], poles[ends])
            poles[2:-2] = np.einsum("kt,tn->kn", solve, rest)
        poles[:, turn == 0.0] = 1.0
        return poles

    @cached_property
    def _proof(self) -> tuple[int, float, Floats, Any]:
        """The degree of the interpolant, the Ehlich-Zeller factor, the nodes, and the sparse matrix of values there.

        Only the first half of the spans is used, because the error is symmetric. If t is replaced by 1 - t, the basis
        and the least-squares nodes do not change, and a wave becomes its own conjugate times a constant.
        """
        degree = self.degree + max(_EXTRA_DEGREE, self.degree // 2)
        count = _NODES_PER_DEGREE * degree
        t = self.nodes(count)[: (self.spans + 1) // 2 * count]
        return degree, 1.0 / math.cos(math.pi * degree / (2.0 * count)), t, self._matrix(t)

    def error(self, turn: Floats, weight: Floats) -> float:
        """Return a proved bound of the weighted sum of ``|exp(i turn t) - its spline|`` over [0, 1].

        On a span of half-width r, each wave is replaced by its interpolant of degree m at Chebyshev nodes. The
        remainder is at most ``rho = 2 (|turn| r / 2)^(m+1) / (m+1)!``. The rest of the error is a polynomial of degree
        m. By Ehlich and Zeller (1964), its maximum is at most its largest value at N > m Chebyshev nodes times the
        factor ``1 / cos(pi m / (2 N))``. This is true for every rotation of the single errors in the complex plane,
        and therefore for the weighted sum of their moduli.

        Args:
            turn: The phase change of each wave on [0, 1], in radians, shape (n,).
            weight: The weights, not negative, shape (n,).
        """
        turn, weight = turn[turn != 0.0], weight[turn != 0.0]
        if len(turn) == 0:
            return 0.0
        degree, factor, t, matrix = self._proof
        with np.errstate(divide="ignore"):
            logarithm = (degree + 1) * np.log(np.abs(turn) / (4.0 * self.spans)) - math.lgamma(degree + 2)
        fine = logarithm > 0.0
        crude = float(weight[fine] @ self._crude_error(turn[fine]))
        turn, weight = turn[~fine], weight[~fine]
        remainder = float(weight @ (2.0 * np.exp(logarithm[~fine])))
        distance = np.zeros(len(t))
        for start in range(0, len(turn), _WAVES_AT_A_TIME):
            part = slice(start, start + _WAVES_AT_A_TIME)
            off = np.exp(1j * np.outer(t, turn[part])) - matrix @ self.poles(turn[part])
            distance += np.einsum("tn,n->t", np.abs(off), weight[part])
        rounding = 64.0 * np.finfo(float).eps * float(weight @ (np.abs(turn) + self.count))
        return (float(distance.max()) + remainder) * factor + remainder + rounding + crude

    def _crude_error(self, turn: Floats) -> Floats:
        """Return a bound of each error from the size of the poles, for waves that are too fine for the spans."""
        ends = 1.0 + np.abs(turn) / (self.degree * self.spans)
        if self.count == 4:
            return 1.0 + ends
        norm = float(np.abs(self._projection[2]).sum(axis=1).max())
        return np.asarray(1.0 + np.maximum(ends, norm * (1.0 + ends)), dtype=np.float64)


@lru_cache(maxsize=256)
def basis(degree: int, spans: int) -> Basis:
    """Return the basis with this degree and this number of spans."""
    return Basis(degree, spans)


@dataclass(frozen=True, eq=False)
class Axis:
    """One axis of a block, divided into patches with the same basis.

    Args:
        lines: The ends of the patches in mm, ascending, shape (patches + 1,).
        basis: The basis on each patch.
    """

    lines: Floats
    basis: Basis

    @property
    def patches(self) -> int:
        """The number of patches."""
        return len(self.lines) - 1

    @property
    def degree(self) -> int:
        """The polynomial degree."""
        return self.basis.degree

    @property
    def pole_count(self) -> int:
        """The number of poles along the whole axis. Poles at joints are counted once."""
        return self.patches * (self.basis.count - 1) + 1

    @cached_property
    def _widths(self) -> Floats:
        """The widths of the patches in mm. Widths that only differ by rounding are made equal."""
        widths = np.diff(self.lines)
        for width in widths.copy():
            widths[np.abs(widths - width) <= 1e-12 * self.lines[-1]] = width
        return widths

    def knots_mm(self, patch: int) -> Floats:
        """Return the ends of the spans of a patch in mm, shape (spans + 1,)."""
        return self._scaled(patch, self.basis.breaks)

    def knots_of(self, patch: int) -> tuple[Floats, list[int]]:
        """Return the different knots of a patch in mm, and the number of copies of each."""
        ends = self.degree + 1
        return self.knots_mm(patch), [ends, *([1] * (self.basis.spans - 1)), ends]

    def values(self, patch: int, t: Floats) -> Floats:
        """Return all basis functions of a patch at ``t`` in [0, 1], shape (len(t), count)."""
        return self.basis.values(t)

    def joined(self) -> tuple[tuple[Floats, list[int]], Bools]:
        """Return the knots of the whole axis with C1 at the joints, the copies of each, and a mask of the kept poles.

        The pole at a joint is a mean of its neighbours and is removed.
        """
        keep = np.ones((self.patches, self.basis.count), dtype=np.bool_)
        keep[1:, 0] = False
        keep[:-1, -1] = False
        knots = np.concatenate([self.lines[:1], *(self.knots_mm(i)[1:] for i in range(self.patches))])
        times = np.ones(len(knots), dtype=np.intp)
        times[:: self.basis.spans] = self.degree - 1
        times[[0, -1]] = self.degree + 1
        return (knots, times.tolist()), keep.ravel()

    def abscissae_mm(self, patch: int) -> Floats:
        """Return the positions of the poles of a patch along the axis in mm, shape (count,)."""
        return self._scaled(patch, self.basis.greville)

    def _scaled(self, patch: int, unit: Floats) -> Floats:
        low, high = self.lines[patch], self.lines[patch + 1]
        scaled = low + (high - low) * unit
        scaled[0], scaled[-1] = low, high
        return np.asarray(scaled, dtype=np.float64)

    def poles(self, frequency: Floats) -> Complexes:
        """Return the poles of the splines of ``exp(i frequency t)``.

        Args:
            frequency: The frequencies in radians per mm, shape (n,).

        Returns:
            The poles, shape (patches, count, n). At a joint, both patches have the same pole.
        """
        starts = np.exp(1j * np.outer(self.lines[:-1], frequency))
        poles = np.empty((self.patches, self.basis.count, len(frequency)), dtype=np.complex128)
        for width, chosen in self._by_width():
            unit = self.basis.poles(frequency * width)
            poles[chosen] = unit[None, :, :] * starts[chosen][:, None, :]
        poles[1:, 0] = poles[:-1, -1]
        return poles

    def sines(self, function: Sines) -> Floats:
        """Return the poles of the spline of a sum of sines, shape (patches, count)."""
        total = np.zeros((self.patches, self.basis.count))
        for start in range(0, len(function.amplitude), _WAVES_AT_A_TIME):
            part = slice(start, start + _WAVES_AT_A_TIME)
            rotation = function.amplitude[part] * np.exp(1j * function.phase[part])
            total += np.imag(np.einsum("pkn,n->pk", self.poles(function.frequency[part]), rotation))
        return total

    def error(self, frequency: Floats, weight: Floats) -> float:
        """Return a proved bound of the weighted sum of ``|exp(i frequency t) - its spline|`` over the whole axis."""
        worst = max(self.basis.error(frequency * width, weight) for width, _ in self._by_width())
        rounding = 4.0 * np.finfo(float).eps * float(weight @ np.abs(frequency)) * float(np.abs(self.lines).max())
        return worst + rounding

    def _by_width(self) -> Iterator[tuple[float, Bools]]:
        for width in sorted(set(self._widths.tolist())):  # np.unique would load numpy.ma, which is slow
            yield width, self._widths == width
