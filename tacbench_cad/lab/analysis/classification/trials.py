"""The data of all trials of a classification, and the trials of the leak-free protocol.

The leak-free protocol fits to the training fold only, and holds out groups completely. Copies of a frame are made after
the split, so a test set never contains a copy of a training frame. Principal components and scaling are fitted to the
training fold. The hold-out levels go from easy to hard, see
:mod:`tacbench_cad.lab.analysis.classification.hold_out`. The results equal those of scikit-learn's
``make_pipeline(PCA(components, svd_solver="full"), StandardScaler(), estimator)`` on the training rows, except for the
signs of components.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
from joblib import Parallel, delayed
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from tacbench_cad.lab.analysis.classification.accuracy import ALL
from tacbench_cad.lab.analysis.classification.hold_out import Fold, Folds, folds_of
from tacbench_cad.lab.analysis.classification.settings import ClassificationSettings, predicted, trial_seed
from tacbench_cad.lab.analysis.classification.training_rows import coordinates, inner_products, noisy
from tacbench_cad.lab.analysis.feature import Feature
from tacbench_cad.lab.analysis.study_design import Design
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.types import Floats, Strings

#: ``train_on`` of every fold of the leak-free protocol: the other groups.
THE_OTHERS = "the others"
#: The number of presses that a thread transforms at a time.
_AT_A_TIME = 16


@dataclass(frozen=True, kw_only=True, eq=False)
class TrialData:
    """The data and the settings that all trials of a classification share.

    Args:
        settings: The settings.
        design: The design of the study.
        feature: The fitted feature.
        rows: The numbers of each press, (n, numbers), from :func:`rows_of`.
    """

    settings: ClassificationSettings
    design: Design
    feature: Feature
    rows: NDArray[Any]

    @cached_property
    def products(self) -> Floats:
        """The inner products of all frames, see :func:`.training_rows.inner_products`."""
        return inner_products(self.rows)


def rows_of(
    design: Design, feature: Feature, jobs: int = 1, progress: Callable[[int, int], None] = lambda done, total: None
) -> NDArray[Any]:
    """Transform all presses, or the series of all presses, reading each frame once.

    Args:
        design: The design of the study.
        feature: The fitted feature.
        jobs: The number of threads that decode at the same time.
        progress: Receives progress updates: the number of presses done and their total number.

    Returns:
        The numbers of each press, (n, numbers). For series, those of the steps follow each other.

    Raises:
        CheckFailedError: Frames are missing or damaged. The message names the first of them and their number.
        InputError: All rows are equal.
    """
    count, steps = len(design), design.steps or 1
    parts, faults = [], list[str]()
    starts = range(0, count, _AT_A_TIME)
    pieces = (design.presses.iloc[start * steps : (start + _AT_A_TIME) * steps] for start in starts)
    threads = Parallel(n_jobs=jobs, backend="threading", return_as="generator")
    for start, (part, found) in zip(starts, threads(delayed(_transformed)(feature, of) for of in pieces), strict=True):
        parts.append(part)
        faults += found
        progress(min(start + _AT_A_TIME, count), count)
    if faults:
        more = f" (and {len(faults) - 1} more of {count * steps:,} frames)" if len(faults) > 1 else ""
        raise CheckFailedError(f"{faults[0]}{more}; find them with `tacbench check-runs` and repair or remove them")
    rows = np.concatenate(parts).reshape(count, -1)
    if not any((row != rows[0]).any() for row in rows):
        raise InputError("frames", None, "are all equal, so they cannot be classified; check the sensor")
    return rows


def _transformed(feature: Feature, presses: pd.DataFrame) -> tuple[NDArray[Any], list[str]]:
    """Return the numbers of some presses, or a message for each of them that cannot be transformed."""
    try:
        return feature.transform(presses), []
    except CheckFailedError as error:
        if len(presses) == 1:
            return np.empty((0, 0)), [str(error)]
    each = (_transformed(feature, presses.iloc[index : index + 1]) for index in range(len(presses)))
    return np.empty((0, 0)), [fault for _, faults in each for fault in faults]


def trial_folds(design: Design, settings: ClassificationSettings, levels: Sequence[str], trial: int = 1) -> Folds:
    """Return the folds of a trial.

    Raises:
        InputError: The data do not support any of the levels.
    """
    seed = trial_seed(settings.seed, trial)
    return folds_of(design, levels, seed=seed, folds=settings.folds, copies=settings.copies)


def leak_free_calls(data: TrialData, level: str, trials: Sequence[int]) -> list[Any]:
    """Return a call for each trial of a hold-out level, for worker processes."""
    settings, feature, plain = data.settings, data.feature, data.settings.components is None
    shape = (data.design.steps, *feature.shape_) if data.design.steps else feature.shape_
    how = (data.rows, shape, feature.few_numbers) if plain else (data.products, None, True)
    texture, train = data.design.first_steps["texture"].to_numpy(str), delayed(leak_free_trial)
    folds = {trial: trial_folds(data.design, settings, [level], trial).folds for trial in trials}
    return [train(settings, texture, *how, trial, of_trial) for trial, of_trial in folds.items()]


@threadpool_limits.wrap(limits=1)  # type: ignore[untyped-decorator]
def leak_free_trial(
    settings: ClassificationSettings,
    texture: Strings,
    source: NDArray[Any],
    shape: tuple[int, ...] | None,
    scale: bool,
    trial: int,
    folds: Sequence[Fold],
) -> pd.DataFrame:
    """Train and test every estimator in every fold of a hold-out level, and return the predictions.

    Args:
        settings: The settings.
        texture: The texture of each press, (n,).
        source: The inner products of all frames, or without principal components the rows themselves.
        shape: The shape of a frame; None with principal components.
        scale: Whether the rows are scaled.
        trial: The number of the trial.
        folds: The folds.

    Raises:
        InputError: An estimator raises an error or predicts an unknown texture, or there are too many components.
    """
    copies, components, seed = settings.augmentation, settings.components, trial_seed(settings.seed, trial)
    outcomes: list[pd.DataFrame] = []
    for fold in folds:
        if components is None:
            train, test = copies.rows(source[fold.train], seed), source[fold.test].astype(np.float64)
        else:
            train, test = coordinates(source, copies, components, fold.train, fold.test)
            train, test = noisy(train, test, copies, components, seed)
        labels = np.tile(texture[fold.train], copies.count)
        held_out = f", {fold.group} held out" if fold.group else ""
        where = f"trial {trial}, hold-out level {fold.hold_out}{held_out}"
        same = {"train_on": THE_OTHERS, "tested_on": fold.group or ALL, "hold_out": fold.hold_out, "trial": trial}
        for name in settings.estimators:
            model = settings.estimator(name, seed, shape)
            (words,) = predicted(name, model, (train, labels), [test], where, scale=scale)
            found = {"estimator": name, **same, "press": fold.test, "copied": 0, "predicted": words}
            outcomes.append(pd.DataFrame(found))
    return pd.concat(outcomes, ignore_index=True)
