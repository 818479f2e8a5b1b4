"""The accuracies of estimators, with intervals whose units are prints and other held-out groups."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tacbench_cad.lab.analysis.classification.accuracy_intervals import TOO_FEW, correlation_of, interval_of
from tacbench_cad.lab.analysis.classification.outcomes import ALL, ALL_OTHERS
from tacbench_cad.lab.analysis.classification.splits import UNITS, PressTable
from tacbench_cad.lab.analysis.conclusions import RIGHT, TOLD_APART, WHICH_TEXTURES, Answer
from tacbench_cad.util.text import natural_unique
from tacbench_cad.util.types import Floats, Ints


@dataclass(frozen=True, kw_only=True, eq=False)
class FoldScore:
    """One row of the result.

    Args:
        protocol: The protocol.
        estimator: The name of the estimator.
        train_on: The training data.
        tested_on: The test data.
        hold_out: The hold-out level, or the paper's column.
        accuracy: The fraction of tested rows that were predicted correctly, over all trials.
        standard_deviation: The standard deviation of the trials' accuracies; None for one trial.
        low: The lower end of the interval; None if there are too few groups.
        high: The upper end of the interval; None if there are too few groups.
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


def texture_answers(outcomes: pd.DataFrame, presses: PressTable, notes: Sequence[str]) -> Iterator[Answer]:
    """Yield the answer for each texture: can the first estimator tell it apart on a print that training has not seen?

    Args:
        outcomes: The predictions with the leak-free protocol, see :data:`.outcomes.OUTCOMES`.
        presses: The presses.
        notes: The notes of the classification, with the reasons why hold-out levels were left out.
    """
    mine = outcomes[(outcomes["hold_out"] == "copy") & (outcomes["estimator"] == outcomes["estimator"].iloc[0])]
    if mine.empty:
        reason = next((note for note in notes if "level copy" in note), "hold-out level copy was not computed")
        yield Answer(question=WHICH_TEXTURES, about="", answer=f"cannot be said: {reason}")
        return
    textures, truth = natural_unique(presses.texture)
    tries, correct = _tallied(mine, presses)
    correlation = _correlation(tries, correct, presses.run, truth)
    for index, texture in enumerate(textures.tolist()):
        tested = (truth == index) & (tries > 0)
        if not tested.any():
            yield Answer(
                question=WHICH_TEXTURES, about=texture, answer="cannot be said: none of its prints was held out"
            )
            continue
        fraction = float(correct[tested].sum() / tries[tested].sum())
        low, high = interval_of(fraction, _sizes(presses.run[tested]), correlation)
        answer = "unclear"
        if low is None or high is None:
            answer = f"unclear: {TOO_FEW}"
        elif low > TOLD_APART or high < TOLD_APART:
            answer = "yes" if low > TOLD_APART else "no"
        yield Answer(
            question=WHICH_TEXTURES,
            about=texture,
            figure=100.0 * fraction,
            low=None if low is None else 100.0 * low,
            high=None if high is None else 100.0 * high,
            unit=RIGHT,
            answer=answer,
        )


def is_whole(tested_on: str, train_on: str) -> bool:
    """Whether a row contains all held-out groups, not a single one."""
    return tested_on in (ALL, ALL_OTHERS, train_on)


def scores(outcomes: pd.DataFrame, presses: PressTable, protocol: str) -> list[FoldScore]:
    """Return the rows: for each hold-out level (or column of the paper) the total, then each named held-out group."""
    rows = []
    truth = np.unique(presses.texture, return_inverse=True)[1]
    for (_, _, hold_out), whole in outcomes.groupby(["train_on", "estimator", "hold_out"], sort=False):
        named = whole["tested_on"].iloc[0]
        tries, correct = _tallied(whole, presses)
        parts: dict[Any, pd.DataFrame] = {ALL if hold_out in UNITS else named: whole}
        if named == ALL_OTHERS:
            of_combination: dict[Any, pd.DataFrame] = dict(list(whole.groupby(presses.combination[whole["press"]])))
            parts |= of_combination if len(of_combination) > 1 else {}
        elif named not in (ALL, whole["train_on"].iloc[0]):
            parts |= dict(list(whole.groupby("tested_on", sort=False)))
        for name, part in parts.items():
            units, unit = presses.units(str(hold_out) if part is whole else "copy")
            correlation = _correlation(tries, correct, unit, truth)
            rows.append(_score(part, presses, protocol, str(name), units, unit, correlation))
    return rows


def _tallied(outcomes: pd.DataFrame, presses: PressTable) -> tuple[Floats, Floats]:
    """Count the tests and the correct predictions of each press, (n,)."""
    which = outcomes["press"].to_numpy()
    right = presses.texture[which] == outcomes["predicted"].to_numpy(str)
    tries, correct = (np.bincount(which, weight, len(presses.run)).astype(np.float64) for weight in (None, right))
    return tries, correct


def _correlation(tries: Floats, correct: Floats, unit: NDArray[Any], truth: Ints) -> float | None:
    """Return the correlation of the tested presses of one unit; None if it is unknown."""
    tested = tries > 0
    return correlation_of(correct[tested], tries[tested], unit[tested], truth[tested])


def _sizes(unit: NDArray[Any]) -> Ints:
    """Return the number of presses of each unit."""
    return np.unique(unit, return_counts=True)[1]


def _score(
    outcomes: pd.DataFrame,
    presses: PressTable,
    protocol: str,
    tested_on: str,
    units: str,
    unit: NDArray[Any],
    correlation: float | None,
) -> FoldScore:
    """Compute the row of some outcomes; ``unit`` has the unit of every press of the study, (n,)."""
    textures = presses.textures
    tries, correct = _tallied(outcomes, presses)
    tested = tries > 0
    sizes = _sizes(unit[tested])
    low, high = interval_of(float(correct.sum() / tries.sum()), sizes, correlation)
    truth = pd.Series(presses.texture[outcomes["press"]], index=outcomes.index)
    accuracies = (truth == outcomes["predicted"]).groupby(outcomes["trial"]).mean()
    confusion = pd.crosstab(truth, outcomes["predicted"]).reindex(index=textures, columns=textures, fill_value=0)
    first = outcomes.iloc[0]
    return FoldScore(
        protocol=protocol,
        estimator=first["estimator"],
        train_on=first["train_on"],
        tested_on=tested_on,
        hold_out=first["hold_out"],
        accuracy=float(correct.sum() / tries.sum()),
        standard_deviation=float(accuracies.std()) if len(accuracies) > 1 else None,
        low=low,
        high=high,
        units=f"{len(sizes)} {units}",
        trials=len(accuracies),
        images=int(tested.sum()),
        confusion=confusion.to_numpy(),
    )
