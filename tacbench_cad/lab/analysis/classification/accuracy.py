"""The accuracies of estimators, with intervals whose units are prints and other held-out groups."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacbench_cad.lab.analysis.answers import RIGHT, TOLD_APART, WHICH_TEXTURES, Answer
from tacbench_cad.lab.analysis.classification.outcomes import ALL, ALL_OTHERS, Outcome
from tacbench_cad.lab.analysis.classification.splits import UNITS, PressTable
from tacbench_cad.util.text import natural_unique
from tacbench_cad.util.types import Floats, Ints

#: The confidence level of the intervals.
CONFIDENCE = 0.95


def interval(correct: Floats, tries: Floats, units: NDArray[np.generic]) -> tuple[float | None, float | None]:
    """Compute the 95 % interval of an accuracy when predictions within one unit are correlated.

    The interval is that of Korn and Graubard (1998): the exact binomial interval of Clopper and Pearson for an
    effective number of presses. Independent presses of this number would have the variance that is measured between
    units. The number is multiplied by (z / t)^2, because the variance is estimated from few units. If all presses,
    or none, are predicted correctly, no differences between units can be measured. They may exist nevertheless, so
    each unit then counts as one trial.

    Args:
        correct: The number of correct predictions of each press, (n,).
        tries: The number of tests of each press, (n,).
        units: The unit of each press, (n,).

    Returns:
        The lower and the upper end; None if there is only one unit.
    """
    from scipy import stats

    _, index = np.unique(units, return_inverse=True)
    count = int(index.max()) + 1
    if count < 2:
        return None, None
    inside, hits = np.bincount(index, tries), np.bincount(index, correct)
    fraction = float(hits.sum() / inside.sum())
    weights = inside / inside.sum()
    beyond = (1 + CONFIDENCE) / 2
    if fraction in (0.0, 1.0):
        edge = float((1 - beyond) ** (1 / count))
        return (edge, 1.0) if fraction else (0.0, 1.0 - edge)
    variance = count / (count - 1) * float(np.sum((weights * (hits / inside - fraction)) ** 2))
    presses = float(len(tries))
    effective = min(presses, fraction * (1 - fraction) / variance) if variance > 0 else presses
    effective *= float((stats.norm.ppf(beyond) / stats.t.ppf(beyond, count - 1)) ** 2)
    successes, failures = fraction * effective, (1 - fraction) * effective
    low, high = stats.beta.ppf([1 - beyond, beyond], [successes, successes + 1], [failures + 1, failures])
    return float(low), float(high)


@dataclass(frozen=True, kw_only=True, eq=False)
class Score:
    """One row of the result.

    Args:
        protocol: The protocol.
        estimator: The name of the estimator.
        train_on: The training data.
        tested_on: The test data.
        hold_out: The hold-out level, or the paper's column.
        accuracy: The fraction of tested rows that were predicted correctly, over all trials.
        standard_deviation: The standard deviation of the trials' accuracies; None for one trial.
        low: The lower end of the interval, or None.
        high: The upper end of the interval, or None.
        units: The number and the name of the interval's units: ``24 prints``.
        trials: The number of trials.
        images: The number of different presses that were tested.
        confusion: How often each texture (rows) was predicted as each texture (columns), over all trials.
    """

    protocol: str
    estimator: str
    train_on: str
    tested_on: str
    hold_out: str
    accuracy: float
    standard_deviation: float | None
    low: float | None
    high: float | None
    units: str
    trials: int
    images: int
    confusion: Ints

    @property
    def whole(self) -> bool:
        """Whether the row contains all held-out groups, not a single one."""
        return is_whole(self.tested_on, self.train_on)

    @property
    def fractions(self) -> Floats:
        """The confusion matrix as fractions of each texture's rows; NaN for a texture that was not tested."""
        totals = self.confusion.sum(axis=1, keepdims=True)
        result = np.full(self.confusion.shape, np.nan)
        np.divide(self.confusion, totals, out=result, where=totals > 0)
        return result

    @property
    def recall(self) -> list[float | None]:
        """The fraction of correct predictions for each texture; None for a texture that was not tested."""
        return [None if np.isnan(value) else float(value) for value in np.diag(self.fractions)]


def texture_answers(outcomes: Sequence[Outcome], presses: PressTable, notes: Sequence[str]) -> Iterator[Answer]:
    """Yield the answer for each texture: can the first estimator tell it apart on a print that training has not seen?

    Args:
        outcomes: The predictions with the leak-free protocol.
        presses: The presses.
        notes: The notes of the classification, with the reasons why hold-out levels were left out.
    """
    mine = [o for o in outcomes if o.hold_out == "copy" and o.estimator == outcomes[0].estimator]
    if not mine:
        reason = next((note for note in notes if "level copy" in note), "hold-out level copy was not computed")
        yield Answer(question=WHICH_TEXTURES, about="", answer=f"cannot be said: {reason}")
        return
    textures, truth = natural_unique(presses.texture)
    tries, correct, _, _ = _tallied(mine, truth)
    for index, texture in enumerate(textures.tolist()):
        tested = (truth == index) & (tries > 0)
        if not tested.any():
            yield Answer(
                question=WHICH_TEXTURES, about=texture, answer="cannot be said: none of its prints was held out"
            )
            continue
        low, high = interval(correct[tested], tries[tested], presses.run[tested])
        answer = "unclear: only one print was held out" if low is None else "unclear"
        if low is not None and high is not None:
            answer = "yes" if low > TOLD_APART else "no" if high < TOLD_APART else answer
        yield Answer(
            question=WHICH_TEXTURES,
            about=texture,
            figure=100.0 * float(correct[tested].sum() / tries[tested].sum()),
            low=None if low is None else 100.0 * low,
            high=None if high is None else 100.0 * high,
            unit=RIGHT,
            answer=answer,
        )


def is_whole(tested_on: str, train_on: str) -> bool:
    """Whether a row contains all held-out groups, not a single one."""
    return tested_on in (ALL, ALL_OTHERS, train_on)


def scores(outcomes: Sequence[Outcome], presses: PressTable, protocol: str) -> list[Score]:
    """Return the rows: for each hold-out level (or column of the paper) the total, then each named held-out group."""
    rows = []
    wholes = defaultdict(list)
    for outcome in outcomes:
        wholes[outcome.train_on, outcome.estimator, outcome.hold_out].append(outcome)
    for (_, _, hold_out), whole in wholes.items():
        tested_on = ALL if hold_out in UNITS else whole[0].tested_on
        rows.append(_score(whole, presses, protocol, tested_on, *presses.units(hold_out)))
        for group, part in _groups(whole, presses).items():
            rows.append(_score(part, presses, protocol, group, *presses.units("copy")))
    return rows


def _groups(whole: Sequence[Outcome], presses: PressTable) -> dict[str, list[Outcome]]:
    """Return the outcomes of each named held-out group."""
    groups = defaultdict(list)
    for outcome in whole:
        if outcome.tested_on == ALL_OTHERS:
            combination = presses.combination[outcome.press]
            names = np.unique(combination)
            for name in names if len(names) > 1 else ():
                groups[str(name)].append(outcome.only(combination == name))
        elif outcome.tested_on not in (ALL, outcome.train_on):
            groups[outcome.tested_on].append(outcome)
    return groups


def _tallied(outcomes: Sequence[Outcome], truth: Ints) -> tuple[Floats, Floats, Ints, Ints]:
    """Count the tests and the correct predictions of each press, (n,); also return each row's press and prediction."""
    which = np.concatenate([outcome.press for outcome in outcomes])
    predicted = np.concatenate([outcome.predicted for outcome in outcomes])
    hit = truth[which] == predicted
    tries, correct = (np.bincount(which, weight, len(truth)).astype(np.float64) for weight in (None, hit))
    return tries, correct, which, predicted


def _score(
    outcomes: Sequence[Outcome], presses: PressTable, protocol: str, tested_on: str, units: str, unit: NDArray[Any]
) -> Score:
    """Compute the row of some outcomes; ``unit`` has the unit of every press of the study, (n,)."""
    textures, truth = natural_unique(presses.texture)
    tries, correct, which, predicted = _tallied(outcomes, truth)
    trial = np.repeat([outcome.trial for outcome in outcomes], [len(outcome.press) for outcome in outcomes])
    hit = truth[which] == predicted
    tested = tries > 0
    low, high = interval(correct[tested], tries[tested], unit[tested])
    accuracies = [float(hit[trial == number].mean()) for number in np.unique(trial)]
    confusion = np.bincount(truth[which] * len(textures) + predicted, minlength=len(textures) ** 2)
    return Score(
        protocol=protocol,
        estimator=outcomes[0].estimator,
        train_on=outcomes[0].train_on,
        tested_on=tested_on,
        hold_out=outcomes[0].hold_out,
        accuracy=float(hit.mean()),
        standard_deviation=float(np.std(accuracies, ddof=1)) if len(accuracies) > 1 else None,
        low=low,
        high=high,
        units=f"{len(np.unique(unit[tested]))} {units}",
        trials=len(accuracies),
        images=int(tested.sum()),
        confusion=confusion.reshape(len(textures), -1),
    )
