"""How much of a cell's variance is the block's seat in its holder, and how much its print.

A block that lies a little off in its pocket is pressed a little off at *every* position, while errors of printing
change from place to place. The grid itself shows what a reading does when the sensor moves along x and y: the slopes of
the cell's mean reading from position to position. So each print gets one offset (x, y) for all of its presses at a
force: the one that explains most of the deviations D of its mean readings from the cell's::

    D(position) = dx dm/dx(position) + dy dm/dy(position) + rest,

by least squares over all pixels and positions. What it explains is the seating part of the variance. Images are not
shifted: the sensor's camera does not move with the block, and arrays of taxels have no image to shift.

Limits, which all make the seating part too small rather than too large: slopes are differences over the grid's spacing,
so texture that changes much within 2 spacings is smoothed; a print that is shifted as a whole (walls printed out of
place) counts as seating too, the exception. An axis along which readings hardly change (textures 1, 5 and 6 along y) is
not fitted. All presses are read twice more; at a time one cell's mean readings at all positions are in memory.
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
from tacbench_cad.lab.analysis.preprocess import Preprocess, read_usable
from tacbench_cad.lab.analysis.variance.streaming import Press, presses_of, runs_to_send
from tacbench_cad.lab.parallel import workers
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.lab.study.spec import UNKNOWN
from tacbench_cad.spec.protocol import PressGrid
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.types import Floats32, Ints

#: An axis is fitted if its slopes have at least this fraction of the other axis's square.
_MIN_SLOPE = 0.01
#: How far a block lies from the mean of the cell's, along x and y; None along an axis that cannot be seen.
Offset = tuple[float | None, float | None]
_Reading = tuple[int, int, Floats32]


@dataclass(frozen=True, kw_only=True)
class Seating:
    """The seats of one cell's prints at one force level.

    Args:
        printer: Printer.
        filament: Filament.
        texture: Texture.
        force_level: Level from 1.
        offsets_mm: For each copy how far its block lies from the mean of the cell's.
        variance: The cell's variance at this level (as in the table).
        seating: The part of it that offsets explain.
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
        """Rows of ``registration.csv``."""
        for copy, (x, y) in self.offsets_mm.items():
            offsets = {"copy": copy, "x_mm": x, "y_mm": y}
            yield {**vars(self), **offsets, "variance_without_seating": self.remaining}


def register(
    collection: Collection,
    preprocess: Preprocess | None = None,
    *,
    ddof: int = 0,
    jobs: int = 1,
    dask: str | None = None,
) -> tuple[Seating, ...]:
    """The seats of all prints, by level, combination and texture.

    Args:
        collection: The study.
        preprocess: What is done to a reading first.
        ddof: As for the table.
        jobs: Processes of this machine.
        dask: Address of a Dask scheduler whose workers do the work instead.

    Raises:
        InputError: The grid has one row and one column, or no cell has two prints.
    """
    grid = collection.pressing.grid
    if grid is None:
        raise InputError("register", None, "needs the places of the positions in mm, which these runs do not have")
    if len(grid.x_mm) < 2 and len(grid.y_mm) < 2:
        raise InputError("register", len(grid.positions_mm), "needs positions in two columns or rows to see a shift")
    cells = list(_cells(collection))
    if not cells:
        raise InputError(
            "register", None, "no printer-filament has two prints of one texture that could lie differently"
        )
    runs = runs_to_send(collection)
    work = partial(_seating, runs=runs, grid=grid, preprocess=preprocess or Preprocess(), ddof=ddof)
    with workers(jobs, dask, [run.folder for run in collection.runs]) as executor:
        return tuple(seating for seating in executor.map(work, cells) if seating is not None)


def _cells(collection: Collection) -> Iterator[list[Press]]:
    """The presses of each cell of two or more prints at each level, position by position."""
    cells: dict[tuple[int, str, str], list[Press]] = defaultdict(list)
    for press in sorted(presses_of(collection), key=lambda press: (press.position, press.copy)):
        cells[press.level, press.combination, press.texture].append(press)
    for key in product(collection.levels, collection.combinations, collection.textures):
        if len({press.copy for press in cells[key]}) > 1:
            yield cells[key]


def _seating(
    presses: Sequence[Press], *, runs: Sequence[Run], grid: PressGrid, preprocess: Preprocess, ddof: int
) -> Seating | None:
    """One cell; None if too little of it can be read."""
    count = len(grid.positions_mm)
    sums: Floats32 | None = None
    numbers = np.zeros(count, dtype=np.int64)
    squares = np.zeros(count)
    for _, position, values in _readings(presses, runs, preprocess):
        if sums is None:
            sums = np.zeros((count, values.size), dtype=np.float32)
        sums[position] += values
        numbers[position] += 1
        squares[position] += float(np.einsum("i,i->", values, values, dtype=np.float64)) / values.size
    if sums is None or not (numbers > ddof).all():
        return None
    sums /= numbers[:, None]
    # Sums of squares about the mean; 32 bits are enough for a fraction, the table itself is computed in 64.
    squares -= numbers * np.einsum("ij,ij->i", sums, sums, dtype=np.float64) / sums.shape[1]
    copies = sorted({press.copy for press in presses})
    offsets, explained = _fit(_readings(presses, runs, preprocess), sums, grid, copies, numbers - ddof)
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


def _readings(presses: Sequence[Press], runs: Sequence[Run], preprocess: Preprocess) -> Iterator[_Reading]:
    """Copy, position from 0 and numbers of each reading; those that cannot be used are left out."""
    for press in presses:
        with contextlib.suppress(CheckFailedError):  # the pass for the table has named it
            values = read_usable(runs[press.run], press.path, preprocess)
            yield press.copy, press.position - 1, values.reshape(-1).astype(np.float32)


def _fit(
    readings: Iterable[_Reading], means: Floats32, grid: PressGrid, copies: Sequence[int], divisors: Ints
) -> tuple[dict[int, Offset], float]:
    """Offsets of all prints by least squares, and the variance that they explain.

    Presses are weighted as in the table's mean over positions.
    """
    count, pixels = means.shape
    normal, right = np.zeros((len(copies), 2, 2)), np.zeros((len(copies), 2))
    at, slopes, products = -1, np.zeros((2, pixels), dtype=np.float32), np.zeros((2, 2))
    for copy, position, values in readings:
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
                offset[axis] = -float(value)  # a block that lies further along is pressed at a place before
        offsets[copy] = (offset[0], offset[1])
    return offsets, max(0.0, explained)


def _slopes(means: Floats32, grid: PressGrid, position: int) -> Floats32:
    """Change of the mean reading along x and y at a position, per mm, shape (2, pixels)."""
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
