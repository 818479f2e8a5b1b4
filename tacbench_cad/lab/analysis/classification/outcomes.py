"""The predictions of estimators, and error messages for users' own estimators."""

from __future__ import annotations

import warnings
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

#: ``train_on`` of every fold of the leak-free protocol: the other groups.
THE_OTHERS = "the others"
#: ``tested_on`` of a whole hold-out level, and of the unseen combinations in the paper's protocol.
ALL, ALL_OTHERS = "all", "all others"

#: The names of an outcome's arrays.
ARRAYS = ("press", "copied", "predicted")


@dataclass(frozen=True, kw_only=True, eq=False)
class ClassifiedStudy:
    """The data and settings that all trials of a classification share.

    Args:
        features: All frames.
        presses: The facts about each press that splits need.
        settings: The settings.
    """

    features: Features
    presses: PressTable
    settings: ClassificationSettings


@dataclass(frozen=True, kw_only=True, eq=False)
class TestOutcome:
    """The predictions of one estimator in one fold.

    Args:
        estimator: The name of the estimator.
        train_on: The training data.
        tested_on: The test data.
        hold_out: The hold-out level, or ``train``, ``test`` or ``unseen`` in the paper's protocol.
        trial: The trial, from 1.
        press: The index of each tested row's press, (m,).
        copied: The version of the frame that each row is, as an index of ``Augmentation.names``, (m,).
        predicted: The index of the predicted texture in sorted order, (m,).
    """

    estimator: str
    train_on: str
    tested_on: str
    hold_out: str
    trial: int
    press: Ints
    copied: Ints
    predicted: Ints

    def only(self, which: Bools) -> TestOutcome:
        """Return the outcome with some of its rows."""
        return replace(self, **{name: getattr(self, name)[which] for name in ARRAYS})


def predictions(model: Any, rows: Any, textures: Sequence[str], estimator: str, where: str) -> Ints:
    """Return the predictions of a fitted estimator as indices of textures.

    Raises:
        InputError: The estimator raises an error, or does not predict one of the textures for each row.
    """
    with guarded(estimator, where):
        words = np.asarray(model.predict(rows))
    if words.shape != (len(rows),) or not np.isin(words, textures).all():
        what = f"predicts {words.dtype} {words.shape} in {where}; must be one of the textures for each of "
        raise InputError("estimator", estimator, f"{what}{len(rows)} rows")
    index = {name: number for number, name in enumerate(textures)}
    return np.array([index[word] for word in words.tolist()], dtype=np.int64)


@contextmanager
def guarded(estimator: str, where: str) -> Iterator[None]:
    """Convert any error of an estimator into one message.

    Raises:
        InputError: The block raised an error. The message names the estimator and the fold.
    """
    from sklearn.exceptions import ConvergenceWarning

    try:
        with warnings.catch_warnings():
            if estimator == "network":  # it runs all epochs, also on few rows
                warnings.simplefilter("ignore", ConvergenceWarning)
                warnings.filterwarnings("ignore", "Got `batch_size`")
            yield
    except TacbenchError:
        raise
    except Exception as error:
        text = str(error).strip()
        what = f"{type(error).__name__}: {text.splitlines()[0] if text else 'without a message'}"
        raise InputError("estimator", estimator, f"raised {what} in {where}") from error
