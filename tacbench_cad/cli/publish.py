"""``tacbench publish``: runs as a data set for a repository."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import rich_click as click

from tacbench_cad.cli import options
from tacbench_cad.cli.common import note, print_json
from tacbench_cad.cli.progress import ProgressLine
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.text import counted

if TYPE_CHECKING:
    from tacbench_cad.spec.block import Block


@options.command("publish")
@options.argument("runs", options.file("RUNS"), "Run folders, or folders that hold some.", many=True, required=False)
@options.option("--about", options.file("FILE.toml"), "What only you know: authors, title, licence. See --init.")
@options.option("--init", options.file("FILE.toml"), "Write the empty form of that file, and stop.")
@options.option("--parts", options.file("DIR"), "Take the blocks' files from here. Default: they are made.")
@options.option("--report", options.file("FILE.html"), "Take this report. Default: it is made.")
@options.flag("--no-parts", "Leave the blocks' files out.")
@options.flag("--no-report", "Leave the report out.")
@options.flag("--no-classify", "Leave classification out of the report; it takes most of the time.")
@options.jobs
@options.out("DIR|FILE.zip", "The data set: a new folder, or a ZIP file, which is one file to upload.")
@options.json
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
    """Write runs as a data set that is ready for Zenodo or another repository. Nothing is uploaded.

    The folder is an RO-Crate: the runs, each frame compared with its checksum; the blocks' files where a run knows its
    block; the report; metadata for DataCite and Zenodo; the licence; SHA256SUMS. Authors, title, licence and
    affiliation come from a file that you fill in; what is empty there is refused, never invented.

    Examples:
      tacbench publish --init about.toml
      tacbench publish runs/ --about about.toml -o data-set
      tacbench publish runs/ --about about.toml -o data-set.zip --no-classify
    """
    from tacbench_cad.lab.publishing.crate import publish
    from tacbench_cad.lab.publishing.publication import read_publication, write_form

    if init is not None:
        write_form(init)
        click.echo(f"{init}: fill in what is empty, then give it to --about")
        return
    if not runs:
        raise InputError("runs", None, "is missing: name run folders, or folders that hold some")
    if about is None:
        raise InputError("about", None, "is missing: write its form with tacbench publish --init FILE.toml")
    if out is None:
        raise InputError("out", None, "is missing: name a new folder or a ZIP file")
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


def _make_report(runs: tuple[Path, ...], classify: bool, jobs: int, progress: ProgressLine, path: Path) -> None:
    from tacbench_cad.lab.analysis.report.page import Options, write_report

    write_report(runs, path, Options(classify=classify, jobs=jobs), progress.show)


def _copy_report(report: Path, path: Path) -> None:
    if not report.is_file():
        raise InputError("report", str(report), "there is no such file")
    shutil.copyfile(report, path)
    beside = report.with_name(f"{report.stem}_files")
    if beside.is_dir():
        shutil.copytree(beside, path.with_name(f"{path.stem}_files"))


def _make_parts(progress: ProgressLine, blocks: Sequence[Block], folder: Path) -> None:
    from tacbench_cad.making.printset import Request, build

    made = build(Request(parts=tuple(blocks), out=folder), progress.show)
    for left in made.left_out:
        note(f"left out: {left.what}: {left.reason}")
    if not made.ok:
        failure = made.failures[0]
        raise CheckFailedError(f"{failure.file}: {'; '.join(failure.faults)}")


def _copy_parts(parts: Path, blocks: Sequence[Block], folder: Path) -> None:
    if not parts.is_dir():
        raise InputError("parts", str(parts), "there is no such folder")
    shutil.copytree(parts, folder, dirs_exist_ok=True)
