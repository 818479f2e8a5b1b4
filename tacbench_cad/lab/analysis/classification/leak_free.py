"""The leak-free protocol: only the training fold is used for fitting, and groups are held out completely.

Copies of a frame are made after the split, so a test set never contains a copy of a training frame. Principal
components and scaling are fitted to the training fold. The hold-out levels go from easy to hard, see
:mod:`tacbench_cad.lab.analysis.classification.splits`. The results equal those of scikit-learn's
``make_pipeline(PCA(components, svd_solver="full"), StandardScaler(), estimator)`` on the training rows, except for the
signs of components.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from tacbench_cad.lab.analysis.classification.augment import trial_seed
from tacbench_cad.lab.analysis.classification.outcomes import (
    ALL,
    OUTCOMES,
    THE_OTHERS,
    ClassifiedStudy,
    guarded,
    predictions,
)
from tacbench_cad.lab.analysis.classification.principal import Products, coordinates, noisy
from tacbench_cad.lab.analysis.classification.settings import ClassificationSettings, one_thread
from tacbench_cad.lab.analysis.classification.splits import Fold, Folds, PressTable, folds_of, with_copies
from tacbench_cad.util.types import Floats


def trial_folds(presses: PressTable, settings: ClassificationSettings, trial: int) -> Folds:
    """Return the folds of a trial, with the number of training prints from the settings.

    Raises:
        InputError: Same as for :func:`tacbench_cad.lab.analysis.classification.splits.folds_of`.
    """
    seed = trial_seed(settings.seed, trial)
    whole = folds_of(presses, settings.hold_out, seed=seed, folds=settings.folds)
    if settings.copies is None:
        return whole
    pairs = [(fold, with_copies(presses, fold, settings.copies, seed)) for fold in whole.folds]
    short = dict.fromkeys(fold.hold_out for fold, cut in pairs if cut is None)
    notes = [
        f"hold-out level {level} is left out: there are fewer than {settings.copies} prints of some texture in training"
        for level in short
    ]
    kept = [cut for _, cut in pairs if cut is not None and cut.hold_out not in short]
    return Folds(folds=tuple(kept), notes=(*whole.notes, *notes))


def calls(study: ClassifiedStudy, _: str, trials: Sequence[int]) -> list[Any]:
    """Return a call for each trial, for worker processes."""
    from joblib import delayed

    products = None if study.settings.components is None else Products.of(study.features.rows)
    return [delayed(leak_free_trial)(study, products, trial) for trial in trials]


@one_thread()
def leak_free_trial(study: ClassifiedStudy, products: Products | None, trial: int) -> pd.DataFrame:
    """Train and test every estimator in every fold of a trial, and return the predictions.

    Their columns are :data:`.outcomes.OUTCOMES`.

    Args:
        study: The data and settings that all trials share.
        products: The inner products of all frames; None if there are no principal components.
        trial: The number of the trial.

    Raises:
        InputError: An estimator raises an error or predicts an unknown texture, or there are too many components.
    """
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    settings, presses, textures = study.settings, study.presses, study.presses.textures
    seed = trial_seed(settings.seed, trial)
    outcomes: list[pd.DataFrame] = []
    for fold in trial_folds(presses, settings, trial).folds:
        train, test = _rows(study, products, fold, seed)
        labels = np.tile(presses.texture[fold.train], settings.augmentation.count)
        for name in settings.estimators:
            where = f"trial {trial}, hold-out level {fold.hold_out}" + (
                f", {fold.group} held out" if fold.group else ""
            )
            model = settings.estimator(name, seed, study.features.shape if products is None else None)
            if products is not None or settings.feature.few_numbers:
                model = make_pipeline(StandardScaler(), model)
            with guarded(name, where):
                model.fit(train, labels)
            predicted = predictions(model, test, textures, name, where)
            tested_on, level = fold.group or ALL, fold.hold_out
            rows = [
                (name, THE_OTHERS, tested_on, level, trial, press, 0, word)
                for press, word in zip(fold.test, predicted, strict=True)
            ]
            outcomes.append(pd.DataFrame(rows, columns=list(OUTCOMES)))
    return pd.concat(outcomes, ignore_index=True)


def _rows(study: ClassifiedStudy, products: Products | None, fold: Fold, seed: int) -> tuple[Floats, Floats]:
    """Return the augmented training rows and the test rows of a fold."""
    components, copies = study.settings.components, study.settings.augmentation
    if products is None or components is None:
        rows = study.features.rows
        return copies.rows(rows[fold.train], seed), rows[fold.test].astype(np.float64)
    found = coordinates(products, copies, components, fold.train, fold.test)
    return noisy(*found, copies, components, seed)
