"""``tacbench classify``: what the sensor can tell apart."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tacbench_cad.cli.common import (
    Dask,
    Jobs,
    console,
    given,
    jobs_of,
    number_of,
    print_json,
    print_simulated,
    table,
    whole_of,
    words_of,
)
from tacbench_cad.cli.progress import ProgressLine
from tacbench_cad.util.errors import InputError

if TYPE_CHECKING:
    from tacbench_cad.lab.analysis.classification.accuracy import Score
    from tacbench_cad.lab.analysis.classification.classify import Result
    from tacbench_cad.lab.analysis.classification.settings import Settings
    from tacbench_cad.lab.analysis.classification.sweep import SweepResult

NAME = "classify"


def command(
    runs: Annotated[
        list[Path],
        typer.Argument(metavar="RUNS", help="Run folders, or folders that hold some.", show_default=False),
    ],
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="OUT", help="Folder of tables, figures and finished trials.")
    ] = Path("classification"),
    protocol: Annotated[
        str, typer.Option(metavar="sound|paper", help="Groups held out whole, or what the paper's text says.")
    ] = "sound",
    estimator: Annotated[
        str | None,
        typer.Option(
            metavar="NAME,...",
            help="forest, network, or your own scikit-learn estimator or pipeline as module:name. Default: forest; of "
            "the paper's protocol forest,network.",
        ),
    ] = None,
    trials: Annotated[
        str | None, typer.Option(metavar="N", help="Trials that are averaged. Default: 5; of the paper's protocol 20.")
    ] = None,
    seed: Annotated[str, typer.Option(metavar="N", help="Fixes every number.")] = "0",
    rungs: Annotated[
        str | None,
        typer.Option(
            metavar="NAME,...",
            help="Of press,position,force,copy,printer-filament. Default: all that the data support.",
        ),
    ] = None,
    folds: Annotated[str, typer.Option(metavar="N", help="Folds of presses and of positions.")] = "5",
    train_on: Annotated[
        str | None,
        typer.Option(
            metavar="NAME,...",
            help="Combinations that the paper's protocol trains on, one at a time: bambu-p1p_pla-minus. Default: the "
            "paper's three where they are there, else all.",
        ),
    ] = None,
    force_level: Annotated[str, typer.Option(metavar="all|N", help="Use the presses of one force level only.")] = "all",
    resolution: Annotated[
        str, typer.Option(metavar="SHARE", help="Share of an image's width and height that is kept.")
    ] = "0.4",
    components: Annotated[
        str | None,
        typer.Option(
            metavar="N|none",
            help="Principal components that the estimator gets; none: the readings themselves. Default: 25, and none "
            "for an estimator of your own.",
        ),
    ] = None,
    noise: Annotated[
        str | None,
        typer.Option(metavar="SIGMA|none", help="Noise of one copy of each training reading. Default: 5 for images."),
    ] = None,
    brightness: Annotated[
        str | None,
        typer.Option(metavar="A,B|none", help="Added to one more copy each. Default: 10,-10 for images."),
    ] = None,
    clip: Annotated[
        bool, typer.Option("--clip", help="Clip the copies to 0 to 255 (paper's protocol; the text leaves it open).")
    ] = False,
    epochs: Annotated[str, typer.Option(metavar="N", help="Epochs of the network.")] = "1500",
    batch_size: Annotated[
        str, typer.Option(metavar="N", help="Rows of a step of the network; the text gives none.")
    ] = "200",
    depth: Annotated[str, typer.Option(metavar="N", help="Largest depth of the forest's trees.")] = "50",
    sweep: Annotated[
        str | None,
        typer.Option(
            metavar="NAME=LOW:HIGH",
            help="A curve over resolution, components, copies (in training) or forces: resolution=0.025:0.475; a third "
            "number says how many values (10), A,B,C names them.",
        ),
    ] = None,
    jobs: Jobs = None,
    dask: Dask = None,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON document.")] = False,
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
        raise InputError("rungs", rungs, "are of --protocol sound; the paper's has train, test and unseen")
    if train_on is not None and protocol == "sound":
        raise InputError("train-on", train_on, "is of --protocol paper; sound holds out each group in turn")
    wanted = None if sweep is None else Sweep.parsed(sweep)
    estimators = words_of(estimator) or (("forest", "network") if protocol == "paper" else ("forest",))
    own = protocol == "sound" and any(is_plugin(name) for name in estimators)
    level = None if force_level == "all" else whole_of("force-level", force_level)
    count = given(whole_of, "trials", trials)
    require("classify", *MODULES)
    collection = Collection.open(runs)
    if level is not None:
        collection = at_level(collection, level)
    settings = Settings(
        protocol=protocol,
        estimators=estimators,
        resolution=number_of("resolution", resolution),
        components=_components(components, own),
        augmentation=_augmentation(noise, brightness, is_image(collection.frame(0))),
        clip=clip,
        seed=whole_of("seed", seed),
        rungs=words_of(rungs) or RUNGS,
        folds=whole_of("folds", folds),
        epochs=whole_of("epochs", epochs),
        batch_size=whole_of("batch-size", batch_size),
        depth=whole_of("depth", depth),
        train_on=words_of(train_on) or (),
    )
    processes = jobs_of(jobs)
    count = TRIALS[protocol] if count is None else count
    with locked(out), workers(processes, dask) as team, ProgressLine() as progress:
        if wanted is not None:
            swept = run_sweep(collection, settings, wanted, count, out, team, progress.show)
            paths = [write_sweep(swept, out), *draw_sweep(swept, out, collection.simulated)]
        else:
            result = classify(collection, settings, count, out, team, progress.show)
            paths = [*write_tables(result, out), *draw_result(result, out)]
    if wanted is not None:
        _show_sweep(swept, collection.simulated, paths, json)
    else:
        _show(result, paths, json)


def _components(text: str | None, own: bool) -> int | None:
    if text is None:
        return None if own else 25
    return None if text == "none" else whole_of("components", text)


def _augmentation(noise: str | None, brightness: str | None, image: bool) -> Any:
    from tacbench_cad.lab.analysis.classification.augment import Augmentation

    usual = Augmentation() if image else Augmentation(noise=None, brightness=())
    sigma = usual.noise if noise is None else None if noise == "none" else number_of("noise", noise)
    levels = usual.brightness
    if brightness is not None:
        words = () if brightness == "none" else words_of(brightness) or ()
        levels = tuple(number_of("brightness", word) for word in words)
    return Augmentation(noise=sigma, brightness=levels)


def _percent(value: float | None) -> str:
    return "" if value is None else f"{100 * value:.1f}"


def _band(score: Score) -> str:
    if score.low is None or score.high is None:
        return "none (one unit)"
    return f"{100 * score.low:.1f} to {100 * score.high:.1f}"


def _show(result: Result, paths: list[Path], json: bool) -> None:
    if json:
        print_json(_document(result, paths))
        return
    screen = console()
    print_simulated(screen, result.collection.simulated)
    if result.settings.protocol == "paper":
        _print_paper(result)
    right = ("accuracy", "spread", "95 % interval", "trials", "images")
    head = ("estimator", "rung", "trained on", "tested on", "accuracy", "spread", "95 % interval", "units", *right[3:])
    title = f"protocol {result.settings.protocol}, per cent; chance is {100 * result.chance:.1f}"
    shown = table(title, *head, right=right)
    for one in result.scores:
        shown.add_row(
            *(one.estimator, one.rung, one.train_on, one.tested_on, _percent(one.accuracy), _percent(one.spread)),
            *(_band(one), one.units, str(one.trials), f"{one.images:,}"),
        )
    screen.print(shown)
    recalls = table("recall of each texture, per cent", "estimator", "rung", "trained on", *result.textures)
    for one in result.scores:
        if one.tested_on in ("all", "all others", one.train_on):
            recalls.add_row(one.estimator, one.rung, one.train_on, *(_percent(value) for value in one.recall))
    screen.print(recalls)
    _print_end(result.notes, paths)


def _print_paper(result: Result) -> None:
    from tacbench_cad.lab.analysis.classification.classify import beside_paper

    columns = [f"{name}, {whose}" for name in ("train", "test", "unseen") for whose in ("ours", "paper")]
    shown = table("the paper's table beside ours, per cent", "estimator", "trained on", *columns, right=columns)
    for one in beside_paper(result):
        pairs = zip(one.ours, one.paper, strict=True)
        cells = ["-" if value is None else f"{value:.2f}" for pair in pairs for value in pair]
        shown.add_row(one.estimator, one.train_on, *cells)
    console().print(shown)


def _print_end(notes: tuple[str, ...], paths: list[Path]) -> None:
    screen = console()
    for line in notes:
        screen.print(f"note: {line}", soft_wrap=True)
    screen.print(f"written to {paths[0].parent}: " + ", ".join(path.name for path in paths), soft_wrap=True)


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


def _show_sweep(result: SweepResult, simulated: tuple[str, ...], paths: list[Path], json: bool) -> None:
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
    screen = console()
    print_simulated(screen, simulated)
    right = (parameter, "accuracy", "spread", "95 % interval", "images")
    shown = table(
        f"protocol {result.settings.protocol}, per cent; chance is {100 / result.textures:.1f}",
        *("estimator", "rung", "trained on", *right),
        right=right,
    )
    for value, one in result.points:
        words = (one.estimator, one.rung, one.train_on, f"{value:g}")
        shown.add_row(*words, _percent(one.accuracy), _percent(one.spread), _band(one), f"{one.images:,}")
    screen.print(shown)
    _print_end(result.notes, paths)
