"""Accuracies from what estimators said, with intervals whose units are prints and other held-out groups."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tacbench_cad.lab.analysis.classification import splits
from tacbench_cad.lab.analysis.classification.settings import Outcome
from tacbench_cad.lab.analysis.classification.splits import PressTable
from tacbench_cad.util.types import Bools, Floats, Ints

#: Confidence of the intervals.
CONFIDENCE = 0.95


def interval(right: Floats, tries: Floats, units: NDArray[np.generic]) -> tuple[float | None, float | None]:
    """A 95 % interval of an accuracy when the presses of one unit go right or wrong together.

    Korn and Graubard's (1998): the exact binomial interval of Clopper and Pearson for an effective number of presses,
    which is what would give the variance that is seen between units, cut by (z / t)^2 for the few units that the
    variance comes from. Where every press was told rightly, or none, no difference between units is seen, which does
    not mean that there is none: then a unit counts as one trial.

    Args:
        right: How often each press was told rightly, (n,).
        tries: How often each was tested, (n,).
        units: The unit of each, (n,).

    Returns:
        Lower and upper end; None where there is one unit, which says nothing of others.
    """
    from scipy import stats

    _, index = np.unique(units, return_inverse=True)
    count = int(index.max()) + 1
    if count < 2:
        return None, None
    inside, hits = np.bincount(index, tries), np.bincount(index, right)
    share = float(hits.sum() / inside.sum())
    weights = inside / inside.sum()
    beyond = (1 + CONFIDENCE) / 2
    if share in (0.0, 1.0):
        edge = float((1 - beyond) ** (1 / count))
        return (edge, 1.0) if share else (0.0, 1.0 - edge)
    variance = count / (count - 1) * float(np.sum((weights * (hits / inside - share)) ** 2))
    presses = float(len(tries))
    effective = min(presses, share * (1 - share) / variance) if variance > 0 else presses
    effective *= float((stats.norm.ppf(beyond) / stats.t.ppf(beyond, count - 1)) ** 2)
    successes, failures = share * effective, (1 - share) * effective
    low, high = stats.beta.ppf([1 - beyond, beyond], [successes, successes + 1], [failures + 1, failures])
    return float(low), float(high)


@dataclass(frozen=True, kw_only=True, eq=False)
class Score:
    """One row of the result.

    Args:
        estimator: Its name.
        train_on: What it was trained on.
        tested_on: What it was tested on.
        rung: The rung, or the paper's column.
        accuracy: Share of tested rows that were told rightly, over all trials.
        spread: Standard deviation of the trials' accuracies; None of one trial.
        low: Lower end of the interval, or None.
        high: Upper end.
        units: What the interval counts as one, and how many there are: ``24 prints``.
        trials: Trials.
        images: Different presses that were tested.
        confusion: How often each texture (rows) was taken for each (columns), over all trials.
    """

    estimator: str
    train_on: str
    tested_on: str
    rung: str
    accuracy: float
    spread: float | None
    low: float | None
    high: float | None
    units: str
    trials: int
    images: int
    confusion: Ints

    @property
    def recall(self) -> list[float | None]:
        """Share of each texture's rows that were told rightly; None of a texture that was not tested."""
        totals = self.confusion.sum(axis=1)
        rights = np.diag(self.confusion)
        return [float(right / total) if total else None for right, total in zip(rights, totals, strict=True)]


def score(
    outcomes: Sequence[Outcome],
    presses: PressTable,
    names: tuple[str, str, str, str],
    units: tuple[str, NDArray[np.generic]],
) -> Score:
    """The row of some outcomes.

    Args:
        outcomes: At least one.
        presses: What is known of each press.
        names: Estimator, train_on, tested_on, rung.
        units: What the units are called, and the unit of every press of the study.
    """
    textures, truth = np.unique(presses.texture, return_inverse=True)
    which = np.concatenate([one.press for one in outcomes])
    said = np.concatenate([one.predicted for one in outcomes])
    trial = np.repeat([one.trial for one in outcomes], [len(one.press) for one in outcomes])
    hit = truth[which] == said
    size = len(truth)
    tries, right = (np.bincount(which, one, size).astype(np.float64) for one in (np.ones(len(which)), hit))
    tested = tries > 0
    low, high = interval(right[tested], tries[tested], units[1][tested])
    each = [float(hit[trial == one].mean()) for one in np.unique(trial)]
    confusion = np.bincount(truth[which] * len(textures) + said, minlength=len(textures) ** 2)
    estimator, train_on, tested_on, rung = names
    return Score(
        estimator=estimator,
        train_on=train_on,
        tested_on=tested_on,
        rung=rung,
        accuracy=float(hit.mean()),
        spread=float(np.std(each, ddof=1)) if len(each) > 1 else None,
        low=low,
        high=high,
        units=f"{len(np.unique(units[1][tested]))} {units[0]}",
        trials=len(each),
        images=int(tested.sum()),
        confusion=confusion.reshape(len(textures), -1),
    )


def sound_scores(outcomes: Sequence[Outcome], presses: PressTable) -> list[Score]:
    """The ladder's rows: each rung as a whole, then each held-out group that has a name."""
    rows = []
    for estimator, rung in _keys(outcomes, lambda one: (one.estimator, one.rung)):
        mine = [one for one in outcomes if (one.estimator, one.rung) == (estimator, rung)]
        units = (splits.UNITS[rung], splits.units_of(presses, rung))
        rows.append(score(mine, presses, (estimator, mine[0].train_on, "all", rung), units))
        for (group,) in _keys(mine, lambda one: (one.tested_on,)):
            if group != "all":
                part = [one for one in mine if one.tested_on == group]
                names = (estimator, mine[0].train_on, group, rung)
                rows.append(score(part, presses, names, ("prints", presses.run)))
    return rows


def paper_scores(outcomes: Sequence[Outcome], presses: PressTable) -> list[Score]:
    """The paper's three columns for each combination and estimator, and each unseen combination by itself."""
    rows = []
    for train_on, estimator, rung in _keys(outcomes, lambda one: (one.train_on, one.estimator, one.rung)):
        mine = [one for one in outcomes if (one.train_on, one.estimator, one.rung) == (train_on, estimator, rung)]
        units = ("prints", presses.run)
        rows.append(score(mine, presses, (estimator, train_on, mine[0].tested_on, rung), units))
        if rung != "unseen":
            continue
        there = np.unique(presses.combination[mine[0].press])
        for combination in there.tolist() if len(there) > 1 else ():
            part = [_only(one, presses.combination[one.press] == combination) for one in mine]
            rows.append(score(part, presses, (estimator, train_on, str(combination), rung), units))
    return rows


def _only(outcome: Outcome, which: Bools) -> Outcome:
    return Outcome(
        estimator=outcome.estimator,
        train_on=outcome.train_on,
        tested_on=outcome.tested_on,
        rung=outcome.rung,
        trial=outcome.trial,
        press=outcome.press[which],
        copied=outcome.copied[which],
        predicted=outcome.predicted[which],
    )


def _keys(outcomes: Iterable[Outcome], key: Callable[[Outcome], tuple[str, ...]]) -> list[tuple[str, ...]]:
    """The different keys, in the order of their first outcome."""
    return list(dict.fromkeys(key(one) for one in outcomes))
