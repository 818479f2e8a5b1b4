"""``tacbench import-frames``: make run folders from existing frames."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import rich_click as click
from click.exceptions import Exit

from tacbench_cad.cli import completing, options
from tacbench_cad.cli.common import note, print_json, print_lines, print_next, print_table
from tacbench_cad.cli.progress import ProgressLine
from tacbench_cad.util.errors import InputError, one_line
from tacbench_cad.util.text import counted

if TYPE_CHECKING:
    from tacbench_cad.lab.rig.colours import Channels
    from tacbench_cad.lab.runs.importing.importer import ImportReport

#: Things that were left out that are named before the rest is only counted; all of them are in --json.
MAX_SHOWN = 100
#: The words of ``--kind``; a test compares them with what the lab can import.
KINDS = ("images", "folders", "tactip", "arrays", "videos", "huggingface", "authors")
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


def _levels_of(option: str, text: str) -> dict[str, int]:
    pairs = _pairs_of(option, text.upper())
    return {name: options.whole_of(option, number) for name, number in pairs.items()}


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
    options.choice(*KINDS),
    f"Kind of data: {', '.join(KINDS[:-1])} or {KINDS[-1]}. Default: found from the files.",
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
    "--force-levels",
    options.Value("P30=1,...", _levels_of),
    "Authors' arrays: force level for each word such as P30 in the file names.",
    options.ADVANCED,
    default="P30=1,P40=2,P50=3",
)
@options.option(
    "--first-axis",
    options.choice("x", "y"),
    "Authors' arrays: axis of the block along the first index of the 5 x 5 positions.",
    options.ADVANCED,
    default="y",
)
@options.option(
    "--preset", options.PRESET, "Authors' arrays: preset of the blocks.", options.ADVANCED, default="released"
)
@options.option(
    "--spacing",
    options.choice("even", "1mm"),
    "Authors' arrays: spacing of the positions along y.",
    options.ADVANCED,
    default="even",
)
def command(
    paths: tuple[Path, ...],
    out: Path,
    columns: dict[str, str] | None,
    names: Path | None,
    kind: str | None,
    channels: Channels,
    json: bool,
    **authors: Any,
) -> None:
    """Make run folders from frames that you already have.

    All analyses can read these run folders. The command imports:
    - images with a table (CSV)
    - images in one folder for each class
    - one or several folders of a TacTip toolchain
    - arrays (.npy, .npz or HDF5) with a table, or with an array of labels
    - videos with a table of times
    - a Hugging Face data set that was saved to disk
    - the arrays of the paper's authors

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
    from tacbench_cad.lab.runs.importing.authors import AuthorsOptions
    from tacbench_cad.lab.runs.importing.importer import import_samples
    from tacbench_cad.lab.runs.importing.kinds import ImportOptions

    how = ImportOptions(
        kind=kind, columns=columns or {}, names=names, channels=channels, authors=AuthorsOptions(**authors)
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
