"""How well it printed: the paper's variance table, with its noise floor, intervals, components and tests.

The table's figure V is the variance of each pixel over prints x repeats at each position, then the mean over pixels and
positions; ``all`` is the mean of the levels' figures. A print that came out differently, a press that landed elsewhere
and the sensor's own noise are all in it, so the noise floor stands beside it, in the same unit:

* from the stationary frames in contact (the sensor does not move between them), variance over the frames of a session
  with ddof 1, pooled over the runs of a cell. They are taken at the protocol's middle force and used for all levels;
* where there are none, from the repeats on one print. The sensor was lifted and pressed again between them, so this is
  an upper bound of the noise, and is named so.

The estimate with the floor removed is the variance with ddof 1 less the floor; it is unbiased and may be negative.

The figures that the paper printed are another quantity: the variance of the repeats on one print, then the mean over
prints, positions and pixels. With the protocol ``as-published`` V is that.
"""

from __future__ import annotations

import operator
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from itertools import chain, combinations, product
from typing import Any, Literal, get_args

import numpy as np

from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.preprocess import AS_PUBLISHED, Preprocess
from tacbench_cad.lab.analysis.published import variance_of
from tacbench_cad.lab.analysis.variance.between import TextureMatrix, texture_matrices
from tacbench_cad.lab.analysis.variance.cells import ALL_LEVELS, FRAMES, REPEATS, Cell, Level, Quantity, parts_of
from tacbench_cad.lab.analysis.variance.components import component_rows, components
from tacbench_cad.lab.analysis.variance.intervals import (
    OF_ALL,
    OF_REPEATS,
    CellSums,
    component_interval,
    variance_interval,
)
from tacbench_cad.lab.analysis.variance.permutation import PermutationTest, dispersion_test
from tacbench_cad.lab.analysis.variance.streaming import CellKey, Floor, Pass, PlaceSums, stream
from tacbench_cad.lab.parallel import workers
from tacbench_cad.lab.study.spec import UNKNOWN
from tacbench_cad.lab.vision.region import SURE
from tacbench_cad.lab.vision.resting import found_region
from tacbench_cad.util.errors import InputError, one_of
from tacbench_cad.util.types import Floats

#: Sums over positions by cell, in the study's order, and by level, rising.
_Sums = Mapping[CellKey, Mapping[int, CellSums]]

#: ``paper``: the variance of prints and repeats, as the text says; ``as-published``: what the printed figures are.
Protocol = Literal["paper", "as-published"]
#: Why there is no table, for each quantity.
_NOT_REPEATED = (
    "no place was pressed more than once; a variance needs a second repeat or a second print",
    "no print was pressed twice at one place; the published quantity is the variance over the repeats on a print",
)


@dataclass(frozen=True, kw_only=True)
class PrinterTest:
    """Whether two printer-filaments vary alike from print to print.

    Args:
        force_level: Level, or ``all``.
        first: Printer and filament.
        second: Likewise.
        outcome: The permutation test.
        p_holm: Its p, adjusted for all pairs of its level (Holm 1979).
    """

    force_level: Level
    first: str
    second: str
    outcome: PermutationTest
    p_holm: float


@dataclass(frozen=True, kw_only=True, eq=False)
class VarianceResult:
    """Everything that ``tacbench variance`` says.

    Args:
        collection: The study; with the protocol ``as-published`` its presses at one force level.
        protocol: Which quantity the table holds.
        preprocess: What was done to a reading first.
        ddof: 0 as in the paper, or 1.
        seed: Seed of intervals and permutations.
        cells: The table, by level (``all`` last), combination and texture.
        components: Rows of ``components.csv``.
        matrices: Between textures, by combination and level.
        tests: Permutation tests between printers, by level.
        positions: Variance at each position by level and cell, shape (positions,); NaN where there is none.
        maps: Variance of each pixel (ddof as the table), mean over positions and those levels at which the cell has
            the most prints, at a resolution for figures.
        fields: Mean displacement of each marker over positions, prints and repeats, by level and cell, shape (n, 2);
            empty for pixels.
        outside: Fraction of the pixels that lie outside of the sensor, where no region of interest leaves them out and
            it is sure; else None.
        sums: What intervals are made of, by cell and level.
        left_out: Readings that could not be used.
        passed: The pass over the readings: counts and times.
    """

    collection: Collection
    protocol: Protocol
    preprocess: Preprocess
    ddof: int
    seed: int
    cells: tuple[Cell, ...]
    components: tuple[Mapping[str, Any], ...]
    matrices: tuple[TextureMatrix, ...]
    tests: tuple[PrinterTest, ...]
    positions: Mapping[tuple[int, CellKey], Floats]
    maps: Mapping[CellKey, Floats]
    fields: Mapping[tuple[int, CellKey], Floats]
    outside: float | None
    sums: _Sums
    left_out: tuple[str, ...]
    passed: Pass

    def cell(self, level: Level, combination: str, texture: str) -> Cell | None:
        """A cell of the table, or None if there is no such one."""
        return self._by_key.get((level, combination, texture))

    @cached_property
    def _by_key(self) -> dict[tuple[Level, str, str], Cell]:
        return {(cell.force_level, cell.combination, cell.texture): cell for cell in self.cells}


def variance_table(
    collection: Collection,
    preprocess: Preprocess | None = None,
    *,
    protocol: Protocol = "paper",
    ddof: int = 0,
    jobs: int = 1,
    dask: str | None = None,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> VarianceResult:
    """The variance table of a study and everything beside it.

    Args:
        collection: The study.
        preprocess: What is done to a reading first; None for grey at full size.
        protocol: ``paper`` for the variance over prints and repeats; ``as-published`` for the quantity that the paper
            printed: the variance over the repeats on one print, at the lowest force level that there is, of images at
            40 % that were made grey and not rounded, ``ddof`` 0.
        ddof: 0 as in the paper, or 1.
        jobs: Processes of this machine.
        dask: Address of a Dask scheduler whose workers do the work instead.
        seed: Seed of intervals and permutations.
        progress: Called with the readings that were passed and with all of them.

    Raises:
        InputError: The place or the print of the presses is unknown, no place was pressed more than once, or a
            setting is not allowed.
    """
    if ddof not in (0, 1):
        raise InputError("ddof", ddof, "allowed: 0, 1")
    one_of("protocol", protocol, get_args(Protocol))
    collection.require("the variance", "position", "print or repeat")
    settings, quantity = preprocess or Preprocess(), OF_ALL
    if protocol == "as-published":
        if preprocess not in (None, AS_PUBLISHED) or ddof:
            raise InputError(
                "protocol", protocol, "has its own grey, resolution and ddof; leave out --colour and --ddof"
            )
        collection.require("the published quantity", "print")
        settings, quantity = AS_PUBLISHED, OF_REPEATS
        collection = collection.at_level(collection.levels[0])
    collection = replace(collection, features=settings.features)
    with workers(jobs, dask, [run.folder for run in collection.runs]) as executor:
        passed = stream(collection, settings, executor, progress)
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
        preprocess=settings,
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
        fields={place: (total / count).reshape(-1, 2) for place, (total, count) in passed.fields.items()},
        outside=_outside(collection, settings),
        sums=sums,
        left_out=tuple(passed.left_out),
        passed=passed,
    )


def _outside(collection: Collection, preprocess: Preprocess) -> float | None:
    """The fraction of the pixels in the table that do not show the sensor, if it is sure where that lies."""
    if preprocess.region is not None or not collection.in_counts:
        return None
    try:
        region = found_region(collection.runs)
    except InputError:
        return None  # no images, or nothing to be seen in them
    return region.outside if region.sureness >= SURE else None


def _summed(collection: Collection, places: Sequence[PlaceSums], quantity: int) -> _Sums:
    """Each cell's sums over positions. A place with one press says nothing of variance and is left out."""
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


#: Noise floor of a cell by level, None for a level without one; and where it comes from.
_CellFloor = tuple[Mapping[int, float | None], str]


def _floors(collection: Collection, frames: Sequence[Floor], sums: _Sums, quantity: int) -> dict[CellKey, _CellFloor]:
    squares: dict[CellKey, float] = defaultdict(float)
    dof: dict[CellKey, int] = defaultdict(int)
    for floor in frames:
        printed = collection.runs[floor.run].info.printed
        key = (printed.combination, printed.texture or UNKNOWN)
        squares[key] += floor.squares
        dof[key] += floor.dof
    floors: dict[CellKey, _CellFloor] = {}
    for key, of_levels in sums.items():
        if key in dof:
            floors[key] = (dict.fromkeys(of_levels, squares[key] / dof[key]), FRAMES)
        elif quantity == OF_REPEATS:
            floors[key] = (dict.fromkeys(of_levels), "")  # the repeats are what the table shows
        else:
            # Variance between repeats on one print, pooled over prints and positions.
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
    """One cell of the table: of one level, or of several whose figures are averaged."""
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
    # ``weights`` holds the fraction of a repeat's variance in the figure, summed over positions: 1 for ddof 1.
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
    """The sums of several force levels added up, or None where the levels have different prints or repeats."""
    if any(not np.array_equal(level.design, levels[0].design) for level in levels):
        return None
    return reduce(operator.add, levels)


def _pools(levels: Iterable[Iterable[int]]) -> list[tuple[Level, list[int]]]:
    """Each of the levels on its own, then all of them."""
    each = sorted(set(chain.from_iterable(levels)))
    return [*((level, [level]) for level in each), (ALL_LEVELS, each)]


def _components(places: Sequence[PlaceSums], sums: _Sums, seed: int) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = []
    for level, members in _pools([place.level] for place in places):
        nested = reduce(operator.add, [place.nested for place in places if place.level in members])
        there = ([cell for at, cell in sums[key].items() if at in members] for key in sorted(sums))
        cells = [pooled(cells) for cells in there if cells]
        rows += component_rows(level, components(nested), _component_intervals(cells, seed))
    return rows


def _component_intervals(cells: Sequence[CellSums | None], seed: int) -> dict[str, tuple[float, float]]:
    """Intervals of the components of prints and of repeats, where the design has some."""
    usable = [cell for cell in cells if cell is not None and cell.prints > 1]
    if any(cell is None for cell in cells) or not sum(cell.dof[1] for cell in usable):
        return {}
    intervals = {name: component_interval(usable, name, seed=seed) for name in ("print", "repeat")}
    return {name: (interval.low, interval.high) for name, interval in intervals.items()}


def _tests(collection: Collection, sums: _Sums, seed: int) -> list[PrinterTest]:
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
    """Values of p adjusted for their number: any of them below 5 % is wrong in 5 % of studies at most (Holm 1979)."""
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


def _map(picture: Floats, count: int, levels: Iterable[CellSums], ddof: int) -> Floats:
    """Mean map of a cell. ``ddof`` rescales it as a whole: all pixels have the same presses."""
    plain, unbiased = np.sum([level.variances[OF_ALL] for level in levels], axis=0)
    return picture / count * (unbiased / plain if ddof else 1.0)
