"""``tacbench grade``: a printer beside the published ones."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from tacbench_cad.cli import options
from tacbench_cad.cli.common import print_json, print_lines, show_table


@options.command("grade")
@options.runs
@options.option("--force-level", options.LEVEL, "Force level to compare; all: the mean over the levels.", default="all")
@options.option("--jobs", options.JOBS, "Processes at once.", default="1", panel=options.WORK)
@options.json
def command(runs: tuple[Path, ...], force_level: int | Literal["all"], jobs: int, json: bool) -> None:
    """Is my print good enough to compare with the published ones? The printer beside the paper's variance table.

    For each texture: the variance between readings of different prints, the noise floor in the same unit, its interval
    with prints as the unit, and whether that is less or more than each published figure or cannot be told apart from
    it. Then a verdict for each published printer, and the reasons that limit it.

    Examples:
      tacbench grade runs/
      tacbench grade runs/ --force-level 2
      tacbench grade runs/*ender-3_pla-plus* --json
    """
    from tacbench_cad.lab.analysis.collection import Collection
    from tacbench_cad.lab.analysis.preprocess import Preprocess
    from tacbench_cad.lab.analysis.variance.grade import grade
    from tacbench_cad.lab.analysis.variance.table import variance_table
    from tacbench_cad.util.convert import to_plain

    collection = Collection.open(runs)
    result = variance_table(collection, Preprocess(), ddof=0, jobs=jobs)
    grades = grade(result.cells, collection, force_level, result.left_out)
    if json:
        document = {"simulated": list(collection.simulated), "units": collection.units}
        print_json({**document, "grades": to_plain(grades)})
        return
    for each in grades:
        show_table(each.table)
        for head, lines in (("Verdicts", [verdict.text for verdict in each.verdicts]), ("Limits", each.limits)):
            print_lines(f"{head}:", *(f"  - {line}" for line in lines))
        print_lines("")
