"""``tacbench classify``: which textures the sensor distinguishes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from tacbench_cad.cli import options
from tacbench_cad.cli.common import print_json, print_lines, print_simulated, show_table
from tacbench_cad.cli.progress import ProgressLine
from tacbench_cad.util.errors import InputError

if TYPE_CHECKING:
    from tacbench_cad.lab.analysis.classification.augment import Augmentation


@options.command("classify")
@options.runs
@options.option(
    "--protocol",
    options.text("leak-free|paper"),
    "Groups held out whole, or what the paper's text says.",
    default="leak-free",
)
@options.look
@options.option(
    "--estimator",
    options.NAMES,
    "forest, network, or your own scikit-learn estimator or pipeline as module:name. Default: forest; of the "
    "paper's protocol forest,network.",
    dest="estimators",
)
@options.option("--trials", options.COUNT, "Trials that are averaged. Default: 5; of the paper's protocol 20.")
@options.option("--seed", options.COUNT, "Fixes every number.", default="0")
@options.option(
    "--hold-out", options.NAMES, "Of press,position,force,copy,printer-filament. Default: all that the data support."
)
@options.option("--folds", options.COUNT, "Folds of presses and of positions.", default="5")
@options.option(
    "--train-on",
    options.NAMES,
    "Combinations that the paper's protocol trains on, one at a time: bambu-p1p_pla-minus. Default: the paper's "
    "three where they are there, else all.",
)
@options.option("--force-level", options.LEVEL, "Use the presses of one force level only.", default="all")
@options.option(
    "--resolution",
    options.Value("FRACTION", options.number_of),
    "Fraction of an image's width and height that is kept.",
    default="0.4",
)
@options.option(
    "--components",
    options.or_none(options.COUNT),
    "Principal components that the estimator gets; none: the readings themselves. Default: 25, and none for an "
    "estimator of your own.",
)
@options.option(
    "--noise",
    options.or_none(options.Value("SIGMA", options.number_of)),
    "Noise of one copy of each training reading. Default: 5 for images.",
)
@options.option(
    "--brightness",
    options.or_none(options.Value("A,B", options.numbers_of)),
    "Added to one more copy each. Default: 10,-10 for images.",
)
@options.flag("--clip", "Clip the copies to 0 to 255 (paper's protocol; the text leaves it open).")
@options.option("--epochs", options.COUNT, "Epochs of the network.", default="1500")
@options.option("--batch-size", options.COUNT, "Rows of a step of the network; the text gives none.", default="200")
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
    protocol: Literal["leak-free", "paper"],
    estimators: tuple[str, ...] | None,
    trials: int | None,
    hold_out: tuple[str, ...] | None,
    train_on: tuple[str, ...] | None,
    force_level: int | str,
    components: Any,
    noise: Any,
    brightness: Any,
    sweep: str | None,
    jobs: int,
    dask: str | None,
    out: Path,
    json: bool,
    **settings: Any,
) -> None:
    """Classify textures from the readings, and state what was held out of the training.

    leak-free (default) makes copies of readings, scales and finds principal components inside each training fold. It
    holds out whole groups: presses, positions, a force, a copy, a printer and filament. A hold-out level that the data
    cannot support is left out and named. paper does what the paper's text says, prints the paper's figures beside ours,
    and warns of what inflates its test column.

    OUT holds classification.csv, confusion.csv, predictions.csv and figures as PNG and PDF; with --sweep, sweep.csv
    and its curve. Each finished trial is kept in OUT/trials: after an interruption the same command resumes.

    Examples:
      tacbench classify runs
      tacbench classify runs --protocol paper -o paper-classification
      tacbench classify runs --estimator my_model:pipeline --hold-out copy,printer-filament
      tacbench classify runs --features markers
      tacbench classify runs --sweep resolution=0.025:0.475 --hold-out copy
    """
    from tacbench_cad.lab.analysis.classification.classify import MODULES, TRIALS, classify, write_tables
    from tacbench_cad.lab.analysis.classification.figures import draw_result
    from tacbench_cad.lab.analysis.classification.settings import ClassificationSettings
    from tacbench_cad.lab.analysis.classification.splits import HOLD_OUT_LEVELS
    from tacbench_cad.lab.analysis.classification.sweep import Sweep, run_sweep
    from tacbench_cad.lab.analysis.collection import Collection
    from tacbench_cad.lab.parallel import workers
    from tacbench_cad.lab.rig.plugin import is_plugin
    from tacbench_cad.lab.rig.sensor import is_image
    from tacbench_cad.util.files import locked
    from tacbench_cad.util.packages import require

    if hold_out is not None and protocol == "paper":
        what = "is for --protocol leak-free; the paper's has train, test and unseen"
        raise InputError("hold-out", ",".join(hold_out), what)
    if train_on is not None and protocol == "leak-free":
        what = "is for --protocol paper; leak-free holds out each group in turn"
        raise InputError("train-on", ",".join(train_on), what)
    swept = None if sweep is None else Sweep.parsed(sweep)
    estimators = estimators or (("forest", "network") if protocol == "paper" else ("forest",))
    own = protocol == "leak-free" and any(is_plugin(name) for name in estimators)
    require("classify", *MODULES)
    collection = Collection.open(runs)
    if isinstance(force_level, int):
        collection = collection.at_level(force_level)
    how = ClassificationSettings(
        protocol=protocol,
        estimators=estimators,
        components=(None if own else 25) if components is None else None if components == "none" else components,
        augmentation=_augmentation(
            noise, brightness, settings["features"] == "pixels" and is_image(collection.frame(0))
        ),
        hold_out=hold_out or HOLD_OUT_LEVELS,
        train_on=train_on or (),
        **settings,
    )
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


def _augmentation(noise: Any, brightness: Any, image: bool) -> Augmentation:
    from tacbench_cad.lab.analysis.classification.augment import Augmentation

    usual = Augmentation() if image else Augmentation(noise=None, brightness=())
    return Augmentation(
        noise=usual.noise if noise is None else None if noise == "none" else noise,
        brightness=usual.brightness if brightness is None else () if brightness == "none" else brightness,
    )
