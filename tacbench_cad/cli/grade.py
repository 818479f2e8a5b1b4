"""``tacbench grade``: compare a printer with the published printers."""

from __future__ import annotations

from pathlib import Path

from tacbench_cad.cli import options
from tacbench_cad.cli.common import next_paths, print_json, print_lines, print_next, show_table


@options.command("grade", "Analyse")
@options.runs
@options.option(
    "--force-level", options.COUNT, "Force level to compare. Default: the lowest, as in the paper.", options.METHOD
)
@options.json
@options.jobs
def command(runs: tuple[Path, ...], force_level: int | None, jobs: int, json: bool) -> None:
    """Compare your printer with the published printers.

    The command compares how much repeated presses vary on your prints and on the published prints. The table of the
    paper has the variance over the repeats on one print. The command computes the same variance from your runs, as
    "tacbench variance --protocol as-published" does. For each texture it shows:
    - this variance, and its confidence interval, computed over prints
    - the variance that noise alone causes
    - whether your variance is smaller or larger than each published figure

    If the data cannot show a difference, the table says so. Below the table there is a verdict for each published
    printer, and a list of the limits of these verdicts.

    Examples:
      tacbench grade runs/
      tacbench grade runs/ --force-level 2
      tacbench grade runs/*ender-3_pla-plus* --json
    """
    from tacbench_cad.lab.analysis.study_design import at_level
    from tacbench_cad.lab.analysis.variance.grading import grade
    from tacbench_cad.lab.runs.press_table import read

    presses = read(runs)
    grades = grade(presses if force_level is None else at_level(presses, force_level), jobs=jobs)
    if json:
        print_json(grades.document())
        return
    for (_, shown), (printer, limits) in zip(grades.shown(), grades.limits.items(), strict=True):
        show_table(shown)
        for head, lines in (("Verdicts", grades.verdicts(printer)), ("Limits", limits)):
            print_lines(f"{head}:", *(f"  - {line}" for line in lines))
        print_lines("")
    print_next("classify", *next_paths(runs))
