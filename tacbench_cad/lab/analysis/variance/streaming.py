"""One pass over the frames of a study, in an order that needs the same memory for any number of frames.

A *place* is a force level and a position. At each place the presses are sorted by combination (printer and filament),
texture, print and repeat. A *cell* contains all presses of one combination and one texture. These are in memory at any
time:

* the frames of one cell at one place (twelve images of bytes in the paper's design);
* the mean frames of all cells at that place.

This memory does not grow with positions or forces. Places are independent and are distributed over processes.

The result is sufficient for every statistic of :mod:`tacbench_cad.lab.analysis.variance.table`:

* each cell's Gram matrix of deviations at each place, as
  :class:`~tacbench_cad.lab.analysis.variance.intervals.CellSums`. The table's variance follows from its diagonal, and
  the matrix can be split into prints and repeats;
* the nested sums of squares of all presses at a place, as
  :class:`~tacbench_cad.lab.analysis.variance.components.NestedSums`, and the squared distances between the texture
  means of a combination. Both follow from the Gram matrix of the cells' mean frames;
* the variance of each pixel, summed over places, at a resolution for figures.

If a press has a series of frames, the frames of one time step are in memory at a time. All sums are means over pixels,
so the sums of a press with T frames are the means over the T steps: the pixels of all frames count alike.

A frame that is damaged or contains NaN is left out and listed, with all frames of its press; the rest is computed
without it.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from typing import NamedTuple, TypeVar

import numpy as np

from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.feature import Feature, read_usable
from tacbench_cad.lab.analysis.variance.cells import CellKey
from tacbench_cad.lab.analysis.variance.components import NestedSums
from tacbench_cad.lab.analysis.variance.intervals import CellSums
from tacbench_cad.lab.analysis.variance.moments import moments, sum_of_squares
from tacbench_cad.lab.parallel import Executor
from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.util.errors import CheckFailedError
from tacbench_cad.util.types import Floats

K = TypeVar("K")

#: The number of tasks for each process: more than one, so that all processes end at about the same time.
TASKS_PER_JOB = 4


class SentPress(NamedTuple):
    """A press as it is sent to other processes."""

    level: int
    position: int
    combination: str
    texture: str
    copy: int
    repeat: int
    run: int
    paths: tuple[str, ...]

    @property
    def cell(self) -> CellKey:
        """The printer-filament and the texture."""
        return (self.combination, self.texture)


def presses_of(collection: Collection, feature: Feature) -> list[SentPress]:
    """Return the presses of a study, in the order of the study, with the files that a feature transforms."""
    columns = (
        *(collection.level, collection.position, collection.combination, collection.texture),
        *(collection.print_number, collection.repeat, collection.run),
    )
    values = zip(*(column.tolist() for column in columns), strict=True)
    return [SentPress._make((*press, feature.paths(collection, i))) for i, press in enumerate(values)]


def runs_to_send(collection: Collection) -> tuple[Run, ...]:
    """Return the runs for other processes, without the data that this process has already read.

    Their paths are absolute, because the workers of a cluster have other working folders.
    """
    return tuple(Run(folder=run.folder.absolute(), info=run.info) for run in collection.runs)


@dataclass(frozen=True, kw_only=True, eq=False)
class PlaceSums:
    """The sums of all presses at one force level and one position.

    Args:
        level: The force level.
        position: The position.
        cells: The sums of each cell.
        nested: The sums of squares of the nested design over all presses at the place.
        distances: For each combination, its textures, and the squared differences between the means of two textures,
            mean over pixels, shape (t, t).
        steps: For each cell, the sum of squared deviations from the mean at each time step, mean over pixels, shape
            (frames of a press,).
    """

    level: int
    position: int
    cells: Mapping[CellKey, CellSums]
    nested: NestedSums
    distances: Mapping[str, tuple[tuple[str, ...], Floats]]
    steps: Mapping[CellKey, Floats]


@dataclass(kw_only=True, eq=False)
class Pass:
    """The result of one pass over a study, or of a part of it.

    Args:
        places: The sums of each place, by level and position.
        maps: For each cell, the variance of each pixel (ddof 0), summed over the places of the levels with the most
            prints, at a resolution for figures, and the number of places.
        floors: The stationary frames in contact, by run: the sum of squared deviations from the mean of their session
            (start, end), mean over pixels, and its degrees of freedom. Runs without such frames are missing.
        left_out: The frames that could not be used, with the reason.
        means: For each level and cell, the mean numbers, summed over places, and the number of places. Only for a
            feature that exhibits them.
        frames: The number of decoded frames.
        seconds: The time of all processes, in s: ``decode`` (reading and decoding files, grey), ``sums``.
    """

    places: list[PlaceSums] = field(default_factory=list)
    maps: dict[CellKey, tuple[Floats, int]] = field(default_factory=dict)
    floors: dict[int, tuple[float, int]] = field(default_factory=dict)
    left_out: list[str] = field(default_factory=list)
    means: dict[tuple[int, CellKey], tuple[Floats, int]] = field(default_factory=dict)
    frames: int = 0
    seconds: dict[str, float] = field(default_factory=lambda: defaultdict(float))

    def add(self, part: Pass) -> None:
        """Add another part of the same pass."""
        self.places += part.places
        self.floors |= part.floors
        self.left_out += part.left_out
        self.frames += part.frames
        for name, seconds in part.seconds.items():
            self.seconds[name] += seconds
        for key, picture in part.maps.items():
            _add(self.maps, key, *picture)
        for place, mean in part.means.items():
            _add(self.means, place, *mean)


def _add(sums: dict[K, tuple[Floats, int]], key: K, values: Floats, count: int = 1) -> None:
    """Add values to a sum, and their number to its count."""
    before, number = sums.get(key, (np.zeros(()), 0))
    sums[key] = (before + values, number + count)


@dataclass(kw_only=True, eq=False)
class _Task:
    """A part of the work that a process can do alone.

    Args:
        runs: The runs, without any data that was read from them.
        feature: The fitted feature.
        designs: The copy numbers of the presses at a place without missing presses, by level and cell.
        places: The presses of each place of the task.
        still: The indices of the runs whose stationary frames are read.
        passed: The result of the task.
    """

    runs: tuple[Run, ...]
    feature: Feature
    designs: Mapping[tuple[int, CellKey], tuple[int, ...]]
    places: tuple[tuple[SentPress, ...], ...]
    still: tuple[int, ...]
    passed: Pass = field(default_factory=Pass)

    def frame(self, run: int, path: str) -> Frame | None:
        """Return a frame; if it cannot be used, return None and add a line to ``left_out``."""
        began = time.perf_counter()
        values: Frame | None = None
        try:
            values = read_usable(self.runs[run], path, self.feature)
        except CheckFailedError as error:
            self.passed.left_out.append(str(error))
        self.passed.seconds["decode"] += time.perf_counter() - began
        return values

    def place(self, presses: Sequence[SentPress]) -> None:
        """Add the sums of a place, unless none of its frames can be used."""
        level, position = presses[0].level, presses[0].position
        drawn = levels_with_most_prints(self.designs)
        lost: set[SentPress] = set()
        while presses := [press for press in presses if press not in lost]:
            lost.clear()
            members = {key: list(of_cell) for key, of_cell in groupby(presses, lambda press: press.cell)}
            count = len(presses[0].paths)
            grams = {key: np.zeros((len(of_cell), len(of_cell))) for key, of_cell in members.items()}
            between = np.zeros((len(members), len(members)))
            steps: dict[CellKey, list[Floats]] = {key: [] for key in members}
            pictures: dict[CellKey, tuple[Floats, int]] = {}
            means: dict[CellKey, tuple[Floats, int]] = {}
            for number in range(count):
                middles = []
                for key, of_cell in members.items():
                    read = [(press, self.frame(press.run, press.paths[number])) for press in of_cell]
                    lost |= {press for press, values in read if values is None}
                    if lost:
                        continue
                    frames = [values for _, values in read if values is not None]
                    summed = moments(frames)
                    grams[key] += summed.gram / count
                    middles.append(summed.mean)
                    # The numbers of the table of a series are its time steps.
                    steps[key].append(summed.squares.mean() if self.feature.from_frames else summed.squares)
                    if self.feature.exhibit is not None:
                        _add(means, key, summed.mean / count)
                    if len(frames) > 1 and level in drawn[key]:
                        picture = self.feature.picture(summed.squares, frames[0].shape)
                        _add(pictures, key, picture / (count * len(frames)))
                if lost:
                    break
                between += moments(middles).gram / count
            if not lost:
                break
        else:
            return
        self.passed.frames += len(presses) * count
        for key, (values, _) in means.items():
            _add(self.passed.means, (level, key), values)
        for key, (picture, _) in pictures.items():
            _add(self.passed.maps, key, picture)
        cells = {
            key: CellSums.of(grams[key], [press.copy for press in of_cell], self.designs[level, key])
            for key, of_cell in members.items()
        }
        self.passed.places.append(
            PlaceSums(
                level=level,
                position=position,
                cells=cells,
                nested=_nested(presses, cells, between),
                distances=_distances(list(cells), between),
                steps={key: np.hstack(of_steps) for key, of_steps in steps.items()},
            )
        )

    def floor(self, number: int) -> None:
        """Add the stationary frames of a run. Each session has its own mean, because the sensor was lifted between."""
        run = self.runs[number]
        total, dof = 0.0, 0
        for when in ("start", "end"):
            paths = [still.path for still in run.stationary_frames if still.in_contact and still.when == when]
            read = (self.frame(number, path) for path in paths)
            count, squares = sum_of_squares(frame for frame in read if frame is not None)
            total, dof = total + squares, dof + max(0, count - 1)
            self.passed.frames += count
        if dof:
            self.passed.floors[number] = (total, dof)

    def done(self) -> Pass:
        """Do the task."""
        began = time.perf_counter()
        for presses in self.places:
            self.place(presses)
        for number in self.still:
            self.floor(number)
        self.passed.seconds["sums"] = time.perf_counter() - began - self.passed.seconds["decode"]
        return self.passed


def _nested(presses: Sequence[SentPress], cells: Mapping[CellKey, CellSums], between: Floats) -> NestedSums:
    """Return the sums of squares of the nested design at a place.

    Args:
        presses: The presses of the place.
        cells: The sums of each cell.
        between: The products of the deviations of the cells' means, mean over pixels, in the order of ``cells``.
    """
    combinations, textures = (
        {name: i for i, name in enumerate(dict.fromkeys(names))} for names in zip(*cells, strict=True)
    )
    counts = np.array([cell.presses for cell in cells.values()], dtype=np.float64)
    same = np.array([[texture == other for _, other in cells] for _, texture in cells])
    of_texture = same * counts / (same @ counts)[:, None]  # the weights of the cells in the mean of each cell's texture
    whole = counts / counts.sum()

    def squares(contrasts: Floats) -> float:
        return max(0.0, float(np.einsum("c,ci,ij,cj->", counts, contrasts, between, contrasts)))

    outer = (squares(of_texture - whole), squares(np.eye(len(counts)) - of_texture))
    inner = (sum(cell.between for cell in cells.values()), sum(cell.within for cell in cells.values()))
    labels = [(textures[press.texture], combinations[press.combination], press.copy) for press in presses]
    return NestedSums.of(labels, (*outer, *inner))


def _distances(cells: Sequence[CellKey], between: Floats) -> dict[str, tuple[tuple[str, ...], Floats]]:
    """Return the textures of each combination, and the squared differences between their means, mean over pixels."""
    squares = np.diag(between)
    distances = np.maximum(0.0, squares[:, None] + squares[None, :] - 2.0 * between)
    result = {}
    for combination in dict.fromkeys(combination for combination, _ in cells):
        mine = [i for i, cell in enumerate(cells) if cell[0] == combination]
        result[combination] = (tuple(cells[i][1] for i in mine), distances[np.ix_(mine, mine)])
    return result


def stream(
    collection: Collection,
    feature: Feature,
    executor: Executor,
    progress: Callable[[int, int], None] | None = None,
) -> Pass:
    """Pass once over all presses and stationary frames of a study.

    Args:
        collection: The study.
        feature: The fitted feature.
        executor: The worker processes.
        progress: Receives progress updates: the number of frames done and their total number.
    """
    tasks = _tasks(collection, feature, executor.jobs)
    still = sum(_still_frames(run) for run in collection.runs) if feature.from_frames else 0
    total = len(collection) * len(feature.paths(collection, 0)) + still
    passed = Pass()
    for part in executor.map(_Task.done, tasks):
        passed.add(part)
        if progress is not None:
            progress(passed.frames + len(passed.left_out), total)
    passed.places.sort(key=lambda place: (place.level, place.position))
    passed.floors = dict(sorted(passed.floors.items()))
    return passed


def levels_with_most_prints(designs: Mapping[tuple[int, CellKey], Sequence[int]]) -> dict[CellKey, tuple[int, ...]]:
    """Return the force levels at which each cell has the most prints. Figures of several levels use only these."""
    prints: dict[CellKey, dict[int, int]] = defaultdict(dict)
    for (level, cell), copies in sorted(designs.items()):
        prints[cell][level] = len(set(copies))
    return {cell: tuple(level for level in of if of[level] == max(of.values())) for cell, of in prints.items()}


def _still_frames(run: Run) -> int:
    return sum(1 for stationary_frame in run.stationary_frames if stationary_frame.in_contact)


def _tasks(collection: Collection, feature: Feature, jobs: int) -> list[_Task]:
    presses = sorted(presses_of(collection, feature))
    places = [tuple(members) for _, members in groupby(presses, lambda press: (press.level, press.position))]
    there: dict[tuple[int, CellKey], set[tuple[int, int]]] = defaultdict(set)
    for press in presses:
        there[press.level, press.cell].add((press.copy, press.repeat))
    designs = {key: tuple(copy for copy, _ in sorted(repeats)) for key, repeats in there.items()}
    still = [i for i, run in enumerate(collection.runs) if _still_frames(run) and feature.from_frames]
    count = 1 if jobs == 1 else min(TASKS_PER_JOB * jobs, len(places))
    runs = runs_to_send(collection)
    return [
        _Task(
            runs=runs,
            feature=feature,
            designs=designs,
            places=tuple(places[i::count]),
            still=tuple(still[i::count]),
        )
        for i in range(count)
    ]
