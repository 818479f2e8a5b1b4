"""``tacbench variance``: how well it printed, the paper's table with what a reviewer would ask for beside it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tacbench_cad.cli.common import Dask, Jobs, console, jobs_of, note, print_json, print_simulated, table, whole_of
from tacbench_cad.cli.progress import ProgressLine
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import counted

if TYPE_CHECKING:
    from tacbench_cad.lab.analysis.variance.cells import Cell
    from tacbench_cad.lab.analysis.variance.registration import Seating
    from tacbench_cad.lab.analysis.variance.table import FloorRemoved, Level, VarianceResult

NAME = "variance"


def command(
    runs: Annotated[
        list[Path],
        typer.Argument(metavar="RUNS", help="Run folders, or folders that hold some.", show_default=False),
    ],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="DIR", help="Folder for tables (CSV) and figures (PNG, PDF).")
    ] = None,
    colour: Annotated[bool, typer.Option("--colour", help="Keep the colours; else BT.601 grey.")] = False,
    ddof: Annotated[str, typer.Option(metavar="0|1", help="Divide by n (0, as the paper's NumPy) or n - 1.")] = "0",
    register: Annotated[
        bool, typer.Option("--register", help="Tell how a block lay apart from how it printed; reads all thrice.")
    ] = False,
    seed: Annotated[str, typer.Option(metavar="N", help="Seed of intervals and permutation tests.")] = "0",
    jobs: Jobs = None,
    dask: Dask = None,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON document.")] = False,
) -> None:
    """The paper's variance table: each pixel's variance over prints and repeats, mean over pixels and positions.

    For each printer-filament and texture, at each force and as the mean of the forces. Under each row: what the
    sensor's noise alone gives in this table (from the stationary frames in contact; without any, from repeats on one
    print, which is only an upper bound), the 95 % interval with prints as its unit, the estimate with the noise floor
    removed (ddof 1), and the paper's own figures where it has some. Then variance components with ISO 5725 limits, and
    permutation tests between printers. A reading that cannot be used is named and left out; the exit code is then 1.

    Examples:
      tacbench variance runs -o results
      tacbench variance runs --register --jobs 4
      tacbench variance runs --colour --ddof 1 --json
    """
    from tacbench_cad.lab.analysis.collection import Collection
    from tacbench_cad.lab.analysis.preprocess import Preprocess
    from tacbench_cad.lab.analysis.variance.files import write_all
    from tacbench_cad.lab.analysis.variance.registration import register as seats
    from tacbench_cad.lab.analysis.variance.table import variance_table
    from tacbench_cad.util.files import locked

    divisor, number = whole_of("ddof", ddof), whole_of("seed", seed)
    if divisor not in (0, 1):
        raise InputError("ddof", divisor, "allowed: 0, 1")
    if number < 0:
        raise InputError("seed", number, "must be 0 or more")
    count = jobs_of(jobs)
    collection, preprocess = Collection.open(runs), Preprocess(colour=colour)
    if out is not None:
        with locked(out):  # a folder that cannot be written is refused before the work, not after it
            pass
    with ProgressLine() as progress:
        seatings: tuple[Seating, ...] = ()

        def readings(done: int, total: int) -> None:
            progress.show("readings", done, total)

        if register:
            progress.say("registering")
            seatings = seats(collection, preprocess, ddof=divisor, jobs=count, dask=dask)
        result = variance_table(
            collection,
            preprocess,
            ddof=divisor,
            jobs=count,
            dask=dask,
            seed=number,
            progress=readings,
        )
    files = [] if out is None else write_all(result, out, seatings)
    if json:
        print_json(_document(result, seatings, files))
    else:
        _print(result, seatings)
        if out is not None:
            typer.echo(f"{counted(len(files), 'file')} in {out}")
    for line in result.left_out:
        note(f"error: left out: {line}")
    if result.left_out:
        raise typer.Exit(1)


def _print(result: VarianceResult, seatings: Sequence[Seating]) -> None:
    from tacbench_cad.lab.analysis.published import FLOOR, FLOOR_READINGS
    from tacbench_cad.lab.analysis.variance.figures import shown_levels

    screen = console()
    print_simulated(screen, result.collection.simulated)
    for level in shown_levels(result):
        _print_level(result, level)
    screen.print(
        "Noise alone: what the table would show if a cell's readings differed by the sensor's noise only"
        f"{_source(result)}. Interval: prints are its unit. Floor removed: variance with ddof 1 less the floor.",
        soft_wrap=True,
    )
    if result.collection.units == "counts":
        readings = ", ".join(f"{value:.3g} counts^2 if it is a {what}" for what, value in FLOOR_READINGS.items())
        screen.print(
            f"The paper gives a stationary sensor's average pixel variation as {FLOOR:g}, without a unit: {readings}. "
            "It says neither grey or colour, nor which force, nor ddof.",
            soft_wrap=True,
        )
    _print_components(result)
    _print_tests(result)
    if seatings:
        _print_seatings(result, seatings)
    for line in result.warnings:
        screen.print(f"warning: {line}", soft_wrap=True)


def _source(result: VarianceResult) -> str:
    """Where the floors come from, in words."""
    from tacbench_cad.lab.analysis.variance.notes import FRAMES, REPEATS

    sources = sorted({one.floor_from for one in result.removed if one.floor_from})
    words = {
        FRAMES: "stationary frames in contact, at the middle force",
        REPEATS: "repeats on one print, an upper bound",
    }
    return f" ({'; or '.join(words[one] for one in sources)})" if sources else ""


def _print_level(result: VarianceResult, level: Level) -> None:
    from tacbench_cad.lab.analysis.published import VARIANCE
    from tacbench_cad.lab.analysis.variance.figures import level_name, name_of, short_texture
    from tacbench_cad.lab.analysis.variance.notes import REPEATS

    collection = result.collection
    textures = [short_texture(one) for one in collection.textures]
    kind = f"; {'colour' if result.preprocess.colour else 'grey'}, full size" if collection.units == "counts" else ""
    made = table(
        f"variance, {level_name(result, level)} ({_unit(result)}{kind}, ddof {result.ddof})",
        *("printer, filament", "", *textures, "prints", "presses"),
        right=(*textures, "prints", "presses"),
    )
    decimals = _decimals([one.variance for one in result.cells if one.force_level == level])
    removed = {(one.cell.force_level, one.cell.combination, one.cell.texture): one for one in result.removed}
    for combination in collection.combinations:
        rows = [removed.get((level, combination, texture)) for texture in collection.textures]
        there = [one for one in rows if one is not None]
        if not there:
            continue
        cells = [None if one is None else one.cell for one in rows]
        made.add_row(
            name_of(combination),
            "variance",
            *(_number(None if one is None else one.variance, decimals) for one in cells),
            _range([one.cell.prints for one in there]),
            _range([one.cell.presses for one in there]),
        )
        bound = "at most " if any(one.floor_from == REPEATS for one in there) else ""
        for label, values in (
            (f"noise alone: {bound}".rstrip(": "), [None if one is None else result.noise_alone(one) for one in cells]),
            ("floor removed (ddof 1)", [None if one is None else one.removed for one in rows]),
        ):
            if any(value is not None for value in values):
                made.add_row("", label, *(_number(value, decimals) for value in values), "", "")
        if any(one is not None and one.low is not None for one in cells):
            made.add_row("", "95 % interval", *(_interval(one) for one in cells), "", "")
        printer, filament = combination.split("_", 1)
        paper = VARIANCE.get((printer, filament))
        if paper is not None and collection.units == "counts":
            made.add_row("", "the paper", *(_published(paper, texture) for texture in textures), "", "")
    console().print(made)


def _published(paper: Sequence[float], texture: str) -> str:
    """The paper's figure of a texture, as it is printed there; empty for a user's own texture."""
    return f"{paper[int(texture) - 1]:g}" if texture.isdigit() and 1 <= int(texture) <= len(paper) else ""


def _unit(result: VarianceResult) -> str:
    units = result.collection.units
    return f"{units}^2" if units.isalnum() else f"({units})^2"


def _number(value: float | None, decimals: int) -> str:
    """A number with so many decimals, without a minus where they are all 0."""
    return "" if value is None else f"{round(value, decimals) + 0.0:.{decimals}f}"


def _decimals(values: Sequence[float]) -> int:
    """Decimals that give the largest value three digits."""
    most = max(values)
    return 2 if most <= 0.0 else min(12, max(0, 2 - math.floor(math.log10(most))))


def _interval(cell: Cell | None) -> str:
    if cell is None or cell.low is None or cell.high is None:
        return ""
    return f"{cell.low:.3g} to {cell.high:.3g}" if cell.high < 1000.0 else f"{cell.low:.3g} up"


def _range(values: Sequence[int]) -> str:
    low, high = min(values), max(values)
    return f"{low:,}" if low == high else f"{low:,} to {high:,}"


def _print_components(result: VarianceResult) -> None:
    from tacbench_cad.lab.analysis.variance.components import LEVELS, LIMIT_FACTOR
    from tacbench_cad.lab.analysis.variance.figures import level_name, shown_levels

    levels = shown_levels(result)
    heads = [level_name(result, one) for one in levels]
    made = table(
        f"variance components of the nested design ({_unit(result)}, unbiased) and ISO 5725", "", *heads, right=heads
    )
    rows = {(one["force_level"], one["component"]): one for one in result.components}
    names = {
        "texture": "texture",
        "printer": "printer-filament",
        "print": "print",
        "repeat": "repeat on one print",
    }
    for name in LEVELS:
        made.add_row(names[name], *(_component(rows[level, name]) for level in levels))
    units = result.collection.units
    for name in ("repeatability", "intermediate", "reproducibility"):
        spreads = [rows[level, name]["variance"] for level in levels]
        shown = [
            "" if one is None else f"{math.sqrt(one):.3g} (limit {LIMIT_FACTOR * math.sqrt(one):.3g})"
            for one in spreads
        ]
        made.add_row(f"{name} s.d. ({units})", *shown)
    console().print(made)


def _component(row: dict[str, Any] | Any) -> str:
    if row["variance"] is None:
        return str(row["note"]) or "not estimated"
    text = f"{row['variance']:.3g}"
    if row["low"] is not None:
        text += f" ({row['low']:.3g} to {row['high']:.3g})"
    return text + (f", with {row['includes'].replace(' ', ', ')}" if row["includes"] else "")


def _print_tests(result: VarianceResult) -> None:
    from tacbench_cad.lab.analysis.variance.cells import ALL_LEVELS
    from tacbench_cad.lab.analysis.variance.figures import level_name, name_of

    if not result.tests:
        if len(result.collection.combinations) > 1:
            note("no permutation test between printers: it needs two printers with two prints of one texture each")
        return
    pooled = [one for one in result.tests if one.force_level == ALL_LEVELS]
    heads = ("prints", "variance ratio", "p", "p for all pairs", "least p possible")
    made = table(
        "do two printers vary alike from print to print? (permutation test, prints permuted)",
        *("force", "first", "second", *heads),
        right=heads,
    )
    for one in pooled or result.tests:
        outcome = one.outcome
        made.add_row(
            level_name(result, one.force_level),
            name_of(one.first),
            name_of(one.second),
            f"{outcome.prints[0]}, {outcome.prints[1]}",
            "" if outcome.ratio is None else f"{outcome.ratio:.3g}",
            f"{outcome.p:.3g}",
            f"{one.p_holm:.3g}",
            f"{outcome.least_p:.2g}",
        )
    console().print(made)


def _print_seatings(result: VarianceResult, seatings: Sequence[Seating]) -> None:
    from tacbench_cad.lab.analysis.variance.figures import level_name, name_of, short_texture

    heads = (f"variance ({_unit(result)})", "seating", "without seating", "largest offset x (mm)", "y (mm)")
    made = table(
        "registration: the part of the variance that blocks lying differently explain (ours, not the paper's)",
        *("force", "printer, filament", "texture", *heads),
        right=heads,
    )
    for one in seatings:
        made.add_row(
            level_name(result, one.force_level),
            name_of(f"{one.printer}_{one.filament}"),
            short_texture(one.texture),
            f"{one.variance:.3g}",
            f"{one.seating:.3g}",
            f"{one.remaining:.3g}",
            *(_largest([pair[axis] for pair in one.offsets_mm.values()]) for axis in (0, 1)),
        )
    console().print(made)


def _largest(offsets: Sequence[float | None]) -> str:
    seen = [abs(one) for one in offsets if one is not None]
    return f"{max(seen):.3f}" if seen else "not seen"


def _document(result: VarianceResult, seatings: Sequence[Seating], files: Sequence[Path]) -> dict[str, Any]:
    from tacbench_cad.lab.analysis.variance import files as variance_files

    return {
        "simulated": list(result.collection.simulated),
        "units": _unit(result),
        "grey": not result.preprocess.colour,
        "ddof": result.ddof,
        "variance": [_cell(one, result) for one in result.removed],
        "components": [dict(one) for one in result.components],
        "between_textures": list(variance_files.matrix_rows(result)),
        "permutation": list(variance_files.test_rows(result)),
        "registration": [row for one in seatings for row in one.rows()],
        "warnings": list(result.warnings),
        "left_out": list(result.left_out),
        "readings": result.passed.readings,
        "process_seconds": dict(result.passed.seconds),
        "files": [str(one) for one in files],
    }


def _cell(one: FloorRemoved, result: VarianceResult) -> dict[str, Any]:
    from dataclasses import asdict

    return {
        **asdict(one.cell),
        "noise_alone": result.noise_alone(one.cell),
        "floor_from": one.floor_from,
        "ddof_1": {"variance": one.variance, "floor_removed": one.removed, "low": one.low, "high": one.high},
    }
