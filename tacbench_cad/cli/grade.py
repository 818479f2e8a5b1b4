"""``tacbench grade``: a printer beside the published ones."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tacbench_cad.cli.common import console, jobs_of, print_json, show_table, whole_of

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
    from tacbench_cad.util.convert import to_plain

    level = force_level if force_level == "all" else whole_of("force-level", force_level)
    workers = jobs_of(jobs)
    collection = Collection.open(runs)
    result = variance_table(collection, Preprocess(), ddof=0, jobs=workers)
    context = Context.of(collection, result.cells, result.left_out)
    grades = grade(result.cells, context, level)
    if json:
        document = {"simulated": list(context.simulated), "units": context.units}
        print_json({**document, "grades": [to_plain(one) for one in grades]})
        return
    screen = console()
    for one in grades:
        show_table(one.table)
        for head, lines in (("Verdicts", [verdict.text for verdict in one.verdicts]), ("Limits", one.limits)):
            screen.print(f"{head}:")
            for line in lines:
                screen.print(f"  - {line}", soft_wrap=True)
        screen.print()
