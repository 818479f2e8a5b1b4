"""One-dimensional B-splines of sines, with a proved error.

The surface of a block is a sum of plane waves, and a plane wave is a product of two complex exponentials, one along
each axis. A spline surface needs therefore nothing but splines of ``exp(i k t)`` along an axis. An axis is cut into
patches; on each patch the same clamped basis with equal spans is used, scaled to the patch.

The spline of a function keeps its value and its slope at both ends of the patch, so that neighbours join with C1, and
is for the rest its least-squares projection. On two patches of the same width the splines of one exponential differ by
a constant factor of modulus one only: what is proved on one patch holds on all.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from tacbench_cad.spec.waves import Sines
from tacbench_cad.util.types import Bools, Complexes, Floats

#: Polynomial degree above the basis' own at which a wave is replaced by its interpolant in the proof, at the least.
_EXTRA_DEGREE = 8
#: Nodes for each degree in the proof: the bound is at most ``1 / cos(pi / 12)``, 3.5 %, above the error at the nodes.
_NODES_PER_DEGREE = 6
# The products below are einsum's on purpose: they are small, and a threaded BLAS takes ten times as long for them where
# the machine is busy.
#: Waves treated in one array operation: bounds the memory that a long series takes.
_WAVES_AT_A_TIME = 256


@dataclass(frozen=True)
class Basis:
    """A clamped B-spline basis on [0, 1] with equal spans. Take one from :func:`basis`, which keeps them.

    Args:
        degree: Polynomial degree, at least 3.
        spans: Number of spans.
    """

    degree: int
    spans: int

    @property
    def count(self) -> int:
        """Number of poles."""
        return self.degree + self.spans

    @cached_property
    def breaks(self) -> Floats:
        """Ends of the spans, shape (spans + 1,)."""
        return np.arange(self.spans + 1) / self.spans

    @cached_property
    def knots(self) -> Floats:
        """Knots with the end ones ``degree + 1`` times, shape (spans + 1 + 2 degree,)."""
        return np.concatenate([np.zeros(self.degree), self.breaks, np.ones(self.degree)])

    @cached_property
    def greville(self) -> Floats:
        """Greville abscissae, shape (count,): poles at which the spline is ``t`` itself."""
        windows = np.lib.stride_tricks.sliding_window_view(self.knots[1:-1], self.degree)
        return np.asarray(windows.mean(axis=1), dtype=np.float64)

    def local(self, t: Floats) -> tuple[NDArray[np.intp], Floats]:
        """The ``degree + 1`` functions that are not zero at ``t`` in [0, 1], by the recursion of Cox and de Boor.

        Returns:
            The number of the first of them, shape (len(t),), and their values, shape (degree + 1, len(t)).
        """
        span = np.clip((t * self.spans).astype(np.intp), 0, self.spans - 1)
        found = np.ones((1, len(t)))
        for k in range(1, self.degree + 1):
            low = self.knots[span + self.degree + 1 - k + np.arange(k)[:, None]]
            high = self.knots[span + self.degree + 1 + np.arange(k)[:, None]]
            upper = found * ((t - low) / (high - low))
            lower = found - upper
            found = np.zeros((k + 1, len(t)))
            found[:-1] = lower
            found[1:] += upper
        return span, found

    def values(self, t: Floats) -> Floats:
        """All basis functions at ``t`` in [0, 1], shape (len(t), count)."""
        first, local = self.local(t)
        full = np.zeros((len(t), self.count))
        np.put_along_axis(full, first[:, None] + np.arange(self.degree + 1), local.T, axis=1)
        return full

    def nodes(self, count: int) -> Floats:
        """``count`` Chebyshev nodes in each span, ascending, shape (spans * count,)."""
        one = (1.0 - np.cos((np.arange(count) + 0.5) * (math.pi / count))) / 2.0
        places: Floats = (np.arange(self.spans)[:, None] + one) / self.spans
        return places.ravel()

    @cached_property
    def _projection(self) -> tuple[Floats, Floats, Floats]:
        """Nodes, basis values there, and the matrix that gives the inner poles from values at the nodes."""
        t = self.nodes(2 * (self.degree + 1))
        values = self.values(t)
        solve: Floats = np.linalg.pinv(values[:, 2:-2]).astype(np.float64)
        return t, values, solve

    def poles(self, turn: Floats) -> Complexes:
        """Poles of the spline of ``exp(i turn t)``.

        Args:
            turn: Phase that each wave runs through on [0, 1], shape (n,).

        Returns:
            Shape (count, n).
        """
        end = np.exp(1j * turn)
        step = 1j * turn / (self.degree * self.spans)
        found = np.zeros((self.count, len(turn)), dtype=np.complex128)
        found[0], found[1], found[-2], found[-1] = 1.0, 1.0 + step, end * (1.0 - step), end
        if self.count > 4:
            t, values, solve = self._projection
            ends = [0, 1, -2, -1]
            rest = np.exp(1j * np.outer(t, turn)) - np.einsum("tk,kn->tn", values[:, ends], found[ends])
            found[2:-2] = np.einsum("kt,tn->kn", solve, rest)
        found[:, turn == 0.0] = 1.0
        return found

    @cached_property
    def _proof(self) -> tuple[int, float, Floats, NDArray[np.intp], Floats]:
        """Degree of the interpolant, inverse of the Ehlich-Zeller factor, nodes, and :meth:`local` there.

        Only the first half of the spans is looked at. Turned about, t to 1 - t, the basis and the least-squares nodes
        are what they were, and a wave becomes its own conjugate times a constant: its error is as large on both sides.
        """
        degree = self.degree + max(_EXTRA_DEGREE, self.degree // 2)
        count = _NODES_PER_DEGREE * degree
        t = self.nodes(count)[: (self.spans + 1) // 2 * count]
        return degree, 1.0 / math.cos(math.pi * degree / (2.0 * count)), t, *self.local(t)

    def error(self, turn: Floats, weight: Floats) -> float:
        """A proved bound, over [0, 1], of ``sum weight |exp(i turn t) - spline of it|``.

        On a span of half-width r each wave is replaced by its interpolant of degree m at Chebyshev nodes; the
        remainder is at most ``rho = 2 (|turn| r / 2)^(m+1) / (m+1)!``. What is left to bound is a polynomial of
        degree m, and by Ehlich and Zeller (1964) it nowhere passes its greatest value at N > m Chebyshev nodes by
        more than the factor ``1 / cos(pi m / (2 N))``. This holds for every rotation of the single errors in the
        complex plane, therefore for the weighted sum of their moduli.

        Args:
            turn: Phase that each wave runs through, shape (n,).
            weight: Weights, none negative, shape (n,).
        """
        turn, weight = turn[turn != 0.0], weight[turn != 0.0]
        if len(turn) == 0:
            return 0.0
        degree, factor, t, first, local = self._proof
        with np.errstate(divide="ignore"):
            logarithm = (degree + 1) * np.log(np.abs(turn) / (4.0 * self.spans)) - math.lgamma(degree + 2)
        fine = logarithm > 0.0
        crude = float(weight[fine] @ self._crude_error(turn[fine]))
        turn, weight = turn[~fine], weight[~fine]
        remainder = float(weight @ (2.0 * np.exp(logarithm[~fine])))
        distance = np.zeros(len(t))
        for start in range(0, len(turn), _WAVES_AT_A_TIME):
            part = slice(start, start + _WAVES_AT_A_TIME)
            off = np.exp(1j * np.outer(t, turn[part]))
            poles = self.poles(turn[part])
            for k, values in enumerate(local):
                off -= values[:, None] * poles[first + k]
            distance += np.einsum("tn,n->t", np.abs(off), weight[part])
        rounding = 64.0 * np.finfo(float).eps * float(weight @ (np.abs(turn) + self.count))
        return (float(distance.max()) + remainder) * factor + remainder + rounding + crude

    def _crude_error(self, turn: Floats) -> Floats:
        """A bound of each error from the size of the poles alone, for waves too fine for the spans."""
        ends = 1.0 + np.abs(turn) / (self.degree * self.spans)
        if self.count == 4:
            return 1.0 + ends
        norm = float(np.abs(self._projection[2]).sum(axis=1).max())
        return np.asarray(1.0 + np.maximum(ends, norm * (1.0 + ends)), dtype=np.float64)


@lru_cache(maxsize=256)
def basis(degree: int, spans: int) -> Basis:
    """The basis of this degree and number of spans."""
    return Basis(degree, spans)


@dataclass(frozen=True, eq=False)
class Axis:
    """One axis of a block, cut into patches that all carry the same basis.

    Args:
        lines: Ends of the patches in mm, ascending, shape (patches + 1,).
        basis: The basis on each patch.
    """

    lines: Floats
    basis: Basis

    @property
    def patches(self) -> int:
        """Number of patches."""
        return len(self.lines) - 1

    @property
    def pole_count(self) -> int:
        """Poles along the whole axis; those at the joints are shared."""
        return self.patches * (self.basis.count - 1) + 1

    @cached_property
    def _widths(self) -> Floats:
        """Widths of the patches in mm; those that differ by rounding only are made equal."""
        widths = np.diff(self.lines)
        for one in widths.copy():
            widths[np.abs(widths - one) <= 1e-12 * self.lines[-1]] = one
        return widths

    def knots_mm(self, patch: int) -> Floats:
        """Ends of the spans of a patch in mm, shape (spans + 1,)."""
        return self._scaled(patch, self.basis.breaks)

    def abscissae_mm(self, patch: int) -> Floats:
        """Where the poles of a patch lie along the axis, in mm, shape (count,)."""
        return self._scaled(patch, self.basis.greville)

    def _scaled(self, patch: int, unit: Floats) -> Floats:
        low, high = self.lines[patch], self.lines[patch + 1]
        found = low + (high - low) * unit
        found[0], found[-1] = low, high
        return np.asarray(found, dtype=np.float64)

    def poles(self, frequency: Floats) -> Complexes:
        """Poles of the splines of ``exp(i frequency t)``.

        Args:
            frequency: In radians per mm, shape (n,).

        Returns:
            Shape (patches, count, n). At a joint both patches have the same number.
        """
        starts = np.exp(1j * np.outer(self.lines[:-1], frequency))
        found = np.empty((self.patches, self.basis.count, len(frequency)), dtype=np.complex128)
        for width, chosen in self._by_width():
            unit = self.basis.poles(frequency * width)
            found[chosen] = unit[None, :, :] * starts[chosen][:, None, :]
        found[1:, 0] = found[:-1, -1]
        return found

    def sines(self, function: Sines) -> Floats:
        """Poles of the spline of a sum of sines, shape (patches, count)."""
        total = np.zeros((self.patches, self.basis.count))
        for start in range(0, len(function.amplitude), _WAVES_AT_A_TIME):
            part = slice(start, start + _WAVES_AT_A_TIME)
            rotation = function.amplitude[part] * np.exp(1j * function.phase[part])
            total += np.imag(np.einsum("pkn,n->pk", self.poles(function.frequency[part]), rotation))
        return total

    def error(self, frequency: Floats, weight: Floats) -> float:
        """A proved bound, over the whole axis, of ``sum weight |exp(i frequency t) - spline of it|``."""
        worst = max(self.basis.error(frequency * width, weight) for width, _ in self._by_width())
        rounding = 4.0 * np.finfo(float).eps * float(weight @ np.abs(frequency)) * float(np.abs(self.lines).max())
        return worst + rounding

    def _by_width(self) -> Iterator[tuple[float, Bools]]:
        for width in sorted(set(self._widths.tolist())):  # np.unique would load numpy.ma, longer than the rest takes
            yield width, self._widths == width
