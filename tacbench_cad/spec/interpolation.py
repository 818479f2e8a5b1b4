"""Splines through samples: height maps, and functions of Python that are sampled where they need it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from tacbench_cad.spec.spline import SplineAxis, SplineSurface
from tacbench_cad.spec.surface import Unit
from tacbench_cad.util.errors import InputError, one_line
from tacbench_cad.util.types import Bools, Floats

#: The degree of the splines through samples.
DEGREE = 3
#: The largest number of samples of a height map, and of poles of a sampled function.
MAX_SAMPLES, MAX_POLES = 20_000_000, 2_000_000
#: The number of points for each interval between samples at which the error of a sampled function is measured.
_POINTS = np.array([0.11, 0.29, 0.5, 0.71, 0.89])
#: The number of spans in which the error is measured more densely, the number of points along their sides, and the
#: largest number of lines before.
_ZOOMED, _ZOOM, _MAX_LINES = 40, 30, 1500
#: The largest ratio of the lengths of neighbouring intervals.
_RATIO = 4.0

#: A height as a function of u and v, called with arrays.
Function = Callable[[Floats, Floats], ArrayLike]


def spline_through(
    u: Floats, v: Floats, heights: Floats, *, repeats: tuple[bool, bool] = (False, False)
) -> SplineSurface:
    """Return the cubic spline through samples on a grid of lines.

    Args:
        u: The positions of the lines along u, ascending, shape (n,), at least 4.
        v: The positions of the lines along v, shape (m,), at least 4.
        heights: The samples, shape (n, m).
        repeats: Whether the surface repeats along u and v. Then the last line is the first line of the next period.
    """
    axes, poles = [], np.asarray(heights, dtype=np.float64)
    for which, (at, periodic) in enumerate(zip((u, v), repeats, strict=True)):
        axis, turned = _interpolated(np.asarray(at, dtype=np.float64), (), np.moveaxis(poles, which, 0), periodic)
        poles = np.moveaxis(turned, 0, which)
        axes.append(axis)
    # single precision halves the size of stored surfaces, and changes a height by at most 6e-8 of the largest
    single = np.ascontiguousarray(poles, dtype=np.float32).astype(np.float64)
    return SplineSurface(axes[0], axes[1], single)


def _interpolated(
    lines: Floats, creases: Sequence[float], values: Floats, smooth_period: bool = False
) -> tuple[SplineAxis, Floats]:
    """Interpolate along the first axis by a cubic spline with creases.

    Args:
        lines: The positions of the samples, at least 4 between neighbouring creases, which are samples themselves.
        creases: The positions of the creases inside.
        values: The samples, shape (n, ...).
        smooth_period: Whether the spline repeats without a crease. It must not have other creases.
    """
    from scipy.interpolate import make_interp_spline

    if smooth_period:
        closed = np.concatenate([values[:-1], values[:1]])
        spline = make_interp_spline(lines, closed, k=DEGREE, bc_type="periodic")
        axis, poles = SplineAxis(spline.t, DEGREE).cut(spline.c, float(lines[0]), float(lines[-1]))
        poles[-1] = poles[0]
        return SplineAxis(axis.knots, DEGREE, True), poles
    # beside an end or a crease, a sample is not a knot
    joints = np.searchsorted(lines, np.array([lines[0], *sorted(creases), lines[-1]]))
    times = np.ones(len(lines), dtype=np.int64)
    times[joints[:-1] + 1] = times[joints[1:] - 1] = 0
    times[joints] = DEGREE
    times[[0, -1]] = DEGREE + 1
    spline = make_interp_spline(lines, values, k=DEGREE, t=np.repeat(lines, times))
    return SplineAxis(spline.t, DEGREE), np.asarray(spline.c)


def height_map(
    heights: ArrayLike,
    *,
    mm_per_pixel: float | tuple[float, float] = 1.0,
    height_mm: float | tuple[float, float] | None = None,
    repeats: bool = False,
) -> SplineSurface:
    """Make a surface from the heights on an even grid. Its units are millimetres.

    The surface is the cubic spline through the heights, so it has no error of its own.

    Args:
        heights: The heights, shape (rows, columns), as in an image: the first row is at the largest y.
        mm_per_pixel: The distance of neighbouring columns, or of neighbouring columns and rows, in mm.
        height_mm: The heights to which the lowest and the highest value are scaled, or their difference; None if the
            values are in mm.
        repeats: Whether the surface repeats beyond its ends. The first column then follows the last.

    Raises:
        InputError: The heights are not a table of finite numbers of different size, or a number is not allowed.
    """
    table = checked_heights(heights, height_mm)
    steps = pixel_steps(mm_per_pixel)
    if repeats:
        table = np.pad(table, (0, 1), mode="wrap")
    x, y = (np.linspace(0.0, round((n - 1) * step, 9), n) for n, step in zip(table.shape, steps, strict=True))
    return replace(spline_through(x, y, table, repeats=(repeats, repeats)), unit="mm")


def smoothed(heights: ArrayLike, smooth_mm: float, mm_per_pixel: float | tuple[float, float], repeats: bool) -> Floats:
    """Return heights after a Gaussian filter with a standard deviation in mm."""
    from scipy.ndimage import gaussian_filter

    steps = pixel_steps(mm_per_pixel)
    width = (smooth_mm / steps[1], smooth_mm / steps[0])
    values = np.asarray(heights, dtype=np.float64)
    return np.asarray(gaussian_filter(values, width, mode="wrap" if repeats else "nearest"))


def checked_heights(heights: ArrayLike, height_mm: float | tuple[float, float] | None) -> Floats:
    """Check the heights of a height map, scale them, and turn them so that the first axis is x and the second is y.

    Raises:
        InputError: The heights are not a table of finite numbers that differ, or the range is not allowed.
    """
    table = np.asarray(heights)
    if table.ndim != 2 or min(table.shape) < 4:
        raise InputError("height map", table.shape, "must have two dimensions, and at least 4 rows and 4 columns")
    if table.size > MAX_SAMPLES:
        raise InputError("height map", table.shape, f"may have at most {MAX_SAMPLES:,} samples; use every second one")
    if table.dtype.kind not in "uifb":
        raise InputError("height map", str(table.dtype), "must consist of numbers")
    table = table.astype(np.float64)
    bad = ~np.isfinite(table)
    if bad.any():
        row, column = np.argwhere(bad)[0].tolist()
        where = f"row {row + 1}, column {column + 1}"
        count = f"{np.count_nonzero(bad)} of {table.size} values are not finite numbers, the first in {where}"
        raise InputError("height map", None, f"{count}; fill the gaps first")
    low, high = float(table.min()), float(table.max())
    if low == high:
        raise InputError("height map", None, f"has the same value {low:g} everywhere")
    if height_mm is not None:
        height_mm = (0.0, float(height_mm)) if isinstance(height_mm, (int, float)) else height_mm
        if not (all(map(math.isfinite, height_mm)) and height_mm[1] > height_mm[0]):
            raise InputError("height_mm", height_mm, "must be above 0, or two heights with the smaller one first")
        table = height_mm[0] + (table - low) * ((height_mm[1] - height_mm[0]) / (high - low))
    return table[::-1].T


def pixel_steps(mm_per_pixel: float | tuple[float, float]) -> tuple[float, float]:
    """Return the distances of neighbouring samples along x and y, in mm.

    Raises:
        InputError: A distance is not allowed.
    """
    steps = (mm_per_pixel, mm_per_pixel) if isinstance(mm_per_pixel, (int, float)) else tuple(mm_per_pixel)
    if len(steps) != 2 or not all(1e-6 <= step <= 1e3 for step in steps):
        raise InputError("mm_per_pixel", mm_per_pixel, "must be from 1e-6 to 1000 mm")
    return float(steps[0]), float(steps[1])


def sampled(
    function: Function,
    *,
    u: tuple[float, float],
    v: tuple[float, float],
    error: float = 1e-4,
    creases: tuple[Sequence[float], Sequence[float]] = ((), ()),
    repeats: tuple[bool, bool] = (False, False),
    unit: Unit = "units",
) -> SplineSurface:
    """Make a surface from a Python function ``h(u, v)``.

    The function is sampled on a grid of lines, which becomes denser where the function needs it. The spline through the
    samples is then compared with the function on a denser grid. The largest difference is the ``error`` of the surface,
    and it is measured, not proved.

    Args:
        function: The function. It is called with arrays of the same shape, or with single numbers if it does not
            accept arrays.
        u: The lower and the upper end of the domain along u.
        v: The ends along v.
        error: The largest allowed difference between the spline and the function.
        creases: Positions along u and along v where the slope changes suddenly. The spline has creases there.
        repeats: Whether the surface repeats beyond the ends, as the function does.
        unit: ``mm`` if u, v and the height are lengths in mm; ``units`` if a block maps them to mm.

    Raises:
        InputError: The function cannot be called, does not return finite numbers, or needs too many samples.
    """
    call = _vectorised(function)
    lines = [
        np.unique(np.concatenate([np.linspace(*span, 9) for span in itertools.pairwise([low, *sorted(sharp), high])]))
        for (low, high), sharp in zip((u, v), creases, strict=True)
    ]
    for _ in range(24):
        dense = [_dense(each, np.array([1.0, 2.0]) / 3.0) for each in lines]
        values = call(dense[0][:, None], dense[1][None, :])
        errors = [_errors(lines[i], creases[i], np.moveaxis(values, i, 0)) for i in (0, 1)]
        largest = max(float(each.max()) for each in errors)
        if largest <= 0.4 * error:
            break
        lines = [_refined(each, split > 0.4 * error) for each, split in zip(lines, errors, strict=True)]
        if len(lines[0]) * len(lines[1]) > MAX_POLES:
            raise _too_fine(function, error, largest)
    surface = measured_error(call, _spline(call, lines, creases, repeats))
    if surface.error > error:
        raise _too_fine(function, error, surface.error)
    return replace(surface, unit=unit)


def _too_fine(function: Function, error: float, reached: float) -> InputError:
    name = getattr(function, "__name__", "h")
    advice = "give a larger error, or name its creases; a function with a step has no surface"
    return InputError("function", name, f"cannot be sampled within {error:g} ({reached:.2g} was reached); {advice}")


def _spline(
    call: Callable[[Floats, Floats], Floats],
    lines: Sequence[Floats],
    creases: Sequence[Sequence[float]],
    repeats: tuple[bool, bool],
) -> SplineSurface:
    poles = np.asarray(call(lines[0][:, None], lines[1][None, :]))
    axes = []
    for which in (0, 1):
        axis, turned = _interpolated(lines[which], creases[which], np.moveaxis(poles, which, 0))
        if repeats[which]:
            if np.abs(turned[-1] - turned[0]).max() > 1e-6 * max(float(np.ptp(poles)), 1e-300):
                raise InputError("repeats", None, f"the function has other values after one period along {'uv'[which]}")
            turned[-1] = turned[0]
        axes.append(SplineAxis(axis.knots, DEGREE, repeats[which]))
        poles = np.moveaxis(turned, 0, which)
    return SplineSurface(axes[0], axes[1], np.ascontiguousarray(poles))


def _vectorised(function: Function) -> Callable[[Floats, Floats], Floats]:
    """Return a function that always takes arrays, and always returns an array of finite numbers."""
    name = getattr(function, "__name__", "h")

    def call(u: Floats, v: Floats) -> Floats:
        uu, vv = np.broadcast_arrays(u, v)
        try:
            try:
                values = np.asarray(function(uu, vv), dtype=np.float64)
            except (TypeError, ValueError):  # it does not accept arrays
                values = np.asarray(np.vectorize(function, otypes=[np.float64])(uu, vv))
        except Exception as error:
            raise InputError("function", name, f"fails: {one_line(str(error))}") from None
        if values.shape != uu.shape:
            values = np.array(np.broadcast_to(values, uu.shape)) if values.ndim == 0 else values
        if values.shape != uu.shape:
            raise InputError("function", name, f"returns the shape {values.shape} for points of shape {uu.shape}")
        if not np.isfinite(values).all():
            i = tuple(np.argwhere(~np.isfinite(values))[0])
            raise InputError("function", name, f"is not a finite number at u = {uu[i]:.6g}, v = {vv[i]:.6g}")
        return values

    return call


def _dense(lines: Floats, between: Floats) -> Floats:
    """Return the samples, and the given fractions of each interval between them."""
    inner = lines[:-1, None] + np.diff(lines)[:, None] * np.append(0.0, between)
    return np.append(inner.ravel(), lines[-1])


def _errors(lines: Floats, creases: Sequence[float], values: Floats) -> Floats:
    """Return the largest error of the interpolation along the first axis in each interval.

    Args:
        lines: The samples.
        creases: The positions of the creases.
        values: The values at the samples and at two points in each interval.
    """
    from scipy.interpolate import BSpline

    axis, poles = _interpolated(lines, creases, values[::3])
    fit = BSpline(axis.knots, poles, DEGREE)(_dense(lines, np.array([1.0, 2.0]) / 3.0))
    off = np.abs(fit - values).max(axis=1)
    return np.asarray(np.maximum(off[1::3], off[2::3]))


def _refined(lines: Floats, split: Bools) -> Floats:
    """Halve the marked intervals, and those that are much longer than a neighbour."""
    while split.any():
        lines = np.sort(np.concatenate([lines, (lines[:-1] + lines[1:])[split] / 2.0]))
        width = np.diff(lines)
        split = width > _RATIO * np.minimum(np.append(width[1:], np.inf), np.append(np.inf, width[:-1]))
    return lines


def measured_error(function: Callable[[Floats, Floats], Floats], surface: SplineSurface) -> SplineSurface:
    """Return the surface with its largest difference from a function as its error.

    The difference is measured at five points along each side of each span, and then at many more points in the spans
    where it is largest. If there are very many spans, only a part of the points is used.
    """
    breaks = surface.u.breaks, surface.v.breaks
    u, v = (_thinned(_dense(lines, _POINTS)) for lines in breaks)
    worst: list[tuple[float, float, float]] = []
    for strip in np.array_split(u, max(1, len(u) * len(v) // 1_000_000)):
        difference = np.abs(surface.grid(strip, v) - function(strip[:, None], v[None, :]))
        rows = difference.argmax(axis=1)
        worst += zip(difference.max(axis=1).tolist(), strip.tolist(), v[rows].tolist(), strict=True)
    largest = 1e-12
    for off, at_u, at_v in sorted(worst)[-_ZOOMED:]:
        near = []
        for lines, at in zip(breaks, (at_u, at_v), strict=True):
            i = int(np.searchsorted(lines[1:-1], at, "right"))
            near.append(np.linspace(lines[i], lines[i + 1], _ZOOM))
        difference = np.abs(surface.grid(near[0], near[1]) - function(near[0][:, None], near[1][None, :]))
        largest = max(largest, off, float(difference.max()))
    return replace(surface, error=largest, evidence="measured")


def _thinned(lines: Floats) -> Floats:
    """Return at most about :data:`_MAX_LINES` lines, in steps that do not always meet the same place in a span."""
    step = math.ceil(len(lines) / _MAX_LINES)
    while math.gcd(step, len(_POINTS) + 1) > 1:
        step += 1
    return lines[::step]
