"""The leak-free protocol: only the training fold is used for fitting, and groups are held out completely.

Copies of a frame are made after the split, so a test set never contains a copy of a training frame. Principal
components and scaling are fitted to the training fold. The hold-out levels go from easy to hard, see
:mod:`tacbench_cad.lab.analysis.classification.splits`. The results equal those of scikit-learn's
``make_pipeline(PCA(components, svd_solver="full"), StandardScaler(), estimator)`` on the complete training rows, except
for the signs of components.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from tacbench_cad.lab.analysis.classification.augment import trial_seed
from tacbench_cad.lab.analysis.classification.outcomes import (
    ALL,
    THE_OTHERS,
    ClassifiedStudy,
    TestOutcome,
    guarded,
    predictions,
)
from tacbench_cad.lab.analysis.classification.pca import PixelNoise, Pool, principal_scores
from tacbench_cad.lab.analysis.classification.settings import ClassificationSettings, one_thread
from tacbench_cad.lab.analysis.classification.splits import Fold, Folds, PressTable, folds_of, with_copies


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


def calls(study: ClassifiedStudy, _: str, trials: Sequence[int], jobs: int) -> list[tuple[Sequence[int], Any]]:
    """Return a call for each trial, for worker processes."""
    from joblib import delayed

    settings = study.settings
    components, noise = settings.components, settings.augmentation.noise is not None
    pool = None
    if components is not None:
        pool = Pool.of(study.features.rows, components=components, noise=noise, jobs=jobs)
    return [([trial], delayed(leak_free_trial)(study, pool, trial)) for trial in trials]


@one_thread()
def leak_free_trial(study: ClassifiedStudy, pool: Pool | None, trial: int) -> list[list[TestOutcome]]:
    """Train and test every estimator in every fold of a trial.

    Args:
        study: The data and settings that all trials share.
        pool: The inner products of all frames; None if there are no principal components.
        trial: The number of the trial.

    Returns:
        A list with one item, the outcomes of the trial.

    Raises:
        InputError: An estimator raises an error or predicts an unknown texture, or there are too many components.
    """
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    settings, presses, textures = study.settings, study.presses, study.presses.textures
    seed = trial_seed(settings.seed, trial)
    folds = trial_folds(presses, settings, trial).folds
    outcomes: list[TestOutcome] = []
    for fold, (train, test) in zip(folds, _rows(study, pool, folds, seed), strict=True):
        labels = np.tile(presses.texture[fold.train], settings.augmentation.count)
        for name in settings.estimators:
            where = f"trial {trial}, hold-out level {fold.hold_out}" + (
                f", {fold.group} held out" if fold.group else ""
            )
            model = settings.estimator(name, seed, study.features.shape if pool is None else None)
            if pool is not None or settings.feature.few_numbers:
                model = make_pipeline(StandardScaler(), model)
            with guarded(name, where):
                model.fit(train, labels)
            outcomes.append(
                TestOutcome(
                    estimator=name,
                    train_on=THE_OTHERS,
                    tested_on=fold.group or ALL,
                    hold_out=fold.hold_out,
                    trial=trial,
                    press=fold.test,
                    copied=np.zeros(len(fold.test), dtype=np.int64),
                    predicted=predictions(model, test, textures, name, where),
                )
            )
    return [outcomes]


def _rows(study: ClassifiedStudy, pool: Pool | None, folds: Sequence[Fold], seed: int) -> Iterator[Any]:
    """Yield the augmented training rows and the test rows of each fold."""
    components, copies = study.settings.components, study.settings.augmentation
    if pool is None or components is None:
        for fold in folds:
            test = study.features.rows[fold.test].astype(np.float64)
            yield copies.rows(study.features, fold.train, seed), test
        return
    noise = None if copies.noise is None else PixelNoise.of(pool, copies.noise, seed)
    for fold in folds:
        scores = principal_scores(pool, noise, copies, components, fold.train)
        yield scores.train, scores.plain[fold.test]
