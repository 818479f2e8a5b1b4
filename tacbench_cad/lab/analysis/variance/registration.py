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

import contextlib
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any

import numpy as np

from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.feature import Feature, read_usable
from tacbench_cad.lab.analysis.pixels import Pixels
from tacbench_cad.lab.analysis.variance.streaming import SentPress, presses_of, runs_to_send
from tacbench_cad.lab.parallel import workers
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.lab.study.spec import UNKNOWN
from tacbench_cad.spec.protocol import PressGrid
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.types import Floats32, Ints

#: An axis is fitted if the sum of its squared slopes is at least this fraction of the larger sum.
_MIN_SLOPE = 0.01
#: The offset of a block from the mean of the cell's blocks along x and y, in mm; None along an axis that is not fitted.
Offset = tuple[float | None, float | None]
_Frame = tuple[int, int, Floats32]


@dataclass(frozen=True, kw_only=True)
class Seating:
    """The offsets of one cell's prints at one force level.

    Args:
        printer: The name of the printer.
        filament: The name of the filament.
        texture: The name of the texture.
        force_level: The level from 1.
        offsets_mm: For each copy, the offset of its block from the mean of the cell's blocks.
        variance: The cell's variance at this level (as in the table).
        seating: The part of the variance that the offsets explain.
    """

    printer: str
    filament: str
    texture: str
    force_level: int
    offsets_mm: dict[int, Offset]
    variance: float
    seating: float

    @property
    def remaining(self) -> float:
        """The variance without the seating part."""
        return max(0.0, self.variance - self.seating)

    def rows(self) -> Iterator[dict[str, Any]]:
        """Yield the rows of ``registration.csv``."""
        for copy, (x, y) in self.offsets_mm.items():
            offsets = {"copy": copy, "x_mm": x, "y_mm": y}
            yield {**vars(self), **offsets, "variance_without_seating": self.remaining}


def register(
    collection: Collection,
    feature: Feature | None = None,
    *,
    ddof: int = 0,
    jobs: int = 1,
    dask: str | None = None,
) -> tuple[Seating, ...]:
    """Estimate the offsets of all prints, sorted by level, combination and texture.

    Args:
        collection: The study.
        feature: The fitted feature; None for grey pixels at full size.
        ddof: The ddof of the variance table.
        jobs: The number of worker processes on this machine.
        dask: The address of a Dask scheduler, whose workers are then used instead.

    Raises:
        InputError: The collection has series, the positions are unknown, the grid has one row and one column, or no
            cell has two prints.
    """
    grid = collection.pressing.grid
    if collection.series:
        raise InputError("register", True, "is for the frames of presses; leave out --series")
    if grid is None:
        raise InputError("register", None, "needs the coordinates of the positions in mm, unknown for these runs")
    if len(grid.x_mm) < 2 and len(grid.y_mm) < 2:
        raise InputError("register", len(grid.positions_mm), "needs positions in at least two columns or two rows")
    feature = feature or Pixels()
    cells = list(_cells(collection, feature))
    if not cells:
        raise InputError("register", None, "needs a printer-filament with at least two prints of one texture")
    runs = runs_to_send(collection)
    work = partial(_seating, runs=runs, grid=grid, feature=feature, ddof=ddof)
    with workers(jobs, dask, [run.folder for run in collection.runs]) as executor:
        return tuple(seating for seating in executor.map(work, cells) if seating is not None)


def _cells(collection: Collection, feature: Feature) -> Iterator[list[SentPress]]:
    """Yield the presses of each cell with two or more prints at each level, sorted by position."""
    cells: dict[tuple[int, str, str], list[SentPress]] = defaultdict(list)
    for press in sorted(presses_of(collection, feature), key=lambda press: (press.position, press.copy)):
        cells[press.level, press.combination, press.texture].append(press)
    for key in product(collection.levels, collection.combinations, collection.textures):
        if len({press.copy for press in cells[key]}) > 1:
            yield cells[key]


def _seating(
    presses: Sequence[SentPress], *, runs: Sequence[Run], grid: PressGrid, feature: Feature, ddof: int
) -> Seating | None:
    """Estimate the offsets of one cell; return None if too few of its frames can be read."""
    count = len(grid.positions_mm)
    sums: Floats32 | None = None
    numbers = np.zeros(count, dtype=np.int64)
    squares = np.zeros(count)
    for _, position, values in _frames(presses, runs, feature):
        if sums is None:
            sums = np.zeros((count, values.size), dtype=np.float32)
        sums[position] += values
        numbers[position] += 1
        squares[position] += float(np.einsum("i,i->", values, values, dtype=np.float64)) / values.size
    if sums is None or not (numbers > ddof).all():
        return None
    sums /= numbers[:, None]
    # These are sums of squares about the mean. 32 bits are enough for a fraction; the table is computed in 64 bits.
    squares -= numbers * np.einsum("ij,ij->i", sums, sums, dtype=np.float64) / sums.shape[1]
    copies = sorted({press.copy for press in presses})
    offsets, explained = _fit(_frames(presses, runs, feature), sums, grid, copies, numbers - ddof)
    printed = runs[presses[0].run].info.printed
    return Seating(
        printer=printed.printer or UNKNOWN,
        filament=printed.filament or UNKNOWN,
        texture=printed.texture or UNKNOWN,
        force_level=presses[0].level,
        offsets_mm=offsets,
        variance=float(np.mean(np.maximum(0.0, squares) / (numbers - ddof))),
        seating=explained,
    )


def _frames(presses: Sequence[SentPress], runs: Sequence[Run], feature: Feature) -> Iterator[_Frame]:
    """Yield the copy, the position from 0 and the numbers of each frame; unusable frames are left out."""
    for press in presses:
        with contextlib.suppress(CheckFailedError):  # the computation of the table has already named it
            values = read_usable(runs[press.run], press.paths[0], feature)
            yield press.copy, press.position - 1, values.reshape(-1).astype(np.float32)


def _fit(
    frames: Iterable[_Frame], means: Floats32, grid: PressGrid, copies: Sequence[int], divisors: Ints
) -> tuple[dict[int, Offset], float]:
    """Return the offsets of all prints by least squares, and the variance that they explain.

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
    offsets: dict[int, Offset] = {}
    explained = 0.0
    for i, copy in enumerate(copies):
        offset: list[float | None] = [None, None]
        if axes:
            shift = np.linalg.lstsq(normal[i][np.ix_(axes, axes)], right[i][axes], rcond=None)[0]
            explained += float(shift @ right[i][axes])
            for axis, value in zip(axes, shift, strict=True):
                offset[axis] = -float(value)  # a block with a positive offset is pressed nearer to its start
        offsets[copy] = (offset[0], offset[1])
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
