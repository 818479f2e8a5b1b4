"""What estimators predicted, and a guard around estimators of users."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tacbench_cad.lab.analysis.classification.features import Features
from tacbench_cad.lab.analysis.classification.settings import ClassificationSettings
from tacbench_cad.lab.analysis.classification.splits import PressTable
from tacbench_cad.util.errors import InputError, TacbenchError
from tacbench_cad.util.types import Bools, Ints

#: What every fold of the leak-free protocol is trained on: the other groups.
THE_OTHERS = "the others"
#: ``tested_on`` of a whole hold-out level, and of the paper's unseen combinations.
ALL, ALL_OTHERS = "all", "all others"

#: The arrays of an outcome.
ARRAYS = ("press", "copied", "predicted")


@dataclass(frozen=True, kw_only=True, eq=False)
class Study:
    """What all trials of a classification share.

    Args:
        features: All readings.
        presses: What splits need of each press.
        settings: The settings.
    """

    features: Features
    presses: PressTable
    settings: ClassificationSettings


@dataclass(frozen=True, kw_only=True, eq=False)
class Outcome:
    """What one estimator predicted in one fold.

    Args:
        estimator: Its name.
        train_on: What it was trained on.
        tested_on: What it was tested on.
        hold_out: The hold-out level, or ``train``, ``test`` or ``unseen`` in the paper's protocol.
        trial: From 1.
        press: Index of each tested row's press, (m,).
        copied: Which copy of the press each row was, as an index of ``Augmentation.names``, (m,).
        predicted: Index of the predicted texture, in sorted order, (m,).
    """

    estimator: str
    train_on: str
    tested_on: str
    hold_out: str
    trial: int
    press: Ints
    copied: Ints
    predicted: Ints

    def only(self, which: Bools) -> Outcome:
        """The outcome of some of its rows."""
        return replace(self, **{name: getattr(self, name)[which] for name in ARRAYS})


def predictions(model: Any, rows: Any, textures: Sequence[str], estimator: str, where: str) -> Ints:
    """What a fitted estimator predicts, as indices of textures.

    Raises:
        InputError: It raises, or does not predict one of the textures for each row.
    """
    with guarded(estimator, where):
        words = np.asarray(model.predict(rows))
    if words.shape != (len(rows),) or not np.isin(words, textures).all():
        what = f"predicts {words.dtype} {words.shape} in {where}; must be one of the textures for each of "
        raise InputError("estimator", estimator, f"{what}{len(rows)} rows")
    return np.searchsorted(np.array(textures), words)


@contextmanager
def guarded(estimator: str, where: str) -> Iterator[None]:
    """Turn what an estimator raises into one message.

    Raises:
        InputError: The block raises; the message names estimator and place.
    """
    try:
        yield
    except TacbenchError:
        raise
    except Exception as error:
        text = str(error).strip()
        what = f"{type(error).__name__}: {text.splitlines()[0] if text else 'without a message'}"
        raise InputError("estimator", estimator, f"raised {what} in {where}") from error
