"""``tacbench grade``: a printer beside the published ones."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tacbench_cad.cli.common import console, jobs_of, print_json, table, whole_of

if TYPE_CHECKING:
    from tacbench_cad.lab.analysis.variance.grade import Compared, Grade

NAME = "grade"


def command(
    runs: Annotated[
        list[Path],
        typer.Argument(metavar="RUNS", help="Run folders, or folders that hold some.", show_default=False),
    ],
    force_level: Annotated[
        str, typer.Option(metavar="all|N", help="Force level to compare; all: the mean over the levels.")
    ] = "all",
    jobs: Annotated[str, typer.Option(metavar="N", help="Processes at once.")] = "1",
    json: Annotated[bool, typer.Option("--json", help="Print one JSON document.")] = False,
) -> None:
    """Is my print good enough to compare with the published ones? The printer beside the paper's variance table.

    For each texture: the variance between readings of different prints, the noise floor in the same unit, its interval
    with prints as the unit, and whether that is less or more than each published figure or cannot be told apart from
    it. Then in plain sentences what the data support and what they cannot.

    Examples:
      tacbench grade runs/
      tacbench grade runs/ --force-level 2
      tacbench grade runs/*ender-3_pla-plus* --json
    """
    from tacbench_cad.lab.analysis.collection import Collection
    from tacbench_cad.lab.analysis.preprocess import Preprocess
    from tacbench_cad.lab.analysis.variance.grade import grade
    from tacbench_cad.lab.analysis.variance.grade_limits import Context
    from tacbench_cad.lab.analysis.variance.table import variance_table

    level = force_level if force_level == "all" else whole_of("force-level", force_level)
    workers = jobs_of(jobs)
    collection = Collection.open(runs)
    result = variance_table(collection, Preprocess(), ddof=0, jobs=workers)
    context = Context.of(
        collection.info,
        floor_from=[one.floor_from for one in result.removed],
        simulated=collection.simulated,
        left_out=result.left_out,
    )
    grades = grade(result.cells, context, level)
    if json:
        print_json(
            {"simulated": list(context.simulated), "units": context.units, "grades": [g.as_dict() for g in grades]}
        )
        return
    for one in grades:
        _print(one, context.units)


def _print(grade: Grade, units: str) -> None:
    from tacbench_cad.lab.analysis.published import ROW_NAMES

    unit = f"{units}^2" if units.isalnum() else f"({units})^2"
    level = "mean over the forces" if grade.force_level == "all" else f"force level {grade.force_level}"
    numbers = ("texture", "prints", f"variance ({unit})", "95 % interval", "floor")
    shown = table(
        f"{grade.printer}, {grade.filament}: {level}; published figures with what yours is beside them",
        *numbers,
        *ROW_NAMES.values(),
        right=(*numbers, *ROW_NAMES.values()),
    )
    for one in grade.textures:
        shown.add_row(*_cells(one))
    screen = console()
    screen.print(shown)
    for head, sentences in (("What the data support", grade.supports), ("What they cannot", grade.limits)):
        screen.print(f"{head}:")
        for sentence in sentences:
            screen.print(f"  - {sentence}", soft_wrap=True)
    screen.print()


def _cells(one: Compared) -> list[str]:
    from tacbench_cad.lab.analysis.published import VARIANCE

    cell = one.cell
    interval = "none" if cell.low is None or cell.high is None else f"{cell.low:.3g} to {cell.high:.3g}"
    rows = [f"{values[one.number - 1]:.2f} {one.verdicts.get(row, '-')}" for row, values in VARIANCE.items()]
    floor = "none" if cell.floor is None else f"{cell.floor:.3g}"
    return [str(one.number), str(cell.prints), f"{cell.variance:.3g}", interval, floor, *rows]
