"""Test the outcome of a session."""

from __future__ import annotations

import pytest

from tacbench_cad.lab.acquire.finish import Outcome, finishing
from tacbench_cad.lab.acquire.interruption import RunInterruptedError
from tacbench_cad.lab.rig.errors import NoAnswerError
from tacbench_cad.util.errors import CheckFailedError, InputError

DONE = Outcome(word="done", message="1 run complete")


@pytest.mark.parametrize(
    ("error", "word", "message"),
    [
        (NoAnswerError("stage: no answer"), "failed", "stage: no answer"),
        (CheckFailedError("a run has faults"), "faults", "a run has faults"),
        (InputError("label", "x", "must be y"), "refused", "label = 'x': must be y"),
        (RunInterruptedError("SIGINT"), "interrupted", "the sensor is lifted; 0 of 0 presses are saved"),
        (KeyboardInterrupt(), "interrupted", "interrupted"),
        (ZeroDivisionError("a\nb"), "error", "ZeroDivisionError: a b"),
    ],
)
def test_the_outcome_follows_from_the_error(error: BaseException, word: str, message: str) -> None:
    outcomes: list[Outcome] = []
    with pytest.raises(type(error)), finishing(outcomes.append, "done"):
        raise error
    assert outcomes == [Outcome(word=word, message=message)]


def test_the_outcome_without_an_error() -> None:
    outcomes: list[Outcome] = []
    with finishing(outcomes.append, "1 run complete"):
        pass
    assert outcomes == [DONE]
