"""``tacbench report``: one page on a study."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tacbench_cad.cli.common import Dask, Jobs, jobs_of, print_json
from tacbench_cad.cli.progress import ProgressLine
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import counted

NAME = "report"


def command(
    runs: Annotated[
        list[Path],
        typer.Argument(metavar="RUNS", help="Run folders, or folders that hold some.", show_default=False),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FILE.html", help="The page.")] = Path("report.html"),
    variance: Annotated[
        Path | None, typer.Option(metavar="DIR", help="What tacbench variance wrote. Default: computed.")
    ] = None,
    classify: Annotated[
        list[Path] | None,
        typer.Option(metavar="DIR", help="What tacbench classify wrote; may be given twice. Default: computed, sound."),
    ] = None,
    no_classify: Annotated[
        bool, typer.Option("--no-classify", help="Leave classification out; it takes most of the time.")
    ] = False,
    jobs: Jobs = None,
    dask: Dask = None,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON document.")] = False,
) -> None:
    """One self-contained page on a study, fit to be sent, printed and quoted.

    What was pressed on what, the print records and what is missing in them, data quality, the variance table with maps
    and matrices, the classification with its ladder and confusion matrices, and a methods paragraph with every
    parameter and the citations. report.html needs nothing else; beside it report_files/ has each figure as PNG and PDF
    and each table as CSV. Finished trials of a classification are kept there too: after an interruption the same
    command goes on. Simulated data are marked on every figure and table.

    Examples:
      tacbench report runs -o report.html
      tacbench report runs -o report.html --no-classify
      tacbench report runs --variance results --classify classification --classify paper-classification
    """
    from tacbench_cad.lab.analysis.report.page import Options, write_report

    if no_classify and classify:
        raise InputError("no-classify", str(classify[0]), "leaves out what --classify gives; give one of the two")
    processes = jobs_of(jobs)
    options = Options(
        variance=variance,
        classifications=tuple(classify or ()),
        classify=not no_classify,
        jobs=processes,
        dask=dask,
    )
    with ProgressLine() as progress:
        files = write_report(runs, out, options, progress.show)
    if json:
        print_json({"report": str(files[0]), "files": [str(one) for one in files[1:]]})
        return
    size = files[0].stat().st_size / 1e6
    typer.echo(f"{files[0]} ({size:.1f} MB), {counted(len(files) - 1, 'file')} in {files[0].stem}_files")
