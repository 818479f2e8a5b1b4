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

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from tacbench_cad.lab.analysis.classification.augment import Augmentation, trial_seed
from tacbench_cad.lab.analysis.classification.features import Rows
from tacbench_cad.lab.analysis.classification.outcomes import (
    ALL_OTHERS,
    ClassifiedStudy,
    guarded,
    predictions,
)
from tacbench_cad.lab.analysis.classification.principal import Products, coordinates, noisy
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


def calls(study: ClassifiedStudy, train_on: str, trials: Sequence[int]) -> list[Any]:
    """Return a call for each trial, for worker processes.

    Args:
        study: The data and settings that all trials share.
        train_on: The training combination.
        trials: The numbers of the trials.

    Raises:
        InputError: The protocol cannot be used with these data, or there are too many components.
    """
    from joblib import delayed

    _require_possible(study)
    settings, presses, rows = study.settings, study.presses, study.features.rows
    trained = ProtocolDesign.of(settings.protocol, presses, train_on).trained
    everything, components = np.arange(len(rows)), settings.components
    assert components is not None  # ClassificationSettings refuses it for this protocol
    if settings.clip:
        scores = [_clipped(rows, trained, settings, trial_seed(settings.seed, trial)) for trial in trials]
    else:
        found = coordinates(Products.of(rows), settings.augmentation, components, trained, everything)
        scores = [found] * len(trials)
    train = delayed(paper_trial)
    return [train(settings, presses, train_on, trial, *of) for trial, of in zip(trials, scores, strict=True)]


def _clipped(rows: Rows, trained: Ints, settings: ClassificationSettings, seed: int) -> tuple[Floats, Floats]:
    """Return the scores of copies that are rounded and clipped as in image files, and of all frames."""
    copies = np.clip(np.rint(settings.augmentation.rows(rows[trained], seed)), 0, 255).astype(np.uint8)
    products = Products.of(np.concatenate([copies, rows]))
    train, test = np.split(np.arange(len(products.gram)), [len(copies)])
    return coordinates(products, Augmentation(), settings.components or 1, train, test)


@one_thread()
def paper_trial(
    settings: ClassificationSettings,
    presses: PressTable,
    train_on: str,
    trial: int,
    trained: Floats,
    tested: Floats,
) -> pd.DataFrame:
    """Train and test every estimator in a trial, and return the predictions, see :data:`.outcomes.OUTCOMES`.

    Args:
        settings: The settings.
        presses: The presses.
        train_on: The training combination.
        trial: The number of the trial.
        trained: The coordinates of the training set, see :func:`.principal.coordinates`.
        tested: The coordinates of all frames.

    Raises:
        InputError: An estimator raises an error, or predicts an unknown texture.
    """
    from sklearn.model_selection import train_test_split

    design = ProtocolDesign.of(settings.protocol, presses, train_on)
    chosen, columns = design.trained, COLUMNS[settings.protocol]
    labels = np.tile(presses.texture[chosen], settings.augmentation.count)
    copies = Augmentation() if settings.clip else settings.augmentation
    seed, where = trial_seed(settings.seed, trial), f"trial {trial} on {train_on}"
    outcomes: list[pd.DataFrame] = []
    for name in settings.estimators:
        rows, plain = noisy(trained, tested, copies, settings.components or 1, seed)
        if settings.protocol == "as-published" and name == ESTIMATORS[1]:
            # The notebooks scale the scores to 0 to 1, with one minimum and maximum for all numbers of a set.
            ends = plain[design.tested["all copies"]]
            rows, plain = (rows - rows.min()) / np.ptp(rows), (plain - ends.min()) / np.ptp(ends)
            split = [np.arange(len(labels))]
        else:
            try:
                fraction = TEST_FRACTIONS[settings.protocol]
                split = train_test_split(np.arange(len(labels)), test_size=fraction, random_state=seed)
            except ValueError as error:
                raise InputError("train-on", train_on, f"has too few presses for a split: {error}") from error
        with guarded(name, where):
            model = settings.estimator(name, seed).fit(rows[split[0]], labels[split[0]])
        sets = [
            (column, train_on, rows[which], chosen[which % len(chosen)], which // len(chosen))
            for column, which in zip(columns, split, strict=False)
        ]
        sets += [
            (column, design.tested_on, plain[which], which, 0 * which)
            for column, which in design.tested.items()
            if len(which)
        ]
        for column, tested_on, values, press, copied in sets:
            predicted = predictions(model, values, presses.textures, name, where)
            same = {"estimator": name, "train_on": train_on, "tested_on": tested_on, "hold_out": column, "trial": trial}
            outcomes.append(pd.DataFrame({**same, "press": press, "copied": copied, "predicted": predicted}))
    return pd.concat(outcomes, ignore_index=True)
