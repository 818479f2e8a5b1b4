"""The predictions of estimators, and error messages for users' own estimators."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from tacbench_cad.lab.analysis.classification.features import Features
from tacbench_cad.lab.analysis.classification.settings import ClassificationSettings
from tacbench_cad.lab.analysis.classification.splits import PressTable
from tacbench_cad.util.errors import InputError, TacbenchError

#: ``train_on`` of every fold of the leak-free protocol: the other groups.
THE_OTHERS = "the others"
#: ``tested_on`` of a whole hold-out level, and of the unseen combinations in the paper's protocol.
ALL, ALL_OTHERS = "all", "all others"

#: The columns of the predictions of estimators, with a row for each tested frame: the estimator; the training data; the
#: test data; the hold-out level, or ``train``, ``test`` or ``unseen`` in the paper's protocol; the trial, from 1; the
#: index of the press; the version of the frame as an index of ``Augmentation.names``; and the predicted texture.
OUTCOMES = ("estimator", "train_on", "tested_on", "hold_out", "trial", "press", "copied", "predicted")


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


def predictions(model: Any, rows: Any, textures: Sequence[str], estimator: str, where: str) -> list[str]:
    """Return the predictions of a fitted estimator.

    Raises:
        InputError: The estimator raises an error, or does not predict one of the textures for each row.
    """
    with guarded(estimator, where):
        words = np.asarray(model.predict(rows))
    if words.shape != (len(rows),) or not np.isin(words, textures).all():
        what = f"predicts {words.dtype} {words.shape} in {where}; must be one of the textures for each of "
        raise InputError("estimator", estimator, f"{what}{len(rows)} rows")
    return [str(word) for word in words.tolist()]


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
