"""``tacbench runs``: check run folders, and write them as other tools read them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import rich_click as click

from tacbench_cad.cli import options
from tacbench_cad.cli.common import end_check, note, print_json, print_lines, print_table, simulated_devices
from tacbench_cad.cli.progress import ProgressLine
from tacbench_cad.util.errors import InputError, one_line
from tacbench_cad.util.text import counted

if TYPE_CHECKING:
    from tacbench_cad.lab.runs.checking import RunReport

#: Findings of one kind that are shown for a run before the rest is only counted.
MAX_SHOWN = 10


@options.group("runs")
def command() -> None:
    """Check run folders, and export them for other tools."""


_folders = options.argument("folders", options.file("DIR"), "Run folders, or folders with runs in them.", many=True)


def _whole_numbers(separator: str, count: int, allowed: str) -> options.Value:
    def read(option: str, text: str) -> tuple[int, ...]:
        parts = text.split(separator)
        if len(parts) != count:
            raise InputError(option, text, f"must be {allowed}")
        return tuple(options.whole_of(option, part) for part in parts)

    return options.Value(allowed.partition(", ")[0], read)


@options.command("check", command)
@_folders
@options.flag("--repair", "Cut off a torn last row. Nothing else is changed.")
@options.json
def check(folders: tuple[Path, ...], repair: bool, json: bool) -> None:
    """Examine run folders and every frame in them.

    Missing, extra, doubled, unreadable, dark, blurred and stuck (identical) images, wrong checksums and gaps in the
    protocol are named, one line a run and then one a finding; the exit code is then 1. The order of the rows of
    targets.csv means nothing: a press is known by its force level, repeat and position. Empty fields of print.toml are
    named and are no fault.

    Examples:
      tacbench runs check runs/
      tacbench runs check runs/texture-4_paper_x1_bambu-p1p_pla-minus_copy01 --repair
      tacbench runs check runs/ --json
    """
    from tacbench_cad.lab.runs.checking import check_run
    from tacbench_cad.lab.runs.reading import find_runs

    reports: list[RunReport] = []
    refusals: list[tuple[Path, InputError]] = []
    with ProgressLine() as progress:
        for folder in find_runs(folders):
            try:
                reports.append(check_run(folder, repair=repair, progress=partial(progress.show, folder.name)))
            except InputError as error:
                refusals.append((folder, error))
    for report in reports:
        for repaired in report.repaired:
            note(f"repaired {report.folder}: {repaired}")
    if json:
        print_json(
            {
                "ok": not refusals and all(report.ok for report in reports),
                "runs": [report.as_dict() for report in reports],
                "refused": [{"folder": str(path), "reason": one_line(refusal)} for path, refusal in refusals],
            }
        )
    else:
        _print(reports)
    end_check(reports, [refusal for _, refusal in refusals])


@options.command("export", command)
@_folders
@options.option("--to", options.choice("tactile-data"), "What it is for.", required=True)
@options.option(
    "--bbox",
    _whole_numbers(",", 4, "X0,Y0,X1,Y1, whole numbers with commas between them"),
    "Pixels to keep. Default: the largest centred square.",
)
@options.option(
    "--size", _whole_numbers("x", 2, "WxH, as 128x128"), "Size of the images afterwards.", default="128x128"
)
@options.flag("--colour", "Keep the colours. Default: grey (BT.601).")
@options.out("DIR", "A folder for one folder a run. Default: into the run folders themselves.")
def export(
    folders: tuple[Path, ...],
    to: str,
    bbox: tuple[int, int, int, int] | None,
    size: tuple[int, int],
    colour: bool,
    out: Path | None,
) -> None:
    """Write run folders as tactile_learning reads them: processed_images/, targets_images.csv and the JSON files.

    The images are cut to a square, made grey and 128 x 128 pixels, as that toolchain's models take them. Every image is
    compared with its checksum on the way.

    Examples:
      tacbench runs export --to tactile-data runs/
      tacbench runs export --to tactile-data runs/ --out learning --bbox 110,0,550,440
    """
    from tacbench_cad.lab.runs.export import Processing, export_tactile_data
    from tacbench_cad.lab.runs.reading import find_runs

    processing = Processing(bbox=bbox, size=size, grey=not colour)
    runs = find_runs(folders)
    twice = next((name for name, count in Counter(folder.name for folder in runs).items() if count > 1), None)
    if out is not None and twice is not None:
        raise InputError("out", str(out), f"two of the runs are named {twice}; export them to different folders")
    images = 0
    with ProgressLine() as progress:
        for folder in runs:
            target = None if out is None else out / folder.name
            images += export_tactile_data(folder, target, processing, partial(progress.show, folder.name))
    exported = f"{counted(len(runs), 'run')}, {counted(images, 'image')} of {size[0]}x{size[1]} pixels"
    click.echo(f"{exported}, in {out or 'the run folders'}")


def _devices(simulated: Sequence[str]) -> str:
    names = simulated_devices(simulated)
    return "all" if len(names) == 3 else ", ".join(names) or "no"


def _print(reports: Sequence[RunReport]) -> None:
    print_table(
        "runs",
        ("run", ">presses", ">references", ">stationary", ">out of band", "simulated", ">findings"),
        [
            (
                report.folder.name,
                f"{report.presses} of {report.planned}",
                report.references,
                report.stationary,
                report.out_of_band,
                _devices(report.simulated),
                len(report.findings) or "ok",
            )
            for report in reports
        ],
    )
    for report in reports:
        so_far: Counter[str] = Counter()
        for finding in report.findings:
            so_far[finding.kind] += 1
            if so_far[finding.kind] <= MAX_SHOWN:
                print_lines(one_line(f"{report.folder.name}: {finding.kind}: {finding.where} {finding.text}"))
        for kind, count in so_far.items():
            if count > MAX_SHOWN:
                print_lines(f"{report.folder.name}: {kind}: and {count - MAX_SHOWN} more (all with --json)")
    empty = Counter(field for report in reports for field in report.empty_fields)
    if empty:
        print_lines("empty in print.toml (runs): " + ", ".join(f"{field} ({count})" for field, count in empty.items()))
    findings = sum(len(report.findings) for report in reports)
    presses = sum(report.presses for report in reports)
    verdict = counted(findings, "finding") if findings else "nothing wrong"
    print_lines(f"{counted(len(reports), 'run')}, {counted(presses, 'press')}: {verdict}")
