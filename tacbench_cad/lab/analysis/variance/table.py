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

import math
import operator
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import reduce
from itertools import chain, combinations, product
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pandas as pd
from sklearn.base import clone

from tacbench_cad.lab.analysis.conclusions import answer_table, print_answers
from tacbench_cad.lab.analysis.feature import Feature
from tacbench_cad.lab.analysis.pixels import Pixels, as_published
from tacbench_cad.lab.analysis.published import variance_of
from tacbench_cad.lab.analysis.study_design import Design, at_level
from tacbench_cad.lab.analysis.variance.between import between_textures
from tacbench_cad.lab.analysis.variance.cells import (
    ALL_LEVELS,
    CELL,
    FRAMES,
    REPEATS,
    CellKey,
    Level,
    Protocol,
    groups,
    parts_of,
    place_of,
)
from tacbench_cad.lab.analysis.variance.components import component_rows, components
from tacbench_cad.lab.analysis.variance.intervals import (
    OF_ALL,
    OF_REPEATS,
    CellSums,
    component_interval,
    pooled,
    variance_interval,
)
from tacbench_cad.lab.analysis.variance.permutation import dispersion_test
from tacbench_cad.lab.analysis.variance.registration import register as registered
from tacbench_cad.lab.analysis.variance.result import Variance
from tacbench_cad.lab.analysis.variance.streaming import PlaceSums, stream
from tacbench_cad.lab.parallel import workers
from tacbench_cad.lab.runs.press_table import STEP, TIME
from tacbench_cad.lab.runs.region import SURE
from tacbench_cad.lab.runs.region_search import found_region
from tacbench_cad.util.errors import InputError, one_of

#: The sums over positions, by cell in the study's order, then by level from low to high.
Sums = Mapping[CellKey, Mapping[int, CellSums]]

#: The samples of a variance, and the reason why there is no table, for each quantity of ``intervals``.
_QUANTITIES = ("prints and repeats", "repeats of one print")
_NOT_REPEATED = (
    "no position was pressed more than once; a variance needs a second repeat or a second print",
    "no print was pressed twice at one position; the published quantity is the variance over the repeats on a print",
)
#: The columns of ``permutation.csv``, which may have no row.
_TESTS = ("force_level", "first", "second", "textures", "prints_first", "prints_second", "ratio", "statistic", "p")


def variance(
    presses: pd.DataFrame,
    feature: Feature | None = None,
    *,
    protocol: Protocol = "paper",
    ddof: int = 0,
    seed: int = 0,
    register: bool = False,
    jobs: int = 1,
    dask: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Variance:
    """Compute the variance table of a study, with its components, matrices, tests and maps.

    Args:
        presses: The table of presses. If it has series, the variance is computed for each pixel of each frame of a
            series.
        feature: The feature, which is fitted to the presses; None for grey pixels at full size.
        protocol: ``paper`` for the variance over prints and repeats; ``as-published`` for the quantity that the paper
            printed: the variance over the repeats on one print at the lowest force level, for images at 40 % of their
            size, in grey without rounding, ``ddof`` 0.
        ddof: 0 as in the paper, or 1.
        seed: The seed of the intervals and permutations.
        register: Whether to separate differences in placement from differences in printing. This reads every frame
            three times.
        jobs: The number of worker processes on this machine.
        dask: The address of a Dask scheduler, whose workers are then used instead.
        progress: Receives progress updates: the number of frames done and their total number.

    Raises:
        InputError: The position or the print of the presses is unknown, no position was pressed more than once, or a
            setting is not allowed.
    """
    if ddof not in (0, 1):
        raise InputError("ddof", ddof, "must be 0 or 1")
    if seed < 0:
        raise InputError("seed", seed, "must be 0 or more")
    one_of("protocol", protocol, get_args(Protocol))
    design, quantity = Design.of(presses), OF_ALL
    design.require("the variance", "position", "print or repeat")
    if protocol == "as-published":
        if feature is not None or ddof or register or design.steps:
            raise InputError(
                "protocol",
                protocol,
                "has fixed settings: grey images at 40 % of their size and ddof 0; leave out the other settings",
            )
        design.require("the published quantity", "print")
        feature, quantity = as_published(), OF_REPEATS
        design = Design.of(at_level(presses, design.levels[0]))
    fitted: Feature = clone(feature or Pixels()).fit(design.presses)
    with workers(jobs, dask, [Path(folder) for folder in design.presses["folder"].dropna().unique()]) as executor:
        seatings = registered(design, fitted, executor, ddof=ddof) if register else None
        passed = stream(design, fitted, executor, progress)
    sums = _summed(design, passed.places, quantity)
    if not sums:
        raise InputError("presses", 1, _NOT_REPEATED[quantity])
    tables = {
        "variance": _table(sums, passed.floors, ddof, seed, quantity, design.in_counts),
        "positions": _positions(design, passed.places, ddof, quantity),
    }
    if protocol == "paper":
        tests = pd.DataFrame(_tests(design, sums, seed), columns=[*_TESTS, "p_holm", "least_p"])
        answers = print_answers(sums, passed.places, tests, known=design.has("print"), seed=seed)
        tables = {
            "printer_answers": answer_table(answers),
            **tables,
            "components": pd.DataFrame(_components(passed.places, sums, seed)).astype({"degrees_of_freedom": "Int64"}),
            "between_textures": between_textures(passed.places, design.combinations, ddof),
            "print_distances": pd.DataFrame(_print_distances(sums), columns=[*CELL, "copy", "from_others"]),
            "permutation": tests,
        }
    if seatings is not None:
        tables["registration"] = seatings
    if design.steps:
        tables["motion"] = _motion(design, passed.places, ddof)
    if fitted.exhibit is not None:
        means = [fitted.exhibit.table(mean).assign(**place_of(*at)) for at, mean in passed.means.items()]
        exhibited = pd.concat(means)
        tables[fitted.exhibit.name] = exhibited[[*CELL, *exhibited.columns.drop(list(CELL))]]
    return Variance(
        design=design,
        feature=fitted,
        protocol=protocol,
        ddof=ddof,
        seed=seed,
        tables=tables,
        maps={key: passed.maps[key] * _rescaled(of_levels.values(), ddof) for key, of_levels in sums.items()},
        means=passed.means,
        outside=_outside(design, fitted),
        left_out=tuple(passed.left_out),
    )


def _outside(design: Design, feature: Feature) -> float | None:
    """Return the fraction of the pixels that do not show the sensor; None if its place in the images is not sure."""
    if feature.region_ is not None or feature.unit is not None or not (design.in_counts and design.runs):
        return None
    try:
        region = found_region(design.runs)
    except InputError:
        return None  # there are no images, or they show no region
    return region.outside if region.sureness >= SURE else None


def _summed(design: Design, places: Sequence[PlaceSums], quantity: int) -> Sums:
    """Return each cell's sums over positions. A position with one press has no variance and is left out."""
    sums: dict[CellKey, dict[int, CellSums]] = {}
    for key in product(design.combinations, design.textures):
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


def _pools(levels: Iterable[Iterable[int]]) -> list[tuple[Level, list[int]]]:
    """Return each level alone, then all levels together."""
    each = sorted(set(chain.from_iterable(levels)))
    return [*((level, [level]) for level in each), (ALL_LEVELS, each)]


def _table(
    sums: Sums, floors: Mapping[CellKey, float], ddof: int, seed: int, quantity: int, in_counts: bool
) -> pd.DataFrame:
    """Return ``variance.csv``, by level (``all`` last), combination and texture."""
    rows = []
    for level, members in _pools(sums.values())[: None if quantity == OF_ALL else 1]:
        for key, of_levels in sums.items():
            cells = [cell for at, cell in of_levels.items() if at in members]
            if cells:
                parts = parts_of(key[0])
                figure = (
                    variance_of(parts["printer"], parts["filament"], key[1])
                    if quantity == OF_REPEATS and in_counts
                    else None
                )
                numbers = _numbers(cells, floors.get(key), ddof, seed, quantity)
                others = {"quantity": _QUANTITIES[quantity], "published": math.nan if figure is None else figure}
                rows.append({**place_of(level, key), **numbers, **others})
    return pd.DataFrame(rows).astype({"force_level": object})


def _numbers(
    levels: Sequence[CellSums], measured: float | None, ddof: int, seed: int, quantity: int
) -> dict[str, float | str]:
    """Return the numbers of one cell, for one level or for several levels whose figures are averaged.

    Args:
        levels: The sums of the cell at each level.
        measured: The noise of the stationary frames; None if there are none.
        ddof: See :func:`variance`.
        seed: See :func:`variance`.
        quantity: The quantity of the table.
    """
    if measured is None and quantity == OF_ALL and all(level.dof[1] for level in levels):
        # This is the variance between repeats on one print, pooled over prints and positions.
        floor, floor_from = float(np.mean([level.within / level.dof[1] for level in levels])), REPEATS
    else:
        # The table of the published quantity itself shows the variance of the repeats.
        floor, floor_from = (math.nan, "") if measured is None else (measured, FRAMES)
    whole = pooled(levels)
    ends = removed = (math.nan, math.nan)
    if whole is not None and whole.prints > 1:
        ends = variance_interval(whole, ddof=ddof, seed=seed, quantity=quantity).ends
        if floor_from:
            removed = variance_interval(whole, ddof=1, floor=floor, seed=seed, quantity=quantity).ends
    # ``weights`` contains the fraction of a repeat's variance in the figure, summed over positions; it is 1 for ddof 1.
    of_noise = 1.0 if ddof else np.mean([cell.weights[quantity, 0, 1] / cell.counts(quantity) for cell in levels])
    unbiased = float(np.mean([level.variance(1, quantity) for level in levels]))
    return {
        "variance": float(np.mean([level.variance(ddof, quantity) for level in levels])),
        **dict(zip(("low", "high"), ends, strict=True)),
        "floor": floor,
        "floor_from": floor_from,
        "noise_alone": floor * float(of_noise),
        "unbiased": unbiased,
        "floor_removed": unbiased - floor,
        **dict(zip(("floor_removed_low", "floor_removed_high"), removed, strict=True)),
        "prints": max(level.prints for level in levels),
        "presses": sum(level.presses for level in levels),
    }


def _components(places: Sequence[PlaceSums], sums: Sums, seed: int) -> Iterator[dict[str, Any]]:
    """Yield the rows of ``components.csv``."""
    for level, members in _pools([place.level] for place in places):
        nested = reduce(operator.add, [place.nested for place in places if place.level in members])
        there = ([cell for at, cell in sums[key].items() if at in members] for key in sorted(sums))
        cells = [pooled(cells) for cells in there if cells]
        yield from component_rows(level, components(nested), _component_intervals(cells, seed))


def _component_intervals(cells: Sequence[CellSums | None], seed: int) -> dict[str, tuple[float, float]]:
    """Return the intervals of the components of prints and of repeats; empty if the design does not allow them."""
    usable = [cell for cell in cells if cell is not None and cell.prints > 1]
    if any(cell is None for cell in cells) or not sum(cell.dof[1] for cell in usable):
        return {}
    return {name: component_interval(usable, name, seed=seed).ends for name in ("print", "repeat")}


def _tests(design: Design, sums: Sums, seed: int) -> Iterator[dict[str, Any]]:
    """Yield the rows of ``permutation.csv``: each pair of printer-filaments with two prints of the same texture."""
    for level, members in _pools(sums.values()):
        grams = {}
        for key, of_levels in sums.items():
            there = [cell for at, cell in of_levels.items() if at in members]
            whole = pooled(there) if len(there) == len(members) else None
            if whole is not None and whole.prints > 1 and whole.whole:
                grams[key] = whole.print_gram()
        rows = []
        for first, second in combinations(design.combinations, 2):
            shared = [t for t in design.textures if (first, t) in grams and (second, t) in grams]
            if shared:
                pair = ([grams[combination, t] for t in shared] for combination in (first, second))
                outcome = dispersion_test(*pair, seed=seed)
                rows.append({"force_level": level, "first": first, "second": second, **vars(outcome)})
        adjusted = holm([row["p"] for row in rows])
        yield from ({**row, "p_holm": p} for row, p in zip(rows, adjusted, strict=True))


def holm(values: Sequence[float]) -> list[float]:
    """Adjust values of p for their number (Holm 1979).

    If none of the differences exist, an adjusted value is below 5 % in at most 5 % of all studies.
    """
    adjusted, highest = [0.0] * len(values), 0.0
    for rank, i in enumerate(sorted(range(len(values)), key=lambda i: values[i])):
        highest = max(highest, min(1.0, (len(values) - rank) * values[i]))
        adjusted[i] = highest
    return adjusted


def _positions(design: Design, places: Sequence[PlaceSums], ddof: int, quantity: int) -> pd.DataFrame:
    """Return ``positions.csv``."""
    columns = [*CELL, "position", "x_mm", "y_mm", "variance"]
    rows = [
        (
            *(*place_of(place.level, key).values(), place.position),
            *design.positions_mm[place.position - 1].tolist(),
            cell.variance(ddof, quantity),
        )
        for place in places
        for key, cell in place.cells.items()
        if cell.presses > 1 and cell.counts(quantity)
    ]
    return pd.DataFrame(rows, columns=columns).sort_values([columns[3], *columns[:3], "position"], ignore_index=True)


def _print_distances(sums: Sums) -> Iterator[dict[str, Any]]:
    """Yield the rows of ``print_distances.csv``."""
    for key, of_levels in sums.items():
        for level, cell in of_levels.items():
            for copy, square in cell.from_others().items():
                yield {**place_of(level, key), "copy": copy, "from_others": square}


def _motion(design: Design, places: Sequence[PlaceSums], ddof: int) -> pd.DataFrame:
    """Return ``motion.csv``: the variance of each cell at each time step, mean over pixels and positions."""
    presses, pose, columns = design.presses, ["pose_x", "pose_y", "pose_z"], ["level", "combination", "texture"]
    moved = presses[pose] - presses.groupby(["run", "press"])[pose].transform("first")
    presses = presses.assign(distance_mm=np.linalg.norm(moved, axis=1))
    tables = []
    for (level, combination, texture), of_cell in groups(presses.sort_values(columns, kind="stable"), columns):
        key = (combination, texture)
        values = [
            place.steps[key] / (place.cells[key].presses - ddof)
            for place in places
            if place.level == level and key in place.cells and place.cells[key].presses > 1
        ]
        if values:
            course = of_cell.groupby(STEP)[[TIME, "distance_mm"]].mean().rename_axis("frame").reset_index()
            tables.append(course.assign(**place_of(level, key), variance=np.mean(values, axis=0)))
    return pd.concat(tables)[[*CELL, "frame", TIME, "distance_mm", "variance"]]


def _rescaled(levels: Iterable[CellSums], ddof: int) -> float:
    """Return the factor from variances for ddof 0 to those for ``ddof``, equal for all pixels of a cell's map."""
    plain, unbiased = np.sum([level.variances[OF_ALL] for level in levels], axis=0)
    return unbiased / plain if ddof else 1.0
