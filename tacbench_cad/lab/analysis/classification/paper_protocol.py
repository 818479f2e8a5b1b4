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

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from joblib import delayed
from sklearn.model_selection import train_test_split
from threadpoolctl import threadpool_limits

from tacbench_cad.lab.analysis.classification.accuracy import ALL
from tacbench_cad.lab.analysis.classification.settings import ClassificationSettings, predicted, trial_seed
from tacbench_cad.lab.analysis.classification.training_rows import Augmentation, coordinates, inner_products, noisy
from tacbench_cad.lab.analysis.classification.trials import TrialData
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import counted
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
#: The number of images of each texture in training, and who says so.
EXPECTED = {
    "paper": (300, "the text says 300 of each (6 prints x 25 positions x 2, one force)"),
    "as-published": (50, "the notebooks had 50 of each (1 print x 25 positions x 2, one force)"),
}


def sets_of(protocol: str, presses: pd.DataFrame, train_on: str) -> tuple[Ints, dict[str, Ints]]:
    """Return the training presses of a protocol for one combination, and its test presses by column.

    Args:
        protocol: ``paper`` or ``as-published``.
        presses: One row for each press.
        train_on: The training combination.
    """
    inside = (presses["combination"] == train_on).to_numpy()
    if protocol == "paper":
        return np.flatnonzero(inside), {"unseen": np.flatnonzero(~inside)}
    first = inside & (presses["copy"] == presses["copy"][inside].min()).to_numpy()
    return np.flatnonzero(first), {
        "all copies": np.flatnonzero(inside),
        "other copies": np.flatnonzero(inside & ~first),
    }


def differences(settings: ClassificationSettings, presses: pd.DataFrame) -> Iterator[str]:
    """Yield differences between the data and the paper's text, or the authors' notebooks.

    Raises:
        InputError: A combination is missing or has fewer than two textures, or there are several force levels.
    """
    levels = presses["level"].unique()
    if settings.protocol == "as-published" and len(levels) > 1:
        raise InputError("force-level", levels.tolist(), "must be one for the protocol as-published")
    expected, whose = EXPECTED[settings.protocol]
    for train_on in settings.train_on:
        known = presses["combination"].unique()
        if train_on not in known:
            raise InputError("train-on", train_on, f"must be a combination of the runs: {', '.join(sorted(known))}")
        mine = presses.iloc[sets_of(settings.protocol, presses, train_on)[0]]
        textures = mine["texture"].unique()
        if len(textures) < 2:
            raise InputError("train-on", train_on, f"has only {textures[0]}; training needs at least two textures")
        images, of_levels = len(mine) / len(textures), counted(mine["level"].nunique(), "force level")
        if images != expected:
            yield f"{train_on}: trained on {images:g} images of each texture ({of_levels}); {whose}"


def calls(data: TrialData, train_on: str, trials: Sequence[int]) -> list[Any]:
    """Return a call for each trial, for worker processes.

    Args:
        data: The data and settings that all trials share.
        train_on: The training combination.
        trials: The numbers of the trials.

    Raises:
        InputError: The frames are not images, or there are too many components.
    """
    settings, rows, presses = data.settings, data.rows, data.design.first_steps
    if rows.dtype != np.uint8:
        what = "is for images (its copies are in counts of 0 to 255); use --protocol leak-free for other sensors"
        raise InputError("protocol", settings.protocol, what)
    sets = sets_of(settings.protocol, presses, train_on)
    chosen, every, components = sets[0], np.arange(len(rows)), settings.components or 1
    found = {}
    if not settings.clip:
        found = dict.fromkeys(trials, coordinates(data.products, settings.augmentation, components, chosen, every))
    for trial in trials if settings.clip else ():
        copies = settings.augmentation.rows(rows[chosen], trial_seed(settings.seed, trial))
        whole = np.concatenate([np.clip(np.rint(copies), 0, 255).astype(np.uint8), rows])
        parts = np.split(np.arange(len(whole)), [len(copies)])
        found[trial] = coordinates(inner_products(whole), Augmentation(), components, *parts)
    train = delayed(paper_trial)
    return [train(settings, presses, train_on, *sets, trial, scores) for trial, scores in found.items()]


@threadpool_limits.wrap(limits=1)  # type: ignore[untyped-decorator]
def paper_trial(
    settings: ClassificationSettings,
    presses: pd.DataFrame,
    train_on: str,
    chosen: Ints,
    tested: Mapping[str, Ints],
    trial: int,
    scores: tuple[Floats, Floats],
) -> pd.DataFrame:
    """Train and test every estimator in a trial, and return the predictions.

    Args:
        settings: The settings.
        presses: One row for each press.
        train_on: The training combination.
        chosen: The indices of the training presses.
        tested: The indices of the test presses, by column.
        trial: The number of the trial.
        scores: The coordinates of the training set and of all frames, see :func:`.training_rows.coordinates`.

    Raises:
        InputError: An estimator raises an error, or predicts an unknown texture.
    """
    copies = Augmentation() if settings.clip else settings.augmentation
    seed, where = trial_seed(settings.seed, trial), f"trial {trial} on {train_on}"
    labels = np.tile(presses["texture"].to_numpy(str)[chosen], settings.augmentation.count)
    outcomes: list[pd.DataFrame] = []
    for name in settings.estimators:
        rows, plain = noisy(*scores, copies, settings.components or 1, seed)
        split = [np.arange(len(labels))]
        if settings.protocol == "as-published" and name == "network":
            # The notebooks scale the scores to 0 to 1, with one minimum and maximum for all numbers of a set.
            ends = plain[tested["all copies"]]
            rows, plain = (rows - rows.min()) / np.ptp(rows), (plain - ends.min()) / np.ptp(ends)
        else:
            try:
                split = train_test_split(*split, test_size=TEST_FRACTIONS[settings.protocol], random_state=seed)
            except ValueError as error:
                raise InputError("train-on", train_on, f"has too few presses for a split: {error}") from error
        # For each column, the rows, their presses, and the number of the copy.
        sets = {
            column: (rows[which], chosen[which % len(chosen)], which // len(chosen))
            for column, which in zip(COLUMNS[settings.protocol], split, strict=False)
        }
        sets |= {column: (plain[which], which, 0 * which) for column, which in tested.items() if len(which)}
        model, training = settings.estimator(name, seed), (rows[split[0]], labels[split[0]])
        words = predicted(name, model, training, [values for values, _, _ in sets.values()], where)
        for (column, (_, press, copied)), found in zip(sets.items(), words, strict=True):
            group = presses["combination"].to_numpy()[press] if column == "unseen" else ALL
            same = {"estimator": name, "train_on": train_on, "tested_on": group, "hold_out": column, "trial": trial}
            outcomes.append(pd.DataFrame({**same, "press": press, "copied": copied, "predicted": found}))
    return pd.concat(outcomes, ignore_index=True)
