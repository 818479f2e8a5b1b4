"""Splines of a sum of sines along one axis, with few knots, poles of few decimals, and a proved error.

An axis is divided into patches. On each patch the spline has its own knots, which lie closer together where the
function is harder to follow. It has the value and the slope of the function at both ends of the patch. Between the
ends it is fitted by least squares. The weights of the fit and the places of the knots are improved step by step, until
the largest error is nearly the same on all spans.

Poles and knots are rounded, so that files need fewer characters. The proof uses the rounded values.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tacbench_cad.geometry.splines.exact import PieceAxis
from tacbench_cad.spec.sines import Sines
from tacbench_cad.spec.spline import SplineAxis
from tacbench_cad.util.types import Floats

#: The number of points on each span for the fit.
_POINTS = 6
#: The number of steps that improve the places of the knots, and the number that improve the weights afterwards.
_KNOT_STEPS, _WEIGHT_STEPS = 16, 6
#: The largest distance of the steps on which knots lie, as a fraction of the mean span.
_ROUNDING_OF_KNOTS = 0.08
#: A number that is added to errors, so that none is zero.
_TINY_MM = 1e-12
#: Weights that are all equal.
_SAME = np.ones((1, 1))
#: The largest fraction of the allowed error that one axis can have.
_LARGEST_FRACTION = 0.8
#: The number of patches in one array operation. It limits the memory for a long axis.
_PATCHES_AT_A_TIME = 32
#: In the proof, the function is replaced by its interpolant. The degree of the interpolant is higher than the degree
#: of the spline by this number.
_EXTRA_DEGREE = 8
#: The number of nodes for each degree in the proof. The factor in the bound is ``1 / cos(pi / 8)``.
_NODES_PER_DEGREE = 4


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted spline of one axis.

    Args:
        axis: The patches and their knots.
        poles_mm: The poles, shape (patches, count). At a joint, both patches have the same pole.
        error_mm: The proved bound of the error.
    """

    axis: PieceAxis
    poles_mm: Floats
    error_mm: float


@dataclass(frozen=True)
class Task:
    """A function to fit.

    Args:
        function: The function in mm.
        offset_mm: A number that is added to the function.
        lines: The ends of the patches in mm, ascending, shape (patches + 1,).
        degree: The degree of the spline.
        unit_mm: Poles are rounded to multiples of this number.
    """

    function: Sines
    offset_mm: float
    lines: Floats
    degree: int
    unit_mm: float

    def fit(self, spans: int) -> Fit:
        """Return a fit with this number of spans on each patch."""
        parts = [
            self._fit_patches(self.lines[start : start + _PATCHES_AT_A_TIME + 1], spans)
            for start in range(0, len(self.lines) - 1, _PATCHES_AT_A_TIME)
        ]
        breaks, poles = (np.concatenate([part[k] for part in parts]) for k in (0, 1))
        poles = np.round(poles / self.unit_mm) * self.unit_mm
        _join(breaks, poles)
        knots = _clamped(breaks, self.degree)
        axis = PieceAxis(self.lines, tuple(SplineAxis(own, self.degree) for own in knots), smooth=True)
        return Fit(axis, poles, self._bound(breaks, poles))

    def _fit_patches(self, lines: Floats, spans: int) -> tuple[Floats, Floats]:
        """Fit neighbouring patches. The poles are not rounded.

        Returns:
            The ends of the spans, shape (patches, spans + 1), and the poles, shape (patches, spans + degree).
        """
        width = np.diff(lines)[:, None]
        breaks = lines[:-1, None] + width * np.arange(spans + 1) / spans
        breaks[:, -1] = lines[1:]
        least, best = np.full(len(breaks), math.inf), breaks
        for _ in range(_KNOT_STEPS):
            error = _TINY_MM + np.abs(_System(self, breaks).solved(_SAME)[1])
            size = (error**4).mean(axis=1)
            best = np.where((size < least)[:, None], breaks, best)
            least = np.minimum(size, least)
            breaks = _moved(breaks, error.reshape(len(breaks), spans, _POINTS).max(axis=2), self.degree)
        step = short_decimal(_ROUNDING_OF_KNOTS * float(width.min()) / spans, self.degree)
        best = breaks[:, :1] + np.round((best - breaks[:, :1]) / step) * step
        best[:, [0, -1]] = breaks[:, [0, -1]]
        system, weight = _System(self, best), _SAME
        for _ in range(_WEIGHT_STEPS):
            error = _TINY_MM + np.abs(system.solved(weight)[1])
            weight = weight * (error / error.max(axis=1, keepdims=True) + 0.02)
        return best, system.solved(weight)[0] + self.offset_mm

    def _bound(self, breaks: Floats, poles: Floats) -> float:
        """Return a proved bound of the largest difference between the spline and the function.

        On a span of half-width r, the function is replaced by its interpolant of degree m at Chebyshev nodes. For each
        wave the remainder is at most ``rho = 2 A (k r / 2)^(m + 1) / (m + 1)!``. The rest of the difference is a
        polynomial of degree m. By Ehlich and Zeller (1964), its maximum is at most its largest value at N > m Chebyshev
        nodes times ``1 / cos(pi m / (2 N))``. A wave that is too fine for this counts with its amplitude.
        """
        degree = self.degree + _EXTRA_DEGREE
        count = _NODES_PER_DEGREE * degree
        factor = 1.0 / math.cos(math.pi * degree / (2.0 * count))
        half = float(np.diff(breaks, axis=1).max()) / 2.0
        amplitude, frequency = np.abs(self.function.amplitude), np.abs(self.function.frequency)
        with np.errstate(divide="ignore"):
            logarithm = (degree + 1) * np.log(frequency * half / 2.0) - math.lgamma(degree + 2)
        fine = logarithm > math.log(0.1)
        coarse = Sines(
            *(part[~fine] for part in (self.function.amplitude, self.function.frequency, self.function.phase))
        )
        remainder = float(amplitude[~fine] @ (2.0 * np.exp(logarithm[~fine])))
        largest = 0.0
        for start in range(0, len(breaks), _PATCHES_AT_A_TIME):
            rows = slice(start, start + _PATCHES_AT_A_TIME)
            points, basis = _collocation(breaks[rows], self.degree, count)
            difference = coarse(points) + self.offset_mm - (basis @ poles[rows, :, None])[:, :, 0]
            largest = max(largest, float(np.abs(difference).max()))
        reach = float(np.abs(self.lines).max())
        size = abs(self.offset_mm) + float(amplitude @ (1.0 + frequency * reach + np.abs(self.function.phase)))
        rounding = 64.0 * float(np.finfo(float).eps) * size
        return (largest + remainder) * factor + remainder + float(amplitude[fine].sum()) + rounding


class _System:
    """The equations for the poles of some patches with given knots.

    Args:
        task: The function to fit.
        breaks: The ends of the spans, shape (patches, spans + 1).
    """

    def __init__(self, task: Task, breaks: Floats) -> None:
        value, slope = (task.function(breaks[:, [0, -1]], order) for order in (0, 1))
        width = np.diff(breaks, axis=1)
        rise = slope * width[:, [0, -1]] / task.degree
        self._ends = np.stack([value[:, 0], value[:, 0] + rise[:, 0], value[:, 1] - rise[:, 1], value[:, 1]], axis=1)
        points, basis = _collocation(breaks, task.degree, _POINTS)
        self._rest = task.function(points) - (basis[:, :, [0, 1, -2, -1]] @ self._ends[:, :, None])[:, :, 0]
        self._inner = basis[:, :, 2:-2]
        self._weight = np.repeat(width, _POINTS, axis=1)

    def solved(self, weight: Floats) -> tuple[Floats, Floats]:
        """Return the poles, shape (patches, count), and the errors at the points, shape (patches, points).

        Args:
            weight: Additional weights of the points.
        """
        weighted = self._inner.transpose(0, 2, 1) * (self._weight * weight)[:, None, :]
        middle = np.linalg.solve(weighted @ self._inner, weighted @ self._rest[:, :, None])
        error = self._rest - (self._inner @ middle)[:, :, 0]
        poles = np.concatenate([self._ends[:, :2], middle[:, :, 0], self._ends[:, 2:]], axis=1)
        return poles, error


def fit_both(
    tasks: tuple[Task, Task], limit_mm: float, starts: tuple[int, int], fewest: tuple[int, int], most: int
) -> tuple[Fit, Fit] | None:
    """Fit the functions of both axes with few spans, so that the sum of their errors is within a limit.

    Args:
        tasks: The functions along x and y.
        limit_mm: The limit.
        starts: The numbers of spans on each patch with which the search begins.
        fewest: The smallest numbers of spans on each patch.
        most: The largest number of spans on each patch.

    Returns:
        The fits, or None if the largest number of spans is not enough.
    """
    fits: tuple[dict[int, Fit], dict[int, Fit]] = ({}, {})
    spans = [min(max(start, least), most) for start, least in zip(starts, fewest, strict=True)]

    def error(axis: int, number: int) -> float:
        if number not in fits[axis]:
            fits[axis][number] = tasks[axis].fit(number)
        return fits[axis][number].error_mm

    for axis in (0, 1):
        while spans[axis] > fewest[axis] and error(axis, spans[axis]) <= limit_mm * _LARGEST_FRACTION:
            spans[axis] -= 1
    while True:
        errors = [error(axis, spans[axis]) for axis in (0, 1)]
        if sum(errors) <= limit_mm:
            return fits[0][spans[0]], fits[1][spans[1]]
        worse = 0 if errors[0] > errors[1] else 1
        if spans[worse] == most:
            return None
        spans[worse] += 1


def short_decimal(limit: float, multiple: int = 1) -> float:
    """Return the largest number of the form ``multiple * 10^-k`` that is at most a limit."""
    return float(multiple * 10.0 ** math.floor(math.log10(limit / multiple)))


def _clamped(breaks: Floats, degree: int) -> Floats:
    """Return the knots of all patches, shape (patches, spans + 1 + 2 degree)."""
    first, last = (np.repeat(breaks[:, [at]], degree, axis=1) for at in (0, -1))
    return np.concatenate([first, breaks, last], axis=1)


def _collocation(breaks: Floats, degree: int, count: int) -> tuple[Floats, Floats]:
    """Return Chebyshev nodes of all spans and the values of all basis functions there.

    Returns:
        The nodes, shape (patches, spans * count), and the values, shape (patches, spans * count, spans + degree).
    """
    from scipy.interpolate import BSpline

    in_span = (1.0 - np.cos((np.arange(count) + 0.5) * (math.pi / count))) / 2.0
    points = (breaks[:, :-1, None] + np.diff(breaks)[:, :, None] * in_span).reshape(len(breaks), -1)
    knots = _clamped(breaks, degree)
    basis = [BSpline.design_matrix(at, own, degree).toarray() for at, own in zip(points, knots, strict=True)]
    return points, np.stack(basis)


def _moved(breaks: Floats, error: Floats, degree: int) -> Floats:
    """Make spans with a large error shorter and the others longer."""
    mean = error.mean(axis=1, keepdims=True)
    width = np.diff(breaks, axis=1) * (mean / (error + 0.1 * mean)) ** (0.5 / (degree + 1))
    width *= (breaks[:, -1:] - breaks[:, :1]) / width.sum(axis=1, keepdims=True)
    moved = np.concatenate([breaks[:, :1], breaks[:, :1] + np.cumsum(width, axis=1)], axis=1)
    moved[:, -1] = breaks[:, -1]
    return np.asarray(moved)


def _join(breaks: Floats, poles: Floats) -> None:
    """Set the poles at the joints so that value and slope are continuous."""
    left, right = (breaks[:-1, -1] - breaks[:-1, -2]), (breaks[1:, 1] - breaks[1:, 0])
    joint = (right * poles[:-1, -2] + left * poles[1:, 1]) / (left + right)
    poles[:-1, -1] = joint
    poles[1:, 0] = joint
