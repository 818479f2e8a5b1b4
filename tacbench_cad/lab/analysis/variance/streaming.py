"""One pass over the frames of a study, in an order that needs the same memory for any number of frames.

A *place* is a force level and a position. A *cell* contains all presses of one combination (printer and filament) and
one texture. These are in memory at any time:

* the numbers of the presses of one cell at one place (twelve images of bytes in the paper's design);
* the mean numbers of all cells at that place.

This memory does not grow with positions or forces. Places are independent and are distributed over processes.

The result is sufficient for every statistic of :mod:`tacbench_cad.lab.analysis.variance.table`:

* each cell's Gram matrix of deviations at each place, as
  :class:`~tacbench_cad.lab.analysis.variance.intervals.CellSums`. The table's variance follows from its diagonal, and
  the matrix can be split into prints and repeats;
* the nested sums of squares of all presses at a place, as
  :class:`~tacbench_cad.lab.analysis.variance.components.NestedSums`, and the squared distances between the means of
  the cells. Both follow from the Gram matrix of the cells' mean numbers;
* the variance of each pixel, summed over places, at a resolution for figures.

If the table has series, the frames of one time step are in memory at a time. All sums are means over pixels, so the
sums of a press with T frames are the means over the T steps: the pixels of all frames count alike.

A frame that is damaged or contains NaN is left out and listed, with all frames of its press; the rest is computed
without it.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tacbench_cad.lab.analysis.feature import Feature
from tacbench_cad.lab.analysis.study_design import Design
from tacbench_cad.lab.analysis.variance.cells import CellKey, groups
from tacbench_cad.lab.analysis.variance.components import NestedSums
from tacbench_cad.lab.analysis.variance.intervals import CellSums
from tacbench_cad.lab.parallel import Executor
from tacbench_cad.lab.runs.press_table import STEP, stationary
from tacbench_cad.util.errors import CheckFailedError
from tacbench_cad.util.types import Floats, Ints

#: The number of values that are converted at a time: 0.5 MB, which fits into the processor's cache.
CHUNK = 1 << 16
#: The number of frames that are read at a time where they need not be compared with each other.
PIECE = 8
#: The columns that identify a cell, and those by which the presses of a study are sorted for the pass.
_CELL = ["combination", "texture"]
_ORDER = ["level", "position", *_CELL, "print_number", "repeat"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Moments:
    """The mean, variance and covariance of a few frames.

    Args:
        mean: The mean frame, shape (pixels,).
        squares: The sum of squared deviations of each pixel, shape (pixels,).
        gram: The products of the frames' deviations, mean over pixels, shape (n, n).
    """

    mean: Floats
    squares: Floats
    gram: Floats


def moments(frames: Sequence[NDArray[Any]] | NDArray[Any]) -> Moments:
    """Compute the moments of n frames, (pixels,) each, in two passes over a few thousand pixels at a time."""
    n, pixels = len(frames), frames[0].size
    mean, squares, gram = np.empty(pixels), np.empty(pixels), np.zeros((n, n))
    width = max(1, CHUNK // n)
    for which in (slice(begin, min(begin + width, pixels)) for begin in range(0, pixels, width)):
        piece = np.array([frame[which] for frame in frames], dtype=np.float64)
        mean[which] = piece.mean(axis=0)
        piece -= mean[which]
        gram += piece @ piece.T
        np.einsum("ij,ij->j", piece, piece, out=squares[which])
    return Moments(mean=mean, squares=squares, gram=gram / pixels)


def usable(
    rows: pd.DataFrame, feature: Feature, left_out: list[str], size: int = PIECE
) -> Iterator[tuple[Ints, NDArray[Any]]]:
    """Transform rows in pieces: yield the indices of each piece and its numbers, (n, numbers).

    Rows that cannot be used are left out, and their errors are added to ``left_out``.
    """
    for start in range(0, len(rows), size):
        piece = rows.iloc[start : start + size]
        try:
            numbers = feature.transform(piece)
        except CheckFailedError as error:
            if size == 1:
                left_out.append(str(error))
            else:
                yield from ((start + indices, values) for indices, values in usable(piece, feature, left_out, 1))
        else:
            yield np.arange(start, start + len(piece)), numbers


def sum_of_squares(pieces: Iterable[NDArray[Any]]) -> tuple[int, float]:
    """Return the number of frames, and the sum of squared deviations from their mean, mean over pixels.

    Args:
        pieces: Pieces of the frames, (n, pixels) each, of which one is in memory at a time.
    """
    count, mean, squares = 0, np.zeros(()), 0.0
    for frames in pieces:
        n, of_piece = len(frames), moments(frames)
        apart = of_piece.mean - mean
        squares += float(np.trace(of_piece.gram)) + count * n / (count + n) * float(np.mean(apart**2))
        mean = mean + n / (count + n) * apart
        count += n
    return count, squares


@dataclass(frozen=True, kw_only=True, eq=False)
class PlaceSums:
    """The sums of all presses at one force level and one position.

    Args:
        level: The force level.
        position: The position.
        cells: The sums of each cell.
        nested: The sums of squares of the nested design over all presses at the place.
        distances: The squared differences between the means of two cells, mean over pixels, in the order of ``cells``.
        steps: For each cell, the sum of squared deviations from the mean at each time step, mean over pixels, shape
            (steps,).
        maps: The variance of each pixel (ddof 0) of each cell with several presses, at a resolution for figures.
        means: The mean numbers of each cell, if the feature exhibits them.
    """

    level: int
    position: int
    cells: Mapping[CellKey, CellSums]
    nested: NestedSums
    distances: Floats
    steps: Mapping[CellKey, Floats]
    maps: Mapping[CellKey, Floats]
    means: Mapping[CellKey, Floats]


@dataclass(frozen=True, kw_only=True, eq=False)
class Pass:
    """The result of one pass over a study.

    Args:
        places: The sums of each place with usable frames, by level and position, without maps and means.
        maps: For each cell, the variance of each pixel (ddof 0), mean over the places of the levels at which the cell
            has the most prints, at a resolution for figures.
        means: For each level and cell, the mean numbers, mean over positions, if the feature exhibits them.
        floors: The noise of each cell with stationary frames in contact: the variance over the frames of a session
            (ddof 1), mean over pixels, pooled over sessions. A run has a session at its start and one at its end,
            because the sensor was lifted between them.
        left_out: The frames that could not be used, with the reason.
    """

    places: Sequence[PlaceSums]
    maps: Mapping[CellKey, Floats]
    means: Mapping[tuple[int, CellKey], Floats]
    floors: Mapping[CellKey, float]
    left_out: Sequence[str]


def stream(
    design: Design, feature: Feature, executor: Executor, progress: Callable[[int, int], None] | None = None
) -> Pass:
    """Pass once over all presses and stationary frames of a study.

    Args:
        design: The design of the study.
        feature: The fitted feature.
        executor: The worker processes.
        progress: Receives progress updates: the number of frames done and their total number.
    """
    presses = design.presses.sort_values(_ORDER, kind="stable")
    presses.attrs.clear()  # pandas would copy them in every step
    still = stationary(presses if feature.from_frames else presses.iloc[:0])
    still = still[still["in_contact"].astype(bool)]
    at_places = presses.groupby(["level", "position"])
    sessions = [of_session for _, of_session in still.groupby(["run", "when"], sort=False)]
    done, total = 0, len(presses) + len(still)
    at_a_place = [name for name in _ORDER if name != "position"]
    there = presses.sort_values(at_a_place).drop_duplicates(at_a_place)
    designs: dict[tuple[int, CellKey], Ints] = {
        (level, (combination, texture)): of_cell["print_number"].to_numpy(np.int64)
        for (level, combination, texture), of_cell in groups(there, ["level", *_CELL])
    }
    drawn = levels_with_most_prints(designs)
    places, left_out = list[PlaceSums](), list[str]()
    maps: dict[CellKey, list[Any]] = defaultdict(lambda: [0.0, 0])
    means: dict[tuple[int, CellKey], list[Any]] = defaultdict(lambda: [0.0, 0])
    floors: dict[CellKey, list[Any]] = defaultdict(lambda: [0.0, 0])

    def advance(frames: int, faults: Sequence[str]) -> None:
        nonlocal done
        done += frames
        left_out.extend(faults)
        if progress is not None:
            progress(done, total)

    work = partial(_sums_or_faults, feature=feature, designs=designs)
    sums = executor.map(work, (of_place for _, of_place in at_places))
    for frames, (place, faults) in zip(at_places.size(), sums, strict=True):
        advance(int(frames), faults)
        if place is None:
            continue
        for key in place.maps:
            if place.level in drawn[key]:
                maps[key] = [maps[key][0] + place.maps[key], maps[key][1] + 1]
        for key in place.means:
            of_cell = means[place.level, key]
            means[place.level, key] = [of_cell[0] + place.means[key], of_cell[1] + 1]
        places.append(replace(place, maps={}, means={}))
    cells = {run: (combination, texture) for run, combination, texture in presses[["run", *_CELL]].to_numpy()}
    noise = executor.map(partial(_noise, feature=feature), sessions)
    for session, (count, squares, faults) in zip(sessions, noise, strict=True):
        advance(len(session), faults)
        if count > 1:
            key = cells[session["run"].iloc[0]]
            floors[key] = [floors[key][0] + squares, floors[key][1] + count - 1]
    return Pass(
        places=places,
        maps={key: picture / count for key, (picture, count) in maps.items()},
        means={at: mean / count for at, (mean, count) in means.items()},
        floors={key: squares / dof for key, (squares, dof) in floors.items()},
        left_out=left_out,
    )


def levels_with_most_prints(prints: Mapping[tuple[int, CellKey], Ints]) -> dict[CellKey, tuple[int, ...]]:
    """Return the force levels at which each cell has the most prints. Figures of several levels use only these.

    Args:
        prints: The copy number of each press at a position, by level and cell.
    """
    numbers: dict[CellKey, dict[int, int]] = defaultdict(dict)
    for (level, cell), copies in sorted(prints.items(), key=lambda item: item[0]):
        numbers[cell][level] = len(np.unique(copies))
    return {cell: tuple(level for level in of if of[level] == max(of.values())) for cell, of in numbers.items()}


def _noise(session: pd.DataFrame, feature: Feature) -> tuple[int, float, list[str]]:
    """Return the number of usable frames of a session, their sum of squares, and the errors of the others."""
    faults: list[str] = []
    return *sum_of_squares(numbers for _, numbers in usable(session, feature, faults)), faults


def _sums_or_faults(
    presses: pd.DataFrame, feature: Feature, designs: Mapping[tuple[int, CellKey], Ints]
) -> tuple[PlaceSums | None, list[str]]:
    """Return the sums of the usable presses at a place, None if there are none, and the errors of the others."""
    faults: list[str] = []
    presses = presses.astype(object)  # of which rows and groups are taken the fastest
    try:
        return sums_at(presses, feature, designs), faults
    except CheckFailedError:
        good = np.concatenate([[], *(indices for indices, _ in usable(presses, feature, faults, 1))]).astype(int)
        names = pd.MultiIndex.from_frame(presses[["run", "press"]])
        left = presses[~names.isin(names.delete(good))]
        return sums_at(left, feature, designs) if len(left) else None, faults


def sums_at(presses: pd.DataFrame, feature: Feature, designs: Mapping[tuple[int, CellKey], Ints]) -> PlaceSums:
    """Return the sums of a place.

    Args:
        presses: The rows of the place, sorted by cell, print and repeat.
        feature: The fitted feature.
        designs: The copy numbers of the presses at a place without missing presses, by level and cell.

    Raises:
        CheckFailedError: A frame cannot be used.
    """
    level, position = (int(presses[name].iloc[0]) for name in ("level", "position"))
    steps = [of_step for _, of_step in presses.groupby(STEP)] if STEP in presses else [presses]
    copies: dict[CellKey, Ints] = {
        key: of_cell["print_number"].to_numpy(np.int64) for key, of_cell in groups(steps[0], _CELL)
    }
    grams: dict[CellKey, Any] = dict.fromkeys(copies, 0.0)
    between = np.zeros((len(copies), len(copies)))
    pictures, means = dict[CellKey, Any](), dict[CellKey, Any]()
    squares: dict[CellKey, list[float]] = {key: [] for key in copies}
    for of_step in steps:
        middles = []
        for key, of_cell in groups(of_step, _CELL):
            summed = moments(feature.transform(of_cell))
            grams[key] += summed.gram / len(steps)
            middles.append(summed.mean)
            squares[key].append(float(summed.squares.mean()))
            if feature.exhibit is not None:
                means[key] = means.get(key, 0.0) + summed.mean / len(steps)
            if len(of_cell) > 1:
                picture = feature.picture(summed.squares) / (len(steps) * len(of_cell))
                pictures[key] = pictures.get(key, 0.0) + picture
        between += moments(middles).gram / len(steps)
    cells = {key: CellSums.of(grams[key], of_cell, designs[level, key]) for key, of_cell in copies.items()}
    norms = np.diag(between)
    return PlaceSums(
        level=level,
        position=position,
        cells=cells,
        nested=_nested(steps[0], cells, between),
        distances=np.maximum(0.0, norms[:, None] + norms[None, :] - 2.0 * between),
        steps={key: np.array(of_cell) for key, of_cell in squares.items()},
        maps=pictures,
        means=means,
    )


def _nested(presses: pd.DataFrame, cells: Mapping[CellKey, CellSums], between: Floats) -> NestedSums:
    """Return the sums of squares of the nested design at a place.

    Args:
        presses: The presses of the place.
        cells: The sums of each cell.
        between: The products of the deviations of the cells' means, mean over pixels, in the order of ``cells``.
    """
    counts = np.array([cell.presses for cell in cells.values()], dtype=np.float64)
    same = np.array([[texture == other for _, other in cells] for _, texture in cells])
    of_texture = same * counts / (same @ counts)[:, None]  # the weights of the cells in the mean of each cell's texture
    whole = counts / counts.sum()

    def squares(contrasts: Floats) -> float:
        return max(0.0, float(np.einsum("c,ci,ij,cj->", counts, contrasts, between, contrasts)))

    outer = (squares(of_texture - whole), squares(np.eye(len(counts)) - of_texture))
    inner = (sum(cell.between for cell in cells.values()), sum(cell.within for cell in cells.values()))
    labels = [pd.factorize(presses[name])[0] for name in ("texture", "combination", "print_number")]
    return NestedSums.of(np.column_stack(labels), (*outer, *inner))
