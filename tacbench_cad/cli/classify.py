"""``tacbench classify``: which textures the sensor distinguishes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from tacbench_cad.cli import options
from tacbench_cad.cli.common import print_json, print_lines, print_simulated, show_table
from tacbench_cad.cli.progress import ProgressLine
from tacbench_cad.util.errors import InputError


@options.command("classify")
@options.runs
@options.option(
    "--protocol",
    options.text("leak-free|paper|as-published"),
    "Groups held out whole; what the paper's text says; or what the cells did that gave the printed accuracies.",
    default="leak-free",
)
@options.look
@options.option(
    "--estimator",
    options.NAMES,
    "forest, network, or your own scikit-learn estimator or pipeline as module:name. Default: forest; of the "
    "protocol paper forest,network. as-published takes one.",
    dest="estimators",
)
@options.option("--trials", options.COUNT, "Trials that are averaged. Default: 5; of the paper's protocols 20.")
@options.option("--seed", options.COUNT, "Fixes every number.", default="0")
@options.option(
    "--hold-out",
    options.NAMES,
    "Of press,position,force,copy,printer-filament,session. Default: all that the data support.",
)
@options.option("--folds", options.COUNT, "Folds of presses and of positions.", default="5")
@options.option(
    "--train-on",
    options.NAMES,
    "Combinations that the paper's protocols train on, one at a time: bambu-p1p_pla-minus. Default: the paper's "
    "three where they are there, else all.",
)
@options.option(
    "--force-level",
    options.LEVEL,
    "Use the presses of one force level only. Default: all; with as-published the lowest.",
    default="all",
)
@options.option(
    "--resolution",
    options.Value("FRACTION", options.number_of),
    "Fraction of an image's width and height that is kept.",
    default="0.4",
)
@options.option(
    "--components",
    options.or_none(options.COUNT),
    "Principal components that the estimator gets; none: the readings themselves. Default: 25 (of fewer than 100 "
    "readings a quarter of their number), none for an estimator of your own, 45 for the network as published.",
)
@options.option(
    "--noise",
    options.or_none(options.Value("SIGMA", options.number_of)),
    "Noise of one copy of each training reading. Default: 5 for images.",
)
@options.option(
    "--brightness",
    options.or_none(options.Value("A,B", options.numbers_of)),
    "Added to one more copy each. Default: 10,-10 for images; as-published none.",
)
@options.flag("--clip", "Clip the copies to 0 to 255 (paper's protocol; the text leaves it open).")
@options.option("--epochs", options.COUNT, "Epochs of the network. Default: 1500; as-published 15000.")
@options.option(
    "--batch-size", options.COUNT, "Rows of a step of the network; the text gives none. Default: 200; as-published 64."
)
@options.option("--depth", options.COUNT, "Largest depth of the forest's trees.", default="50")
@options.option(
    "--sweep",
    options.text("NAME=LOW:HIGH"),
    "A curve over resolution, components, copies (in training) or forces: resolution=0.025:0.475; a third number "
    "says how many values (10), A,B,C names them.",
)
@options.jobs
@options.dask
@options.out("OUT", "Folder of tables, figures and finished trials.", default="classification")
@options.json
def command(
    runs: tuple[Path, ...],
    protocol: Literal["leak-free", "paper", "as-published"],
    estimators: tuple[str, ...] | None,
    trials: int | None,
    hold_out: tuple[str, ...] | None,
    train_on: tuple[str, ...] | None,
    force_level: int | str,
    components: Any,
    noise: Any,
    brightness: Any,
    epochs: int | None,
    batch_size: int | None,
    sweep: str | None,
    jobs: int,
    dask: str | None,
    out: Path,
    json: bool,
    **settings: Any,
) -> None:
    """Classify textures from the readings, and state what was held out of the training.

    leak-free (default) makes copies of readings, scales and finds principal components inside each training fold. It
    holds out whole groups: presses, positions, a force, a copy, a printer and filament, a session. A hold-out level
    that the data cannot support is left out and named. paper does what the paper's text says, and warns of what
    inflates its test column. as-published does what the cells of the authors' notebooks did that gave the paper's
    table, and sets that table beside ours: trained on copy 1 of one combination at one force, on edges, tested on all
    its copies, copy 1 included. A column without copy 1 says what is left.

    OUT holds classification.csv, confusion.csv, predictions.csv and figures as PNG and PDF; with --sweep, sweep.csv
    and its curve. Each finished trial is kept in OUT/trials: after an interruption the same command resumes.

    Examples:
      tacbench classify runs
      tacbench classify runs --protocol as-published -o as-published
      tacbench classify runs --protocol as-published --estimator network -o network-as-published
      tacbench classify runs --protocol paper -o paper-classification
      tacbench classify runs --estimator my_model:pipeline --hold-out copy,printer-filament
      tacbench classify runs --features markers
      tacbench classify runs --sweep resolution=0.025:0.475 --hold-out copy
    """
    from tacbench_cad.lab.analysis.classification.classify import MODULES, TRIALS, classify, write_tables
    from tacbench_cad.lab.analysis.classification.figures import draw_result
    from tacbench_cad.lab.analysis.classification.settings import ClassificationSettings, usual
    from tacbench_cad.lab.analysis.classification.splits import levels_of
    from tacbench_cad.lab.analysis.classification.sweep import Sweep, run_sweep
    from tacbench_cad.lab.analysis.collection import Collection
    from tacbench_cad.lab.parallel import workers
    from tacbench_cad.lab.rig.sensor import is_image
    from tacbench_cad.util.files import locked
    from tacbench_cad.util.packages import require

    if hold_out is not None and protocol != "leak-free":
        what = "is for --protocol leak-free; the paper's have columns of their own"
        raise InputError("hold-out", ",".join(hold_out), what)
    if train_on is not None and protocol == "leak-free":
        what = "is for --protocol paper or as-published; leak-free holds out each group in turn"
        raise InputError("train-on", ",".join(train_on), what)
    swept = None if sweep is None else Sweep.parsed(sweep)
    estimators = estimators or (("forest", "network") if protocol == "paper" else ("forest",))
    require("classify", *MODULES)
    collection = Collection.open(runs)
    if protocol == "as-published" and force_level == "all" and (swept is None or swept.parameter != "forces"):
        force_level = collection.levels[0]
    if isinstance(force_level, int):
        collection = collection.at_level(force_level)
    image = settings["features"] == "pixels" and is_image(collection.frame(0))
    given = usual(protocol, estimators, image=image, readings=len(collection))
    copies = {"noise": noise, "brightness": () if brightness == "none" else brightness}
    given["augmentation"] = replace(given["augmentation"], **_given(copies))
    given |= _given({"components": components, "epochs": epochs, "batch_size": batch_size})
    levels = hold_out or levels_of(collection)
    how = ClassificationSettings(**given, **settings, hold_out=levels, train_on=train_on or ())
    trials = TRIALS[protocol] if trials is None else trials
    with locked(out), workers(jobs, dask) as executor, ProgressLine() as progress:
        if swept is not None:
            result = run_sweep(collection, how, swept, trials, out, executor, progress.show)
        else:
            result = classify(collection, how, trials, out, executor, progress.show)
        paths = [*write_tables(result, out), *draw_result(result, out)]
    if json:
        print_json({**result.document(), "files": [str(path) for path in paths]})
        return
    print_simulated(collection.simulated)
    for table in result.shown:
        show_table(table)
    print_lines(*(f"note: {line}" for line in result.notes))
    print_lines(f"written to {out}: " + ", ".join(path.name for path in paths))


def _given(options: Mapping[str, Any]) -> dict[str, Any]:
    """The options that were given; ``none`` as None."""
    return {name: None if value == "none" else value for name, value in options.items() if value is not None}
