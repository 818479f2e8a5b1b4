"""Proved bounds for the distance between a faceted top and its formula.

Along one axis, a fit is piecewise linear, and the formula is a sum of sines. Each link is divided into pieces of length
h. On a piece, the deviation ``e = fit - p`` is at most its larger value at the two ends plus ``max(-e'') h^2 / 8``. Its
second derivative ``e'' = -p''`` is bounded by its values at the ends and by the bound of ``p''''`` over the whole line,
``sum |A| k^4``. The bounds hold for all points of a piece, not only for samples.

The distance is bounded in the same way, between each point of a piece and a point of p that is shifted along the axis.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacbench_cad.spec.sines import Sines
from tacbench_cad.util.types import Floats, Ints

#: The smallest number of pieces of a link.
PIECES = 40
#: The approximate fraction of the allowance that the formula can use between the ends of a piece.
SPARE = 0.00125
#: The largest phase of the finest wave on a piece, in radians.
PIECE_PHASE = 0.125
#: The number of steps of the search for the nearest points.
STEPS = 3
#: The largest change of the shift per mm beside a point where the slope is 0.
SHIFT_CHANGE = 4.0


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
    """The allowed distance of one axis p of a separable top.

    To first order, the allowed deviation is ``w = fraction tolerance sqrt(1 + p'^2 / fraction)``.

    Args:
        tolerance_mm: The allowed distance of the whole top.
        fraction: The fraction of the tolerance for this axis, above 0 and at most 1.
    """

    tolerance_mm: float
    fraction: float

    def half_width(self, slope: Floats) -> Floats:
        """Return the allowed deviation where p has this slope, to first order."""
        return np.asarray(self.fraction * self.tolerance_mm * np.sqrt(1.0 + slope**2 / self.fraction))

    def half_widths(self, sines: Sines, t: Floats) -> tuple[Floats, Floats]:
        """Return the allowed deviations below and above p at some points.

        A point above p is near enough if an ellipse around it, with the half axes ``sqrt(s) tolerance`` along the axis
        and ``s tolerance`` along z, reaches p. The points where it touches p are found by a few steps.

        Args:
            sines: The sum p.
            t: The points from one end of the axis to the other, ascending, shape (n,).
        """
        value, slope = derivatives(sines, t, [0, 1])
        reach = _reach(t, slope)
        widths = []
        for sign in (-1.0, 1.0):
            width = np.full(len(t), self.fraction * self.tolerance_mm)
            uphill = sign * np.sign(slope)
            bent = slope
            for _ in range(STEPS):
                best = self.tolerance_mm * bent * np.sign(slope) / np.sqrt(1.0 + bent**2 / self.fraction)
                shift = np.clip(best, 0.0, reach)
                there, bent = derivatives(sines, t + uphill * shift, [0, 1])
                ellipse = np.sqrt(np.maximum(self.tolerance_mm**2 - shift**2 / self.fraction, 0.0))
                width = np.maximum(width, sign * (there - value) + self.fraction * ellipse)
            widths.append(np.minimum(width, self.half_width(slope)))
        return widths[0], widths[1]

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
        sines: The sum p.
        at: The ends of the pieces, ascending, shape (n + 1,).
        fit: The fit at the ends of the pieces, shape (n + 1,). It is linear on each piece.
        above: The upper bound of ``fit - p`` on each piece, shape (n,).
        below: The upper bound of ``p - fit`` on each piece, shape (n,).
    """

    sines: Sines
    at: Floats
    fit: Floats
    above: Floats
    below: Floats

    @property
    def exact(self) -> bool:
        """Whether the fit is equal to the function."""
        return not (np.any(self.above) or np.any(self.below))

    def distance(self, fraction: float) -> float:
        """Bound the distance between the fit and p, with this fraction s of the distance of a whole top.

        Every point ``(x, fit(x))`` is compared with a point ``(x + v(x), p(x + v(x)))``. The shift v is continuous,
        linear on each piece, and 0 at both ends of the axis, so every point of p is compared as well. The distance is
        ``sqrt(v^2 / s + (fit(x) - p(x + v))^2 / s^2)``; see :func:`within`. On a piece, the second difference is at
        most as far from its linear interpolation as p is from its own on the shifted piece, ``max|p''| h^2 / 8``. Any
        shift gives a bound. Three damped steps of Gauss and Newton look for the one with the smallest distance.
        """
        value, slope, second = derivatives(self.sines, self.at, [0, 1, 2])
        shift, rest = np.zeros(len(self.at)), self.fit - value
        first = 1.5 * rest * slope / (fraction + slope**2)
        most = np.minimum(np.abs(first), _reach(self.at, slope))
        low, high = np.where(first < 0.0, -most, 0.0), np.where(first > 0.0, most, 0.0)
        step = np.ones(len(self.at))
        for _ in range(STEPS):
            best = slope * (rest + slope * shift) / (fraction + slope**2)
            trial = shift + step * (np.clip(best, low, high) - shift)
            value, *bent = derivatives(self.sines, self.at + trial, [0, 1, 2])
            left = self.fit - value
            nearer = trial**2 * fraction + left**2 < shift**2 * fraction + rest**2
            shift, rest = np.where(nearer, trial, shift), np.where(nearer, left, rest)
            slope, second = np.where(nearer, bent[0], slope), np.where(nearer, bent[1], second)
            step = np.where(nearer, 1.0, 0.4 * step)
        square = np.diff(self.at + shift) ** 2 / 8.0
        between = (_largest_end(np.abs(second)) + self.sines.bound(4) * square) * square / fraction
        whole, rest = np.hypot(shift / math.sqrt(fraction), rest / fraction), np.abs(rest) / fraction
        return float(np.sqrt(_largest_end(whole) ** 2 + between * (2.0 * _largest_end(rest) + between)).max())


def _reach(t: Floats, slope: Floats) -> Floats:
    """Return the largest shifts at some points: small near the ends, and near the points where the slope is 0.

    There, the shifts to both sides must meet at 0.
    """
    flat = np.flatnonzero(slope[:-1] * slope[1:] <= 0.0)
    turn = slope[flat] - slope[flat + 1]
    part = np.divide(slope[flat], turn, out=np.full(len(flat), 0.5), where=turn != 0.0)
    still = np.concatenate([[-np.inf], t[flat] + part * (t[flat + 1] - t[flat]), [np.inf]])
    after = np.searchsorted(still, t)
    level = np.minimum(t - still[after - 1], still[after] - t)
    return np.asarray(np.minimum(np.minimum(t - t[0], t[-1] - t), SHIFT_CHANGE * level))


def _largest_end(values: Floats) -> Floats:
    """Return the larger value at the two ends of each piece."""
    return np.asarray(np.maximum(values[:-1], values[1:]))


def prove_axis(sines: Sines, at: Floats, heights: Floats, allowance: Allowance | None = None) -> AxisProof:
    """Bound the deviation of a piecewise-linear function from a sum of sines.

    Args:
        sines: The sum p.
        at: The abscissae of the vertices, ascending, shape (n,).
        heights: The heights of the vertices, shape (n,).
        allowance: The allowance; None if there is none. With an allowance, the pieces are so short that
            :meth:`AxisProof.distance` gives a tight bound.
    """
    lengths = np.diff(at)
    if sines.is_constant:
        deviation = heights - derivatives(sines, at, [0])[0]
        return AxisProof(sines, at, heights, _largest_end(deviation), _largest_end(-deviation))
    link, fraction = _pieces(sines, at, allowance)
    points = at[link] + fraction * lengths[link]
    fit = heights[link] + fraction * (heights[link + 1] - heights[link])
    value, second = derivatives(sines, points, [0, 2])
    square = np.diff(points) ** 2 / 8.0
    swing = sines.bound(4) * square
    deviation = fit - value
    above = _largest_end(deviation) + np.maximum(_largest_end(second) + swing, 0.0) * square
    below = _largest_end(-deviation) + np.maximum(_largest_end(-second) + swing, 0.0) * square
    return AxisProof(sines, points, fit, above, below)


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


def within(along_x: AxisProof, along_y: AxisProof, fraction: float) -> float:
    """Bound the distance of a separable top from its formula.

    The shifts v and w of both axes and the differences a and b of their heights lead from each point of the top to a
    point of the formula at the distance ``sqrt(v^2 + w^2 + (a + b)^2)``. The square is convex, so
    ``(a + b)^2 <= a^2 / s + b^2 / (1 - s)``. If ``v^2 / s + a^2 / s^2`` and ``w^2 / (1 - s) + b^2 / (1 - s)^2`` are at
    most the square of a distance, so is the sum. The shifts are continuous and keep the sides of the rectangle, so
    they reach every point of the formula.

    Args:
        along_x: The proof along x.
        along_y: The proof along y.
        fraction: The fraction s of the distance for x.

    Returns:
        The bound in mm of the distance of each point of one surface from the other surface.
    """
    parts = ((along_x, fraction), (along_y, 1.0 - fraction))
    return max([0.0, *(proof.distance(part) for proof, part in parts if not proof.exact)])


def vertical(along_x: AxisProof, along_y: AxisProof) -> float:
    """Bound the vertical deviation ``e_p(x) + e_q(y)`` of a separable top."""
    highest = float(along_x.above.max() + along_y.above.max())
    return max(highest, float(along_x.below.max() + along_y.below.max()), 0.0)
