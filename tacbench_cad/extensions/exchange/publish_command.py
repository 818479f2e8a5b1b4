"""``tacbench publish``: write runs as a data set for a repository."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import rich_click as click

from tacbench_cad.cli import ProgressLine, completing, next_paths, note, options, print_json, print_next
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.text import counted

if TYPE_CHECKING:
    from tacbench_cad.spec import Block


@options.command("publish", "Share")
@options.argument(
    "runs",
    options.file("RUNS", completing.of_run_folders),
    "Run folders, or folders that contain run folders.",
    many=True,
    required=False,
)
@options.option("--about", options.file("FILE.toml"), "Authors, title and licence. See --init.", options.INPUT)
@options.option("--report", options.file("FILE.html"), "Use this report. Default: a new report.", options.CONTENT)
@options.option(
    "--parts",
    options.file("DIR"),
    "Use the files of the blocks in this folder. Default: new files.",
    options.CONTENT,
)
@options.flag("--no-report", "Leave out the report.", options.CONTENT)
@options.flag("--no-parts", "Leave out the files of the blocks.", options.CONTENT)
@options.flag(
    "--no-classify", "Leave out classification, which takes most of the time, from a new report.", options.CONTENT
)
@options.out("DIR", "The data set: a new folder, or a ZIP file.")
@options.option("--init", options.file("FILE.toml"), "Write an empty form for --about, and stop.", options.OUTPUT)
@options.json
@options.jobs
def command(
    runs: tuple[Path, ...],
    about: Path | None,
    init: Path | None,
    parts: Path | None,
    report: Path | None,
    no_parts: bool,
    no_report: bool,
    no_classify: bool,
    jobs: int,
    out: Path | None,
    json: bool,
) -> None:
    """Write a data set that is ready to upload.

    You can upload the data set to Zenodo or another repository. The command itself uploads nothing. The data set is an
    RO-Crate with:
    - the runs, after each frame was compared with its checksum
    - the files of the blocks, if the runs contain the formulas of the blocks
    - the report
    - metadata for DataCite and Zenodo
    - the licence
    - the checksums of all files (SHA256SUMS)

    You write the authors, the title, the licence and the affiliations into a form. If a required field is empty, the
    command stops and names the field.

    Examples:
      tacbench publish --init about.toml
      tacbench publish runs/ --about about.toml -o data-set
      tacbench publish runs/ --about about.toml -o data-set.zip --no-classify
    """
    from tacbench_cad.extensions.exchange.publishing.crate import publish
    from tacbench_cad.extensions.exchange.publishing.publication import read_publication, write_form

    if init is not None:
        write_form(init)
        note(f"wrote {init}; fill in the empty fields")
        given = ["--report", report] if report is not None else []
        print_next("publish", *(next_paths(runs) or ["RUNS"]), "--about", init, *given, "-o", "data-set", err=True)
        return
    if not runs:
        raise InputError("RUNS", None, "is missing; name run folders, or folders that contain run folders")
    if about is None:
        raise InputError("--about FILE.toml", None, "is missing; write the form with --init FILE.toml and fill it in")
    if out is None:
        raise InputError("--out DIR", None, "is missing; name a new folder or a ZIP file")
    publication = read_publication(about)
    with ProgressLine() as progress:
        make_report = partial(_make_report, runs, not no_classify, jobs, progress)
        write_report: Callable[[Path], None] = make_report if report is None else partial(_copy_report, report)
        write_parts = partial(_make_parts, progress) if parts is None else partial(_copy_parts, parts)
        files = publish(
            runs,
            out,
            publication,
            report=None if no_report else write_report,
            parts=None if no_parts else write_parts,
            progress=progress.show,
        )
    if json:
        print_json({"out": str(out), "files": [path.as_posix() for path in files]})
    else:
        click.echo(f"{counted(len(files), 'file')} in {out}; nothing was uploaded")
        print_next("cite")


def _make_report(runs: tuple[Path, ...], classify: bool, jobs: int, progress: ProgressLine, path: Path) -> None:
    from tacbench_cad.lab import read, report

    report(read(runs), path, classifications=None if classify else (), jobs=jobs, progress=progress.show)


def _copy_report(report: Path, path: Path) -> None:
    if not report.is_file():
        raise InputError("report", str(report), "this file does not exist")
    shutil.copyfile(report, path)
    beside = report.with_name(f"{report.stem}_files")
    if beside.is_dir():
        shutil.copytree(beside, path.with_name(f"{path.stem}_files"))


def _make_parts(progress: ProgressLine, blocks: Sequence[Block], folder: Path) -> None:
    from tacbench_cad.making import Request, build

    print_set = build(Request(parts=tuple(blocks), out=folder), progress.show)
    for left in print_set.left_out:
        note(f"left out: {left.what}: {left.reason}")
    if not print_set.ok:
        failure = print_set.failures[0]
        raise CheckFailedError(f"{failure.file}: {'; '.join(failure.faults)}")


def _copy_parts(parts: Path, blocks: Sequence[Block], folder: Path) -> None:
    if not parts.is_dir():
        raise InputError("parts", str(parts), "this folder does not exist")
    shutil.copytree(parts, folder, dirs_exist_ok=True)
