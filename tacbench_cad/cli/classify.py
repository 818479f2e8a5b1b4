"""``tacbench classify``: measure how well a sensor distinguishes the textures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from tacbench_cad.cli import options
from tacbench_cad.cli.common import next_paths, print_json, print_lines, print_next, print_simulated, show_table
from tacbench_cad.cli.progress import ProgressLine
from tacbench_cad.util.errors import InputError

if TYPE_CHECKING:
    from tacbench_cad.lab.analysis.classification.classification import Classification
    from tacbench_cad.lab.analysis.classification.sweep import Sweep

#: What ``--sweep`` can vary; a test compares these words with those of the analysis.
SWEPT = ("resolution", "components", "copies", "forces", "frames")


@options.command("classify", "Analyse")
@options.runs
@options.option(
    "--protocol",
    options.text("NAME", "leak-free", "paper", "as-published"),
    "leak-free holds out whole groups. paper follows the text of the paper. as-published repeats the computation of "
    "the accuracies in the paper.",
    options.METHOD,
    default="leak-free",
)
@options.option(
    "--estimator",
    options.words("LIST", "forest", "network"),
    "forest, network, or a scikit-learn estimator of your own as module:name. Default: forest; for paper "
    "forest,network. as-published takes one estimator.",
    options.METHOD,
    dest="estimators",
)
@options.option(
    "--hold-out",
    options.words("LIST", *options.LEVELS),
    f"Hold-out levels of leak-free: {', '.join(options.LEVELS)}. Default: all that the data support.",
    options.METHOD,
)
@options.option(
    "--force-level",
    options.LEVEL,
    "Use one force level only. Default: all; for as-published the lowest.",
    options.METHOD,
    default="all",
    show_default=False,
)
@options.option(
    "--trials",
    options.COUNT,
    "Number of trials to average. Default: 1; for paper and as-published 20.",
    options.METHOD,
)
@options.look
@options.out("DIR", "Folder of tables, figures and finished trials.", default="classification")
@options.json
@options.jobs
@options.dask
@options.option(
    "--train-on",
    options.words("LIST"),
    "Combinations of printer and filament to train on, one after the other, for example bambu-p1p_pla-minus. Only for "
    "paper and as-published. Default: the three of the paper if your data have them, otherwise all.",
    options.ADVANCED,
)
@options.option(
    "--sweep",
    options.text("SWEEP", *(f"{name}=" for name in SWEPT)),
    "Draw the accuracy as a function of resolution, components, copies (in training), forces, or with --series of the "
    "frames that are used from the start of each series. Write NAME=LOW:HIGH for 10 values, NAME=LOW:HIGH:N for N "
    "values, or NAME=A,B,C.",
    options.ADVANCED,
    dest="swept",
)
@options.option(
    "--folds", options.COUNT, "Number of folds of the levels press and position.", options.ADVANCED, default="5"
)
@options.option(
    "--resolution",
    options.Value("FRACTION", options.number_of),
    "Size to which the images are reduced, as a fraction of their own size.",
    options.ADVANCED,
    default="0.4",
)
@options.option(
    "--components",
    options.or_none(options.COUNT),
    "Number of principal components, or none. Default: 25. There are three exceptions: a quarter of the samples if "
    "there are fewer than 100, none for your own estimator and for forces, and 45 for the network of as-published.",
    options.ADVANCED,
)
@options.option(
    "--noise",
    options.or_none(options.Value("SIGMA", options.number_of)),
    "Add a copy of each training sample with noise of this standard deviation. Default: none; for images with paper "
    "and as-published 5.",
    options.ADVANCED,
)
@options.option(
    "--brightness",
    options.or_none(options.Value("A,B", options.numbers_of)),
    "Add a copy of each training sample for each of these changes in brightness. Default: none; for images with paper "
    "10,-10.",
    options.ADVANCED,
)
@options.flag(
    "--clip", "Clip the added copies to 0 to 255. The paper does not say whether its authors clipped.", options.ADVANCED
)
@options.option("--depth", options.COUNT, "Maximum depth of the trees of the forest.", options.ADVANCED, default="50")
@options.option(
    "--epochs", options.COUNT, "Epochs of the network. Default: 1500; for as-published 15000.", options.ADVANCED
)
@options.option(
    "--batch-size",
    options.COUNT,
    "Batch size of the network. Default: 200; for as-published 64.",
    options.ADVANCED,
)
@options.option("--seed", options.COUNT, "Seed of all random numbers.", options.ADVANCED, default="0")
def command(
    runs: tuple[Path, ...],
    protocol: Literal["leak-free", "paper", "as-published"],
    estimators: tuple[str, ...] | None,
    trials: int | None,
    hold_out: tuple[str, ...] | None,
    train_on: tuple[str, ...] | None,
    force_level: int | str,
    features: str,
    series: bool,
    roi: str | None,
    resolution: float,
    components: Any,
    noise: Any,
    brightness: Any,
    swept: str | None,
    jobs: int,
    dask: str | None,
    out: Path,
    json: bool,
    **given: Any,
) -> None:
    """Measure how well the textures can be distinguished.

    A classifier is trained on some presses and tested on others. The protocol says how the presses are divided.

    The protocol leak-free (default) holds out whole groups: presses, positions, a force, a copy, a printer and
    filament, or a session. Scaling, principal components and added copies are computed from the training data of each
    fold only. If the data are not sufficient for a hold-out level, it is named and left out.

    The protocol paper follows the text of the paper. Its test accuracy is too high, and the output explains why.

    The protocol as-published repeats the computation of the authors' notebooks. The output has the table of the paper
    next to your result. The classifier is trained on copy 1 of one combination of printer and filament at one force
    level. An edge filter (Sobel) is applied to all images. The classifier is tested on all copies, including copy 1.
    One more column shows the result without copy 1, which was in training.

    If the protocol has a motion, --series classifies each press by all frames that were taken while the sensor slid
    in contact. To see what the motion adds, classify once with and once without this option, each into
    its own folder, and use "tacbench compare".

    The command writes classification.csv, confusion.csv, predictions.csv and figures (PNG, PDF) into the output folder,
    and with --sweep also sweep.csv and a curve. It stores each finished trial there, so the same command resumes after
    an interruption.

    Examples:
      tacbench classify runs
      tacbench classify runs --hold-out copy,printer-filament
      tacbench classify runs --features markers
      tacbench classify slides --series -o slide-classification
      tacbench classify runs --estimator my_model:pipeline
      tacbench classify runs --protocol paper -o paper-classification
      tacbench classify runs --protocol as-published -o as-published
      tacbench classify runs --sweep resolution=0.025:0.475 --hold-out copy
    """
    from tacbench_cad.lab.analysis.classification import MODULES
    from tacbench_cad.util.packages import require

    require("classify", *MODULES)
    from tacbench_cad.lab.analysis.classification.classify import classify
    from tacbench_cad.lab.analysis.classification.settings import default_settings
    from tacbench_cad.lab.analysis.classification.sweep import parsed, sweep
    from tacbench_cad.lab.analysis.feature import feature_of
    from tacbench_cad.lab.analysis.pixels import as_published
    from tacbench_cad.lab.analysis.study_design import Design, at_level
    from tacbench_cad.lab.runs.press_table import read
    from tacbench_cad.util.files import locked

    if hold_out and protocol != "leak-free":
        what = "is only for --protocol leak-free; the other protocols have their own test sets"
        raise InputError("hold-out", ",".join(hold_out), what)
    if train_on and protocol == "leak-free":
        what = "is only for --protocol paper and as-published; leak-free holds out each group in turn"
        raise InputError("train-on", ",".join(train_on), what)
    published = protocol == "as-published"
    if published and (series or features != "pixels" or roi is not None):
        what = "uses the pixels of whole images of presses; leave out --series, --features and --roi"
        raise InputError("protocol", protocol, what)
    parameter = None if swept is None else parsed(swept)[0]
    presses = read(runs, series=series)
    if published and force_level == "all" and parameter != "forces":
        force_level = Design.of(presses).levels[0]
    if isinstance(force_level, int):
        presses = at_level(presses, force_level)
    how = {"resolution": resolution, "roi": roi}
    feature = as_published(resolution, edges=True) if published else feature_of(features, **how)
    given |= {"hold_out": hold_out, "train_on": train_on}
    given |= {"noise": noise, "brightness": () if brightness == "none" else brightness, "components": components}
    known = {name: None if value == "none" else value for name, value in given.items() if value is not None}
    settings = default_settings(Design.of(presses), feature, protocol, estimators or (), **known)
    with locked(out), ProgressLine() as progress:
        more: dict[str, Any] = {"trials": trials, "folder": out, "jobs": jobs, "dask": dask, "progress": progress.show}
        result: Classification | Sweep = (
            classify(presses, feature, settings, **more)
            if swept is None
            else sweep(presses, swept, feature, settings, **more)
        )
        paths = result.save(out)
    if json:
        print_json({**result.document(), "files": [str(path) for path in paths]})
        return
    print_simulated(result.record.simulated)
    for _, table in result.shown():
        show_table(table)
    print_lines(*(f"note: {line}" for line in result.notes))
    print_lines(f"written to {out}: " + ", ".join(path.name for path in paths))
    if swept is None:
        print_next("report", *next_paths(runs), "--classify", out)
