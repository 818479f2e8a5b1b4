"""``tacbench check-runs``: check run folders."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from tacbench_cad.cli import options
from tacbench_cad.cli.common import (
    end_check,
    next_paths,
    note,
    print_json,
    print_lines,
    print_next,
    print_table,
    simulated_devices,
)
from tacbench_cad.cli.progress import ProgressLine
from tacbench_cad.util.errors import InputError, one_line
from tacbench_cad.util.text import counted

if TYPE_CHECKING:
    from tacbench_cad.lab.runs.checking import RunReport

#: The number of findings of a kind that are listed for a run; the others are only counted.
MAX_SHOWN = 10
#: The number of empty fields of ``print.toml`` that are listed; the others are only counted.
MAX_FIELDS = 3


@options.command("check-runs", "Press")
@options.runs
@options.flag("--repair", "Remove the last row of a table if it is incomplete.", options.REPAIR)
@options.json
def command(runs: tuple[Path, ...], repair: bool, json: bool) -> None:
    """Check recorded runs for damaged or missing data.

    The command reads every frame. It reports:
    - missing, extra, duplicate and unreadable images
    - dark, saturated, blurred, noisy, identical and mirrored images
    - images with red and blue swapped
    - changes of brightness, flicker, drift, and a camera that moved
    - wrong checksums
    - gaps in the protocol

    There is one line for each run and one line for each fault. If there is a fault, the exit code is 1.

    The rows of targets.csv may be in any order. Empty fields of print.toml are listed, but they are not a fault.

    Examples:
      tacbench check-runs runs/
      tacbench check-runs runs/texture-4_paper_x1_ender-3_petg_copy01 --repair
      tacbench check-runs runs/ --json
    """
    from tacbench_cad.lab.runs.checking import check_run
    from tacbench_cad.lab.runs.reading import find_runs

    reports: list[RunReport] = []
    refusals: list[tuple[Path, InputError]] = []
    with ProgressLine() as progress:
        for folder in find_runs(runs):
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
    if not json:
        print_next("variance", *next_paths(runs))


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
    empty = list(dict.fromkeys(field for report in reports for field in report.empty_fields))
    if empty:
        incomplete = sum(bool(report.empty_fields) for report in reports)
        more = f" and {len(empty) - MAX_FIELDS} more (all with --json)" if len(empty) > MAX_FIELDS else ""
        where = f"print.toml ({counted(incomplete, 'run')})"
        print_lines(f"{where}: {counted(len(empty), 'empty field')}: {', '.join(empty[:MAX_FIELDS])}{more}")
    for presses, text in (
        (sum(report.unchecked for report in reports), "was not checked afterwards"),
        (sum(report.unchecked_sideways for report in reports), "was checked in z only, not in x and y"),
    ):
        if presses:
            print_lines(f"position: of {counted(presses, 'press')}, the position {text}")
    findings = sum(len(report.findings) for report in reports)
    presses = sum(report.presses for report in reports)
    verdict = counted(findings, "finding") if findings else "nothing wrong"
    print_lines(f"{counted(len(reports), 'run')}, {counted(presses, 'press')}: {verdict}")
