"""Proved bounds of how far a faceted top lies from its formula.

Along one axis a fit is piecewise linear, and the formula is a sum of sines. Each link is cut into pieces; on a piece
the deviation ``e = fit - p`` is at most its larger end plus ``max(-e'') h^2 / 8``, where ``e'' = -p''`` is bounded by
its own values at the ends and the bound of ``p''''`` over the whole line, ``sum |A| k^4``. Nothing is left to samples:
every statement holds for all points of a piece.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacbench_cad.spec.waves import Sines
from tacbench_cad.util.types import Floats, Ints

#: Pieces that a link is cut into, at least.
PIECES = 40
#: Fraction of what is allowed that a formula may do between the ends of a piece, about.
SPARE = 0.00125
#: A piece spans at most this phase of the finest wave, in radians.
PIECE_PHASE = 0.125
#: Bins of the slope that two axes are paired through.
BINS = 400


def derivatives(sines: Sines, t: Floats, orders: Sequence[int]) -> list[Floats]:
    """Several derivatives of a sum of sines at once.

    Args:
        sines: The sum.
        t: Points, shape (n,).
        orders: Orders of the derivatives wanted, 0 for the value.

    Returns:
        One array (n,) for each order.
    """
    if len(sines.frequency) == 0:
        return [np.zeros(len(t)) for _ in orders]
    phase = np.multiply.outer(t, sines.frequency) + sines.phase
    parts = (np.sin(phase), np.cos(phase))
    found = []
    for order in orders:
        weight = sines.amplitude * sines.frequency**order
        found.append((parts[order % 2] @ weight) * (1.0 if order % 4 < 2 else -1.0))
    return found


@dataclass(frozen=True, kw_only=True)
class Allowance:
    """What one axis p of a separable top may deviate: ``w = fraction tolerance sqrt(1 + p'^2 / fraction)``.

    Args:
        tolerance_mm: The distance allowed to the whole top.
        fraction: This axis's part of it, above 0 and at most 1.
    """

    tolerance_mm: float
    fraction: float

    def half_width(self, slope: Floats) -> Floats:
        """The deviation allowed where p has this slope."""
        return np.asarray(self.fraction * self.tolerance_mm * np.sqrt(1.0 + slope**2 / self.fraction))

    def bend(self, least: Floats, most: Floats, second: Floats, third: Floats) -> Floats:
        """Bound of ``|w''|`` where ``least <= |p'| <= most`` and ``|p''|``, ``|p'''|`` have these bounds.

        As a function of ``s = p'``, w has the slope ``tolerance s / sqrt(1 + s^2 / fraction)`` and the second
        derivative ``tolerance (1 + s^2 / fraction)^(-3/2)``.
        """
        slope = most / np.sqrt(1.0 + most**2 / self.fraction)
        curve = (1.0 + least**2 / self.fraction) ** -1.5
        return np.asarray(self.tolerance_mm * (curve * second**2 + slope * third))


@dataclass(frozen=True, eq=False)
class AxisProof:
    """What is proved of a one-dimensional fit, piece by piece.

    Args:
        above: Upper bound of ``fit - p`` on each piece, shape (n,).
        below: Upper bound of ``p - fit`` on each piece, shape (n,).
        steep: Lower bound of ``|p'|`` on each piece, shape (n,).
        steepest: Upper bound of ``|p'|`` on each piece, shape (n,).
        ends: ``|fit - p|`` and ``p'`` at both ends of each piece, shape (2, 2, n).
        bend: Upper bounds of ``|p''|`` and ``|p'''|`` on each piece, shape (2, n).
        width: Length of each piece, shape (n,).
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
        """Whether the fit is the function itself."""
        return not (np.any(self.above) or np.any(self.below))

    def used(self, allowance: Allowance) -> float:
        """The least distance in whose allowance the fit stays, as a bound; infinite above the allowance's own.

        With w for the allowance and r for the part of it that is used, ``F = |fit - p| - r w`` is at most its larger
        end plus ``max(-F'') h^2 / 8``, and ``-F'' <= |p''| + |w''|`` as long as r is at most 1.
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
        at: Abscissae of the vertices, ascending, shape (n,).
        heights: Heights of the vertices, shape (n,).
        allowance: What is allowed, where something is: pieces are then short enough to tell it sharply.
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
    """The link and the fraction along it of every end of a piece, the very last one included."""
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
    """Bound of the distance of a separable top whose axes were given fractions s and 1 - s of a tolerance.

    The square root is concave, so by Jensen's inequality
    ``s sqrt(1 + p'^2 / s) + (1 - s) sqrt(1 + q'^2 / (1 - s)) <= sqrt(1 + p'^2 + q'^2)``: where each axis stays in its
    allowance, the distance stays within the tolerance.

    Args:
        along_x: The proof along x.
        along_y: The proof along y.
        tolerance_mm: The tolerance.
        fraction: The part of it that x was given.

    Returns:
        The bound in mm, infinite where an axis leaves its allowance.
    """
    used = [0.0]
    for proof, part in ((along_x, fraction), (along_y, 1.0 - fraction)):
        if not proof.exact:
            used.append(proof.used(Allowance(tolerance_mm=tolerance_mm, fraction=part)))
    return max(used)


def vertical(along_x: AxisProof, along_y: AxisProof) -> float:
    """Bound of the vertical deviation ``e_p(x) + e_q(y)`` of a separable top."""
    highest = float(along_x.above.max() + along_y.above.max())
    return max(highest, float(along_x.below.max() + along_y.below.max()), 0.0)


def paired(along_x: AxisProof, along_y: AxisProof) -> float:
    """Bound of the distance of a separable top, by pairing all pieces of one axis with all of the other."""
    return max(_paired(along_x, along_y, "above"), _paired(along_x, along_y, "below"), 0.0)


def _paired(along_x: AxisProof, along_y: AxisProof, side: str) -> float:
    """Largest ``(e_p + e_q) / sqrt(1 + p'^2 + q'^2)`` over all pairs of pieces."""
    e, s = _binned(getattr(along_x, side), along_x.steep**2)
    f, r = _binned(getattr(along_y, side), along_y.steep**2)
    return float(np.max((e[:, None] + f[None, :]) / np.sqrt(1.0 + s[:, None] + r[None, :])))


def _binned(deviation: Floats, steep: Floats) -> tuple[Floats, Floats]:
    """For each bin of the slope its largest deviation and least slope: no pair of pieces gives more than its bins."""
    level = np.log1p(steep)
    most = float(level.max())
    place = np.zeros(len(level), dtype=np.int64) if most == 0.0 else (level * ((BINS - 1) / most)).astype(np.int64)
    largest = np.full(BINS, -np.inf)
    np.maximum.at(largest, place, deviation)
    least = np.full(BINS, np.inf)
    np.minimum.at(least, place, steep)
    used = np.isfinite(largest)
    return largest[used], least[used]
