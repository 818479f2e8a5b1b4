"""``tacbench compare``: two sensors side by side."""

from __future__ import annotations

from pathlib import Path

import rich_click as click

from tacbench_cad.cli import options
from tacbench_cad.cli.common import note, print_json, print_lines, print_simulated, show_table
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import counted


@options.command("compare")
@options.argument("a", options.file("A"), "Runs of one sensor, or what classify wrote of them.")
@options.argument("b", options.file("B"), "The same of the other sensor.")
@options.option(
    "--estimator",
    options.NAMES,
    "The estimator of both, or A's and B's: forest,network. Default: A's first.",
    dest="estimators",
)
@options.flag("--unpaired", "Run folders of one name are different prints, as another lab's own are.")
@options.option("--trials", options.COUNT, "Trials, where runs are given.", default="5")
@options.jobs
@options.dask
@options.out("DIR", "Folder of table, figure, and classifications of runs.", default="comparison")
@options.json
def command(
    a: Path,
    b: Path,
    estimators: tuple[str, ...] | None,
    unpaired: bool,
    trials: int,
    jobs: int,
    dask: str | None,
    out: Path,
    json: bool,
) -> None:
    """Two sensors' studies of the same textures side by side, and the smallest difference that the data can show.

    A and B are each a folder that tacbench classify wrote (protocol leak-free), or a folder of runs, which is then
    classified as tacbench classify does without options. For each hold-out level: accuracy, recall of each texture,
    their differences with 95 % intervals over prints, and what difference a study of this size would find in four of
    five repetitions. Where both sensors pressed the same prints (run folders of one name), prints are compared in
    pairs; --unpaired, where names are the same and prints are not. With two estimators, two ways to classify one
    sensor's presses are compared in the same manner.

    Examples:
      tacbench compare tactip-runs other-runs -o comparison
      tacbench compare tactip-classification other-classification --json
      tacbench compare classification classification --estimator forest,network
    """
    from tacbench_cad.lab.analysis.classification.classify import MODULES
    from tacbench_cad.lab.analysis.compare import compare, read_side, write_comparison
    from tacbench_cad.util.files import locked
    from tacbench_cad.util.packages import require

    names = estimators or (None,)
    if len(names) > 2:
        raise InputError("estimator", ",".join(map(str, names)), "must be one name, or A's and B's")
    if a.resolve() == b.resolve() and len(set(names)) < 2:
        raise InputError("B", str(b), "is A itself; name the other sensor's study")
    require("compare", *(("matplotlib",) if _is_classified(a) and _is_classified(b) else MODULES))
    with locked(out):
        folders = [_classified(side, folder, out, trials, jobs, dask) for side, folder in (("a", a), ("b", b))]
        first, used = read_side(folders[0], a.name, names[0])
        second, other = read_side(folders[1], b.name, names[-1] or used)
        comparison = compare(first, second, " and ".join(dict.fromkeys([used, other])), same_prints=not unpaired)
        files = write_comparison(comparison, out)
    if json:
        print_json({**comparison.document(), "files": [str(path) for path in files]})
        return
    print_simulated(comparison.simulated)
    show_table(comparison.shown)
    print_lines(*(f"note: {text}" for text in comparison.notes))
    click.echo(f"{counted(len(files), 'file')} in {out}")


def _is_classified(folder: Path) -> bool:
    """Whether a folder is one that tacbench classify wrote."""
    from tacbench_cad.lab.analysis.classification.settings import SETTINGS_FILE

    return (folder / SETTINGS_FILE).is_file()


def _classified(side: str, folder: Path, out: Path, trials: int, jobs: int, dask: str | None) -> Path:
    """The folder of a classification: the folder itself, or one within ``out`` in which its runs are classified."""
    from tacbench_cad.lab.analysis.collection import Collection
    from tacbench_cad.lab.analysis.report.classification import classify_into

    if _is_classified(folder):
        return folder
    collection = Collection.open([folder])
    target = out / f"classification_{side}"
    note(f"classifying {folder}: {counted(len(collection), 'press')}, {counted(trials, 'trial')}")
    classify_into(collection, target, trials, jobs, dask)
    return target
