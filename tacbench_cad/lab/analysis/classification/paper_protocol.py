"""The paper's protocol, as in its text or as in its authors' notebooks, including the steps that inflate its results.

In the text (``paper``), every image of one printer-filament combination has four copies, and principal components are
fitted to all of these copies. Only then are 20 % of the rows split off at random. Copies of one image are therefore in
both parts, and the test column shows how well a classifier recognises an image that it has seen. The unseen column has
no such leak, because its images are from other combinations.

The printed accuracies come from other notebook cells (``as-published``). Their training data are copy 1 of one
combination at one force: the magnitude of each image's Sobel derivatives, and one noisy copy of it. The forest is
trained on a random 75 % of these rows, and the network on all rows. The printed "unseen" column contains all copies of
that combination, including copy 1. Here it is called ``all copies``, and ``other copies`` leaves copy 1 out.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tacbench_cad.lab.analysis.classification.augment import trial_seed
from tacbench_cad.lab.analysis.classification.outcomes import (
    ALL_OTHERS,
    ClassifiedStudy,
    TestOutcome,
    guarded,
    predictions,
)
from tacbench_cad.lab.analysis.classification.pca import Pool, Scores, clipped_scores, trial_scores
from tacbench_cad.lab.analysis.classification.settings import ESTIMATORS, ClassificationSettings, one_thread
from tacbench_cad.lab.analysis.classification.splits import PressTable
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats, Ints

#: The columns of each protocol's table. The paper printed the first three of ``as-published``.
COLUMNS = {
    "paper": ("train", "test", "unseen"),
    "as-published": ("train", "test", "all copies", "other copies"),
}
#: The fraction of the augmented rows that is split off for the test.
TEST_FRACTIONS = {"paper": 0.2, "as-published": 0.25}
#: The warning for each of these protocols.
WARNINGS = {
    "paper": "protocol paper: copies of an image are on both sides of the 20 % split, and the principal components are "
    "fitted to both, so the test column is inflated (it is close to 100 % even for random labels); compare it with "
    "--protocol leak-free",
    "as-published": 'protocol as-published: "all copies", printed in the paper as unseen prints, includes the training '
    'images, and "test" includes noisy copies of most of them, to which the principal components were also fitted; '
    'both are inflated, and only "other copies" has prints that training has not seen',
}


@dataclass(frozen=True, kw_only=True, eq=False)
class ProtocolDesign:
    """The training and test presses of a protocol.

    Args:
        trained: The indices of the training presses, before copies are made.
        tested: The indices of the test presses, by column.
        tested_on: The name of the test data.
    """

    trained: Ints
    tested: Mapping[str, Ints]
    tested_on: str

    @classmethod
    def of(cls, protocol: str, presses: PressTable, train_on: str) -> ProtocolDesign:
        """Make the design of a protocol for one combination."""
        inside = presses.combination == train_on
        if protocol == "paper":
            columns = {"unseen": np.flatnonzero(~inside)}
            return cls(trained=np.flatnonzero(inside), tested=columns, tested_on=ALL_OTHERS)
        first = inside & (presses.copy == np.unique(presses.copy[inside])[0])
        columns = {"all copies": np.flatnonzero(inside), "other copies": np.flatnonzero(inside & ~first)}
        return cls(trained=np.flatnonzero(first), tested=columns, tested_on=train_on)


def _require_possible(study: ClassifiedStudy) -> None:
    """Check that this protocol can be used with the data.

    Raises:
        InputError: The frames are not images, or a combination is missing or has fewer than two textures.
    """
    protocol = study.settings.protocol
    if not study.features.is_image:
        what = "is for images (its copies are in counts of 0 to 255); use --protocol leak-free for other sensors"
        raise InputError("protocol", protocol, what)
    levels = np.unique(study.presses.level)
    if protocol == "as-published" and len(levels) > 1:
        raise InputError("force-level", levels.tolist(), "must be one for the protocol as-published")
    combinations, textures = study.presses.combination, study.presses.texture
    known = [str(name) for name in np.unique(combinations)]
    for name in study.settings.train_on:
        if name not in known:
            raise InputError("train-on", name, f"must be a combination of the runs: {', '.join(known)}")
        present = np.unique(textures[ProtocolDesign.of(protocol, study.presses, name).trained])
        if len(present) < 2:
            raise InputError("train-on", name, f"has only {present[0]}; training needs at least two textures")


def calls(study: ClassifiedStudy, train_on: str, trials: Sequence[int], jobs: int) -> list[tuple[Sequence[int], Any]]:
    """Return calls for worker processes. Each call has several trials, whose networks are trained together.

    Args:
        study: The data and settings that all trials share.
        train_on: The training combination.
        trials: The numbers of the trials.
        jobs: The number of worker processes.

    Raises:
        InputError: The protocol cannot be used with these data, or there are too many components.
    """
    from joblib import delayed

    from tacbench_cad.lab.analysis.classification.network import TOGETHER

    _require_possible(study)
    settings, copies = study.settings, study.settings.augmentation
    components = settings.components
    assert components is not None  # ClassificationSettings refuses it for this protocol
    chosen = ProtocolDesign.of(settings.protocol, study.presses, train_on).trained
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
) -> list[list[TestOutcome]]:
    """Train and test every estimator in some trials.

    Returns:
        The outcomes of each trial.

    Raises:
        InputError: An estimator raises an error, or predicts an unknown texture.
    """
    from sklearn.model_selection import train_test_split

    design = ProtocolDesign.of(settings.protocol, presses, train_on)
    chosen, columns = design.trained, COLUMNS[settings.protocol]
    labels = np.tile(presses.texture[chosen], settings.augmentation.count)
    seeds = [trial_seed(settings.seed, trial) for trial in trials]
    whole, fraction = np.arange(len(labels)), TEST_FRACTIONS[settings.protocol]
    outcomes: list[list[TestOutcome]] = [[] for _ in trials]
    for name in settings.estimators:
        where = f"trials {trials[0]} to {trials[-1]} on {train_on}"
        try:
            splits = [train_test_split(whole, test_size=fraction, random_state=seed) for seed in seeds]
        except ValueError as error:
            raise InputError("train-on", train_on, f"has too few presses for a split: {error}") from error
        if settings.protocol == "as-published" and name == ESTIMATORS[1]:
            splits = [(whole,) for _ in seeds]
            scores = [_scaled(drawn, design.tested["all copies"]) for drawn in scores]
        with guarded(name, where):
            sets = [(drawn.train[train], labels[train]) for drawn, (train, *_) in zip(scores, splits, strict=True)]
            models = _fitted(settings, name, seeds, sets)
        for trial, model, split, drawn, results in zip(trials, models, splits, scores, outcomes, strict=True):
            tested = [
                (column, train_on, drawn.train[which], chosen[which % len(chosen)], which // len(chosen))
                for column, which in zip(columns, split, strict=False)
            ]
            tested += [
                (column, design.tested_on, drawn.plain[which], which, 0 * which)
                for column, which in design.tested.items()
                if len(which)
            ]
            for column, tested_on, rows, press, copied in tested:
                results.append(
                    TestOutcome(
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
    """Return a fitted model for each trial."""
    models = [settings.estimator(name, seed) for seed in seeds]
    if name == ESTIMATORS[1] and settings.protocol == "paper":
        from tacbench_cad.lab.analysis.classification.network import fit_together

        return list(fit_together(models, sets))
    from sklearn.exceptions import ConvergenceWarning

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # all epochs are run
        warnings.filterwarnings("ignore", "Got `batch_size`")
        return [model.fit(rows, labels) for model, (rows, labels) in zip(models, sets, strict=True)]


def _scaled(scores: Scores, tested: Ints) -> Scores:
    """Scale scores as for the notebooks' network: to 0 to 1, with one minimum and maximum for all numbers of a set."""

    def scaled(rows: Floats, ends: Floats) -> Floats:
        return np.asarray((rows - ends.min()) / np.ptp(ends))

    plain = scaled(scores.plain, scores.plain[tested])
    return replace(scores, train=scaled(scores.train, scores.train), plain=plain)
