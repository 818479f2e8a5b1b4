"""Complete classifications: run the trials, store each finished trial, and write the tables."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from tacbench_cad.lab.analysis import published
from tacbench_cad.lab.analysis.classification import leak_free, paper_protocol
from tacbench_cad.lab.analysis.classification.accuracy import FoldScore, scores, texture_answers
from tacbench_cad.lab.analysis.classification.augment import Augmentation
from tacbench_cad.lab.analysis.classification.features import read_features
from tacbench_cad.lab.analysis.classification.outcomes import OUTCOMES, ClassifiedStudy
from tacbench_cad.lab.analysis.classification.result import Result
from tacbench_cad.lab.analysis.classification.settings import ClassificationSettings, one_thread, shown_protocol
from tacbench_cad.lab.analysis.classification.splits import PressTable, leak_warning
from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.conclusions import Answer
from tacbench_cad.lab.analysis.tables import percent, write_csv
from tacbench_cad.lab.parallel import Executor
from tacbench_cad.lab.runs.region_search import region_of
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.files import refusing, write_json
from tacbench_cad.util.text import counted
from tacbench_cad.util.untrusted import parse_json, read_bytes

#: The default number of trials by protocol; for the paper's protocols it is the number in the text.
TRIALS = {"leak-free": 5, "paper": published.TRIALS, "as-published": published.TRIALS}
#: The optional packages that classifying and drawing the results import.
MODULES = ("sklearn", "joblib", "cv2", "matplotlib")
#: The folder of finished trials in the output folder.
TRIALS_FOLDER = "trials"

#: A function that receives progress updates: the name of the step, the steps done and their total number (0: unknown).
Progress = Callable[[str, int, int], None]


def classify(
    collection: Collection,
    settings: ClassificationSettings,
    trials: int,
    out: Path,
    executor: Executor,
    progress: Progress | None = None,
    beside_plain: bool = True,
) -> Result:
    """Run a classification. Finished trials in the output folder are not repeated.

    Args:
        collection: The presses.
        settings: The settings.
        trials: The number of trials.
        out: The output folder, which the caller has locked. Each finished trial is stored in ``trials/``.
        executor: The worker processes.
        progress: Receives progress updates on frames and trials.
        beside_plain: Whether a leak-free classification with copies of training frames is repeated without them, so
            that a note can say what the copies changed.

    Raises:
        InputError: The data or the settings do not allow a classification, or an estimator raises an error.
        CheckFailedError: A frame is damaged.
    """
    if trials < 1:
        raise InputError("trials", trials, "must be at least 1")
    collection.require("classification", "label", *(["print"] if settings.protocol == "as-published" else []))
    collection = collection.viewed(settings.series, settings.frames)
    presses = PressTable.of(collection)
    if settings.protocol != "leak-free":
        settings = replace(settings, train_on=settings.train_on or default_train_on(collection))
    notes = _notes(collection, presses, settings)
    for name in settings.estimators:
        settings.estimator(name, 0)  # refuses an estimator that cannot be made, before frames are read
    folder = out / TRIALS_FOLDER
    with refusing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    show = progress or (lambda what, done, total: None)
    with one_thread():
        outcomes = pd.concat(
            _outcomes(collection, presses, settings, trials, folder, executor, show), ignore_index=True
        )
    answers: tuple[Answer, ...] = ()
    if settings.protocol == "leak-free":
        answers = tuple(texture_answers(outcomes, presses, notes))
    rows = tuple(scores(outcomes, presses, shown_protocol(settings.protocol, collection.unknown_groups)))
    if beside_plain and settings.protocol == "leak-free" and settings.augmentation.count > 1:
        plain = replace(settings, augmentation=Augmentation())
        without = classify(collection, plain, trials, out, executor, progress).scores
        notes = (*notes, *_effects(settings.augmentation, rows, without))
    return Result(
        settings=settings,
        outcomes=outcomes,
        scores=rows,
        notes=notes,
        collection=collection,
        answers=answers,
    )


def _effects(copies: Augmentation, rows: Sequence[FoldScore], without: Sequence[FoldScore]) -> Iterator[str]:
    """Yield a note for each estimator: what the copies of training frames changed."""
    pairs = [(row, plain) for row, plain in zip(rows, without, strict=True) if row.whole]
    for name in dict.fromkeys(row.estimator for row, _ in pairs):
        changes = ", ".join(
            f"{row.hold_out} from {percent(plain.accuracy)} to {percent(row.accuracy)} %"
            for row, plain in pairs
            if row.estimator == name
        )
        yield f"the copies of training frames ({', '.join(copies.names[1:])}) changed the accuracy of {name}: {changes}"


def default_train_on(collection: Collection) -> tuple[str, ...]:
    """Return the study's combinations that are in the paper's classification table, or all of them if none is."""
    expected = ["_".join(row.train_on) for row in published.CLASSIFICATION]
    return tuple(name for name in collection.combinations if name in expected) or collection.combinations


def _outcomes(
    collection: Collection,
    presses: PressTable,
    settings: ClassificationSettings,
    trials: int,
    folder: Path,
    executor: Executor,
    show: Progress,
) -> list[pd.DataFrame]:
    """Return the predictions of all trials. Each is read from its file, or computed and stored there."""
    region = region_of(collection.runs, settings.roi)
    references = " ".join(frame.image_sha256 for run in collection.runs for frame in run.references)
    data = f"{collection.data_key} {region.digest if region else ''} {references}"
    key = f"{settings.protocol}-{replace(settings, train_on=()).key(data)}"
    groups = {name: f"{key}-{name}" for name in settings.train_on} or {"": key}
    files = {
        (group, trial): folder / f"{stem}-trial-{trial:03d}.json"
        for group, stem in groups.items()
        for trial in range(1, trials + 1)
    }
    outcomes = {place: _read(path) for place, path in files.items()}
    missing = {
        group: [trial for name, trial in files if name == group and outcomes[name, trial] is None] for group in groups
    }
    done = len(files) - sum(map(len, missing.values()))
    if done < len(files):
        feature = settings.feature.fit(collection, region)
        features = read_features(collection, feature, executor.jobs, lambda *counts: show("frames", *counts))
        study = ClassifiedStudy(features=features, presses=presses, settings=settings)
        calls_of = leak_free.calls if settings.protocol == "leak-free" else paper_protocol.calls
        show("trials", done, len(files))
        for group in (name for name in groups if missing[name]):
            results = executor(calls_of(study, group, missing[group]))
            for trial, result in zip(missing[group], results, strict=True):
                write_json(files[group, trial], result.to_dict("list"))
                outcomes[group, trial] = result
                done += 1
                show("trials", done, len(files))
    return [found for found in outcomes.values() if found is not None]


def _read(path: Path) -> pd.DataFrame | None:
    """Read the predictions of a trial; return None if its file is missing or cannot be read."""
    try:
        document = parse_json(read_bytes(path, "trial", "json", within=path.parent), "trial", str(path))
        return pd.DataFrame(document)[list(OUTCOMES)]
    except (InputError, ValueError, KeyError, TypeError):
        return None


def _notes(collection: Collection, presses: PressTable, settings: ClassificationSettings) -> tuple[str, ...]:
    """Return the notes that a reader must know. Impossible settings raise an InputError."""
    notes: list[str] = []
    if settings.protocol == "leak-free":
        folds = leak_free.trial_folds(presses, settings, 1)
        if not folds.folds:
            raise InputError("hold-out", ", ".join(settings.hold_out), "no level is left; " + "; ".join(folds.notes))
        units = ", ".join(f"{level}: {presses.units(level)[0]}" for level in folds.levels)
        notes += folds.notes
        repeated, _ = presses.units("copy")
        notes.append(f"the units of the 95 % intervals are {units}; for a named group they are its {repeated}")
        if collection.unknown_groups:
            notes.append(leak_warning(collection.unknown_groups))
    else:
        notes += [
            paper_protocol.WARNINGS[settings.protocol],
            "the units of the 95 % intervals are prints, over all trials",
        ]
        notes += _paper_counts(presses, settings)
    forces = {row.force_level for run in collection.runs for row in run.rows}
    if len(collection.levels) == 1 < len(forces):
        notes.append(f"only force level {collection.levels[0]} of {len(forces)} levels is used")
    cells = [
        int(np.sum((presses.combination == combination) & (presses.texture == texture)))
        for combination in collection.combinations
        for texture in collection.textures
    ]
    if min(cells) != max(cells):
        notes.append(
            f"the design is unbalanced: there are {min(cells)} to {max(cells)} presses of a texture and combination; "
            "an accuracy is a fraction of all tested presses, so textures with more presses count more"
        )
    return tuple(notes)


def _paper_counts(presses: PressTable, settings: ClassificationSettings) -> Iterator[str]:
    """Yield differences between the data and the paper's text, or the authors' notebooks."""
    expected, whose = {
        "paper": (300, "the text says 300 of each (6 prints x 25 positions x 2, one force)"),
        "as-published": (50, "the notebooks had 50 of each (1 print x 25 positions x 2, one force)"),
    }[settings.protocol]
    for train_on in settings.train_on:
        mine = paper_protocol.ProtocolDesign.of(settings.protocol, presses, train_on).trained
        images = len(mine) / max(1, len(np.unique(presses.texture[mine])))
        levels = counted(len(np.unique(presses.level[mine])), "force level")
        if images != expected:
            yield f"{train_on}: trained on {images:g} images of each texture ({levels}); {whose}"


def write_tables(result: Result, out: Path) -> list[Path]:
    """Write the tables, and for a single classification also its settings."""
    paths = [write_csv(out / name, table, result.collection.simulated) for name, table in result.tables.items()]
    return paths if result.parameter else [*paths, result.record.write(out)]
