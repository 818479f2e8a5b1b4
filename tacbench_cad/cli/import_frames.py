"""``tacbench import-frames``: make run folders from existing frames."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import rich_click as click
from click.exceptions import Exit

from tacbench_cad.cli import completing, options
from tacbench_cad.cli.common import note, print_json, print_lines, print_next, print_table
from tacbench_cad.cli.progress import ProgressLine
from tacbench_cad.util.entries import entries
from tacbench_cad.util.errors import InputError, one_line
from tacbench_cad.util.text import counted

if TYPE_CHECKING:
    from tacbench_cad.lab.rig.colours import Channels
    from tacbench_cad.lab.runs.importing.importer import ImportReport

#: Things that were left out that are named before the rest is only counted; all of them are in --json.
MAX_SHOWN = 100
#: The formats that are always there; a test compares these words with those of the import.
KINDS = ("images", "folders", "arrays")
#: What a column of a table can be; a test compares these words with those that the import knows.
COLUMNS = (
    *("label", "print", "printer", "filament", "position", "force", "repeat", "session"),
    *("image", "time", "video", "index", "measured_force", "x", "y", "z", "Rx", "Ry", "Rz"),
)


def _pairs_of(option: str, text: str) -> dict[str, str]:
    pairs: dict[str, str] = {}
    for word in options.words_of(option, text):
        name, equals, value = (part.strip() for part in word.partition("="))
        if not (name and equals and value):
            raise InputError(option, word, "must be NAME=VALUE, for example label=material")
        if name in pairs:
            raise InputError(option, text, f"has {name} twice")
        pairs[name] = value
    return pairs


@options.command("import-frames", "Press")
@options.argument("paths", options.file("PATHS"), "Folders and files with frames and tables.", many=True)
@options.option(
    "--columns",
    options.Value("NAME=COLUMN,...", _pairs_of, completing.of_lists(*(f"{name}=" for name in COLUMNS))),
    "Meaning of the columns of the table, for example label=material. You need it only for unusual column names. The "
    "meanings are label, print, printer, filament, position, force (N), repeat, session, image, time, video, index, "
    "measured_force, x, y, z (mm), Rx, Ry and Rz (degrees).",
    options.INPUT,
)
@options.option(
    "--names",
    options.file("FILE.toml"),
    "File that translates the words in your data into printers, filaments and labels.",
    options.INPUT,
)
@options.option(
    "--kind",
    options.choice(*KINDS, *entries("tacbench.formats")),
    "Kind of data. Default: found from the files.",
    options.INPUT,
)
@options.option(
    "--channels",
    options.choice("rgb", "bgr"),
    "Arrays: order of the three colours. The order in image files, videos and the authors' arrays is known.",
    options.INPUT,
    default="rgb",
)
@options.out("DIR", "Folder of the runs.", required=True)
@options.json
@options.option(
    "--format-options",
    options.Value("NAME=VALUE,...", _pairs_of),
    "Options of the chosen --kind. The kind authors has first-axis (x or y: axis of the block along the first index of "
    "the 5 x 5 positions), preset, spacing (even or 1mm: positions along y), and the force level of each word such as "
    "P30 in the file names: P20=1,P30=2.",
    options.ADVANCED,
)
def command(
    paths: tuple[Path, ...],
    out: Path,
    columns: dict[str, str] | None,
    names: Path | None,
    kind: str | None,
    channels: Channels,
    json: bool,
    format_options: dict[str, str] | None,
) -> None:
    """Make run folders from frames that you already have.

    All analyses can read these run folders. The command imports:
    - images: images with a table (CSV)
    - folders: images in one folder for each class
    - arrays: .npy or .npz files with a table, or with an array of labels
    - hdf5: the same in HDF5 files
    - tactip: one or several folders of a TacTip toolchain
    - videos: videos with a table of times
    - huggingface: a Hugging Face data set that was saved to disk
    - authors: the arrays of the paper's authors

    Other packages can add formats.

    Each print becomes one run. If the prints are unknown, each label becomes one run. Values that are not in your data
    stay empty. An analysis that needs such a value says so. All columns of your tables, and the names of your files,
    are kept in source.csv in each run.

    At the end, the command lists the frames that it could not import, with the reasons. The exit code is then 1. If you
    interrupt the command, type it again to resume.

    Examples:
      tacbench import-frames frames/ labels.csv -o runs
      tacbench import-frames frames/ labels.csv --columns label=material -o runs
      tacbench import-frames images_by_class/ -o runs
      tacbench import-frames X.npy X.csv -o runs
      tacbench import-frames X.npy y.npy -o runs
      tacbench import-frames press.mp4 times.csv -o runs
      tacbench import-frames arrays/*.npy --names printers.toml -o runs
    """
    from tacbench_cad.lab.runs.importing.importer import import_samples
    from tacbench_cad.lab.runs.importing.sources import ImportOptions

    how = ImportOptions(
        kind=kind, columns=columns or {}, names=names, channels=channels, of_format=format_options or {}
    )
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
            ("run", ">imported", ">imported before", ">left out", "kind"),
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
        print_next("check-runs", out)
