"""Complete classifications: read the frames, run the trials, and store each finished trial."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import joblib
import numpy as np
import pandas as pd
import sklearn
from sklearn.base import clone
from threadpoolctl import threadpool_limits

from tacbench_cad import __version__
from tacbench_cad.lab.analysis import published
from tacbench_cad.lab.analysis.classification import paper_protocol
from tacbench_cad.lab.analysis.classification.accuracy import PREDICTIONS
from tacbench_cad.lab.analysis.classification.classification import Classification, ClassificationRecord
from tacbench_cad.lab.analysis.classification.hold_out import leak_warning, levels_of, unit_name, units_of
from tacbench_cad.lab.analysis.classification.settings import TRIALS, ClassificationSettings, default_settings
from tacbench_cad.lab.analysis.classification.trials import TrialData, leak_free_calls, rows_of, trial_folds
from tacbench_cad.lab.analysis.feature import Feature
from tacbench_cad.lab.analysis.pixels import Pixels, as_published
from tacbench_cad.lab.analysis.study_design import Design
from tacbench_cad.lab.parallel import Executor, workers
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.files import refusing, write_json
from tacbench_cad.util.untrusted import parse_json, read_bytes

#: The version of the algorithm. Raise it with every change that gives other results for the same settings and data:
#: trials that were stored by an older version are then computed again.
ALGORITHM = 2
#: The fraction of an image's width and height that remains by default.
RESOLUTION = 0.4
#: The presses of all trials and levels below which forests are trained in this process, because worker processes need
#: longer to start.
_SHORT = 20_000
#: The folder of finished trials in the output folder.
TRIALS_FOLDER = "trials"
#: The columns of a stored trial. ``press`` is an index, and ``copied`` is an index of ``Augmentation.names``.
_STORED = ["estimator", "train_on", "tested_on", "hold_out", "trial", "press", "copied", "predicted"]

#: A function that receives progress updates: the name of the step, the steps done and their total number (0: unknown).
Progress = Callable[[str, int, int], None]


def classify(
    presses: pd.DataFrame,
    feature: Feature | None = None,
    settings: ClassificationSettings | None = None,
    *,
    trials: int | None = None,
    folder: Path | None = None,
    jobs: int = 1,
    dask: str | None = None,
    progress: Progress = lambda what, done, total: None,
) -> Classification:
    """Measure how well the textures can be distinguished.

    Args:
        presses: The table from :func:`tacbench_cad.lab.read`.
        feature: The feature that is classified; None for the pixels at 40 % of the image's width and height, and with
            the protocol ``as-published`` for the edges in them.
        settings: The settings; None for the usual ones, see :func:`.settings.default_settings`.
        trials: The number of trials; None for the usual number of the protocol, :data:`.settings.TRIALS`.
        folder: A folder in which finished trials are stored, so that they are not repeated; None to store nothing.
        jobs: The number of worker processes on this machine.
        dask: The address of a Dask scheduler.
        progress: Receives progress updates on frames and trials.

    Raises:
        InputError: The data or the settings do not allow a classification, an estimator raises an error, or no Dask
            scheduler answers at the address.
        CheckFailedError: A frame is damaged.
    """
    design = Design.of(presses)
    if feature is None:
        published = settings is not None and settings.protocol == "as-published"
        feature = as_published(RESOLUTION, edges=True) if published else Pixels(resolution=RESOLUTION)
    settings = settings or default_settings(design, feature)
    trials = TRIALS[settings.protocol] if trials is None else trials
    if trials < 1:
        raise InputError("trials", trials, "must be at least 1")
    design.require("classification", "label", *(["print"] if settings.protocol == "as-published" else []))
    if settings.protocol == "leak-free":
        settings = replace(settings, hold_out=settings.hold_out or levels_of(design))
        divided = trial_folds(design, settings, settings.hold_out)
        groups, notes = divided.levels, divided.notes
    else:
        settings = replace(settings, train_on=settings.train_on or default_train_on(design))
        groups, notes = settings.train_on, tuple(paper_protocol.differences(settings, design.first_steps))
    for name in settings.estimators:
        settings.estimator(name, 0)  # refuses an estimator that cannot be made, before frames are read
    work = len(design) * len(groups) * trials
    processes = 1 if work < _SHORT and settings.estimators == ("forest",) else min(jobs, len(groups) * trials)
    with threadpool_limits(limits=1), workers(processes, dask) as executor:
        feature = clone(feature).fit(design.presses)
        rows = rows_of(design, feature, jobs, lambda *counts: progress("frames", *counts))
        data = TrialData(settings=settings, design=design, feature=feature, rows=rows)
        outcomes = _outcomes(data, groups, trials, folder, executor, progress)
    record = ClassificationRecord(
        settings=settings,
        features=" ".join(repr(feature).split()),
        summary=feature.summary,
        units=feature.unit or design.units,
        steps=design.steps,
        trials=trials,
        textures=design.textures,
        sensor=design.sensor,
        simulated=design.simulated,
        data=design.data_key,
        unknown_groups=design.unknown_groups,
        notes=(*notes, *_notes(design, settings, groups)),
    )
    return Classification(record=record, predictions=_predictions(outcomes, data))


def default_train_on(design: Design) -> tuple[str, ...]:
    """Return the study's combinations that are in the paper's classification table, or all of them if none is."""
    expected = ["_".join(row.train_on) for row in published.CLASSIFICATION]
    return tuple(name for name in design.combinations if name in expected) or design.combinations


def _outcomes(
    data: TrialData, groups: tuple[str, ...], trials: int, folder: Path | None, executor: Executor, progress: Progress
) -> pd.DataFrame:
    """Return the predictions of all trials. Each is read from its file, or computed and stored there.

    Args:
        data: The data and the settings.
        groups: The hold-out levels, or the training combinations. Each has its own trials.
        trials: The number of trials.
        folder: The folder for the folder of finished trials.
        executor: The worker processes.
        progress: Receives progress updates.
    """
    stored, key = folder and folder / TRIALS_FOLDER, f"{data.settings.protocol}-{_key(data)}"
    if stored is not None:
        with refusing(stored):
            stored.mkdir(parents=True, exist_ok=True)
    places = [(group, trial) for group in groups for trial in range(1, trials + 1)]
    files = {(group, n): stored and stored / f"{key}-{group}-trial-{n:03d}.json" for group, n in places}
    outcomes = {place: _read(path) for place, path in files.items()}
    todo = [place for place in places if outcomes[place] is None]
    calls_of = leak_free_calls if data.settings.protocol == "leak-free" else paper_protocol.calls
    missing = {group: [trial for of, trial in todo if of == group] for group, _ in todo}
    calls = (call for group, numbers in missing.items() for call in calls_of(data, group, numbers))
    for done, (place, outcome) in enumerate(zip(todo, executor(calls), strict=True), start=1):
        if path := files[place]:
            write_json(path, outcome.to_dict("list"))
        outcomes[place] = outcome
        progress("trials", len(places) - len(todo) + done, len(places))
    return pd.concat(outcomes.values(), ignore_index=True)


def _key(data: TrialData) -> str:
    """Return a key of the predictions that follow from the data, the settings and the versions of the programs."""
    columns = ["run", "press", "texture", "combination", "copy", "level", "position", "session"]
    programs = [ALGORITHM, __version__, np.__version__, sklearn.__version__, data.settings.sources]
    settings = replace(data.settings, hold_out=(), train_on=())
    return str(joblib.hash([settings, programs, data.design.first_steps[columns].to_csv(), data.rows]))[:16]


def _read(path: Path | None) -> pd.DataFrame | None:
    """Read the predictions of a trial; return None if its file is missing or cannot be read."""
    if path is None:
        return None
    try:
        document = parse_json(read_bytes(path, "trial", "json", within=path.parent), "trial", str(path))
        return pd.DataFrame(document)[_STORED]
    except (InputError, ValueError, KeyError, TypeError):
        return None


def _predictions(outcomes: pd.DataFrame, data: TrialData) -> pd.DataFrame:
    """Return the predictions with the facts about each press, see :data:`.accuracy.PREDICTIONS`."""
    units = [
        pd.Series(units_of(data.design, str(level))[of_level["press"]], index=of_level.index).astype(str)
        for level, of_level in outcomes.groupby("hold_out", sort=False)
    ]
    names = np.array(data.settings.augmentation.names)[outcomes["copied"]]
    facts = data.design.first_steps[["run", "press", "texture"]].iloc[outcomes["press"]].set_index(outcomes.index)
    return outcomes.assign(**facts, unit=pd.concat(units), augmentation=names)[PREDICTIONS]


def _notes(design: Design, settings: ClassificationSettings, groups: tuple[str, ...]) -> Iterator[str]:
    """Yield the notes that a reader must know, besides those on left-out levels."""
    if settings.protocol == "leak-free":
        units = ", ".join(f"{level}: {unit_name(level, design.unknown_groups)}" for level in groups)
        repeated = unit_name("copy", design.unknown_groups)
        yield f"the units of the 95 % intervals are {units}; for a named group they are its {repeated}"
        if design.unknown_groups:
            yield leak_warning(design.unknown_groups)
    else:
        yield paper_protocol.WARNINGS[settings.protocol]
        yield "the units of the 95 % intervals are prints, over all trials"
    if len(design.levels) == 1 < len(design.level_values):
        yield f"only force level {design.levels[0]} of {len(design.level_values)} levels is used"
    cells = pd.crosstab(design.first_steps["combination"], design.first_steps["texture"]).to_numpy()
    if cells.min() != cells.max():
        yield (
            f"the design is unbalanced: there are {cells.min()} to {cells.max()} presses of a texture and combination; "
            "an accuracy is a fraction of all tested presses, so textures with more presses count more"
        )
