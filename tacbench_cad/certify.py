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
from numpy.typing import NDArray

from tacbench_cad.mesh import Certificate
from tacbench_cad.waves import Sines

Floats = NDArray[np.float64]

#: Pieces that a link is cut into, at least.
PIECES = 40
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


@dataclass(frozen=True, eq=False)
class AxisProof:
    """What is proved of a one-dimensional fit, piece by piece.

    Args:
        above: Upper bound of ``fit - p`` on each piece, shape (n,).
        below: Upper bound of ``p - fit`` on each piece, shape (n,).
        steep: Lower bound of ``p'^2`` on each piece, shape (n,).
        ends: ``|fit - p|``, ``p'``, at both ends of each piece, shape (2, 2, n).
        bend: Upper bounds of ``|p''|`` and ``|p'''|`` on each piece, shape (2, n).
        width: Length of each piece, shape (n,).
    """

    above: Floats
    below: Floats
    steep: Floats
    ends: Floats
    bend: Floats
    width: Floats

    @property
    def exact(self) -> bool:
        """Whether the fit is the function itself."""
        return not (np.any(self.above) or np.any(self.below))

    def share_of(self, share: float, limit_mm: float) -> float:
        """The least r with ``|fit - p| <= r share sqrt(1 + p'^2 / share)`` on every piece.

        With ``g`` for the right side without r, ``F = e - r g`` is at most its larger end plus ``max(-F'') h^2 / 8``
        and ``|F''| <= |p''| + r (p''^2 + sqrt(share) |p'''|)``, because ``g`` as a function of ``p'`` has a slope of
        at most ``sqrt(share)`` and a second derivative between 0 and 1.

        Args:
            share: This axis's part of the tolerance, above 0 and at most 1.
            limit_mm: An r that is not passed; where it is, infinity is returned.
        """
        second, third = self.bend
        spare = (second + limit_mm * (second**2 + math.sqrt(share) * third)) * self.width**2 / 8.0
        deviation, slope = self.ends
        allowed = share * np.sqrt(1.0 + slope**2 / share)
        found = float(np.max((deviation + spare) / allowed))
        return found if found <= limit_mm else math.inf


def prove_axis(sines: Sines, at: Floats, heights: Floats) -> AxisProof:
    """Bound the deviation of a piecewise-linear function from a sum of sines.

    Args:
        sines: The sum p.
        at: Abscissae of the vertices, ascending, shape (n,).
        heights: Heights of the vertices, shape (n,).
    """
    lengths = np.diff(at)
    if sines.is_constant:
        value = derivatives(sines, at, [0])[0]
        deviation = heights - value
        ends = np.stack([np.stack([deviation[:-1], deviation[1:]]), np.zeros((2, len(lengths)))])
        above, below = ends[0].max(axis=0), (-ends[0]).max(axis=0)
        nothing = np.zeros(len(lengths))
        return AxisProof(above, below, nothing, np.abs(ends), np.zeros((2, len(lengths))), lengths)
    finest = float(np.max(np.abs(sines.frequency)))
    pieces = np.maximum(PIECES, np.ceil(lengths * (finest / PIECE_PHASE))).astype(np.int64)
    start = np.repeat(np.cumsum(pieces) - pieces, pieces)
    link = np.repeat(np.arange(len(lengths)), pieces)
    share = np.append((np.arange(len(link)) - start) / pieces[link], 1.0)
    link = np.append(link, len(lengths) - 1)
    points = at[link] + share * lengths[link]
    fit = heights[link] + share * (heights[link + 1] - heights[link])
    value, slope, second, third = derivatives(sines, points, [0, 1, 2, 3])
    width = np.diff(points)
    square = width**2 / 8.0
    left, right = second[:-1], second[1:]
    swing = sines.bound(4) * square
    highest, lowest = np.maximum(left, right) + swing, np.minimum(left, right) - swing
    deviation = fit - value
    above = np.maximum(deviation[:-1], deviation[1:]) + np.maximum(highest, 0.0) * square
    below = np.maximum(-deviation[:-1], -deviation[1:]) + np.maximum(-lowest, 0.0) * square
    jerk = np.maximum(np.abs(third[:-1]), np.abs(third[1:])) + sines.bound(5) * square
    least = np.minimum(np.abs(slope[:-1]), np.abs(slope[1:])) - jerk * square
    one_way = slope[:-1] * slope[1:] > 0.0
    steep = np.where(one_way, np.maximum(least, 0.0), 0.0) ** 2
    size = np.abs(deviation)
    ends = np.stack([np.stack([size[:-1], size[1:]]), np.stack([slope[:-1], slope[1:]])])
    return AxisProof(above, below, steep, ends, np.stack([np.maximum(highest, -lowest), jerk]), width)


def combine(
    along_x: AxisProof, along_y: AxisProof, rounding_mm: float, share: float | None = None, limit_mm: float = math.inf
) -> Certificate:
    """Bound the deviation ``e_p(x) + e_q(y)`` of a separable top.

    Args:
        along_x: The proof along x.
        along_y: The proof along y.
        rounding_mm: What the rounding of heights adds.
        share: The part s of the tolerance that x was given. The square root is concave, so by Jensen's inequality
            ``s sqrt(1 + p'^2 / s) + (1 - s) sqrt(1 + q'^2 / (1 - s)) <= sqrt(1 + p'^2 + q'^2)``, which gives a sharp
            bound of the distance. None to pair the pieces of both axes instead.
        limit_mm: See :meth:`AxisProof.share_of`.
    """
    highest = float(along_x.above.max() + along_y.above.max())
    lowest = float(along_x.below.max() + along_y.below.max())
    vertical = max(highest, lowest, 0.0)
    if share is None:
        distance = max(_paired(along_x, along_y, "above"), _paired(along_x, along_y, "below"), 0.0)
    else:
        first = 0.0 if along_x.exact else along_x.share_of(share, limit_mm)
        second = 0.0 if along_y.exact else along_y.share_of(1.0 - share, limit_mm)
        distance = max(first, second)
    return Certificate(distance_mm=min(distance, vertical) + rounding_mm, vertical_mm=vertical + rounding_mm)


def _paired(along_x: AxisProof, along_y: AxisProof, side: str) -> float:
    """Largest ``(e_p + e_q) / sqrt(1 + p'^2 + q'^2)`` over all pairs of pieces."""
    e, s = _binned(getattr(along_x, side), along_x.steep)
    f, r = _binned(getattr(along_y, side), along_y.steep)
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
