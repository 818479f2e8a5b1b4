"""``tacbench report``: one page on a study."""

from __future__ import annotations

from pathlib import Path

import rich_click as click

from tacbench_cad.cli import options
from tacbench_cad.cli.common import print_json
from tacbench_cad.cli.progress import ProgressLine
from tacbench_cad.util.door import read_document
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import counted


@options.command("report")
@options.runs
@options.option("--variance", options.file("DIR"), "What tacbench variance wrote. Default: computed.")
@options.option(
    "--classify",
    options.file("DIR"),
    "What tacbench classify wrote; may be given twice. Default: computed, leak-free.",
    multiple=True,
)
@options.flag("--no-classify", "Leave classification out; it takes most of the time.")
@options.jobs
@options.dask
@options.out("FILE.html", "The page.", default="report.html")
@options.json
def command(
    runs: tuple[Path, ...],
    variance: Path | None,
    classify: tuple[Path, ...],
    no_classify: bool,
    jobs: int,
    dask: str | None,
    out: Path,
    json: bool,
) -> None:
    """One self-contained page on a study, fit to be sent, printed and quoted.

    Its first screen has five sentences (what was pressed, how good the data are, how well it printed, what can be told
    apart on prints that training has not seen, what to do next) and a figure. Then come a frame of each texture and the
    table to quote. Everything else is folded on a screen and open on paper: the design, data quality, variance, the
    classification at each hold-out level, a methods paragraph with every parameter, citations and the print records.

    report.html needs nothing else. report_files/ beside it has each figure as PNG and PDF, each table as CSV, and all
    that the page shows as report.json, which --json prints. Finished trials of a classification are kept there too:
    after an interruption the same command goes on. Simulated data are marked at the top and in each file.

    Examples:
      tacbench report runs -o report.html
      tacbench report runs -o report.html --no-classify
      tacbench report runs --variance results --classify classification --classify paper-classification
    """
    from tacbench_cad.lab.analysis.report.page import Options, write_report

    if no_classify and classify:
        raise InputError("no-classify", str(classify[0]), "leaves out what --classify gives; give one of the two")
    how = Options(variance=variance, classifications=classify, classify=not no_classify, jobs=jobs, dask=dask)
    with ProgressLine() as progress:
        files = write_report(runs, out, how, progress.show)
    if json:
        document = read_document(files[1], "report", "json")
        print_json({"report": str(files[0]), "files": [str(path) for path in files[1:]], **document})
        return
    size = files[0].stat().st_size / 1e6
    click.echo(f"{files[0]} ({size:.1f} MB), {counted(len(files) - 1, 'file')} in {files[0].stem}_files")
