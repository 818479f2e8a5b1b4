"""One pass over the frames of a study, in an order that needs the same memory for any number of frames.

A *place* is a force level and a position. At each place the presses are sorted by combination (printer and filament),
texture, print and repeat. A *cell* contains all presses of one combination and one texture. These are in memory at any
time:

* the frames of one cell at one place (twelve images of bytes in the paper's design);
* the means of the textures of one combination;
* the running means of all textures and of all frames.

This memory does not grow with positions, forces or printers. Places are independent and are distributed over processes.

The result is sufficient for every statistic of :mod:`tacbench_cad.lab.analysis.variance.table`:

* each cell's Gram matrix of deviations at each place, as
  :class:`~tacbench_cad.lab.analysis.variance.intervals.CellSums`. The table's variance follows from its diagonal, and
  the matrix can be split into prints and repeats;
* the nested sums of squares of all presses at a place, as
  :class:`~tacbench_cad.lab.analysis.variance.components.NestedSums`. The outer two are merged with the recursions of
  Welford and Chan (Chan, Golub and LeVeque 1983);
* the squared distances between the texture means of a combination;
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
from functools import cached_property
from itertools import groupby
from typing import Any

import numpy as np

from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.feature import Feature, read_usable
from tacbench_cad.lab.analysis.variance.components import NestedSums
from tacbench_cad.lab.analysis.variance.intervals import CellSums
from tacbench_cad.lab.analysis.variance.moments import Running, moments, running_moments
from tacbench_cad.lab.analysis.variance.presses import CellKey, Press, presses_of, runs_to_send
from tacbench_cad.lab.parallel import Executor
from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.util.errors import CheckFailedError
from tacbench_cad.util.types import Floats

#: The number of tasks for each process: more than one, so that all processes end at about the same time.
TASKS_PER_JOB = 4


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


@dataclass(frozen=True, kw_only=True, eq=False)
class Floor:
    """The sums of the stationary frames in contact of one run.

    Args:
        run: The index of the run.
        squares: The sum of squared deviations from the mean of their session (start, end), mean over pixels.
        dof: The degrees of freedom of the sum.
    """

    run: int
    squares: float
    dof: int


@dataclass(kw_only=True, eq=False)
class Pass:
    """The result of one pass over a study, or of a part of it.

    Args:
        places: The sums of each place, by level and position.
        maps: For each cell, the variance of each pixel (ddof 0), summed over the places of the levels with the most
            prints, at a resolution for figures, and the number of places.
        floors: The stationary frames, by run; runs without such frames are missing.
        left_out: The frames that could not be used, with the reason.
        means: For each level and cell, the mean numbers, summed over places, and the number of places. Only for a
            feature that exhibits them.
        frames: The number of decoded frames.
        seconds: The time of all processes, in s: ``decode`` (reading and decoding files, grey), ``sums``.
    """

    places: list[PlaceSums] = field(default_factory=list)
    maps: dict[CellKey, tuple[Floats, int]] = field(default_factory=dict)
    floors: list[Floor] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)
    means: dict[tuple[int, CellKey], tuple[Floats, int]] = field(default_factory=dict)
    frames: int = 0
    seconds: dict[str, float] = field(default_factory=lambda: {"decode": 0.0, "sums": 0.0})

    def add_map(self, key: CellKey, picture: Floats, count: int = 1) -> None:
        """Add a map of variances."""
        before, places = self.maps.get(key, (0.0, 0))
        self.maps[key] = (before + picture, places + count)

    def add_mean(self, key: tuple[int, CellKey], mean: Floats, count: int = 1) -> None:
        """Add mean numbers."""
        before, places = self.means.get(key, (0.0, 0))
        self.means[key] = (before + mean, places + count)

    def add(self, part: Pass) -> None:
        """Add another part of the same pass."""
        self.places += part.places
        self.floors += part.floors
        self.left_out += part.left_out
        self.frames += part.frames
        for name, seconds in part.seconds.items():
            self.seconds[name] += seconds
        for key, (picture, count) in part.maps.items():
            self.add_map(key, picture, count)
        for place, (mean, count) in part.means.items():
            self.add_mean(place, mean, count)


@dataclass(kw_only=True, eq=False)
class _Sums:
    """The sums of a place, added up over time steps.

    Args:
        presses: The presses whose frames could be used.
        grams: The products of the presses' deviations of each cell, mean over pixels.
        outer: The sums of squares of textures and of printers, shape (2,).
        distances: The textures of each combination.
        squares: The squared differences between the means of these textures.
        pictures: The sums of squared deviations of each cell as a picture.
        means: The mean numbers of each cell, if the feature exhibits them.
        steps: The sum of squared deviations of each cell at each time step, mean over pixels.
    """

    presses: list[Press] = field(default_factory=list)
    grams: dict[CellKey, Floats] = field(default_factory=dict)
    outer: Floats = field(default_factory=lambda: np.zeros(2))
    distances: dict[str, tuple[str, ...]] = field(default_factory=dict)
    squares: dict[str, Floats] = field(default_factory=dict)
    pictures: dict[CellKey, Floats] = field(default_factory=dict)
    means: dict[CellKey, Floats] = field(default_factory=dict)
    steps: list[dict[CellKey, Floats]] = field(default_factory=list)

    def add(self, step: _Sums) -> None:
        """Add the sums of another time step of the same presses."""
        self.presses, self.distances = step.presses, step.distances
        self.outer = self.outer + step.outer
        self.steps += step.steps
        pairs: Sequence[tuple[dict[Any, Floats], dict[Any, Floats]]] = (
            (self.grams, step.grams),
            (self.squares, step.squares),
            (self.pictures, step.pictures),
            (self.means, step.means),
        )
        for sums, more in pairs:
            for key, values in more.items():
                sums[key] = sums[key] + values if key in sums else values


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
    places: tuple[tuple[Press, ...], ...]
    still: tuple[int, ...]
    passed: Pass = field(default_factory=Pass)

    @cached_property
    def drawn(self) -> dict[CellKey, tuple[int, ...]]:
        """The levels at which a map of each cell is drawn."""
        return levels_with_most_prints(self.designs)

    def frame(self, run: int, path: str) -> Frame | None:
        """Return a frame; if it cannot be used, return None and add a line to ``left_out``."""
        began = time.perf_counter()
        values: Frame | None = None
        try:
            values = read_usable(self.runs[run], path, self.feature)
        except CheckFailedError as error:
            self.passed.left_out.append(str(error))
        self.passed.frames += values is not None
        self.passed.seconds["decode"] += time.perf_counter() - began
        return values

    def place(self, presses: Sequence[Press]) -> None:
        """Add the sums of a place, unless none of its frames can be used."""
        level, position = presses[0].level, presses[0].position
        sums, before = _Sums(), self.passed.frames
        count = len(presses[0].paths)
        while len(sums.steps) < count:
            step = self.step(presses, len(sums.steps))
            if not step.presses:
                return
            if step.presses != list(presses) and sums.steps:  # the earlier steps have a press that is left out now
                sums, self.passed.frames = _Sums(), before
            else:
                sums.add(step)
            presses = step.presses
        cells = {}
        names = {what: i for i, what in enumerate(sorted({press.texture for press in presses}))}
        numbers = {combination: i for i, combination in enumerate(sums.distances)}
        labels = [(names[press.texture], numbers[press.combination], press.copy) for press in presses]
        for key, of_cell in groupby(presses, lambda press: press.cell):
            copies = [press.copy for press in of_cell]
            cells[key] = CellSums.of(sums.grams[key] / count, copies, self.designs[level, key])
            if key in sums.means:
                self.passed.add_mean((level, key), sums.means[key] / count)
            if key in sums.pictures:
                self.passed.add_map(key, sums.pictures[key] / (count * len(copies)))
        squares = (
            *(sums.outer / count).tolist(),
            sum(cell.between for cell in cells.values()),
            sum(cell.within for cell in cells.values()),
        )
        self.passed.places.append(
            PlaceSums(
                level=level,
                position=position,
                cells=cells,
                nested=NestedSums.of(labels, squares),
                distances={name: (textures, sums.squares[name] / count) for name, textures in sums.distances.items()},
                steps={key: np.hstack([step[key] for step in sums.steps]) for key in cells},
            )
        )

    def step(self, presses: Sequence[Press], number: int) -> _Sums:
        """Return the sums of the frames that the presses at a place have at one time step."""
        sums = _Sums()
        textures: dict[str, Running] = {}
        squares: dict[CellKey, Floats] = {}
        for combination, of_combination in groupby(presses, lambda press: press.combination):
            means: dict[str, Floats] = {}
            for key, of_cell in groupby(of_combination, lambda press: press.cell):
                read = ((press, self.frame(press.run, press.paths[number])) for press in of_cell)
                used = [(press, values) for press, values in read if values is not None]
                if not used:
                    continue
                sums.presses += [press for press, _ in used]
                shape = used[0][1].shape
                summed = moments([values for _, values in used])
                sums.grams[key] = summed.gram
                # The numbers of the table of a series are its time steps.
                squares[key] = summed.squares.mean() if self.feature.from_frames else summed.squares
                textures.setdefault(key[1], Running()).add(len(used), summed.mean, 0.0)
                means[key[1]] = summed.mean
                if self.feature.exhibit is not None:
                    sums.means[key] = summed.mean
                if len(used) > 1 and presses[0].level in self.drawn[key]:
                    sums.pictures[key] = self.feature.picture(summed.squares, shape)
            if means:
                sums.distances[combination] = tuple(means)
                sums.squares[combination] = _distances(list(means.values()))
        grand = Running()
        for running in textures.values():
            grand.add(running.count, running.mean, 0.0)
        sums.outer = np.array([grand.merged, sum(texture.merged for texture in textures.values())])
        sums.steps.append(squares)
        return sums

    def floor(self, number: int) -> None:
        """Add the stationary frames of a run. Each session has its own mean, because the sensor was lifted between."""
        run = self.runs[number]
        squares, dof = 0.0, 0
        for when in ("start", "end"):
            paths = [
                stationary_frame.path
                for stationary_frame in run.stationary_frames
                if stationary_frame.in_contact and stationary_frame.when == when
            ]
            frames = running_moments(frame for path in paths if (frame := self.frame(number, path)) is not None)
            squares, dof = squares + frames.squares, dof + max(0, frames.count - 1)
        if dof:
            self.passed.floors.append(Floor(run=number, squares=squares, dof=dof))

    def done(self) -> Pass:
        """Do the task."""
        began = time.perf_counter()
        for presses in self.places:
            self.place(presses)
        for number in self.still:
            self.floor(number)
        self.passed.seconds["sums"] = time.perf_counter() - began - self.passed.seconds["decode"]
        return self.passed


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
    passed.floors.sort(key=lambda floor: floor.run)
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


def _distances(means: Sequence[Floats]) -> Floats:
    """Return the squared differences between images, mean over pixels, shape (t, t)."""
    gram = moments(means).gram
    squares = np.diag(gram)
    return np.asarray(np.maximum(0.0, squares[:, None] + squares[None, :] - 2.0 * gram))
