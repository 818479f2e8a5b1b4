"""Separate differences in placement (the block's seat in its holder) from differences in printing.

If a block is shifted in its pocket, it is pressed with the same shift at *every* position, while errors of printing
change from position to position. The press grid itself shows how a frame changes when the sensor moves along x and y:
by the slopes of the cell's mean frame m from position to position. Each print gets one offset (x, y) for all of its
presses at a force. It is the offset that explains most of the deviations D of the print's mean frames from the mean
frames of the cell::

    D(position) = dx dm/dx(position) + dy dm/dy(position) + rest,

by least squares over all pixels and positions. The variance that the offsets explain is the seating part. Images are
not shifted: the sensor's camera does not move with the block, and arrays of taxels have no image to shift.

The method has these limits:

- The slopes are differences over the spacing of the grid, so a texture that changes much within 2 spacings is smoothed.
  This makes the seating part too small.
- An axis along which frames hardly change (textures 1, 5 and 6 along y) is not fitted. This makes it too small as well.
- If a print is shifted as a whole (walls printed out of place), the shift counts as seating. This makes it too large.

All presses are read twice more. The mean frames of one cell at all positions are in memory at a time.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from tacbench_cad.lab.analysis.feature import Feature
from tacbench_cad.lab.analysis.study_design import Design
from tacbench_cad.lab.analysis.variance.cells import CELL, place_of
from tacbench_cad.lab.analysis.variance.streaming import usable
from tacbench_cad.lab.parallel import Executor
from tacbench_cad.spec.protocol import PressGrid
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats, Floats32, Ints

#: An axis is fitted if the sum of its squared slopes is at least this fraction of the larger sum.
_MIN_SLOPE = 0.01
#: The columns of ``registration.csv``: the offset of each print's block from the mean of the cell's blocks, missing
#: along an axis that is not fitted; the cell's variance at this level; and the part of it that the offsets explain.
_COLUMNS = (*CELL, "copy", "x_mm", "y_mm", "variance", "seating", "variance_without_seating")
_Frame = tuple[int, int, Floats32]


def register(design: Design, feature: Feature, executor: Executor, *, ddof: int = 0) -> pd.DataFrame:
    """Return ``registration.csv``: the offsets of all prints, by level, combination and texture.

    Args:
        design: The design of the study.
        feature: The fitted feature.
        executor: The worker processes.
        ddof: The ddof of the variance table.

    Raises:
        InputError: The table has series, the positions are unknown, the grid has one row and one column, or no cell
            has two prints.
    """
    grid = design.grid
    if design.steps:
        raise InputError("register", True, "is for the frames of presses; leave out --series")
    if grid is None:
        raise InputError("register", None, "needs the coordinates of the positions in mm, unknown for these runs")
    if len(grid.x_mm) < 2 and len(grid.y_mm) < 2:
        raise InputError("register", len(grid.positions_mm), "needs positions in at least two columns or two rows")
    presses = design.presses.sort_values(["position", "print_number"], kind="stable")
    order = {name: i for i, name in enumerate(design.combinations)}
    cells = [of for _, of in presses.groupby(["level", "combination", "texture"]) if of["print_number"].nunique() > 1]
    cells.sort(key=lambda of: (of["level"].iloc[0], order[of["combination"].iloc[0]]))
    if not cells:
        raise InputError("register", None, "needs a printer-filament with at least two prints of one texture")
    work = partial(_seating, grid=grid, feature=feature, ddof=ddof)
    return pd.DataFrame([row for rows in executor.map(work, cells) for row in rows], columns=list(_COLUMNS))


def _seating(presses: pd.DataFrame, grid: PressGrid, feature: Feature, ddof: int) -> list[dict[str, Any]]:
    """Estimate the offsets of the prints of one cell; return no rows if too few of its frames can be read."""
    count = len(grid.positions_mm)
    sums = np.zeros((count, 0), dtype=np.float32)
    numbers = np.zeros(count, dtype=np.int64)
    squares = np.zeros(count)
    for _, position, values in _frames(presses, feature):
        if not sums.size:
            sums = np.zeros((count, values.size), dtype=np.float32)
        sums[position] += values
        numbers[position] += 1
        squares[position] += float(np.einsum("i,i->", values, values, dtype=np.float64)) / values.size
    if not (numbers > ddof).all():
        return []
    sums /= numbers[:, None]
    # These are sums of squares about the mean. 32 bits are enough for a fraction; the table is computed in 64 bits.
    squares -= numbers * np.einsum("ij,ij->i", sums, sums, dtype=np.float64) / sums.shape[1]
    copies = np.unique(presses["print_number"])
    offsets, explained = _fit(_frames(presses, feature), sums, grid, copies.tolist(), numbers - ddof)
    variance = float(np.mean(np.maximum(0.0, squares) / (numbers - ddof)))
    first = presses.iloc[0]
    of_cell = place_of(int(first["level"]), (first["combination"], first["texture"]))
    of_cell |= {"variance": variance, "seating": explained, "variance_without_seating": max(0.0, variance - explained)}
    return [{**of_cell, "copy": copy, "x_mm": x, "y_mm": y} for copy, (x, y) in zip(copies, offsets, strict=True)]


def _frames(presses: pd.DataFrame, feature: Feature) -> Iterator[_Frame]:
    """Yield the copy, the position from 0 and the numbers of each frame; unusable frames are left out.

    The pass over all frames names them.
    """
    places = presses[["print_number", "position"]].to_numpy()
    for indices, numbers in usable(presses, feature, []):
        for (copy, position), values in zip(places[indices].tolist(), numbers, strict=True):
            yield copy, position - 1, values.astype(np.float32)


def _fit(
    frames: Iterator[_Frame], means: Floats32, grid: PressGrid, copies: Sequence[int], divisors: Ints
) -> tuple[Floats, float]:
    """Return the offsets of all prints by least squares, (prints, 2), and the variance that they explain.

    Presses are weighted as in the table's mean over positions.
    """
    count, pixels = means.shape
    normal, right = np.zeros((len(copies), 2, 2)), np.zeros((len(copies), 2))
    at, slopes, products = -1, np.zeros((2, pixels), dtype=np.float32), np.zeros((2, 2))
    for copy, position, values in frames:
        if position != at:
            at, slopes = position, _slopes(means, grid, position)
            products = (slopes @ slopes.T).astype(np.float64) / pixels
        weight = 1.0 / (float(divisors[position]) * count)
        normal[copies.index(copy)] += weight * products
        right[copies.index(copy)] += weight * (slopes @ (values - means[position])).astype(np.float64) / pixels
    seen = np.diag(normal.sum(axis=0))
    axes = [i for i in (0, 1) if seen[i] > _MIN_SLOPE * seen.max()]
    offsets, explained = np.full((len(copies), 2), np.nan), 0.0
    for i in range(len(copies) if axes else 0):
        shift = np.linalg.lstsq(normal[i][np.ix_(axes, axes)], right[i][axes], rcond=None)[0]
        explained += float(shift @ right[i][axes])
        offsets[i, axes] = -shift  # a block with a positive offset is pressed nearer to its start
    return offsets, max(0.0, explained)


def _slopes(means: Floats32, grid: PressGrid, position: int) -> Floats32:
    """Return the change of the mean frame along x and y at a position, per mm, shape (2, pixels)."""
    columns = len(grid.x_mm)
    row, column = divmod(position, columns)
    slopes = np.zeros((2, means.shape[1]), dtype=np.float32)
    for axis, at, places in ((0, column, grid.x_mm), (1, row, grid.y_mm)):
        low, high = max(0, at - 1), min(len(places) - 1, at + 1)
        if low == high:
            continue
        step = 1 if axis == 0 else columns
        difference = means[position + (high - at) * step] - means[position - (at - low) * step]
        slopes[axis] = difference / (places[high] - places[low])
    return slopes
