"""``tacbench classify``: what the sensor can tell apart."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tacbench_cad.cli import options
from tacbench_cad.cli.common import print_json, print_lines, print_simulated, print_table
from tacbench_cad.cli.progress import ProgressLine
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import interval

if TYPE_CHECKING:
    from tacbench_cad.lab.analysis.classification.accuracy import Score
    from tacbench_cad.lab.analysis.classification.augment import Augmentation
    from tacbench_cad.lab.analysis.classification.classify import Result
    from tacbench_cad.lab.analysis.classification.settings import Settings
    from tacbench_cad.lab.analysis.classification.sweep import SweepResult


@options.command("classify")
@options.runs
@options.option(
    "--protocol",
    kind=options.text("sound|paper"),
    default="sound",
    help="Groups held out whole, or what the paper's text says.",
)
@options.option(
    "--estimator",
    dest="estimators",
    kind=options.NAMES,
    help="forest, network, or your own scikit-learn estimator or pipeline as module:name. Default: forest; of the "
    "paper's protocol forest,network.",
)
@options.option(
    "--trials", kind=options.COUNT, help="Trials that are averaged. Default: 5; of the paper's protocol 20."
)
@options.option("--seed", kind=options.COUNT, default="0", help="Fixes every number.")
@options.option(
    "--rungs",
    kind=options.NAMES,
    help="Of press,position,force,copy,printer-filament. Default: all that the data support.",
)
@options.option("--folds", kind=options.COUNT, default="5", help="Folds of presses and of positions.")
@options.option(
    "--train-on",
    kind=options.NAMES,
    help="Combinations that the paper's protocol trains on, one at a time: bambu-p1p_pla-minus. Default: the paper's "
    "three where they are there, else all.",
)
@options.option("--force-level", kind=options.LEVEL, default="all", help="Use the presses of one force level only.")
@options.option(
    "--resolution",
    kind=options.Value("SHARE", options.number_of),
    default="0.4",
    help="Share of an image's width and height that is kept.",
)
@options.option(
    "--components",
    kind=options.or_none(options.COUNT),
    help="Principal components that the estimator gets; none: the readings themselves. Default: 25, and none for an "
    "estimator of your own.",
)
@options.option(
    "--noise",
    kind=options.or_none(options.Value("SIGMA", options.number_of)),
    help="Noise of one copy of each training reading. Default: 5 for images.",
)
@options.option(
    "--brightness",
    kind=options.or_none(options.Value("A,B", options.numbers_of)),
    help="Added to one more copy each. Default: 10,-10 for images.",
)
@options.flag("--clip", help="Clip the copies to 0 to 255 (paper's protocol; the text leaves it open).")
@options.option("--epochs", kind=options.COUNT, default="1500", help="Epochs of the network.")
@options.option(
    "--batch-size", kind=options.COUNT, default="200", help="Rows of a step of the network; the text gives none."
)
@options.option("--depth", kind=options.COUNT, default="50", help="Largest depth of the forest's trees.")
@options.option(
    "--sweep",
    kind=options.text("NAME=LOW:HIGH"),
    help="A curve over resolution, components, copies (in training) or forces: resolution=0.025:0.475; a third number "
    "says how many values (10), A,B,C names them.",
)
@options.jobs
@options.dask
@options.out("OUT", "Folder of tables, figures and finished trials.", default="classification")
@options.json
def command(
    runs: tuple[Path, ...],
    protocol: str,
    estimators: tuple[str, ...] | None,
    trials: int | None,
    rungs: tuple[str, ...] | None,
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
    """What can the sensor tell apart? Textures classified from the readings, with what is held out said plainly.

    sound (default) makes copies of readings, scales and finds principal components inside each training fold, and
    holds out whole groups in a ladder: presses, positions, a force, a copy, a printer and filament. A rung that the
    data cannot support is left out and named. paper does what the paper's text says, prints the paper's figures beside
    ours, and warns of what inflates its test column.

    OUT holds classification.csv, confusion.csv, predictions.csv and figures as PNG and PDF; with --sweep, sweep.csv
    and its curve. Each finished trial is kept in OUT/trials: after an interruption the same command goes on.

    Examples:
      tacbench classify runs
      tacbench classify runs --protocol paper -o paper-classification
      tacbench classify runs --estimator my_model:pipeline --rungs copy,printer-filament
      tacbench classify runs --sweep resolution=0.025:0.475 --rungs copy
    """
    from tacbench_cad.lab.analysis.classification.classify import MODULES, TRIALS, classify, write_tables
    from tacbench_cad.lab.analysis.classification.figures import draw_result, draw_sweep
    from tacbench_cad.lab.analysis.classification.settings import Settings
    from tacbench_cad.lab.analysis.classification.splits import RUNGS
    from tacbench_cad.lab.analysis.classification.sweep import Sweep, at_level, run_sweep, write_sweep
    from tacbench_cad.lab.analysis.collection import Collection
    from tacbench_cad.lab.parallel import workers
    from tacbench_cad.lab.rig.plugin import is_plugin
    from tacbench_cad.lab.rig.sensor import is_image
    from tacbench_cad.util.files import locked
    from tacbench_cad.util.packages import require

    if rungs is not None and protocol == "paper":
        raise InputError("rungs", ",".join(rungs), "are of --protocol sound; the paper's has train, test and unseen")
    if train_on is not None and protocol == "sound":
        raise InputError("train-on", ",".join(train_on), "is of --protocol paper; sound holds out each group in turn")
    swept = None if sweep is None else Sweep.parsed(sweep)
    estimators = estimators or (("forest", "network") if protocol == "paper" else ("forest",))
    own = protocol == "sound" and any(is_plugin(name) for name in estimators)
    require("classify", *MODULES)
    collection = Collection.open(runs)
    if isinstance(force_level, int):
        collection = at_level(collection, force_level)
    how = Settings(
        protocol=protocol,
        estimators=estimators,
        components=(None if own else 25) if components is None else None if components == "none" else components,
        augmentation=_augmentation(noise, brightness, is_image(collection.frame(0))),
        rungs=rungs or RUNGS,
        train_on=train_on or (),
        **settings,
    )
    trials = TRIALS[protocol] if trials is None else trials
    with locked(out), workers(jobs, dask) as team, ProgressLine() as progress:
        if swept is not None:
            curve = run_sweep(collection, how, swept, trials, out, team, progress.show)
            paths = [write_sweep(curve, out), *draw_sweep(curve, out, collection.simulated)]
        else:
            result = classify(collection, how, trials, out, team, progress.show)
            paths = [*write_tables(result, out), *draw_result(result, out)]
    if swept is not None:
        _show_sweep(curve, collection.simulated, paths, json)
    else:
        _show(result, paths, json)


def _augmentation(noise: Any, brightness: Any, image: bool) -> Augmentation:
    from tacbench_cad.lab.analysis.classification.augment import Augmentation

    usual = Augmentation() if image else Augmentation(noise=None, brightness=())
    return Augmentation(
        noise=usual.noise if noise is None else None if noise == "none" else noise,
        brightness=usual.brightness if brightness is None else () if brightness == "none" else brightness,
    )


def _percent(value: float | None) -> str:
    return "" if value is None else f"{100 * value:.1f}"


def _band(score: Score) -> str:
    if score.low is None or score.high is None:
        return "none (one unit)"
    return interval(100.0 * score.low, 100.0 * score.high)


def _show(result: Result, paths: list[Path], json: bool) -> None:
    if json:
        print_json(_document(result, paths))
        return
    print_simulated(result.collection.simulated)
    if result.settings.protocol == "paper":
        _print_paper(result)
    print_table(
        f"protocol {result.settings.protocol}, per cent; chance is {100 * result.chance:.1f}",
        (
            *("estimator", "rung", "trained on", "tested on", ">accuracy", ">spread", ">95 % interval", "units"),
            *(">trials", ">images"),
        ),
        [
            (
                *(one.estimator, one.rung, one.train_on, one.tested_on, _percent(one.accuracy), _percent(one.spread)),
                *(_band(one), one.units, one.trials, f"{one.images:,}"),
            )
            for one in result.scores
        ],
    )
    print_table(
        "recall of each texture, per cent",
        ("estimator", "rung", "trained on", *result.textures),
        [
            (one.estimator, one.rung, one.train_on, *map(_percent, one.recall))
            for one in result.scores
            if one.tested_on in ("all", "all others", one.train_on)
        ],
    )
    _print_end(result.notes, paths)


def _print_paper(result: Result) -> None:
    from tacbench_cad.lab.analysis.classification.classify import beside_paper

    columns = [f">{name}, {whose}" for name in ("train", "test", "unseen") for whose in ("ours", "paper")]
    rows = []
    for one in beside_paper(result):
        values = [value for pair in zip(one.ours, one.paper, strict=True) for value in pair]
        rows.append((one.estimator, one.train_on, *("-" if value is None else f"{value:.2f}" for value in values)))
    print_table("the paper's table beside ours, per cent", ("estimator", "trained on", *columns), rows)


def _print_end(notes: Sequence[str], paths: list[Path]) -> None:
    print_lines(*(f"note: {line}" for line in notes))
    print_lines(f"written to {paths[0].parent}: " + ", ".join(path.name for path in paths))


def _score_document(score: Score) -> dict[str, Any]:
    names = ("estimator", "train_on", "tested_on", "rung", "accuracy", "spread", "low", "high", "units")
    return {name: getattr(score, name) for name in (*names, "trials", "images", "recall")}


def _settings_document(settings: Settings) -> dict[str, Any]:
    from dataclasses import asdict

    return asdict(settings)


def _document(result: Result, paths: list[Path]) -> dict[str, Any]:
    from dataclasses import asdict

    from tacbench_cad.lab.analysis.classification.classify import beside_paper

    return {
        "simulated": list(result.collection.simulated),
        "settings": _settings_document(result.settings),
        "textures": list(result.textures),
        "chance": result.chance,
        "scores": [_score_document(one) for one in result.scores],
        "beside_paper": [asdict(one) for one in beside_paper(result)] if result.settings.protocol == "paper" else [],
        "notes": list(result.notes),
        "files": [str(path) for path in paths],
    }


def _show_sweep(result: SweepResult, simulated: Sequence[str], paths: list[Path], json: bool) -> None:
    parameter = result.sweep.parameter
    if json:
        points = [{parameter: value, **_score_document(score)} for value, score in result.points]
        print_json(
            {
                "simulated": list(simulated),
                "settings": _settings_document(result.settings),
                "parameter": parameter,
                "points": points,
                "notes": list(result.notes),
                "files": [str(path) for path in paths],
            }
        )
        return
    print_simulated(simulated)
    print_table(
        f"protocol {result.settings.protocol}, per cent; chance is {100 / result.textures:.1f}",
        ("estimator", "rung", "trained on", f">{parameter}", ">accuracy", ">spread", ">95 % interval", ">images"),
        [
            (
                *(one.estimator, one.rung, one.train_on, f"{value:g}"),
                *(_percent(one.accuracy), _percent(one.spread), _band(one), f"{one.images:,}"),
            )
            for value, one in result.points
        ],
    )
    _print_end(result.notes, paths)
