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

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.preprocess import Preprocess
from tacbench_cad.lab.analysis.variance.streaming import read_usable
from tacbench_cad.lab.parallel import workers
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.spec.protocol import PressGrid
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.types import Floats32, Ints

#: An axis is fitted if its slopes have at least this fraction of the other axis's square.
_MIN_SLOPE = 0.01


@dataclass(frozen=True, kw_only=True)
class Seating:
    """The seats of one cell's prints at one force level.

    Args:
        printer: Printer.
        filament: Filament.
        texture: Texture.
        force_level: Level from 1.
        offsets_mm: For each copy how far its block lies from the mean of the cell's, along x and y of the block; None
            along an axis that cannot be seen.
        variance: The cell's variance at this level (as in the table).
        seating: The part of it that offsets explain.
    """

    printer: str
    filament: str
    texture: str
    force_level: int
    offsets_mm: dict[int, tuple[float | None, float | None]]
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


@dataclass(frozen=True, kw_only=True)
class _Task:
    """The presses of one cell at one level: run, path, copy and position of each."""

    runs: tuple[Run, ...]
    level: int
    presses: tuple[tuple[int, str, int, int], ...]


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
    grid = collection.info.protocol.grid
    if len(grid.x_mm) < 2 and len(grid.y_mm) < 2:
        raise InputError("register", len(grid.positions_mm), "needs positions in two columns or rows to see a shift")
    tasks = list(_tasks(collection))
    if not tasks:
        raise InputError(
            "register", None, "no printer-filament has two prints of one texture that could lie differently"
        )
    work = partial(_seating, grid=grid, preprocess=preprocess or Preprocess(), ddof=ddof)
    with workers(jobs, dask, [run.folder for run in collection.runs]) as team:
        return tuple(seating for seating in team.map(work, tasks) if seating is not None)


def _tasks(collection: Collection) -> Iterator[_Task]:
    # Whole paths: the workers of a cluster stand in other folders.
    runs = tuple(Run(folder=run.folder.absolute(), info=run.info) for run in collection.runs)
    for level in collection.levels:
        for combination in collection.combinations:
            for texture in collection.textures:
                mine = (collection.level == level) & (collection.combination == combination)
                where = np.flatnonzero(mine & (collection.texture == texture))
                if len(np.unique(collection.copy[where])) < 2:
                    continue
                numbers = np.unique(collection.run[where])
                place = {int(run): i for i, run in enumerate(numbers)}
                presses = tuple(
                    (
                        place[int(collection.run[i])],
                        collection.path(int(i)),
                        int(collection.copy[i]),
                        int(collection.position[i]) - 1,
                    )
                    for i in where
                )
                yield _Task(runs=tuple(runs[i] for i in numbers), level=level, presses=presses)


def _seating(task: _Task, *, grid: PressGrid, preprocess: Preprocess, ddof: int) -> Seating | None:
    """One cell; None if too little of it can be read."""
    count = len(grid.positions_mm)
    sums: Floats32 | None = None
    presses = np.zeros(count, dtype=np.int64)
    squares = np.zeros(count)
    for _, position, values in _readings(task, preprocess):
        if sums is None:
            sums = np.zeros((count, values.size), dtype=np.float32)
        sums[position] += values
        presses[position] += 1
        squares[position] += float(np.einsum("i,i->", values, values, dtype=np.float64)) / values.size
    usable = presses > ddof
    if sums is None or not usable.all():
        return None
    sums /= presses[:, None]
    # Sums of squares about the mean; 32 bits are enough for a fraction, the table itself is computed in 64.
    squares -= presses * np.einsum("ij,ij->i", sums, sums, dtype=np.float64) / sums.shape[1]
    copies = sorted({copy for _, _, copy, _ in task.presses})
    fit = _fit(task, preprocess, sums, grid, {copy: i for i, copy in enumerate(copies)}, presses - ddof)
    printed = task.runs[0].info.printed
    return Seating(
        printer=printed.printer,
        filament=printed.filament,
        texture=printed.texture,
        force_level=task.level,
        offsets_mm={copy: fit.offsets[i] for i, copy in enumerate(copies)},
        variance=float(np.mean(np.maximum(0.0, squares) / (presses - ddof))),
        seating=fit.explained,
    )


def _readings(task: _Task, preprocess: Preprocess) -> Iterator[tuple[int, int, Floats32]]:
    """Copy, position and numbers of each reading, position by position; those that cannot be used are left out."""
    for run, path, copy, position in sorted(task.presses, key=lambda press: (press[3], press[2])):
        try:
            yield copy, position, read_usable(task.runs[run], path, preprocess).reshape(-1).astype(np.float32)
        except CheckFailedError:
            continue  # the pass for the table has named it


@dataclass(frozen=True)
class _Fit:
    offsets: Sequence[tuple[float | None, float | None]]
    explained: float


def _fit(
    task: _Task,
    preprocess: Preprocess,
    means: Floats32,
    grid: PressGrid,
    order: dict[int, int],
    divisors: Ints,
) -> _Fit:
    """Offsets of all prints by least squares; presses are weighted as in the table's mean over positions."""
    k, count, pixels = len(order), *means.shape
    normal, right = np.zeros((k, 2, 2)), np.zeros((k, 2))
    at, slopes, products = -1, np.zeros((2, pixels), dtype=np.float32), np.zeros((2, 2))
    for copy, position, values in _readings(task, preprocess):
        if position != at:
            at, slopes = position, _slopes(means, grid, position)
            products = (slopes @ slopes.T).astype(np.float64) / pixels
        weight = 1.0 / (float(divisors[position]) * count)
        normal[order[copy]] += weight * products
        right[order[copy]] += weight * (slopes @ (values - means[position])).astype(np.float64) / pixels
    seen = np.diag(normal.sum(axis=0))
    axes = [i for i in (0, 1) if seen[i] > _MIN_SLOPE * seen.max()]
    offsets: list[tuple[float | None, float | None]] = []
    explained = 0.0
    for i in range(k):
        offset: list[float | None] = [None, None]
        if axes:
            shift = np.linalg.lstsq(normal[i][np.ix_(axes, axes)], right[i][axes], rcond=None)[0]
            explained += float(shift @ right[i][axes])
            for axis, value in zip(axes, shift, strict=True):
                offset[axis] = -float(value)  # a block that lies further along is pressed at a place before
        offsets.append((offset[0], offset[1]))
    return _Fit(offsets, max(0.0, explained))


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
