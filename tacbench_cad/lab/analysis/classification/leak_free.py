"""The sound protocol: everything that learns does so inside the training fold, and groups are held out whole.

Copies of a reading are made after the split, so that a test set has none of a training reading's. Principal components
and scaling are fitted to the training fold. What is held out rises in a ladder, see
:mod:`tacbench_cad.lab.analysis.classification.splits`. The numbers are those of scikit-learn's own
``make_pipeline(PCA(components, svd_solver="full"), StandardScaler(), estimator)`` on the written-out training rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacbench_cad.lab.analysis.classification.augment import trial_seed
from tacbench_cad.lab.analysis.classification.features import Features
from tacbench_cad.lab.analysis.classification.pca import Noise, Pool, Products, principal_scores
from tacbench_cad.lab.analysis.classification.settings import Outcome, Settings, guarded, one_thread, predicted_index
from tacbench_cad.lab.analysis.classification.splits import Fold, Ladder, PressTable, ladder, with_copies

#: What every fold of this protocol is trained on: the other groups.
TRAIN_ON = "the others"
#: What a draw of presses or positions is tested on.
TESTED_ON = "all"


@dataclass(frozen=True, kw_only=True, eq=False)
class Task:
    """What the trials of a study share.

    Args:
        features: All readings.
        pool: Their inner products, if principal components are wanted.
        presses: What splits need of each press.
        settings: The settings.
    """

    features: Features
    pool: Pool | None
    presses: PressTable
    settings: Settings

    @classmethod
    def of(cls, features: Features, presses: PressTable, settings: Settings) -> Task:
        """Compute what is shared."""
        pool = None
        if settings.components is not None:
            pool = Products(rows=features.rows).pool(noise=settings.augmentation.noise is not None)
        return cls(features=features, pool=pool, presses=presses, settings=settings)


def folds_of(presses: PressTable, settings: Settings, trial: int) -> Ladder:
    """The folds of a trial, with as many prints in training as the settings say.

    Raises:
        InputError: See :func:`tacbench_cad.lab.analysis.classification.splits.ladder`.
    """
    seed = trial_seed(settings.seed, trial)
    whole = ladder(presses, settings.rungs, seed=seed, folds=settings.folds)
    if settings.copies is None:
        return whole
    cut = [with_copies(presses, fold, settings.copies, seed) for fold in whole.folds]
    short = dict.fromkeys(old.rung for old, new in zip(whole.folds, cut, strict=True) if new is None)
    notes = tuple(f"rung {rung} is left out: no {settings.copies} copies of each print in training" for rung in short)
    kept = tuple(fold for fold in cut if fold is not None and fold.rung not in short)
    return Ladder(folds=kept, notes=whole.notes + notes)


@one_thread()
def sound_trial(task: Task, trial: int) -> list[Outcome]:
    """Train and test every estimator in every fold of a trial.

    Raises:
        InputError: An estimator raises or says what is no texture, or there are too many components.
    """
    settings, presses = task.settings, task.presses
    seed = trial_seed(settings.seed, trial)
    folds = folds_of(presses, settings, trial).folds
    textures = [str(one) for one in np.unique(presses.texture)]
    outcomes: list[Outcome] = []
    for fold, (train, test) in zip(folds, _rows(task, folds, seed), strict=True):
        labels = np.tile(presses.texture[fold.train], settings.augmentation.count)
        for name in settings.estimators:
            where = f"trial {trial}, rung {fold.rung}" + (f", {fold.held_out} held out" if fold.held_out else "")
            said = _said(task, name, (train, labels, test), seed, where)
            outcomes.append(
                Outcome(
                    estimator=name,
                    train_on=TRAIN_ON,
                    tested_on=fold.held_out or TESTED_ON,
                    rung=fold.rung,
                    trial=trial,
                    press=fold.test,
                    copied=np.zeros(len(fold.test), dtype=np.int64),
                    predicted=predicted_index(name, said, len(fold.test), textures, where),
                )
            )
    return outcomes


def _rows(task: Task, folds: Sequence[Fold], seed: int) -> Any:
    """Training rows, augmented, and test rows of each fold."""
    settings = task.settings
    copies = settings.augmentation
    if task.pool is None or settings.components is None:
        for fold in folds:
            test = task.features.rows[fold.test].astype(np.float64)
            yield copies.rows(task.features, fold.train, seed), test
        return
    noise = None if copies.noise is None else Noise.of(task.pool, copies.noise, seed)
    for fold in folds:
        scores = principal_scores(task.pool, noise, copies, settings.components, fold.train)
        yield scores.train, scores.plain[fold.test]


def _said(task: Task, name: str, data: tuple[Any, Any, Any], seed: int, where: str) -> NDArray[Any]:
    """What an estimator says of the test rows."""
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    train, labels, test = data
    model = task.settings.estimator(name, seed)
    if task.pool is not None:
        model = make_pipeline(StandardScaler(), model)
    return np.asarray(guarded(name, where, lambda: model.fit(train, labels).predict(test)))
