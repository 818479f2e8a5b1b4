"""``tacbench runs``: check run folders, and write them as other tools read them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tacbench_cad.cli.common import console, note, one_line, print_json, simulated_devices, table, whole_of
from tacbench_cad.util.errors import InputError, one_of
from tacbench_cad.util.text import counted

if TYPE_CHECKING:
    from tacbench_cad.lab.runs.checking import RunReport

NAME = "runs"
app = typer.Typer(name=NAME, help="Check run folders, and export them for other tools.")

#: Findings of one kind that are shown for a run before the rest is only counted.
MOST_SHOWN = 10


@app.command("check")
def check(
    folders: Annotated[
        list[Path],
        typer.Argument(metavar="DIR", help="Run folders, or folders with runs in them.", show_default=False),
    ],
    json: Annotated[bool, typer.Option("--json", help="Print one JSON document.")] = False,
    repair: Annotated[bool, typer.Option("--repair", help="Cut off a torn last row. Nothing else is changed.")] = False,
) -> None:
    """Examine run folders and every reading in them.

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
    found = find_runs(folders)
    with _progress("checking", len(found)) as told:
        for folder in found:
            try:
                reports.append(check_run(folder, repair=repair, progress=told(folder.name)))
            except InputError as error:
                refusals.append((folder, error))
    for report in reports:
        for repaired in report.repaired:
            note(f"repaired {report.folder}: {repaired}")
    if json:
        print_json(
            {
                "ok": not refusals and all(one.ok for one in reports),
                "runs": [one.as_dict() for one in reports],
                "refused": [{"folder": str(path), "reason": one_line(str(refusal))} for path, refusal in refusals],
            }
        )
    else:
        _print(reports)
    for _, refusal in refusals:
        note(f"error: {one_line(str(refusal))}")
    if any(not one.ok for one in reports):
        raise typer.Exit(1)
    if refusals:
        raise typer.Exit(InputError.exit_code)


@app.command("export")
def export(
    folders: Annotated[
        list[Path],
        typer.Argument(metavar="DIR", help="Run folders, or folders with runs in them.", show_default=False),
    ],
    to: Annotated[str, typer.Option(metavar="tactile-data", help="What it is for.", show_default=False)],
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="A folder for one folder a run. Default: into the run folders themselves."),
    ] = None,
    bbox: Annotated[
        str | None, typer.Option(metavar="X0,Y0,X1,Y1", help="Pixels to keep. Default: the largest centred square.")
    ] = None,
    size: Annotated[str, typer.Option(metavar="WxH", help="Size of the images afterwards.")] = "128x128",
    colour: Annotated[bool, typer.Option("--colour", help="Keep the colours. Default: grey (BT.601).")] = False,
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

    one_of("to", to, ("tactile-data",))
    how = Processing(bbox=_box(bbox), size=_size(size), grey=not colour)
    found = find_runs(folders)
    names = Counter(folder.name for folder in found)
    twice = next((name for name, times in names.items() if times > 1), None)
    if out is not None and twice is not None:
        raise InputError("out", str(out), f"two of the runs are named {twice}; export them to different folders")
    images = 0
    with _progress("exporting", len(found)) as told:
        for folder in found:
            target = None if out is None else out / folder.name
            images += export_tactile_data(folder, target, how, told(folder.name))
    made = f"{counted(len(found), 'run')}, {counted(images, 'image')} of {size} pixels"
    typer.echo(f"{made}, in {out or 'the run folders'}")


def _box(text: str | None) -> tuple[int, int, int, int] | None:
    if text is None:
        return None
    parts = text.split(",")
    if len(parts) != 4:
        raise InputError("bbox", text, "must be X0,Y0,X1,Y1, whole numbers with commas between them")
    x0, y0, x1, y1 = (whole_of("bbox", part) for part in parts)
    return (x0, y0, x1, y1)


def _size(text: str) -> tuple[int, int]:
    parts = text.split("x")
    if len(parts) != 2:
        raise InputError("size", text, "must be WxH, as 128x128")
    return (whole_of("size", parts[0]), whole_of("size", parts[1]))


@contextmanager
def _progress(doing: str, runs: int) -> Iterator[Callable[[str], Callable[[int, int], None]]]:
    """A bar on the standard error, if that is a terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    screen = Console(stderr=True, markup=False, emoji=False)
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=screen, disable=not screen.is_terminal, transient=True) as bar:
        whole = bar.add_task(f"{doing} runs", total=runs)
        one = bar.add_task("", total=None)

        def told(name: str) -> Callable[[int, int], None]:
            bar.update(one, description=name, completed=0, total=None)

            def tell(done: int, of: int) -> None:
                bar.update(one, completed=done, total=of)
                if done == of:
                    bar.advance(whole)

            return tell

        yield told


def _devices(simulated: tuple[str, ...]) -> str:
    names = simulated_devices(simulated)
    return "all" if len(names) == 3 else ", ".join(names) or "no"


def _print(reports: list[RunReport]) -> None:
    shown = table(
        "runs",
        "run",
        "presses",
        "references",
        "stationary",
        "out of band",
        "simulated",
        "findings",
        right=("presses", "references", "stationary", "out of band", "findings"),
    )
    for one in reports:
        shown.add_row(
            one.folder.name,
            f"{one.presses} of {one.planned}",
            str(one.references),
            str(one.stationary),
            str(one.out_of_band),
            _devices(one.simulated),
            str(len(one.findings)) if one.findings else "ok",
        )
    screen = console()
    screen.print(shown)
    for report in reports:
        so_far: Counter[str] = Counter()
        for finding in report.findings:
            so_far[finding.kind] += 1
            if so_far[finding.kind] <= MOST_SHOWN:
                text = f"{report.folder.name}: {finding.kind}: {finding.where} {finding.text}"
                screen.print(one_line(text), soft_wrap=True)
        for kind, times in so_far.items():
            if times > MOST_SHOWN:
                screen.print(f"{report.folder.name}: {kind}: and {times - MOST_SHOWN} more (all with --json)")
    empty = Counter(field for report in reports for field in report.empty_fields)
    if empty:
        named = ", ".join(f"{field} ({times})" for field, times in empty.items())
        screen.print(f"empty in print.toml (runs): {named}", soft_wrap=True)
    findings = sum(len(report.findings) for report in reports)
    presses = sum(report.presses for report in reports)
    verdict = "nothing wrong" if not findings else counted(findings, "finding")
    screen.print(f"{counted(len(reports), 'run')}, {counted(presses, 'press')}: {verdict}", soft_wrap=True)
