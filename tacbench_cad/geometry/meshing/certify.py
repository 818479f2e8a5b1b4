"""Proved bounds for the distance between a faceted top and its formula.

Along one axis, a fit is piecewise linear, and the formula is a sum of sines. Each link is divided into pieces of length
h. On a piece, the deviation ``e = fit - p`` is at most its larger value at the two ends plus ``max(-e'') h^2 / 8``. Its
second derivative ``e'' = -p''`` is bounded by its values at the ends and by the bound of ``p''''`` over the whole line,
``sum |A| k^4``. The bounds hold for all points of a piece, not only for samples.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacbench_cad.spec.waves import Sines
from tacbench_cad.util.types import Floats, Ints

#: The smallest number of pieces of a link.
PIECES = 40
#: The approximate fraction of the allowance that the formula can use between the ends of a piece.
SPARE = 0.00125
#: The largest phase of the finest wave on a piece, in radians.
PIECE_PHASE = 0.125
#: The number of bins of the slope for pairing two axes.
BINS = 400


def derivatives(sines: Sines, t: Floats, orders: Sequence[int]) -> list[Floats]:
    """Compute several derivatives of a sum of sines.

    Args:
        sines: The sum.
        t: The points, shape (n,).
        orders: The orders of the derivatives; 0 is the value itself.

    Returns:
        An array of shape (n,) for each order.
    """
    if len(sines.frequency) == 0:
        return [np.zeros(len(t)) for _ in orders]
    phase = np.multiply.outer(t, sines.frequency) + sines.phase
    parts = (np.sin(phase), np.cos(phase))
    results = []
    for order in orders:
        weight = sines.amplitude * sines.frequency**order
        results.append((parts[order % 2] @ weight) * (1.0 if order % 4 < 2 else -1.0))
    return results


@dataclass(frozen=True, kw_only=True)
class Allowance:
    """The allowed deviation of one axis p of a separable top: ``w = fraction tolerance sqrt(1 + p'^2 / fraction)``.

    Args:
        tolerance_mm: The allowed distance of the whole top.
        fraction: The fraction of the tolerance for this axis, above 0 and at most 1.
    """

    tolerance_mm: float
    fraction: float

    def half_width(self, slope: Floats) -> Floats:
        """Return the allowed deviation where p has this slope."""
        return np.asarray(self.fraction * self.tolerance_mm * np.sqrt(1.0 + slope**2 / self.fraction))

    def bend(self, lowest: Floats, highest: Floats, second: Floats, third: Floats) -> Floats:
        """Return a bound of ``|w''|`` where ``lowest <= |p'| <= highest`` and ``|p''|``, ``|p'''|`` have these bounds.

        As a function of ``s = p'``, w has the slope ``tolerance s / sqrt(1 + s^2 / fraction)`` and the second
        derivative ``tolerance (1 + s^2 / fraction)^(-3/2)``.
        """
        slope = highest / np.sqrt(1.0 + highest**2 / self.fraction)
        curve = (1.0 + lowest**2 / self.fraction) ** -1.5
        return np.asarray(self.tolerance_mm * (curve * second**2 + slope * third))


@dataclass(frozen=True, eq=False)
class AxisProof:
    """Proved bounds for a one-dimensional fit, for each piece.

    Args:
        above: The upper bound of ``fit - p`` on each piece, shape (n,).
        below: The upper bound of ``p - fit`` on each piece, shape (n,).
        steep: The lower bound of ``|p'|`` on each piece, shape (n,).
        steepest: The upper bound of ``|p'|`` on each piece, shape (n,).
        ends: The values of ``|fit - p|`` and ``p'`` at both ends of each piece, shape (2, 2, n).
        bend: The upper bounds of ``|p''|`` and ``|p'''|`` on each piece, shape (2, n).
        width: The length of each piece, shape (n,).
    """

    above: Floats
    below: Floats
    steep: Floats
    steepest: Floats
    ends: Floats
    bend: Floats
    width: Floats

    @property
    def exact(self) -> bool:
        """Whether the fit is equal to the function."""
        return not (np.any(self.above) or np.any(self.below))

    def used(self, allowance: Allowance) -> float:
        """Return an upper bound of the smallest tolerance that the fit meets, in mm.

        The result is infinite if it is larger than the tolerance of the allowance. With the allowance w and the used
        fraction r of it, ``F = |fit - p| - r w`` is at most its larger value at the two ends plus
        ``max(-F'') h^2 / 8``, and ``-F'' <= |p''| + |w''|`` if r is at most 1.
        """
        second, third = self.bend
        spare = (second + allowance.bend(self.steep, self.steepest, second, third)) * self.width**2 / 8.0
        deviation, slope = self.ends
        used = float(np.max((deviation + spare) / allowance.half_width(slope)))
        return used * allowance.tolerance_mm if used <= 1.0 else math.inf


def prove_axis(sines: Sines, at: Floats, heights: Floats, allowance: Allowance | None = None) -> AxisProof:
    """Bound the deviation of a piecewise-linear function from a sum of sines.

    Args:
        sines: The sum p.
        at: The abscissae of the vertices, ascending, shape (n,).
        heights: The heights of the vertices, shape (n,).
        allowance: The allowance; None if there is none. With an allowance, the pieces are so short that
            :meth:`AxisProof.used` gives a tight bound.
    """
    lengths = np.diff(at)
    if sines.is_constant:
        deviation = heights - derivatives(sines, at, [0])[0]
        nothing = np.zeros(len(lengths))
        ends = np.stack([np.stack([deviation[:-1], deviation[1:]]), np.zeros((2, len(lengths)))])
        above, below = ends[0].max(axis=0), (-ends[0]).max(axis=0)
        return AxisProof(above, below, nothing, nothing, np.abs(ends), np.zeros((2, len(lengths))), lengths)
    link, fraction = _pieces(sines, at, allowance)
    points = at[link] + fraction * lengths[link]
    fit = heights[link] + fraction * (heights[link + 1] - heights[link])
    value, slope, second, third = derivatives(sines, points, [0, 1, 2, 3])
    width = np.diff(points)
    square = width**2 / 8.0
    swing = sines.bound(4) * square
    highest = np.maximum(second[:-1], second[1:]) + swing
    lowest = np.minimum(second[:-1], second[1:]) - swing
    deviation = fit - value
    above = np.maximum(deviation[:-1], deviation[1:]) + np.maximum(highest, 0.0) * square
    below = np.maximum(-deviation[:-1], -deviation[1:]) + np.maximum(-lowest, 0.0) * square
    jerk = np.maximum(np.abs(third[:-1]), np.abs(third[1:])) + sines.bound(5) * square
    left, right = np.abs(slope[:-1]), np.abs(slope[1:])
    one_way = slope[:-1] * slope[1:] > 0.0
    steep = np.where(one_way, np.maximum(np.minimum(left, right) - jerk * square, 0.0), 0.0)
    steepest = np.maximum(left, right) + jerk * square
    ends = np.stack([np.abs([deviation[:-1], deviation[1:]]), np.stack([slope[:-1], slope[1:]])])
    return AxisProof(above, below, steep, steepest, ends, np.stack([np.maximum(highest, -lowest), jerk]), width)


def _pieces(sines: Sines, at: Floats, allowance: Allowance | None) -> tuple[Ints, Floats]:
    """Return the link and the fraction along it for the start of every piece and the end of the last piece."""
    lengths = np.diff(at)
    finest = float(np.max(np.abs(sines.frequency)))
    numbers = np.maximum(PIECES, lengths * (finest / PIECE_PHASE))
    if allowance is not None:
        points = (at[:-1, None] + lengths[:, None] * (np.arange(5) / 4.0)).ravel()
        slope, second, third = np.abs(derivatives(sines, points, [1, 2, 3]))
        per_mm = np.sqrt((second + allowance.bend(slope, slope, second, third)) / allowance.half_width(slope))
        numbers = np.maximum(numbers, per_mm.reshape(-1, 5).max(axis=1) * lengths / math.sqrt(8.0 * SPARE))
    pieces = np.ceil(numbers).astype(np.int64)
    link = np.repeat(np.arange(len(lengths)), pieces)
    first = np.repeat(np.cumsum(pieces) - pieces, pieces)
    fraction = (np.arange(len(link)) - first) / pieces[link]
    return np.append(link, len(lengths) - 1), np.append(fraction, 1.0)


def within(along_x: AxisProof, along_y: AxisProof, tolerance_mm: float, fraction: float) -> float:
    """Bound the distance of a separable top whose axes have the fractions s and 1 - s of a tolerance.

    The square root is concave, so by Jensen's inequality
    ``s sqrt(1 + p'^2 / s) + (1 - s) sqrt(1 + q'^2 / (1 - s)) <= sqrt(1 + p'^2 + q'^2)``. If each axis is within its
    allowance, the distance is therefore within the tolerance.

    Args:
        along_x: The proof along x.
        along_y: The proof along y.
        tolerance_mm: The tolerance.
        fraction: The fraction of the tolerance for x.

    Returns:
        The bound in mm. It is infinite if an axis exceeds its allowance.
    """
    used = [0.0]
    for proof, part in ((along_x, fraction), (along_y, 1.0 - fraction)):
        if not proof.exact:
            used.append(proof.used(Allowance(tolerance_mm=tolerance_mm, fraction=part)))
    return max(used)


def vertical(along_x: AxisProof, along_y: AxisProof) -> float:
    """Bound the vertical deviation ``e_p(x) + e_q(y)`` of a separable top."""
    highest = float(along_x.above.max() + along_y.above.max())
    return max(highest, float(along_x.below.max() + along_y.below.max()), 0.0)


def paired(along_x: AxisProof, along_y: AxisProof) -> float:
    """Bound the distance of a separable top by pairing all pieces of one axis with all pieces of the other axis."""
    return max(_paired(along_x, along_y, "above"), _paired(along_x, along_y, "below"), 0.0)


def _paired(along_x: AxisProof, along_y: AxisProof, side: str) -> float:
    """Return the largest ``(e_p + e_q) / sqrt(1 + p'^2 + q'^2)`` over all pairs of pieces."""
    e, s = _binned(getattr(along_x, side), along_x.steep**2)
    f, r = _binned(getattr(along_y, side), along_y.steep**2)
    return float(np.max((e[:, None] + f[None, :]) / np.sqrt(1.0 + s[:, None] + r[None, :])))


def _binned(deviation: Floats, steep: Floats) -> tuple[Floats, Floats]:
    """Return the largest deviation and the smallest slope in each bin of the slope.

    Pairs of bins then give an upper bound for all pairs of pieces.
    """
    level = np.log1p(steep)
    highest = float(level.max())
    place = (
        np.zeros(len(level), dtype=np.int64) if highest == 0.0 else (level * ((BINS - 1) / highest)).astype(np.int64)
    )
    largest = np.full(BINS, -np.inf)
    np.maximum.at(largest, place, deviation)
    smallest = np.full(BINS, np.inf)
    np.minimum.at(smallest, place, steep)
    used = np.isfinite(largest)
    return largest[used], smallest[used]
