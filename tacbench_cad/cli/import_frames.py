"""``tacbench import-frames``: anybody's frames as run folders."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import rich_click as click
from click.exceptions import Exit

from tacbench_cad.cli import options
from tacbench_cad.cli.common import note, print_json, print_lines, print_table
from tacbench_cad.cli.progress import ProgressLine
from tacbench_cad.util.errors import InputError, one_line
from tacbench_cad.util.text import counted

if TYPE_CHECKING:
    from tacbench_cad.lab.runs.importing.importer import ImportReport

#: Things that were left out that are named before the rest is only counted; all of them are in --json.
MAX_SHOWN = 100
#: The words of ``--kind``; a test compares them with what the lab can import.
KINDS = ("images", "folders", "tactip", "arrays", "videos", "huggingface", "authors")


def _pairs_of(option: str, text: str) -> dict[str, str]:
    pairs: dict[str, str] = {}
    for word in options.words_of(option, text):
        name, equals, value = (part.strip() for part in word.partition("="))
        if not (name and equals and value):
            raise InputError(option, word, "must be NAME=VALUE")
        if name in pairs:
            raise InputError(option, text, f"names {name} twice")
        pairs[name] = value
    return pairs


def _levels_of(option: str, text: str) -> dict[str, int]:
    pairs = _pairs_of(option, text.upper())
    return {name: options.whole_of(option, number) for name, number in pairs.items()}


@options.command("import-frames")
@options.argument("paths", options.file("PATHS"), "Folders and files.", many=True)
@options.option(
    "--columns",
    options.Value("label=COLUMN,...", _pairs_of),
    "Which column of the table is what: label, print, printer, filament, position, force (N), repeat, session; image, "
    "time, video, index, measured_force, x, y, z. Usual names are recognised.",
)
@options.option(
    "--names", options.file("FILE.toml"), "Which printers, filaments and labels the words of the data mean."
)
@options.option("--kind", options.choice(*KINDS), "What it is. Default: recognised by what lies there.")
@options.option(
    "--force-levels",
    options.Value("P30=1,...", _levels_of),
    "What the authors' file names call the paper's three forces.",
    default="P30=1,P40=2,P50=3",
)
@options.option(
    "--first-axis",
    options.choice("x", "y"),
    "Axis that the first index of the authors' 5 x 5 positions runs along.",
    default="y",
)
@options.option("--preset", options.PRESET, "Geometry of the authors' blocks.", default="released")
@options.option("--spacing", options.choice("even", "1mm"), "The authors' press grid along y.", default="even")
@options.json
@options.out("DIR", "The folder for the run folders.", required=True)
def command(
    paths: tuple[Path, ...],
    out: Path,
    columns: dict[str, str] | None,
    names: Path | None,
    kind: str | None,
    json: bool,
    **authors: Any,
) -> None:
    """Turn frames of any study into run folders, which every analysis reads.

    It reads a folder of images with a table (CSV), one folder of images for each class, a folder of a TacTip toolchain,
    arrays (.npy, .npz, HDF5) with a table, videos with a table of times, a Hugging Face data set that was saved on the
    disk, and the arrays of the paper's authors. Each print becomes a run; where prints are unknown, each label. What
    the data do not say stays unknown, and the analyses say what they cannot do without it.

    What cannot be imported is listed at the end, each with its reason, and the exit code is then 1. Run again after an
    interruption, it resumes.

    Examples:
      tacbench import-frames frames/ labels.csv -o runs
      tacbench import-frames frames/ labels.csv --columns label=material,print=block_id -o runs
      tacbench import-frames images_by_class/ -o runs
      tacbench import-frames X.npy X.csv -o runs
      tacbench import-frames press.mp4 times.csv -o runs
      tacbench import-frames arrays/*.npy --names printers.toml -o runs
    """
    from tacbench_cad.lab.runs.importing.authors import AuthorsOptions
    from tacbench_cad.lab.runs.importing.importer import import_samples
    from tacbench_cad.lab.runs.importing.kinds import ImportOptions

    how = ImportOptions(kind=kind, columns=columns or {}, names=names, authors=AuthorsOptions(**authors))
    with ProgressLine() as progress:
        report = import_samples(paths, out, how, progress.show)
    if json:
        print_json(_document(report))
    else:
        _print(report, out)
    if not report.ok:
        raise Exit(1)


def _document(report: ImportReport) -> dict[str, Any]:
    return {
        "ok": report.ok,
        "runs": [
            {"folder": str(run.folder), "kind": run.kind, "imported": run.imported, "present": run.present}
            for run in report.runs
        ],
        "left_out": [
            {"where": each.where, "reason": one_line(each.reason), "count": each.count} for each in report.left_out
        ],
        "notes": list(report.notes),
    }


def _print(report: ImportReport, out: Path) -> None:
    for line in report.notes:
        note(line)
    if report.runs:
        print_table(
            "imported",
            ("run", ">imported", ">there already", ">left out", "from"),
            [(run.folder.name, run.imported, run.present, run.left_out or "", run.kind) for run in report.runs],
        )
    for each in report.left_out[:MAX_SHOWN]:
        print_lines(f"left out: {each.line}")
    if len(report.left_out) > MAX_SHOWN:
        print_lines(f"left out: and {len(report.left_out) - MAX_SHOWN:,} more (all with --json)")
    samples = sum(run.imported + run.present for run in report.runs)
    left = f"; {sum(each.count for each in report.left_out):,} left out" if report.left_out else ""
    click.echo(f"{counted(samples, 'sample')} in {counted(len(report.runs), 'run')} in {out}{left}")
    if report.runs:
        click.echo(f"next: tacbench check-runs {out}")
