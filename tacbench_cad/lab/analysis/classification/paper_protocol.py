"""The paper's protocol, as its text gives it, with what makes its test column too good.

Every image of one printer-filament combination is copied four times, principal components are fitted to all of these
copies, and only then are 20 % of the rows split off at random: copies of one image lie on both sides, so the test
column says how well a classifier recognises an image that it has seen. The unseen column is sound: it is of other
combinations. Components and batched networks come from :mod:`.pca` and :mod:`.network`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tacbench_cad.lab.analysis.classification.augment import trial_seed
from tacbench_cad.lab.analysis.classification.features import Features
from tacbench_cad.lab.analysis.classification.pca import Noise, Products, Scores, clipped_scores, principal_scores
from tacbench_cad.lab.analysis.classification.settings import (
    ESTIMATORS,
    TEST_SHARE,
    Outcome,
    Settings,
    guarded,
    one_thread,
    predicted_index,
)
from tacbench_cad.lab.analysis.classification.splits import PressTable
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Ints, Strings

#: The three columns of the paper's table.
RUNGS = ("train", "test", "unseen")
#: What is said beside every number of this protocol.
WARNING = (
    "protocol paper: copies of an image lie on both sides of the 20 % split, and the principal components have seen "
    "both, so the test column is inflated (it nears 100 % even on labels of pure noise); compare --protocol sound"
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Batch:
    """Trials of one training combination that one process trains.

    Args:
        settings: The settings.
        train_on: The combination.
        trials: Their numbers.
        scores: Of each trial.
        labels: Texture of every press.
        chosen: Indices of the presses that are trained on.
        unseen: Indices of the others.
    """

    settings: Settings
    train_on: str
    trials: tuple[int, ...]
    scores: tuple[Scores, ...]
    labels: Strings
    chosen: Ints
    unseen: Ints


def require_possible(features: Features, presses: PressTable, settings: Settings) -> None:
    """Check that the data can be put through this protocol.

    Raises:
        InputError: The readings are no images, or a combination is not there or has fewer than two textures.
    """
    if not features.is_image:
        what = "is for images (its copies are in counts of 0 to 255); use --protocol sound for other sensors"
        raise InputError("protocol", "paper", what)
    known = [str(one) for one in np.unique(presses.combination)]
    for one in settings.train_on:
        if one not in known:
            raise InputError("train-on", one, f"the runs have {', '.join(known)}")
        textures = np.unique(presses.texture[presses.combination == one])
        if len(textures) < 2:
            raise InputError("train-on", one, f"has only {textures[0]}; training needs at least two textures")


def batches(
    products: Products,
    presses: PressTable,
    settings: Settings,
    train_on: str,
    trials: Sequence[int],
    jobs: int,
) -> Iterator[Batch]:
    """The trials of a combination with their components' scores, in parts for processes.

    Args:
        products: Of all readings, images.
        presses: What is known of each press.
        settings: The settings.
        train_on: The combination.
        trials: Numbers of the trials.
        jobs: Processes that will take them.

    Raises:
        InputError: There are more components than the images have directions.
    """
    from joblib import Parallel, delayed

    from tacbench_cad.lab.analysis.classification.network import TOGETHER

    chosen = np.flatnonzero(presses.combination == train_on)
    unseen = np.flatnonzero(presses.combination != train_on)
    components = settings.components
    assert components is not None  # Settings refuses it for this protocol
    copies = settings.augmentation
    pool = None if settings.clip else products.pool(chosen, noise=copies.noise is not None)

    def scores(trial: int) -> Scores:
        seed = trial_seed(settings.seed, trial)
        if pool is None:
            return clipped_scores(np.asarray(products.rows, np.uint8), chosen, copies, components, seed)
        noise = None if copies.noise is None else Noise.of(pool, copies.noise, seed)
        return principal_scores(pool, noise, copies, components)

    # Each trial in a thread of its own: threads within each product would mostly wait for each other.
    found = Parallel(n_jobs=1 if pool is None else jobs, backend="threading")(delayed(scores)(one) for one in trials)
    size = min(TOGETHER, -(-len(trials) // jobs))
    for first in range(0, len(trials), size):
        part = slice(first, first + size)
        yield Batch(
            settings=settings,
            train_on=train_on,
            trials=tuple(trials[part]),
            scores=tuple(found[part]),
            labels=presses.texture,
            chosen=chosen,
            unseen=unseen,
        )


@one_thread()
def paper_trials(batch: Batch) -> list[list[Outcome]]:
    """Train and test every estimator in each trial of a batch.

    Returns:
        The outcomes of each trial.

    Raises:
        InputError: An estimator raises, or says what is no texture.
    """
    from sklearn.model_selection import train_test_split

    settings = batch.settings
    textures = [str(one) for one in np.unique(batch.labels)]
    labels = np.tile(batch.labels[batch.chosen], settings.augmentation.count)
    seeds = [trial_seed(settings.seed, trial) for trial in batch.trials]
    rows = [one.train for one in batch.scores]
    try:
        splits = [train_test_split(np.arange(len(labels)), test_size=TEST_SHARE, random_state=seed) for seed in seeds]
    except ValueError as error:
        raise InputError("train-on", batch.train_on, f"has too few presses for a split: {error}") from error
    outcomes: list[list[Outcome]] = [[] for _ in seeds]
    for name in settings.estimators:
        where = f"trials {batch.trials[0]} to {batch.trials[-1]} on {batch.train_on}"
        sets = [(one[train], labels[train]) for one, (train, _) in zip(rows, splits, strict=True)]
        models = guarded(name, where, lambda name=name, sets=sets: _fitted(settings, name, seeds, sets))
        for index, (model, (train, test)) in enumerate(zip(models, splits, strict=True)):
            for rung, scores, which in (
                ("train", rows[index][train], train),
                ("test", rows[index][test], test),
                ("unseen", batch.scores[index].plain[batch.unseen], None),
            ):
                if not len(scores):
                    continue
                said = guarded(name, where, lambda model=model, scores=scores: model.predict(scores))
                outcomes[index].append(
                    Outcome(
                        estimator=name,
                        train_on=batch.train_on,
                        tested_on="all others" if which is None else batch.train_on,
                        rung=rung,
                        trial=batch.trials[index],
                        press=batch.unseen if which is None else batch.chosen[which % len(batch.chosen)],
                        copied=np.zeros(len(scores), dtype=np.int64) if which is None else which // len(batch.chosen),
                        predicted=predicted_index(name, said, len(scores), textures, where),
                    )
                )
    return outcomes


def _fitted(settings: Settings, name: str, seeds: Sequence[int], sets: Sequence[tuple[Any, Any]]) -> list[Any]:
    """One fitted model for each trial."""
    models = [settings.estimator(name, seed) for seed in seeds]
    if name == ESTIMATORS[1]:
        from tacbench_cad.lab.analysis.classification.network import fit_together

        return list(fit_together(models, sets))
    return [model.fit(rows, labels) for model, (rows, labels) in zip(models, sets, strict=True)]
