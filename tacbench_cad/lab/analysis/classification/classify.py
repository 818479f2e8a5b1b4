"""Classifications from beginning to end: trials that are kept as they finish, tables, predictions."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tacbench_cad import __version__
from tacbench_cad.lab.analysis import published
from tacbench_cad.lab.analysis.classification.accuracy import Score, paper_scores, sound_scores
from tacbench_cad.lab.analysis.classification.features import Features, read_features
from tacbench_cad.lab.analysis.classification.leak_free import Task, folds_of, sound_trial
from tacbench_cad.lab.analysis.classification.paper_protocol import WARNING, batches, paper_trials, require_possible
from tacbench_cad.lab.analysis.classification.pca import Products
from tacbench_cad.lab.analysis.classification.settings import ESTIMATORS, Outcome, Settings, data_key, one_thread
from tacbench_cad.lab.analysis.classification.splits import UNITS, PressTable
from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.csvfile import write_csv
from tacbench_cad.lab.analysis.preprocess import Preprocess
from tacbench_cad.lab.parallel import Team
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.files import refusing, replacing

#: Trials by protocol where nothing else is said; the paper's are the text's.
TRIALS = {"sound": 5, "paper": published.TRIALS}
#: What classifying, and drawing what comes of it, imports beside the base install.
MODULES = ("sklearn", "joblib", "cv2", "matplotlib")
#: Where finished trials are kept, in the output folder.
TRIALS_FOLDER = "trials"
#: What was asked for, beside the tables.
SETTINGS_FILE = "classification_settings.json"
#: Heads of ``classification.csv``.
COLUMNS = ["protocol", "estimator", "train_on", "tested_on", "rung", "accuracy", "low", "high", "trials", "images"]
#: Heads of ``confusion.csv``.
CONFUSION_COLUMNS = ["protocol", "estimator", "train_on", "tested_on", "rung", "texture", "predicted", "count", "share"]
#: Heads of ``predictions.csv``.
PREDICTION_COLUMNS = (
    *("protocol", "estimator", "train_on", "tested_on", "rung", "trial"),
    *("run", "press", "augmentation", "texture", "predicted"),
)

#: Called with what is counted, how many are done, and how many there are (0: nobody knows).
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, kw_only=True, eq=False)
class Result:
    """A classification.

    Args:
        settings: What decided it.
        textures: The textures, sorted.
        outcomes: What the estimators said.
        scores: The table.
        notes: Warnings, rungs that are left out, and what was taken where the paper is open.
        presses: What is known of each press.
        collection: The data.
    """

    settings: Settings
    textures: tuple[str, ...]
    outcomes: tuple[Outcome, ...]
    scores: tuple[Score, ...]
    notes: tuple[str, ...]
    presses: PressTable
    collection: Collection

    @property
    def chance(self) -> float:
        """The accuracy of guessing."""
        return 1.0 / len(self.textures)


def classify(
    collection: Collection, settings: Settings, trials: int, out: Path, team: Team, progress: Progress | None = None
) -> Result:
    """Run a classification, or what of it is missing.

    Args:
        collection: The presses.
        settings: What decides every number.
        trials: How many trials.
        out: Folder, held by the caller, that keeps each finished trial in ``trials/``.
        team: Processes.
        progress: Told of readings and trials.

    Raises:
        InputError: The data or the settings do not allow it, or an estimator raises.
        CheckFailedError: A reading is damaged.
    """
    if trials < 1:
        raise InputError("trials", trials, "must be at least 1")
    presses = PressTable.of(collection)
    if settings.protocol == "paper":
        settings = replace(settings, train_on=settings.train_on or default_train_on(collection))
    notes = _notes(collection, presses, settings)
    for name in settings.estimators:
        settings.estimator(name, 0)  # one that cannot be made is refused before the readings are read
    said = progress or (lambda what, done, total: None)
    run = _run_sound if settings.protocol == "sound" else _run_paper
    with one_thread():
        outcomes = tuple(run(collection, presses, settings, trials, _Kept.at(out), team, said))
    scores = (sound_scores if settings.protocol == "sound" else paper_scores)(outcomes, presses)
    return Result(
        settings=settings,
        textures=collection.textures,
        outcomes=outcomes,
        scores=tuple(scores),
        notes=notes,
        presses=presses,
        collection=collection,
    )


def default_train_on(collection: Collection) -> tuple[str, ...]:
    """The combinations of the paper's classification table that are there; all of them if there are none."""
    wanted = ["_".join(one.train_on) for one in published.CLASSIFICATION]
    return tuple(one for one in collection.combinations if one in wanted) or collection.combinations


@dataclass(frozen=True)
class _Kept:
    """The folder of finished trials."""

    folder: Path

    @classmethod
    def at(cls, out: Path) -> _Kept:
        folder = out / TRIALS_FOLDER
        with refusing(folder):
            folder.mkdir(parents=True, exist_ok=True)
        return cls(folder)

    def read(self, key: str, trial: int) -> list[Outcome] | None:
        """A trial's outcomes; None if it is not there or cannot be read."""
        try:
            document = json.loads(self._path(key, trial).read_bytes())
            return [Outcome.from_dict(one) for one in document["outcomes"]]
        except (OSError, ValueError, KeyError, TypeError):
            return None

    def write(self, key: str, trial: int, outcomes: Sequence[Outcome]) -> None:
        """Keep a trial."""
        document = {"trial": trial, "outcomes": [one.as_dict() for one in outcomes]}
        with replacing(self._path(key, trial)) as temporary:
            temporary.write_text(json.dumps(document, separators=(",", ":")), encoding="utf-8")

    def _path(self, key: str, trial: int) -> Path:
        return self.folder / f"{key}-trial-{trial:03d}.json"


def _features(collection: Collection, settings: Settings, team: Team, said: Progress) -> Features:
    prepare = Preprocess(resolution=settings.resolution)
    return read_features(collection, prepare, team.jobs, lambda done, total: said("readings", done, total))


def _run_sound(
    collection: Collection,
    presses: PressTable,
    settings: Settings,
    trials: int,
    kept: _Kept,
    team: Team,
    said: Progress,
) -> Iterator[Outcome]:
    key = f"sound-{settings.key(data_key(collection))}"
    found = {trial: kept.read(key, trial) for trial in range(1, trials + 1)}
    missing = [trial for trial, outcomes in found.items() if outcomes is None]
    if missing:
        task = Task.of(_features(collection, settings, team, said), presses, settings)
        said("trials", trials - len(missing), trials)
        for done, (trial, outcomes) in enumerate(
            zip(missing, team.map(partial(sound_trial, task), missing), strict=True), trials - len(missing) + 1
        ):
            kept.write(key, trial, outcomes)
            found[trial] = outcomes
            said("trials", done, trials)
    for trial in range(1, trials + 1):
        yield from found[trial] or ()


def _run_paper(
    collection: Collection,
    presses: PressTable,
    settings: Settings,
    trials: int,
    kept: _Kept,
    team: Team,
    said: Progress,
) -> Iterator[Outcome]:
    key = f"paper-{replace(settings, train_on=()).key(data_key(collection))}"
    keys = {train_on: f"{key}-{train_on}" for train_on in settings.train_on}
    pairs = [(train_on, trial) for train_on in settings.train_on for trial in range(1, trials + 1)]
    found = {pair: kept.read(keys[pair[0]], pair[1]) for pair in pairs}
    done = sum(outcomes is not None for outcomes in found.values())
    if done < len(pairs):
        features = _features(collection, settings, team, said)
        require_possible(features, presses, settings)
        products = Products(rows=features.rows)
        products.compute(team.jobs)
        said("trials", done, len(pairs))
    for train_on in settings.train_on:
        missing = [trial for one, trial in pairs if one == train_on and found[one, trial] is None]
        if not missing:
            continue
        parts = list(batches(products, presses, settings, train_on, missing, team.jobs))
        for part, results in zip(parts, team.map(paper_trials, parts), strict=True):
            for trial, outcomes in zip(part.trials, results, strict=True):
                kept.write(keys[train_on], trial, outcomes)
                found[train_on, trial] = outcomes
                done += 1
            said("trials", done, len(pairs))
    for pair in pairs:
        yield from found[pair] or ()


def _notes(collection: Collection, presses: PressTable, settings: Settings) -> tuple[str, ...]:
    """What a reader has to know; impossible settings are refused on the way."""
    notes: list[str] = []
    if settings.protocol == "sound":
        ladder = folds_of(presses, settings, 1)
        if not ladder.folds:
            raise InputError("rungs", ", ".join(settings.rungs), "none is left; " + "; ".join(ladder.notes))
        notes += ladder.notes
        units = ", ".join(f"{rung}: {UNITS[rung]}" for rung in ladder.rungs)
        notes.append(
            f"intervals (95 %) count as one what is held out or repeated: {units}; of a named group: its prints"
        )
    else:
        notes.append(WARNING)
        notes.append("intervals (95 %) count prints as one, over all trials")
        notes += _paper_counts(presses, settings)
    cells = [
        int(np.sum((presses.combination == combination) & (presses.texture == texture)))
        for combination in collection.combinations
        for texture in collection.textures
    ]
    if min(cells) != max(cells):
        notes.append(
            f"the design is unbalanced: {min(cells)} to {max(cells)} presses of a texture and combination; "
            "an accuracy is the share of all presses that were tested"
        )
    return tuple(notes)


def _paper_counts(presses: PressTable, settings: Settings) -> list[str]:
    """Where the data differ from what the text says."""
    notes = []
    for train_on in settings.train_on:
        mine = presses.combination == train_on
        count = int(mine.sum())
        textures = max(1, len(np.unique(presses.texture[mine])))
        levels = len(np.unique(presses.level[mine]))
        if count / textures != 300:
            notes.append(
                f"{train_on}: trained on {count / textures:g} images a texture ({levels} force level"
                f"{'s' * (levels > 1)}); the text says 300 of each (6 prints x 25 positions x 2, one force)"
            )
    return notes


def write_tables(result: Result, out: Path) -> list[Path]:
    """Write ``classification.csv``, ``confusion.csv``, ``predictions.csv`` and ``classification_settings.json``.

    Training rows of the paper's protocol are in the first two, not in the predictions.
    """
    protocol = {"protocol": result.settings.protocol}
    with replacing(out / SETTINGS_FILE) as temporary:
        temporary.write_text(json.dumps(settings_of(result), indent=1) + "\n", encoding="utf-8")
    return [
        write_csv(out / "classification.csv", COLUMNS, (protocol | _fields(one, COLUMNS) for one in result.scores)),
        write_csv(out / "confusion.csv", CONFUSION_COLUMNS, _confusions(result)),
        write_csv(out / "predictions.csv", PREDICTION_COLUMNS, _predictions(result)),
        out / SETTINGS_FILE,
    ]


def settings_of(result: Result) -> dict[str, Any]:
    """What was asked for and of which data, for ``classification_settings.json``: reports and comparisons name it."""
    collection = result.collection
    return {
        "analysis": "classification",
        "version": __version__,
        **asdict(result.settings),
        "trials": max(one.trial for one in result.outcomes),
        "textures": list(result.textures),
        "sensor": str(collection.info.sensor.get("name", "")),
        "units": collection.units,
        "simulated": list(collection.simulated),
        "data": data_key(collection),
        "notes": list(result.notes),
    }


def _fields(score: Score, columns: Sequence[str]) -> dict[str, Any]:
    return {name: getattr(score, name) for name in columns if name != "protocol"}


def _confusions(result: Result) -> Iterator[dict[str, Any]]:
    for one in result.scores:
        totals = one.confusion.sum(axis=1)
        for i, texture in enumerate(result.textures):
            for j, predicted in enumerate(result.textures):
                yield {
                    "protocol": result.settings.protocol,
                    **_fields(one, ("estimator", "train_on", "tested_on", "rung")),
                    "texture": texture,
                    "predicted": predicted,
                    "count": int(one.confusion[i, j]),
                    "share": float(one.confusion[i, j] / totals[i]) if totals[i] else None,
                }


def _predictions(result: Result) -> Iterator[dict[str, Any]]:
    names = [run.info.printed.name for run in result.collection.runs]
    runs, numbers = result.collection.run.tolist(), result.collection.number.tolist()
    truth = result.presses.texture.tolist()
    copies = result.settings.augmentation.names
    for one in result.outcomes:
        if one.rung == "train":
            continue
        for press, copied, said in zip(one.press.tolist(), one.copied.tolist(), one.predicted.tolist(), strict=True):
            yield {
                "protocol": result.settings.protocol,
                "estimator": one.estimator,
                "train_on": one.train_on,
                "tested_on": one.tested_on,
                "rung": one.rung,
                "trial": one.trial,
                "run": names[runs[press]],
                "press": numbers[press],
                "augmentation": copies[copied],
                "texture": truth[press],
                "predicted": result.textures[said],
            }


@dataclass(frozen=True, kw_only=True)
class Beside:
    """A row of the paper's table beside ours, in per cent; None where there is none.

    Args:
        estimator: Ours.
        train_on: The combination.
        ours: Train, test, unseen.
        paper: Likewise.
    """

    estimator: str
    train_on: str
    ours: tuple[float | None, ...]
    paper: tuple[float | None, ...]


def beside_paper(result: Result) -> list[Beside]:
    """The paper's table beside ours, one row a combination and estimator."""
    printed = {
        ("_".join(one.train_on), one.model): (one.train, one.test, one.unseen) for one in published.CLASSIFICATION
    }
    rows = []
    for train_on in result.settings.train_on:
        for name in result.settings.estimators:
            mine = {
                one.rung: 100 * one.accuracy
                for one in reversed(result.scores)
                if (one.train_on, one.estimator) == (train_on, name)
            }
            theirs = printed.get((train_on, name), (None, None, None)) if name in ESTIMATORS else (None, None, None)
            ours = tuple(mine.get(rung) for rung in ("train", "test", "unseen"))
            rows.append(Beside(estimator=name, train_on=train_on, ours=ours, paper=theirs))
    return rows
