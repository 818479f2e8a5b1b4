"""Parameters of roughness by ISO 25178-2, computed by surfalize on the largest measured rectangle of a height map."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass

import numpy as np

from tacbench_cad.extensions.scan.cloud import HeightGrid
from tacbench_cad.util.errors import InputError, require_between
from tacbench_cad.util.packages import require
from tacbench_cad.util.types import Bools, Floats

#: The default cutoff of the S-filter, in pixels. Shorter waves are mostly noise of the scanner.
S_FILTER_PIXELS = 3.0
#: The smallest side of a rectangle, in pixels.
MIN_PIXELS = 10
#: The largest hole that is filled, as a fraction of the map.
MAX_HOLE = 0.01
#: The largest side of the mask in which the rectangle is searched, in cells.
_MASK_CELLS = 300


@dataclass(frozen=True, kw_only=True)
class Roughness:
    """The parameters of a surface.

    Args:
        sa_um: The arithmetic mean height Sa.
        sq_um: The root mean square height Sq.
        sz_um: The maximum height Sz, from the lowest to the highest point.
        ssk: The skewness Ssk. It is negative if the surface has deep valleys.
        sku: The kurtosis Sku, 3 for heights with a normal distribution.
        sdr_percent: The developed interfacial area ratio Sdr: how much larger the surface is than its plan.
        area_mm: The sides x and y of the rectangle.
        filled_fraction: The fraction of its heights that were missing.
        filters: What was done before, in words.
    """

    sa_um: float
    sq_um: float
    sz_um: float
    ssk: float
    sku: float
    sdr_percent: float
    area_mm: tuple[float, float]
    filled_fraction: float
    filters: str


def roughness(grid: HeightGrid, *, s_filter_mm: float | None = None, level: bool = True) -> Roughness:
    """Compute the parameters of a height map.

    Small holes are filled with the nearest measured height. Then the largest measured rectangle is used, because the
    standard defines the parameters on a rectangle.

    Args:
        grid: The heights.
        s_filter_mm: The cutoff wavelength of the Gaussian S-filter, which removes shorter waves; None for three pixels,
            0 for no filter.
        level: Whether the plane of least squares is removed first (the F-operation).

    Raises:
        InputError: The map has no rectangle of at least 10 x 10 measured heights.
        MissingToolError: surfalize is not installed.
    """
    require("roughness by ISO 25178", "surfalize")
    from surfalize import Surface
    from surfalize.filter import GaussianFilter

    cutoff = S_FILTER_PIXELS * max(grid.step_mm) if s_filter_mm is None else s_filter_mm
    require_between("S-filter", cutoff, 0.0, 1000.0, " mm")
    measured: Bools = np.asarray(np.isfinite(grid.heights_mm))
    filled = _filled(measured)
    rows, columns = _largest_rectangle(filled)
    heights = _nearest(grid.heights_mm, measured)[rows, columns]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that pixels are not square, which has no effect on these parameters
        surface = Surface(heights * 1000.0, *(1000.0 * step for step in grid.step_mm))
        surface = surface.level() if level else surface
        surface = GaussianFilter(1000.0 * cutoff, "lowpass")(surface) if cutoff else surface
    values = surface.height_parameters()
    words = ["the plane of least squares removed" if level else "not levelled"]
    words.append(f"Gaussian S-filter with a cutoff of {cutoff:.3g} mm" if cutoff else "no S-filter")
    return Roughness(
        sa_um=float(values["Sa"]),
        sq_um=float(values["Sq"]),
        sz_um=float(values["Sz"]),
        ssk=float(values["Ssk"]),
        sku=float(values["Sku"]),
        sdr_percent=float(surface.Sdr()),
        area_mm=((heights.shape[1] - 1) * grid.step_mm[0], (heights.shape[0] - 1) * grid.step_mm[1]),
        filled_fraction=float(1.0 - np.mean(measured[rows, columns])),
        filters=", ".join([*words, "no L-filter"]),
    )


def _filled(measured: Bools) -> Bools:
    """Return the mask of a map with its small holes filled."""
    from scipy.ndimage import label

    holes, count = label(~measured)
    if count == 0:
        return measured
    small = np.bincount(holes.ravel()) <= max(MAX_HOLE * measured.size, 4.0)
    small[0] = False
    return np.asarray(measured | small[holes])


def _nearest(heights: Floats, measured: Bools) -> Floats:
    """Return heights with each missing one replaced by the nearest."""
    from scipy.ndimage import distance_transform_edt

    if measured.all() or not measured.any():
        return heights
    row, column = distance_transform_edt(~measured, return_distances=False, return_indices=True)
    return np.asarray(heights[row, column])


def _largest_rectangle(mask: Bools) -> tuple[slice, slice]:
    """Return the rows and columns of the largest rectangle inside a mask, to within one cell of 300 on each side."""
    step = max(1, math.ceil(max(mask.shape) / _MASK_CELLS))
    rows, columns = (length // step for length in mask.shape)
    if min(rows, columns) == 0:
        raise InputError("heights", list(mask.shape), f"must have at least {MIN_PIXELS} rows and columns")
    cells = mask[: rows * step, : columns * step].reshape(rows, step, columns, step)
    coarse: Bools = np.all(cells, axis=(1, 3))
    best, place = 0, (0, 0, 0, 0)
    above = np.zeros(columns, dtype=np.int64)
    for row in range(rows):
        above = np.where(coarse[row], above + 1, 0)
        open_bars: list[tuple[int, int]] = []  # where a bar can begin, and its height; heights increase
        for column, height in enumerate([*above.tolist(), 0]):
            start = column
            while open_bars and open_bars[-1][1] >= height:
                start, bar = open_bars.pop()
                if bar * (column - start) > best:
                    best, place = bar * (column - start), (row - bar + 1, row + 1, start, column)
            open_bars.append((start, height))
    top, bottom, left, right = (edge * step for edge in place)
    if bottom == rows * step and top == 0 and mask[bottom:, left:right].all():
        bottom = mask.shape[0]
    if right == columns * step and left == 0 and mask[top:bottom, right:].all():
        right = mask.shape[1]
    if min(bottom - top, right - left) < MIN_PIXELS:
        allowed = f"has no measured rectangle of at least {MIN_PIXELS} x {MIN_PIXELS} heights"
        raise InputError("height map", f"{mask.shape[1]} x {mask.shape[0]}", allowed)
    return slice(top, bottom), slice(left, right)
