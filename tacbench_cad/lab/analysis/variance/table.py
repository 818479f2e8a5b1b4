"""How well it printed: the paper's variance table, with its noise floor, intervals, components and tests.

The table's figure V is the variance of each pixel over prints x repeats at each position, then the mean over pixels and
positions; ``all`` is the mean of the levels' figures. A print that came out differently, a press that landed elsewhere
and the sensor's own noise are all in it, so the noise floor stands beside it, in the same unit:

* from the stationary frames in contact (the sensor does not move between them), variance over the frames of a sitting
  with ddof 1, pooled over the runs of a cell. They are taken at the protocol's middle force and used for all levels;
* where there are none, from the repeats on one print. The sensor was lifted and pressed again between them, so this is
  an upper bound of the noise, and is named so.

The estimate with the floor removed is the variance with ddof 1 less the floor; it is unbiased and may be negative.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial, reduce
from typing import Any

import numpy as np

from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.preprocess import Preprocess
from tacbench_cad.lab.analysis.variance.between import TextureMatrix, texture_matrices
from tacbench_cad.lab.analysis.variance.cells import ALL_LEVELS, Cell
from tacbench_cad.lab.analysis.variance.components import component_rows, components
from tacbench_cad.lab.analysis.variance.intervals import CellSums, component_interval, variance_interval
from tacbench_cad.lab.analysis.variance.notes import FRAMES, REPEATS, variance_warnings
from tacbench_cad.lab.analysis.variance.permutation import PermutationTest, dispersion_test
from tacbench_cad.lab.analysis.variance.streaming import CellKey, Floor, Pass, PlaceSums, stream
from tacbench_cad.lab.parallel import workers
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats

Level = int | str

_NOT_REPEATED = "no place was pressed more than once; a variance needs a second repeat or a second print"

#: Heads of ``variance.csv``.
COLUMNS = (
    "printer",
    "filament",
    "texture",
    "force_level",
    "variance",
    "floor",
    "low",
    "high",
    "prints",
    "presses",
)


@dataclass(frozen=True, kw_only=True)
class FloorRemoved:
    """A cell's variance with the noise floor removed, all with ddof 1, in the reading's unit squared.

    Args:
        cell: The cell, as it stands in the table.
        floor_from: ``stationary frames``, ``repeats (upper bound)`` or empty.
        variance: Variance with ddof 1; None where it cannot be computed.
        removed: Variance less floor; may be negative. None without a floor.
        low: Lower end of its 95 % interval, None without one.
        high: Upper end.
    """

    cell: Cell
    floor_from: str
    variance: float | None
    removed: float | None
    low: float | None
    high: float | None


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
        collection: The study.
        preprocess: What was done to a reading first.
        ddof: 0 as in the paper, or 1.
        seed: Seed of intervals and permutations.
        cells: The table, by level (``all`` last), combination and texture.
        removed: The same cells with the floor removed.
        components: Rows of ``components.csv``.
        matrices: Between textures, by combination and level.
        tests: Permutation tests between printers, by level.
        positions: Variance at each position by level and cell, shape (positions,); NaN where there is none.
        maps: Variance of each pixel (ddof as the table), mean over positions and those levels at which the cell has
            the most prints, at a resolution for figures.
        sums: What intervals are made of, by level and cell.
        left_out: Readings that could not be used.
        warnings: What a reader must know, a sentence each.
        passed: The pass over the readings: counts and times.
    """

    collection: Collection
    preprocess: Preprocess
    ddof: int
    seed: int
    cells: tuple[Cell, ...]
    removed: tuple[FloorRemoved, ...]
    components: tuple[Mapping[str, Any], ...]
    matrices: tuple[TextureMatrix, ...]
    tests: tuple[PrinterTest, ...]
    positions: Mapping[tuple[int, CellKey], Floats]
    maps: Mapping[CellKey, Floats]
    sums: Mapping[tuple[int, CellKey], CellSums]
    left_out: tuple[str, ...]
    warnings: tuple[str, ...]
    passed: Pass

    @property
    def force_levels(self) -> tuple[Level, ...]:
        """The levels of the table in its order; ``all`` comes last."""
        return tuple(dict.fromkeys(one.force_level for one in self.cells))

    def cell(self, level: Level, combination: str, texture: str) -> Cell | None:
        """A cell of the table, or None if there is no such one.

        Args:
            level: Force level, or ``all``.
            combination: Printer and filament.
            texture: Name of the texture.
        """
        return self._by_key.get((level, combination, texture))

    def noise_alone(self, cell: Cell) -> float | None:
        """What the table's figure would be if all readings of a cell differed by noise only; None without a floor.

        With ddof 0 and n presses at a place it is (1 - 1/n) times the floor, which is for ddof 1.
        """
        if cell.floor is None or self.ddof:
            return cell.floor
        members = [
            self.sums[level, key]
            for level, key in self.sums
            if key == (cell.combination, cell.texture) and cell.force_level in (level, ALL_LEVELS)
        ]
        # ``weights`` holds the share of a repeat's variance in the figure, summed over positions.
        return cell.floor * float(np.mean([one.weights[0, 1] / one.positions for one in members]))

    @cached_property
    def _by_key(self) -> dict[tuple[Level, str, str], Cell]:
        return {(one.force_level, one.combination, one.texture): one for one in self.cells}


def variance_table(
    collection: Collection,
    preprocess: Preprocess | None = None,
    *,
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
        ddof: 0 as in the paper, or 1.
        jobs: Processes of this machine.
        dask: Address of a Dask scheduler whose workers do the work instead.
        seed: Seed of intervals and permutations.
        progress: Called with the readings that were passed and with all of them.

    Raises:
        InputError: No place was pressed more than once, or ``ddof`` is not 0 or 1.
    """
    if ddof not in (0, 1):
        raise InputError("ddof", ddof, "allowed: 0, 1")
    settings = preprocess or Preprocess()
    with workers(jobs, dask, [one.folder for one in collection.runs]) as team:
        passed = stream(collection, settings, team, progress)
        sums = _summed(passed.places)
        if not sums:
            raise InputError("presses", 1, _NOT_REPEATED)
        floors = _floors(collection, passed.floors, sums)
        tasks = [
            _CellTask(key=key, sums={level: sums[level, key] for level in _levels_of(sums, key)}, floor=floors[key])
            for key in _keys(collection, sums)
        ]
        rows = [one for of_cell in team.map(partial(_rows, ddof=ddof, seed=seed), tasks) for one in of_cell]
    levels = [level for level, _ in _pools({level for level, _ in sums})]
    rows.sort(key=lambda one: levels.index(one.cell.force_level))  # stable: combinations and textures keep their order
    cells = tuple(one.cell for one in rows)
    variances = {(level, key): one.variance(ddof) for (level, key), one in sums.items()}
    positions = _positions(collection, passed.places, ddof)
    return VarianceResult(
        collection=collection,
        preprocess=settings,
        ddof=ddof,
        seed=seed,
        cells=cells,
        removed=tuple(rows),
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
        positions=positions,
        maps={key: _map(passed, key, sums, ddof) for key in _keys(collection, sums)},
        sums=sums,
        left_out=passed.left_out,
        warnings=variance_warnings(collection, cells, {one.cell: one.floor_from for one in rows}, passed.left_out),
        passed=passed,
    )


def _summed(places: Sequence[PlaceSums]) -> dict[tuple[int, CellKey], CellSums]:
    """Each cell's sums over positions. A place with one press says nothing of variance and is left out."""
    parts: dict[tuple[int, CellKey], list[CellSums]] = {}
    for place in places:
        for key, one in place.cells.items():
            if one.presses > 1:
                parts.setdefault((place.level, key), []).append(one)
    return {key: reduce(operator.add, members) for key, members in parts.items()}


def _levels_of(sums: Mapping[tuple[int, CellKey], CellSums], key: CellKey) -> list[int]:
    return sorted(level for level, one in sums if one == key)


def _keys(collection: Collection, sums: Mapping[tuple[int, CellKey], CellSums]) -> list[CellKey]:
    there = {key for _, key in sums}
    return [(c, t) for c in collection.combinations for t in collection.textures if (c, t) in there]


@dataclass(frozen=True)
class _CellFloor:
    """Noise floor of a cell by level; ``None`` for a level without one."""

    by_level: Mapping[int, float | None]
    source: str


def _floors(
    collection: Collection, found: Sequence[Floor], sums: Mapping[tuple[int, CellKey], CellSums]
) -> dict[CellKey, _CellFloor]:
    squares: dict[CellKey, float] = {}
    dof: dict[CellKey, int] = {}
    for one in found:
        printed = collection.runs[one.run].info.printed
        key = (printed.combination, printed.texture)
        squares[key] = squares.get(key, 0.0) + one.squares
        dof[key] = dof.get(key, 0) + one.dof
    floors = {}
    for key in dict.fromkeys(key for _, key in sums):
        levels = _levels_of(sums, key)
        by_level: dict[int, float | None]
        if key in dof:
            by_level, source = dict.fromkeys(levels, squares[key] / dof[key]), FRAMES
        else:
            by_level = {level: _repeat_variance(sums[level, key]) for level in levels}
            source = REPEATS if any(value is not None for value in by_level.values()) else ""
        floors[key] = _CellFloor(by_level, source)
    return floors


def _repeat_variance(cell: CellSums) -> float | None:
    """Variance between repeats on one print, pooled over prints and positions; None with one repeat."""
    return cell.within / cell.dof[1] if cell.dof[1] else None


@dataclass(frozen=True, kw_only=True)
class _CellTask:
    """A cell at all its levels."""

    key: CellKey
    sums: Mapping[int, CellSums]
    floor: _CellFloor


def _rows(task: _CellTask, *, ddof: int, seed: int) -> list[FloorRemoved]:
    """A cell's rows: each level, then all."""
    rows = [
        _row(task, level, [one], task.floor.by_level[level], ddof=ddof, seed=seed) for level, one in task.sums.items()
    ]
    floors = [task.floor.by_level[level] for level in task.sums]
    known = [one for one in floors if one is not None]
    floor = float(np.mean(known)) if len(known) == len(floors) else None
    return [*rows, _row(task, ALL_LEVELS, list(task.sums.values()), floor, ddof=ddof, seed=seed)]


def _row(
    task: _CellTask, level: Level, levels: Sequence[CellSums], floor: float | None, *, ddof: int, seed: int
) -> FloorRemoved:
    """One row: of one level, or of several whose figures are averaged."""
    combination, texture = task.key
    printer, filament = combination.split("_", 1)
    whole = pooled(levels)
    plain = removed = None
    if whole is not None and whole.prints > 1:
        plain = variance_interval(whole, ddof=ddof, seed=seed)
        if floor is not None:
            removed = variance_interval(whole, ddof=1, floor=floor, seed=seed)
    one_less = float(np.mean([one.variance(1) for one in levels]))
    return FloorRemoved(
        cell=Cell(
            printer=printer,
            filament=filament,
            texture=texture,
            force_level=level,
            variance=float(np.mean([one.variance(ddof) for one in levels])),
            floor=floor,
            low=plain.low if plain else None,
            high=plain.high if plain else None,
            prints=max(one.prints for one in levels),
            presses=sum(one.presses for one in levels),
        ),
        floor_from=task.floor.source if floor is not None else "",
        variance=one_less,
        removed=None if floor is None else one_less - floor,
        low=removed.low if removed else None,
        high=removed.high if removed else None,
    )


def pooled(levels: Sequence[CellSums]) -> CellSums | None:
    """The sums of several force levels added up, or None where the levels have different prints or repeats."""
    if any(not np.array_equal(one.design, levels[0].design) for one in levels):
        return None
    return reduce(operator.add, levels)


def _pools(levels: set[int]) -> list[tuple[Level, list[int]]]:
    """Each level on its own, then all of them."""
    return [*((level, [level]) for level in sorted(levels)), (ALL_LEVELS, sorted(levels))]


def _components(
    places: Sequence[PlaceSums], sums: Mapping[tuple[int, CellKey], CellSums], seed: int
) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = []
    for level, wanted in _pools({place.level for place in places}):
        nested = reduce(operator.add, [place.nested for place in places if place.level in wanted])
        keys = dict.fromkeys(key for at, key in sums if at in wanted)
        cells = [pooled([sums[at, key] for at in _levels_of(sums, key) if at in wanted]) for key in keys]
        rows += component_rows(level, components(nested), _component_intervals(cells, seed))
    return rows


def _component_intervals(cells: Sequence[CellSums | None], seed: int) -> dict[str, tuple[float, float]]:
    """Intervals of the components of prints and of repeats, where the design has some."""
    usable = [one for one in cells if one is not None and one.prints > 1]
    if any(one is None for one in cells) or not sum(one.dof[1] for one in usable):
        return {}
    found = {name: component_interval(usable, name, seed=seed) for name in ("print", "repeat")}
    return {name: (one.low, one.high) for name, one in found.items()}


def _tests(collection: Collection, sums: Mapping[tuple[int, CellKey], CellSums], seed: int) -> list[PrinterTest]:
    found: list[PrinterTest] = []
    for level, wanted in _pools({level for level, _ in sums}):
        grams: dict[CellKey, Floats] = {}
        for key in _keys(collection, sums):
            there = [sums[at, key] for at in wanted if (at, key) in sums]
            whole = pooled(there) if len(there) == len(wanted) else None
            if whole is not None and whole.prints > 1 and whole.whole:
                grams[key] = whole.print_gram()
        of_level: list[tuple[str, str, PermutationTest]] = []
        for i, first in enumerate(collection.combinations):
            for second in collection.combinations[i + 1 :]:
                shared = [t for t in collection.textures if (first, t) in grams and (second, t) in grams]
                if shared:
                    test = dispersion_test(
                        [grams[first, t] for t in shared], [grams[second, t] for t in shared], seed=seed
                    )
                    of_level.append((first, second, test))
        adjusted = holm([test.p for *_, test in of_level])
        found += [
            PrinterTest(force_level=level, first=first, second=second, outcome=test, p_holm=p)
            for (first, second, test), p in zip(of_level, adjusted, strict=True)
        ]
    return found


def holm(values: Sequence[float]) -> list[float]:
    """Values of p adjusted for their number: any of them below 5 % is wrong in 5 % of studies at most (Holm 1979)."""
    adjusted, least = [0.0] * len(values), 0.0
    for rank, i in enumerate(sorted(range(len(values)), key=lambda i: values[i])):
        least = max(least, min(1.0, (len(values) - rank) * values[i]))
        adjusted[i] = least
    return adjusted


def _positions(collection: Collection, places: Sequence[PlaceSums], ddof: int) -> dict[tuple[int, CellKey], Floats]:
    count = len(collection.info.protocol.grid.positions_mm)
    found: dict[tuple[int, CellKey], Floats] = {}
    for place in places:
        for key, one in place.cells.items():
            if one.presses > 1:
                row = found.setdefault((place.level, key), np.full(count, np.nan))
                row[place.position - 1] = one.variance(ddof)
    return found


def _map(passed: Pass, key: CellKey, sums: Mapping[tuple[int, CellKey], CellSums], ddof: int) -> Floats:
    """Mean map of a cell. ``ddof`` rescales it as a whole: all pixels have the same presses."""
    picture, count = passed.maps[key]
    ratio = 1.0
    if ddof:
        members = [sums[level, key] for level in _levels_of(sums, key)]
        ratio = sum(one.variances[1] for one in members) / sum(one.variances[0] for one in members)
    return picture / count * ratio
