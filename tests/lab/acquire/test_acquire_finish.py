"""Test the outcome of a session, which the progress file has."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from helpers.rigs import small_protocol, study_of

from tacbench_cad.lab.acquire.events import PROGRESS_FILE, ProgressFile
from tacbench_cad.lab.acquire.safety import RunInterruptedError
from tacbench_cad.lab.rig.errors import NoAnswerError
from tacbench_cad.lab.study.spec import Study
from tacbench_cad.util.errors import CheckFailedError, InputError


def outcome_of(folder: Path, study: Study, error: BaseException | None) -> tuple[str, str]:
    file = ProgressFile(folder)
    file.start(study, 0)
    if error is None:
        with file.finishing("1 run complete"):
            pass
    else:
        with pytest.raises(type(error)), file.finishing("1 run complete"):
            raise error
    file.close()
    *_, last = map(json.loads, (folder / PROGRESS_FILE).read_text().splitlines())
    assert last["event"] == "over"
    return last["outcome"], last["message"]


@pytest.mark.parametrize(
    ("error", "word", "message"),
    [
        (None, "done", "1 run complete"),
        (NoAnswerError("stage: no answer"), "failed", "stage: no answer"),
        (CheckFailedError("a run has faults"), "faults", "a run has faults"),
        (InputError("label", "x", "must be y"), "refused", "label = 'x': must be y"),
        (RunInterruptedError("SIGINT"), "interrupted", "the sensor is lifted; 0 of 0 presses are saved"),
        (KeyboardInterrupt(), "interrupted", "interrupted"),
        (ZeroDivisionError("a\nb"), "error", "ZeroDivisionError: a b"),
    ],
)
def test_the_outcome_follows_from_the_error(
    tmp_path: Path, error: BaseException | None, word: str, message: str
) -> None:
    assert outcome_of(tmp_path, study_of(small_protocol(), 1), error) == (word, message)
