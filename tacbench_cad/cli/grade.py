"""``tacbench grade``: a printer beside the published ones."""

from __future__ import annotations

from pathlib import Path

from tacbench_cad.cli import options
from tacbench_cad.cli.common import print_json, print_lines, show_table


@options.command("grade")
@options.runs
@options.option("--force-level", options.COUNT, "Force level to compare. Default: the lowest, as the paper's.")
@options.option("--jobs", options.JOBS, "Processes at once.", default="1", panel=options.WORK)
@options.json
def command(runs: tuple[Path, ...], force_level: int | None, jobs: int, json: bool) -> None:
    """Do my prints repeat as well as the published ones? The printer beside the paper's variance table.

    The paper's table is the variance over the repeats on one print, so this is computed from the runs in the same way
    (tacbench variance --protocol as-published). For each texture: that variance, what noise alone would give, its
    interval with prints as the unit, and whether it is less or more than each published figure or cannot be told apart
    from it. Then a verdict for each published printer, and the reasons that limit it.

    Examples:
      tacbench grade runs/
      tacbench grade runs/ --force-level 2
      tacbench grade runs/*ender-3_pla-plus* --json
    """
    from tacbench_cad.lab.analysis.collection import Collection
    from tacbench_cad.lab.analysis.variance.grade import grade
    from tacbench_cad.lab.analysis.variance.table import variance_table
    from tacbench_cad.util.convert import to_plain

    collection = Collection.open(runs)
    if force_level is not None:
        collection = collection.at_level(force_level)
    result = variance_table(collection, protocol="as-published", jobs=jobs)
    grades = grade(result.cells, collection, result.left_out)
    if json:
        document = {"simulated": list(collection.simulated), "units": collection.units}
        print_json({**document, "grades": to_plain(grades)})
        return
    for each in grades:
        show_table(each.table)
        for head, lines in (("Verdicts", [verdict.text for verdict in each.verdicts]), ("Limits", each.limits)):
            print_lines(f"{head}:", *(f"  - {line}" for line in lines))
        print_lines("")
