"""``tacbench compare``: compare two sensors."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import rich_click as click

from tacbench_cad.cli import completing, options
from tacbench_cad.cli.common import note, print_json, print_lines, print_simulated, show_table
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import counted

if TYPE_CHECKING:
    from tacbench_cad.lab.analysis.classification.classification import Classification


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
@options.option("--trials", options.COUNT, "Number of trials, if A or B has runs. Default: 1.", options.METHOD)
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
    trials: int | None,
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
    from tacbench_cad.lab.analysis.classification import MODULES
    from tacbench_cad.util.packages import require

    require("compare", *MODULES)
    from tacbench_cad.lab.analysis.compare import compare
    from tacbench_cad.util.files import locked

    chosen = estimators or ()
    if len(chosen) > 2:
        raise InputError("estimator", ",".join(chosen), "must be one name, or one for A and one for B")
    if names is not None and len(set(names)) != 2:
        raise InputError("names", ",".join(names), "must be two different names, one for A and one for B")
    if a.resolve() == b.resolve() and len(set(chosen)) < 2:
        raise InputError("B", str(b), "is the same folder as A; name the study of the other sensor, or two estimators")
    with locked(out):
        first, second = (
            _classified(folder, out / f"classification_{side}", trials, jobs, dask)
            for side, folder in (("a", a), ("b", b))
        )
        used = (chosen or first.settings.estimators)[0], (chosen or first.settings.estimators[:1])[-1]
        # The first pair of names that differ: of the sensors, of the folders, their paths, or the estimators.
        pairs = [names, (first.record.sensor, second.record.sensor), (a.resolve().name, b.resolve().name)]
        pairs += [(str(a), str(b)), used]
        shown = next(pair for pair in pairs if pair and all(pair) and len(set(pair)) == 2)
        comparison = compare(first, second, estimators=used, names=(shown[0], shown[1]), same_prints=not unpaired)
        files = comparison.save(out)
    if json:
        print_json({**comparison.document(), "files": [str(path) for path in files]})
        return
    print_simulated(comparison.simulated)
    for _, table in comparison.shown():
        show_table(table)
    print_lines(*(f"note: {text}" for text in comparison.notes))
    click.echo(f"{counted(len(files), 'file')} in {out}")


def _classified(folder: Path, target: Path, trials: int | None, jobs: int, dask: str | None) -> Classification:
    """Open the classification in a folder, or classify the runs in it into another folder."""
    from tacbench_cad.lab.analysis.classification.classification import SETTINGS_FILE, Classification
    from tacbench_cad.lab.analysis.classification.classify import classify
    from tacbench_cad.lab.runs.press_table import read

    if (folder / SETTINGS_FILE).is_file():
        return Classification.open(folder)
    presses = read(folder)
    note(f"classifying {folder}: {counted(len(presses), 'press')}")
    result = classify(presses, trials=trials, folder=target, jobs=jobs, dask=dask)
    result.save(target)
    return result
