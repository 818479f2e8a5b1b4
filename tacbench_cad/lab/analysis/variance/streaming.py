"""One pass over the readings of a study, in an order that keeps memory the same however many there are.

A *place* is a force level and a position. At each place the presses are taken combination by combination (printer and
filament), texture by texture, print by print, repeat by repeat. A *cell* is what one combination pressed of one
texture. In memory at any time: the readings of one cell at one place (twelve images of bytes in the paper's design),
the means of one combination's textures, and the running means of all textures and of everything. None of this grows
with positions, forces or printers. Places are independent and are handed out to processes.

What comes out is enough for every statistic of :mod:`tacbench_cad.lab.analysis.variance.table`:

* each cell's Gram matrix of deviations at each place (its diagonal holds the table's variance, and it splits into
  prints and repeats), as :class:`~tacbench_cad.lab.analysis.variance.intervals.CellSums`;
* the nested sums of squares of all presses of a place, the outer two merged as Welford's and Chan's recursions do
  (Chan, Golub and LeVeque 1983), as :class:`~tacbench_cad.lab.analysis.variance.components.NestedSums`;
* squared distances between the texture means of a combination;
* the variance of each pixel, summed over places, at a resolution for figures.

A reading that is damaged, or holds NaN, is left out and named; everything else is computed.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.preprocess import Preprocess
from tacbench_cad.lab.analysis.variance.components import NestedSums
from tacbench_cad.lab.analysis.variance.intervals import CellSums
from tacbench_cad.lab.analysis.variance.moments import Running, moments, running_moments, small_map
from tacbench_cad.lab.parallel import Executor
from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.util.errors import CheckFailedError
from tacbench_cad.util.types import Floats

#: Printer-filament and texture.
CellKey = tuple[str, str]
T = TypeVar("T")

#: Tasks for each process: some more than one, so that all end at about the same time.
TASKS_PER_JOB = 4


@dataclass(frozen=True, kw_only=True, eq=False)
class PlaceSums:
    """What the presses of one force level at one position come to.

    Args:
        level: Force level.
        position: Position.
        cells: Each cell's sums.
        nested: Sums of squares of the nested design over all presses of the place.
        distances: For each combination its textures, and the mean over pixels of the squared difference of two
            textures' means, shape (t, t).
    """

    level: int
    position: int
    cells: Mapping[CellKey, CellSums]
    nested: NestedSums
    distances: Mapping[str, tuple[tuple[str, ...], Floats]]


@dataclass(frozen=True, kw_only=True, eq=False)
class Floor:
    """Stationary frames in contact of one run.

    Args:
        run: Index of the run.
        squares: Mean over pixels of squared deviations from the mean of their sitting (start, end), summed.
        dof: Degrees of freedom of the sum.
    """

    run: int
    squares: float
    dof: int


@dataclass(frozen=True, kw_only=True, eq=False)
class Pass:
    """What one pass over a study gives.

    Args:
        places: Sums of each place, by level and position.
        maps: For each cell the variance of each pixel (ddof 0) summed over the places of the levels with the most
            prints, at a resolution for figures, and the number of places.
        floors: Stationary frames, by run; runs without such frames are missing.
        left_out: Readings that could not be used, with the reason.
        readings: Readings that were decoded.
        seconds: Time of all processes: ``decode`` (reading and decoding files, grey), ``sums``.
    """

    places: tuple[PlaceSums, ...]
    maps: Mapping[CellKey, tuple[Floats, int]]
    floors: tuple[Floor, ...]
    left_out: tuple[str, ...]
    readings: int
    seconds: Mapping[str, float]


@dataclass(frozen=True, kw_only=True)
class _Press:
    run: int
    path: str
    combination: str
    texture: str
    copy: int

    @property
    def cell(self) -> CellKey:
        return (self.combination, self.texture)


@dataclass(frozen=True, kw_only=True)
class _Place:
    level: int
    position: int
    presses: tuple[_Press, ...]


@dataclass(frozen=True, kw_only=True)
class _Task:
    """A part of the work that a process can do on its own.

    Args:
        runs: The runs, with nothing read of them.
        preprocess: What is done to a reading.
        designs: Copy numbers of the presses of a place without holes, by level and cell.
        drawn: Levels of each cell whose maps are summed.
        places: Places to pass over.
        still: Indices of runs whose stationary frames are read.
    """

    runs: tuple[Run, ...]
    preprocess: Preprocess
    designs: Mapping[tuple[int, CellKey], tuple[int, ...]]
    drawn: Mapping[CellKey, tuple[int, ...]]
    places: tuple[_Place, ...]
    still: tuple[int, ...]


def stream(
    collection: Collection,
    preprocess: Preprocess,
    team: Executor,
    progress: Callable[[int, int], None] | None = None,
) -> Pass:
    """Pass once over all presses and stationary frames of a study.

    Args:
        collection: The study.
        preprocess: What is done to a reading first.
        team: The processes that do it.
        progress: Called with the readings that were passed and with all of them.
    """
    tasks = _tasks(collection, preprocess, team.jobs)
    total = len(collection) + sum(_still_frames(run) for run in collection.runs)
    places: list[PlaceSums] = []
    maps: dict[CellKey, tuple[Floats, int]] = {}
    floors: list[Floor] = []
    left_out: list[str] = []
    seconds = {"decode": 0.0, "sums": 0.0}
    readings = 0
    for part in team.map(_work, tasks):
        places += part.places
        floors += part.floors
        left_out += part.left_out
        readings += part.readings
        for name in seconds:
            seconds[name] += part.seconds[name]
        for key, (picture, count) in part.maps.items():
            before = maps.get(key)
            maps[key] = (picture, count) if before is None else (before[0] + picture, before[1] + count)
        if progress is not None:
            progress(readings + len(left_out), total)
    return Pass(
        places=tuple(sorted(places, key=lambda place: (place.level, place.position))),
        maps=maps,
        floors=tuple(sorted(floors, key=lambda floor: floor.run)),
        left_out=tuple(left_out),
        readings=readings,
        seconds=seconds,
    )


def read_usable(run: Run, path: str, preprocess: Preprocess) -> Frame:
    """A reading, preprocessed.

    Raises:
        CheckFailedError: Its file is missing or damaged, or holds NaN or infinity; the message names it.
    """
    values = preprocess(run.read(path))
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        raise CheckFailedError(f"{run.folder / path}: holds NaN or infinity")
    return values


def designs_of(collection: Collection) -> dict[tuple[int, CellKey], tuple[int, ...]]:
    """Copy numbers of the presses that a place of each cell has at each level, if none is missing."""
    presses_of: dict[tuple[int, CellKey], set[tuple[int, int]]] = {}
    columns = (collection.level, collection.combination, collection.texture, collection.copy, collection.repeat)
    for level, combination, texture, copy, repeat in zip(*(column.tolist() for column in columns), strict=True):
        presses_of.setdefault((level, (combination, texture)), set()).add((copy, repeat))
    return {key: tuple(copy for copy, _ in sorted(presses)) for key, presses in presses_of.items()}


def levels_with_most_prints(designs: Mapping[tuple[int, CellKey], Sequence[int]]) -> dict[CellKey, tuple[int, ...]]:
    """The force levels at which each cell has the most prints: what figures that pool levels are made of."""
    prints = {key: len(set(copies)) for key, copies in designs.items()}
    most: dict[CellKey, int] = {}
    for (_, cell), count in prints.items():
        most[cell] = max(most.get(cell, 0), count)
    return {
        cell: tuple(sorted(level for (level, of), n in prints.items() if of == cell and n == count))
        for cell, count in most.items()
    }


def _still_frames(run: Run) -> int:
    return sum(1 for stationary_frame in run.stationary_frames if stationary_frame.in_contact)


def _tasks(collection: Collection, preprocess: Preprocess, jobs: int) -> list[_Task]:
    order = np.lexsort(
        (
            collection.repeat,
            collection.copy,
            collection.texture,
            collection.combination,
            collection.position,
            collection.level,
        )
    )
    places: dict[tuple[int, int], list[_Press]] = {}
    for index in order.tolist():
        press = _Press(
            run=int(collection.run[index]),
            path=collection.path(index),
            combination=str(collection.combination[index]),
            texture=str(collection.texture[index]),
            copy=int(collection.copy[index]),
        )
        places.setdefault((int(collection.level[index]), int(collection.position[index])), []).append(press)
    every = [
        _Place(level=level, position=position, presses=tuple(presses)) for (level, position), presses in places.items()
    ]
    still = [i for i, run in enumerate(collection.runs) if _still_frames(run)]
    count = 1 if jobs == 1 else min(TASKS_PER_JOB * jobs, len(every))
    # New objects: what this process has read of the runs is not sent along.
    # Whole paths: the workers of a cluster stand in other folders.
    runs = tuple(Run(folder=run.folder.absolute(), info=run.info) for run in collection.runs)
    designs = designs_of(collection)
    return [
        _Task(
            runs=runs,
            preprocess=preprocess,
            designs=designs,
            drawn=levels_with_most_prints(designs),
            places=tuple(every[i::count]),
            still=tuple(still[i::count]),
        )
        for i in range(count)
    ]


class _Worker:
    """Reads and sums the presses of one task."""

    def __init__(self, task: _Task) -> None:
        self.task = task
        self.left_out: list[str] = []
        self.readings = 0
        self.decode = 0.0
        self.maps: dict[CellKey, tuple[Floats, int]] = {}

    def frame(self, run: int, path: str) -> Frame | None:
        """A reading, or None (and a line in ``left_out``) if it cannot be used."""
        began = time.perf_counter()
        values: Frame | None = None
        try:
            values = read_usable(self.task.runs[run], path, self.task.preprocess)
        except CheckFailedError as error:
            self.left_out.append(str(error))
        self.readings += values is not None
        self.decode += time.perf_counter() - began
        return values

    def place(self, place: _Place) -> PlaceSums | None:
        """The sums of a place, or None if none of its readings can be used."""
        names = {what: i for i, what in enumerate(sorted({p.texture for p in place.presses}))}
        cells: dict[CellKey, CellSums] = {}
        textures: dict[str, Running] = {}
        distances: dict[str, tuple[tuple[str, ...], Floats]] = {}
        labels: list[tuple[int, int, int]] = []
        groups = _grouped(place.presses, lambda press: press.combination)
        for number, (combination, presses) in enumerate(groups):
            means: dict[str, Floats] = {}
            for (_, texture), of_cell in _grouped(presses, lambda press: press.cell):
                used = [
                    (press.copy, values)
                    for press in of_cell
                    if (values := self.frame(press.run, press.path)) is not None
                ]
                if not used:
                    continue
                key = (combination, texture)
                copies = [copy for copy, _ in used]
                shape = used[0][1].shape
                summed = moments([values for _, values in used])
                cells[key] = CellSums.of(summed.gram, copies, self.task.designs[place.level, key])
                labels += [(names[texture], number, copy) for copy in copies]
                textures.setdefault(texture, Running()).add(len(used), summed.mean, 0.0)
                means[texture] = summed.mean
                if len(used) > 1 and place.level in self.task.drawn[key]:
                    self.draw(key, small_map(summed.squares, shape) / len(used))
            if means:
                distances[combination] = (tuple(means), _distances(list(means.values())))
        if not cells:
            return None
        grand = Running()
        for running in textures.values():
            grand.add(running.count, running.mean, 0.0)
        squares = (
            grand.merged,
            sum(texture.merged for texture in textures.values()),
            sum(cell.between for cell in cells.values()),
            sum(cell.within for cell in cells.values()),
        )
        return PlaceSums(
            level=place.level,
            position=place.position,
            cells=cells,
            nested=NestedSums.of(labels, squares),
            distances=distances,
        )

    def draw(self, key: CellKey, picture: Floats) -> None:
        """Add a map of variances."""
        before = self.maps.get(key)
        self.maps[key] = (picture, 1) if before is None else (before[0] + picture, before[1] + 1)

    def floor(self, number: int) -> Floor | None:
        """The stationary frames of a run; each sitting has its own mean, since the sensor was lifted in between."""
        run = self.task.runs[number]
        squares, dof = 0.0, 0
        for when in ("start", "end"):
            paths = [
                stationary_frame.path
                for stationary_frame in run.stationary_frames
                if stationary_frame.in_contact and stationary_frame.when == when
            ]
            frames = running_moments(frame for path in paths if (frame := self.frame(number, path)) is not None)
            squares, dof = squares + frames.squares, dof + max(0, frames.count - 1)
        return Floor(run=number, squares=squares, dof=dof) if dof else None


def _work(task: _Task) -> Pass:
    """Do one task."""
    worker = _Worker(task)
    began = time.perf_counter()
    places = [sums for sums in map(worker.place, task.places) if sums is not None]
    floors = [floor for floor in map(worker.floor, task.still) if floor is not None]
    return Pass(
        places=tuple(places),
        maps=worker.maps,
        floors=tuple(floors),
        left_out=tuple(worker.left_out),
        readings=worker.readings,
        seconds={"decode": worker.decode, "sums": time.perf_counter() - began - worker.decode},
    )


def _grouped(presses: Sequence[_Press], key: Callable[[_Press], T]) -> Iterator[tuple[T, list[_Press]]]:
    """Runs of presses with the same key; they are sorted by it."""
    from itertools import groupby

    for value, members in groupby(presses, key):
        yield value, list(members)


def _distances(means: Sequence[Floats]) -> Floats:
    """Mean over pixels of squared differences between images, shape (t, t)."""
    gram = moments(means).gram
    squares = np.diag(gram)
    return np.asarray(np.maximum(0.0, squares[:, None] + squares[None, :] - 2.0 * gram))
