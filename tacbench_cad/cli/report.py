"""``tacbench report``: write a report of a study as one web page."""

from __future__ import annotations

from pathlib import Path

import rich_click as click

from tacbench_cad.cli import options
from tacbench_cad.cli.common import next_paths, print_json, print_next
from tacbench_cad.cli.progress import ProgressLine
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import counted


@options.command("report", "Analyse")
@options.runs
@options.features
@options.series
@options.option(
    "--classify",
    options.file("DIR"),
    "Output folder of tacbench classify. Can be repeated. Default: computed with the protocol leak-free.",
    options.CONTENT,
    multiple=True,
)
@options.flag("--no-classify", "Leave out classification, which takes most of the time.", options.CONTENT)
@options.out("FILE.html", "The page.", default="report.html")
@options.json
@options.jobs
@options.dask
def command(
    runs: tuple[Path, ...],
    features: str,
    series: bool,
    classify: tuple[Path, ...],
    no_classify: bool,
    jobs: int,
    dask: str | None,
    out: Path,
    json: bool,
) -> None:
    """Write a report of a study as one web page.

    The first screen has a figure and answers five questions:
    - What was pressed?
    - How good are the data?
    - How well were the blocks printed?
    - Which textures can be distinguished on prints that were not in training?
    - What can you do next?

    Below are a frame of each texture and a table that you can quote. Further sections open when you click on them:
    design, data quality, variance, classification at each hold-out level, a methods paragraph with every parameter,
    citations, and the print records. If you print the page on paper, all sections are open. Simulated data are marked.

    The page needs no other file. The folder next to it (report_files) has each figure as PNG and PDF, each table as
    CSV, and all numbers as report.json. Finished trials of a classification are stored there too, so the same command
    resumes after an interruption.

    Examples:
      tacbench report runs -o report.html
      tacbench report runs -o report.html --no-classify
      tacbench report runs --features markers
      tacbench report runs --classify classification
    """
    from tacbench_cad.lab.analysis.classification.classification import Classification
    from tacbench_cad.lab.analysis.feature import feature_of
    from tacbench_cad.lab.analysis.report.page import report
    from tacbench_cad.lab.analysis.study_design import Design
    from tacbench_cad.lab.runs.press_table import read
    from tacbench_cad.util.untrusted import read_document

    if no_classify and classify:
        raise InputError("no-classify", str(classify[0]), "cannot be combined with --classify; leave out one of them")
    presses = read(runs, series=series)
    feature = None if features == "pixels" else feature_of(features)
    earlier = [Classification.open(folder, Design.of(presses)) for folder in classify]
    classifications = None if not earlier and not no_classify else earlier
    with ProgressLine() as progress:
        files = report(
            presses,
            out,
            feature,
            classifications=classifications,
            jobs=jobs,
            dask=dask,
            progress=progress.show,
        )
    if json:
        document = read_document(files[1], "report", "json")
        print_json({"report": str(files[0]), "files": [str(path) for path in files[1:]], **document})
        return
    size = files[0].stat().st_size / 1e6
    click.echo(f"{files[0]} ({size:.1f} MB), {counted(len(files) - 1, 'file')} in {files[0].stem}_files")
    print_next("publish", *next_paths(runs), "--report", out, "--init", "about.toml")
