"""The leak-free protocol: everything that learns does so inside the training fold, and groups are held out whole.

Copies of a reading are made after the split, so that a test set has none of a training reading's. Principal components
and scaling are fitted to the training fold. What is held out grows from level to level, see
:mod:`tacbench_cad.lab.analysis.classification.splits`. The numbers are those of scikit-learn's own
``make_pipeline(PCA(components, svd_solver="full"), StandardScaler(), estimator)`` on the written-out training rows, but
for the signs of components.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from tacbench_cad.lab.analysis.classification.augment import trial_seed
from tacbench_cad.lab.analysis.classification.outcomes import ALL, THE_OTHERS, Outcome, Study, guarded, predictions
from tacbench_cad.lab.analysis.classification.pca import Noise, Pool, principal_scores
from tacbench_cad.lab.analysis.classification.settings import ClassificationSettings, one_thread
from tacbench_cad.lab.analysis.classification.splits import Fold, Folds, PressTable, folds_of, with_copies


def trial_folds(presses: PressTable, settings: ClassificationSettings, trial: int) -> Folds:
    """The folds of a trial, with as many prints in training as the settings say.

    Raises:
        InputError: See :func:`tacbench_cad.lab.analysis.classification.splits.folds_of`.
    """
    seed = trial_seed(settings.seed, trial)
    whole = folds_of(presses, settings.hold_out, seed=seed, folds=settings.folds)
    if settings.copies is None:
        return whole
    pairs = [(fold, with_copies(presses, fold, settings.copies, seed)) for fold in whole.folds]
    short = dict.fromkeys(fold.hold_out for fold, cut in pairs if cut is None)
    notes = [
        f"hold-out level {level} is left out: no {settings.copies} copies of each print in training" for level in short
    ]
    kept = [cut for _, cut in pairs if cut is not None and cut.hold_out not in short]
    return Folds(folds=tuple(kept), notes=(*whole.notes, *notes))


def calls(study: Study, _: str, trials: Sequence[int], jobs: int) -> list[tuple[Sequence[int], Any]]:
    """A call for each trial, for worker processes."""
    from joblib import delayed

    settings = study.settings
    components, noise = settings.components, settings.augmentation.noise is not None
    pool = None
    if components is not None:
        pool = Pool.of(study.features.rows, components=components, noise=noise, jobs=jobs)
    return [([trial], delayed(leak_free_trial)(study, pool, trial)) for trial in trials]


@one_thread()
def leak_free_trial(study: Study, pool: Pool | None, trial: int) -> list[list[Outcome]]:
    """Train and test every estimator in every fold of a trial.

    Args:
        study: What all trials share.
        pool: All readings' inner products, if principal components are wanted.
        trial: Its number.

    Returns:
        A list of one item, the outcomes of the trial.

    Raises:
        InputError: An estimator raises or predicts what is no texture, or there are too many components.
    """
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    settings, presses, textures = study.settings, study.presses, study.presses.textures
    seed = trial_seed(settings.seed, trial)
    folds = trial_folds(presses, settings, trial).folds
    outcomes: list[Outcome] = []
    for fold, (train, test) in zip(folds, _rows(study, pool, folds, seed), strict=True):
        labels = np.tile(presses.texture[fold.train], settings.augmentation.count)
        for name in settings.estimators:
            where = f"trial {trial}, hold-out level {fold.hold_out}" + (
                f", {fold.group} held out" if fold.group else ""
            )
            model = settings.estimator(name, seed, study.features.shape if pool is None else None)
            if pool is not None:
                model = make_pipeline(StandardScaler(), model)
            with guarded(name, where):
                model.fit(train, labels)
            outcomes.append(
                Outcome(
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


def _rows(study: Study, pool: Pool | None, folds: Sequence[Fold], seed: int) -> Iterator[Any]:
    """Training rows, augmented, and test rows of each fold."""
    components, copies = study.settings.components, study.settings.augmentation
    if pool is None or components is None:
        for fold in folds:
            test = study.features.rows[fold.test].astype(np.float64)
            yield copies.rows(study.features, fold.train, seed), test
        return
    noise = None if copies.noise is None else Noise.of(pool, copies.noise, seed)
    for fold in folds:
        scores = principal_scores(pool, noise, copies, components, fold.train)
        yield scores.train, scores.plain[fold.test]
