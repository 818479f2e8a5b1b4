"""The paper's protocol, as its text gives it, with what makes its test column too good.

Every image of one printer-filament combination is copied four times, principal components are fitted to all of these
copies, and only then are 20 % of the rows split off at random: copies of one image lie on both sides, so the test
column says how well a classifier recognises an image that it has seen. The unseen column does not leak: it is of other
combinations.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from tacbench_cad.lab.analysis.classification.augment import trial_seed
from tacbench_cad.lab.analysis.classification.outcomes import ALL_OTHERS, Outcome, Study, guarded, predictions
from tacbench_cad.lab.analysis.classification.pca import Pool, Scores, clipped_scores, trial_scores
from tacbench_cad.lab.analysis.classification.settings import (
    ESTIMATORS,
    TEST_FRACTION,
    ClassificationSettings,
    one_thread,
)
from tacbench_cad.lab.analysis.classification.splits import PressTable
from tacbench_cad.util.errors import InputError

#: The three columns of the paper's table.
COLUMNS = ("train", "test", "unseen")
#: What is said beside every number of this protocol.
WARNING = (
    "protocol paper: copies of an image lie on both sides of the 20 % split, and the principal components have seen "
    "both, so the test column is inflated (it nears 100 % even on labels of pure noise); compare --protocol leak-free"
)


def _require_possible(study: Study) -> None:
    """Check that the data can be put through this protocol.

    Raises:
        InputError: The readings are no images, or a combination is not there or has fewer than two textures.
    """
    if not study.features.is_image:
        what = "is for images (its copies are in counts of 0 to 255); use --protocol leak-free for other sensors"
        raise InputError("protocol", "paper", what)
    combinations, textures = study.presses.combination, study.presses.texture
    known = [str(name) for name in np.unique(combinations)]
    for name in study.settings.train_on:
        if name not in known:
            raise InputError("train-on", name, f"the runs have {', '.join(known)}")
        present = np.unique(textures[combinations == name])
        if len(present) < 2:
            raise InputError("train-on", name, f"has only {present[0]}; training needs at least two textures")


def calls(study: Study, train_on: str, trials: Sequence[int], jobs: int) -> list[tuple[Sequence[int], Any]]:
    """Calls for worker processes, each with the trials whose networks it trains together.

    Args:
        study: What all trials share.
        train_on: The combination that is trained on.
        trials: Numbers of the trials.
        jobs: Processes that will take the calls.

    Raises:
        InputError: The protocol is not for these data, or there are more components than directions.
    """
    from joblib import delayed

    from tacbench_cad.lab.analysis.classification.network import TOGETHER

    _require_possible(study)
    settings, copies = study.settings, study.settings.augmentation
    components = settings.components
    assert components is not None  # ClassificationSettings refuses it for this protocol
    chosen = np.flatnonzero(study.presses.combination == train_on)
    rows, seeds = study.features.rows, [trial_seed(settings.seed, trial) for trial in trials]
    if settings.clip:
        images = np.asarray(rows, np.uint8)
        all_scores = [clipped_scores(images, chosen, copies, components, seed) for seed in seeds]
    else:
        noise = copies.noise is not None
        pool = Pool.of(rows, chosen, components=components, noise=noise, seeds=seeds, jobs=jobs)
        all_scores = trial_scores(pool, copies, components, seeds, jobs)
    size = min(TOGETHER, -(-len(trials) // jobs))
    parts = [slice(first, first + size) for first in range(0, len(trials), size)]
    train = delayed(paper_trials)
    return [(trials[part], train(settings, study.presses, train_on, trials[part], all_scores[part])) for part in parts]


@one_thread()
def paper_trials(
    settings: ClassificationSettings,
    presses: PressTable,
    train_on: str,
    trials: Sequence[int],
    scores: Sequence[Scores],
) -> list[list[Outcome]]:
    """Train and test every estimator in some trials.

    Returns:
        The outcomes of each trial.

    Raises:
        InputError: An estimator raises, or predicts what is no texture.
    """
    from sklearn.model_selection import train_test_split

    inside = presses.combination == train_on
    chosen, unseen = np.flatnonzero(inside), np.flatnonzero(~inside)
    labels = np.tile(presses.texture[chosen], settings.augmentation.count)
    seeds = [trial_seed(settings.seed, trial) for trial in trials]
    try:
        splits = [train_test_split(np.arange(len(labels)), test_size=TEST_FRACTION, random_state=s) for s in seeds]
    except ValueError as error:
        raise InputError("train-on", train_on, f"has too few presses for a split: {error}") from error
    outcomes: list[list[Outcome]] = [[] for _ in trials]
    for name in settings.estimators:
        where = f"trials {trials[0]} to {trials[-1]} on {train_on}"
        with guarded(name, where):
            sets = [(rows.train[train], labels[train]) for rows, (train, _) in zip(scores, splits, strict=True)]
            models = _fitted(settings, name, seeds, sets)
        for trial, model, split, drawn, results in zip(trials, models, splits, scores, outcomes, strict=True):
            tested = [
                (column, train_on, drawn.train[which], chosen[which % len(chosen)], which // len(chosen))
                for column, which in zip(COLUMNS, split, strict=False)
            ]
            if len(unseen):
                tested.append((COLUMNS[2], ALL_OTHERS, drawn.plain[unseen], unseen, 0 * unseen))
            for column, tested_on, rows, press, copied in tested:
                results.append(
                    Outcome(
                        estimator=name,
                        train_on=train_on,
                        tested_on=tested_on,
                        hold_out=column,
                        trial=trial,
                        press=press,
                        copied=copied,
                        predicted=predictions(model, rows, presses.textures, name, where),
                    )
                )
    return outcomes


def _fitted(
    settings: ClassificationSettings, name: str, seeds: Sequence[int], sets: Sequence[tuple[Any, Any]]
) -> list[Any]:
    """One fitted model for each trial."""
    models = [settings.estimator(name, seed) for seed in seeds]
    if name == ESTIMATORS[1]:
        from tacbench_cad.lab.analysis.classification.network import fit_together

        return list(fit_together(models, sets))
    return [model.fit(rows, labels) for model, (rows, labels) in zip(models, sets, strict=True)]
