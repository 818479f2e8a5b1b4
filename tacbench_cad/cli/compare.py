"""``tacbench compare``: compare two sensors."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import rich_click as click

from tacbench_cad.cli import completing, options
from tacbench_cad.cli.common import note, print_json, print_lines, print_simulated, show_table
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import counted


@options.command("compare", "Analyse")
@options.argument(
    "a", options.file("A", completing.of_folders), "Runs of the first sensor, or the output folder of classify."
)
@options.argument(
    "b", options.file("B", completing.of_folders), "Runs of the second sensor, or the output folder of classify."
)
@options.option(
    "--estimator",
    options.words("LIST", "forest", "network"),
    "One estimator for both, or one for A and one for B, such as forest,network. Default: the first estimator of A.",
    options.METHOD,
    dest="estimators",
)
@options.option(
    "--names",
    options.words("A,B"),
    "Names of A and B in the table and the figure. Default: the names of the sensors, or of the folders if the sensors "
    "have the same name.",
    options.METHOD,
)
@options.flag("--unpaired", "Runs with the same name are different prints, for example of another lab.", options.METHOD)
@options.option("--trials", options.COUNT, "Number of trials, if A or B has runs.", options.METHOD, default="5")
@options.out("DIR", "Folder of the table, the figure and the classifications.", default="comparison")
@options.json
@options.jobs
@options.dask
def command(
    a: Path,
    b: Path,
    estimators: tuple[str, ...] | None,
    names: tuple[str, ...] | None,
    unpaired: bool,
    trials: int,
    jobs: int,
    dask: str | None,
    out: Path,
    json: bool,
) -> None:
    """Compare the results of two sensors or two estimators.

    A and B are studies of the same textures. Each of them is a folder that "tacbench classify" wrote with the protocol
    leak-free, or a folder of runs. The command first classifies runs with the default options.

    For each hold-out level, the table has:
    - the accuracy and the recall of each texture, for A and for B
    - the differences, with 95 % confidence intervals computed over prints

    You also get the smallest difference that a study of this size would detect with a probability of 80 %.

    If both sensors pressed the same prints (run folders with the same names), the prints are compared in pairs, and
    prints that only one sensor pressed are left out. Use --unpaired if the names are the same but the prints are not.
    You can also compare two estimators for the same sensor: give the same folder twice and two estimators.

    Examples:
      tacbench compare tactip-runs other-runs -o comparison
      tacbench compare tactip-classification other-classification --json
      tacbench compare classification classification --estimator forest,network
    """
    from tacbench_cad.lab.analysis.classification.classify import MODULES
    from tacbench_cad.lab.analysis.compare import compare
    from tacbench_cad.lab.analysis.comparison_sides import read_side, side_names
    from tacbench_cad.util.files import locked
    from tacbench_cad.util.packages import require

    chosen = estimators or (None,)
    if len(chosen) > 2:
        raise InputError("estimator", ",".join(map(str, chosen)), "must be one name, or one for A and one for B")
    if names is not None and len(set(names)) != 2:
        raise InputError("names", ",".join(names), "must be two different names, one for A and one for B")
    if a.resolve() == b.resolve() and len(set(chosen)) < 2:
        raise InputError("B", str(b), "is the same folder as A; name the study of the other sensor, or two estimators")
    require("compare", *(("matplotlib",) if _is_classified(a) and _is_classified(b) else MODULES))
    with locked(out):
        folders = [_classified(side, folder, out, trials, jobs, dask) for side, folder in (("a", a), ("b", b))]
        first, used = read_side(folders[0], a.name, chosen[0])
        second, other = read_side(folders[1], b.name, chosen[-1] or used)
        shown = names or side_names((a, b), (first.record, second.record)) or (used, other)
        first, second = (replace(side, name=name) for side, name in zip((first, second), shown, strict=True))
        comparison = compare(first, second, " and ".join(dict.fromkeys([used, other])), same_prints=not unpaired)
        files = comparison.save(out)
    if json:
        print_json({**comparison.document(), "files": [str(path) for path in files]})
        return
    print_simulated(comparison.simulated)
    show_table(comparison.shown)
    print_lines(*(f"note: {text}" for text in comparison.notes))
    click.echo(f"{counted(len(files), 'file')} in {out}")


def _is_classified(folder: Path) -> bool:
    """Whether ``tacbench classify`` wrote this folder."""
    from tacbench_cad.lab.analysis.classification.settings import SETTINGS_FILE

    return (folder / SETTINGS_FILE).is_file()


def _classified(side: str, folder: Path, out: Path, trials: int, jobs: int, dask: str | None) -> Path:
    """The folder of a classification. The runs of another folder are classified into a folder in ``out``."""
    from tacbench_cad.lab.analysis.collection import Collection
    from tacbench_cad.lab.analysis.report.classification import classify_into

    if _is_classified(folder):
        return folder
    collection = Collection.open([folder])
    target = out / f"classification_{side}"
    note(f"classifying {folder}: {counted(len(collection), 'press')}, {counted(trials, 'trial')}")
    classify_into(collection, target, trials, jobs, dask)
    return target
