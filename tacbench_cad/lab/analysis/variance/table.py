"""The paper's variance table, with its noise floor, intervals, components and tests.

The table's figure V is the variance of each pixel over prints x repeats at each position, then the mean over pixels and
positions; ``all`` is the mean of the levels' figures. V contains differences between prints, differences in where and
how the sensor presses, and sensor noise. Therefore the table also has the noise floor, in the same unit:

* It is computed from the stationary frames in contact, between which the sensor does not move: the variance over the
  frames of a session with ddof 1, pooled over the runs of a cell. These frames are recorded at the protocol's middle
  force, and are used for all levels.
* If there are no such frames, it is computed from the repeats on one print. The sensor was lifted and pressed again
  between them, so this is an upper bound of the noise, and the table says so.

The estimate with the noise floor removed is the variance with ddof 1 minus the noise floor. It is unbiased and may be
negative.

The figures that the paper printed are another quantity: the variance of the repeats on one print, then the mean over
prints, positions and pixels. With the protocol ``as-published``, V is this quantity.
"""

from __future__ import annotations

import operator
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import reduce
from itertools import chain, combinations, product
from typing import Any, get_args

import numpy as np

from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.feature import Feature
from tacbench_cad.lab.analysis.pixels import AS_PUBLISHED, Pixels
from tacbench_cad.lab.analysis.published import variance_of
from tacbench_cad.lab.analysis.variance.between import texture_matrices
from tacbench_cad.lab.analysis.variance.cells import (
    ALL_LEVELS,
    FRAMES,
    REPEATS,
    Cell,
    CellKey,
    Level,
    Quantity,
    parts_of,
)
from tacbench_cad.lab.analysis.variance.components import component_rows, components
from tacbench_cad.lab.analysis.variance.intervals import (
    OF_ALL,
    OF_REPEATS,
    CellSums,
    component_interval,
    variance_interval,
)
from tacbench_cad.lab.analysis.variance.permutation import PermutationTest, dispersion_test
from tacbench_cad.lab.analysis.variance.result import PrinterTest, Protocol, Sums, VarianceResult
from tacbench_cad.lab.analysis.variance.streaming import PlaceSums, stream
from tacbench_cad.lab.parallel import workers
from tacbench_cad.lab.runs.region import SURE
from tacbench_cad.lab.runs.region_search import found_region
from tacbench_cad.lab.study.spec import UNKNOWN
from tacbench_cad.util.errors import InputError, one_of
from tacbench_cad.util.types import Floats

#: The reason why there is no table, for each quantity.
_NOT_REPEATED = (
    "no position was pressed more than once; a variance needs a second repeat or a second print",
    "no print was pressed twice at one position; the published quantity is the variance over the repeats on a print",
)


def variance_table(
    collection: Collection,
    feature: Feature | None = None,
    *,
    protocol: Protocol = "paper",
    ddof: int = 0,
    jobs: int = 1,
    dask: str | None = None,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> VarianceResult:
    """Compute the variance table of a study, with its components, matrices, tests and maps.

    Args:
        collection: The study. If it has series, the variance is computed for each pixel of each frame of a series.
        feature: The fitted feature; None for grey pixels at full size.
        protocol: ``paper`` for the variance over prints and repeats; ``as-published`` for the quantity that the paper
            printed: the variance over the repeats on one print at the lowest force level, for images at 40 % of their
            size, in grey without rounding, ``ddof`` 0.
        ddof: 0 as in the paper, or 1.
        jobs: The number of worker processes on this machine.
        dask: The address of a Dask scheduler, whose workers are then used instead.
        seed: The seed of the intervals and permutations.
        progress: Receives progress updates: the number of frames done and their total number.

    Raises:
        InputError: The position or the print of the presses is unknown, no position was pressed more than once, or a
            setting is not allowed.
    """
    if ddof not in (0, 1):
        raise InputError("ddof", ddof, "must be 0 or 1")
    one_of("protocol", protocol, get_args(Protocol))
    collection.require("the variance", "position", "print or repeat")
    used, quantity = feature or Pixels(), OF_ALL
    if protocol == "as-published":
        if feature not in (None, AS_PUBLISHED) or ddof:
            raise InputError(
                "protocol",
                protocol,
                "always uses grey images at 40 % of their size and ddof 0; leave out feature and ddof",
            )
        if collection.series:
            raise InputError("protocol", protocol, "is for the frames of presses; leave out --series")
        collection.require("the published quantity", "print")
        used, quantity = AS_PUBLISHED, OF_REPEATS
        collection = collection.at_level(collection.levels[0])
    with workers(jobs, dask, [run.folder for run in collection.runs]) as executor:
        passed = stream(collection, used, executor, progress)
    sums = _summed(collection, passed.places, quantity)
    if not sums:
        raise InputError("presses", 1, _NOT_REPEATED[quantity])
    floors = _floors(collection, passed.floors, sums, quantity)
    cells = tuple(
        _cell(
            key,
            level,
            {at: cell for at, cell in of_levels.items() if at in members},
            floors[key],
            ddof,
            seed,
            quantity,
            collection.in_counts,
        )
        for level, members in _pools(sums.values())[: None if quantity == OF_ALL else 1]
        for key, of_levels in sums.items()
        if not of_levels.keys().isdisjoint(members)
    )
    variances = {(at, key): cell.variance(ddof) for key, of_levels in sums.items() for at, cell in of_levels.items()}
    return VarianceResult(
        collection=collection,
        protocol=protocol,
        feature=used,
        ddof=ddof,
        seed=seed,
        cells=cells,
        components=tuple(_components(passed.places, sums, seed)),
        matrices=tuple(
            texture_matrices(
                passed.places,
                variances,
                combinations=collection.combinations,
                textures=collection.textures,
                ddof=ddof,
            )
        ),
        tests=tuple(_tests(collection, sums, seed)),
        positions=_positions(collection, passed.places, ddof, quantity),
        maps={key: _map(*passed.maps[key], of_levels.values(), ddof) for key, of_levels in sums.items()},
        means={place: total / count for place, (total, count) in passed.means.items()},
        steps=_steps(passed.places, ddof) if collection.series else {},
        outside=_outside(collection, used),
        sums=sums,
        left_out=tuple(passed.left_out),
        passed=passed,
    )


def _outside(collection: Collection, feature: Feature) -> float | None:
    """Return the fraction of the pixels that do not show the sensor; None if its place in the images is not sure."""
    if feature.region is not None or feature.unit is not None or not collection.in_counts:
        return None
    try:
        region = found_region(collection.runs)
    except InputError:
        return None  # there are no images, or they show no region
    return region.outside if region.sureness >= SURE else None


def _summed(collection: Collection, places: Sequence[PlaceSums], quantity: int) -> Sums:
    """Return each cell's sums over positions. A position with one press has no variance and is left out."""
    sums: dict[CellKey, dict[int, CellSums]] = {}
    for key in product(collection.combinations, collection.textures):
        for place in places:
            cell = place.cells.get(key)
            if cell is not None and cell.presses > 1:
                of_levels = sums.setdefault(key, {})
                of_levels[place.level] = of_levels[place.level] + cell if place.level in of_levels else cell
    measured = {
        key: {level: cell for level, cell in of_levels.items() if cell.counts(quantity)}
        for key, of_levels in sums.items()
    }
    return {key: of_levels for key, of_levels in measured.items() if of_levels}


#: The noise floor of a cell by level, None for a level without one; and its source.
_CellFloor = tuple[Mapping[int, float | None], str]


def _floors(
    collection: Collection, frames: Mapping[int, tuple[float, int]], sums: Sums, quantity: int
) -> dict[CellKey, _CellFloor]:
    squares: dict[CellKey, float] = defaultdict(float)
    dof: dict[CellKey, int] = defaultdict(int)
    for run, (of_run, dof_of_run) in frames.items():
        printed = collection.runs[run].info.printed
        key = (printed.combination, printed.texture or UNKNOWN)
        squares[key] += of_run
        dof[key] += dof_of_run
    floors: dict[CellKey, _CellFloor] = {}
    for key, of_levels in sums.items():
        if key in dof:
            floors[key] = (dict.fromkeys(of_levels, squares[key] / dof[key]), FRAMES)
        elif quantity == OF_REPEATS:
            floors[key] = (dict.fromkeys(of_levels), "")  # the table itself shows the variance of the repeats
        else:
            # This is the variance between repeats on one print, pooled over prints and positions.
            repeats = {at: cell.within / cell.dof[1] if cell.dof[1] else None for at, cell in of_levels.items()}
            floors[key] = (repeats, REPEATS)
    return floors


def _cell(
    key: CellKey,
    level: Level,
    sums: Mapping[int, CellSums],
    floors: _CellFloor,
    ddof: int,
    seed: int,
    quantity: int,
    in_counts: bool,
) -> Cell:
    """Compute one cell of the table for one level, or for several levels whose figures are averaged."""
    combination, texture = key
    levels = list(sums.values())
    known = [floor for at in sums if (floor := floors[0][at]) is not None]
    floor = float(np.mean(known)) if len(known) == len(levels) else None
    whole = pooled(levels)
    interval = removed = None
    if whole is not None and whole.prints > 1:
        interval = variance_interval(whole, ddof=ddof, seed=seed, quantity=quantity)
        if floor is not None:
            removed = variance_interval(whole, ddof=1, floor=floor, seed=seed, quantity=quantity)
    # ``weights`` contains the fraction of a repeat's variance in the figure, summed over positions; it is 1 for ddof 1.
    weights = [sums.weights[quantity, 0, 1] / sums.counts(quantity) for sums in levels]
    of_noise = 1.0 if ddof else float(np.mean(weights))
    unbiased = float(np.mean([level.variance(1, quantity) for level in levels]))
    parts = parts_of(combination)
    published = (
        variance_of(parts["printer"], parts["filament"], texture) if quantity == OF_REPEATS and in_counts else None
    )
    return Cell(
        **parts,
        texture=texture,
        force_level=level,
        variance=float(np.mean([level.variance(ddof, quantity) for level in levels])),
        floor=floor,
        low=interval.low if interval else None,
        high=interval.high if interval else None,
        prints=max(level.prints for level in levels),
        presses=sum(level.presses for level in levels),
        noise_alone=None if floor is None else floor * of_noise,
        floor_from="" if floor is None else floors[1],
        unbiased=unbiased,
        floor_removed=None if floor is None else unbiased - floor,
        floor_removed_low=removed.low if removed else None,
        floor_removed_high=removed.high if removed else None,
        quantity=get_args(Quantity)[quantity],
        published=published,
    )


def pooled(levels: Sequence[CellSums]) -> CellSums | None:
    """Add the sums of several force levels; return None if the levels have different prints or repeats."""
    if any(not np.array_equal(level.design, levels[0].design) for level in levels):
        return None
    return reduce(operator.add, levels)


def _pools(levels: Iterable[Iterable[int]]) -> list[tuple[Level, list[int]]]:
    """Return each level alone, then all levels together."""
    each = sorted(set(chain.from_iterable(levels)))
    return [*((level, [level]) for level in each), (ALL_LEVELS, each)]


def _components(places: Sequence[PlaceSums], sums: Sums, seed: int) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = []
    for level, members in _pools([place.level] for place in places):
        nested = reduce(operator.add, [place.nested for place in places if place.level in members])
        there = ([cell for at, cell in sums[key].items() if at in members] for key in sorted(sums))
        cells = [pooled(cells) for cells in there if cells]
        rows += component_rows(level, components(nested), _component_intervals(cells, seed))
    return rows


def _component_intervals(cells: Sequence[CellSums | None], seed: int) -> dict[str, tuple[float, float]]:
    """Return the intervals of the components of prints and of repeats; empty if the design does not allow them."""
    usable = [cell for cell in cells if cell is not None and cell.prints > 1]
    if any(cell is None for cell in cells) or not sum(cell.dof[1] for cell in usable):
        return {}
    intervals = {name: component_interval(usable, name, seed=seed) for name in ("print", "repeat")}
    return {name: (interval.low, interval.high) for name, interval in intervals.items()}


def _tests(collection: Collection, sums: Sums, seed: int) -> list[PrinterTest]:
    tests: list[PrinterTest] = []
    for level, members in _pools(sums.values()):
        grams: dict[CellKey, Floats] = {}
        for key, of_levels in sums.items():
            there = [cell for at, cell in of_levels.items() if at in members]
            whole = pooled(there) if len(there) == len(members) else None
            if whole is not None and whole.prints > 1 and whole.whole:
                grams[key] = whole.print_gram()
        of_level: list[tuple[str, str, PermutationTest]] = []
        for first, second in combinations(collection.combinations, 2):
            shared = [t for t in collection.textures if (first, t) in grams and (second, t) in grams]
            if shared:
                pair = ([grams[combination, t] for t in shared] for combination in (first, second))
                of_level.append((first, second, dispersion_test(*pair, seed=seed)))
        adjusted = holm([test.p for *_, test in of_level])
        tests += [
            PrinterTest(force_level=level, first=first, second=second, outcome=test, p_holm=p)
            for (first, second, test), p in zip(of_level, adjusted, strict=True)
        ]
    return tests


def holm(values: Sequence[float]) -> list[float]:
    """Adjust values of p for their number (Holm 1979).

    If none of the differences exist, an adjusted value is below 5 % in at most 5 % of all studies.
    """
    adjusted, highest = [0.0] * len(values), 0.0
    for rank, i in enumerate(sorted(range(len(values)), key=lambda i: values[i])):
        highest = max(highest, min(1.0, (len(values) - rank) * values[i]))
        adjusted[i] = highest
    return adjusted


def _positions(
    collection: Collection, places: Sequence[PlaceSums], ddof: int, quantity: int
) -> dict[tuple[int, CellKey], Floats]:
    count = len(collection.pressing.positions_mm)
    positions: dict[tuple[int, CellKey], Floats] = {}
    for place in places:
        for key, cell in place.cells.items():
            if cell.presses > 1 and cell.counts(quantity):
                row = positions.setdefault((place.level, key), np.full(count, np.nan))
                row[place.position - 1] = cell.variance(ddof, quantity)
    return positions


def _steps(places: Sequence[PlaceSums], ddof: int) -> dict[tuple[int, CellKey], Floats]:
    """Return the variance of each cell at each time step, mean over pixels and positions."""
    steps: dict[tuple[int, CellKey], list[Floats]] = defaultdict(list)
    for place in places:
        for key, cell in place.cells.items():
            if cell.presses > 1:
                steps[place.level, key].append(place.steps[key] / (cell.presses - ddof))
    return {key: np.mean(of_places, axis=0) for key, of_places in steps.items()}


def _map(picture: Floats, count: int, levels: Iterable[CellSums], ddof: int) -> Floats:
    """Return the mean map of a cell. ``ddof`` scales all pixels by the same factor, as they have the same presses."""
    plain, unbiased = np.sum([level.variances[OF_ALL] for level in levels], axis=0)
    return picture / count * (unbiased / plain if ddof else 1.0)
