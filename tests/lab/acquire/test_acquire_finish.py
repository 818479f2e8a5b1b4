"""Test the outcome of a session and the command that it starts: no shell, no injection, and failures as warnings."""

from __future__ import annotations

import json
import shlex
import sys
from pathlib import Path

import pytest

from tacbench_cad.lab.acquire import finish
from tacbench_cad.lab.acquire.finish import Outcome, finishing, hook_words, run_hook
from tacbench_cad.lab.acquire.safety import RunInterruptedError
from tacbench_cad.lab.rig.errors import NoAnswerError
from tacbench_cad.util.errors import CheckFailedError, InputError

DONE = Outcome(word="done", exit_code=0, message="1 run complete")
WRITE = "import json, os, sys; json.dump([sys.argv[1:], dict(os.environ)], open('hook.json', 'w'))"


def program(code: str, *words: str) -> str:
    return shlex.join([sys.executable, "-c", code, *words])


def run(command: str, folder: Path, outcome: Outcome = DONE) -> list[str]:
    said: list[str] = []
    run_hook(command, folder, outcome, folder / "runs", said.append)
    return said


@pytest.mark.parametrize(
    ("error", "word", "code", "message"),
    [
        (NoAnswerError("stage: no answer"), "failed", 3, "stage: no answer"),
        (CheckFailedError("a run has faults"), "faults", 1, "a run has faults"),
        (InputError("label", "x", "must be y"), "refused", 2, "label = 'x': must be y"),
        (RunInterruptedError("SIGINT"), "interrupted", 130, "the sensor is lifted; 0 of 0 presses are saved"),
        (KeyboardInterrupt(), "interrupted", 130, "interrupted"),
        (ZeroDivisionError("a\nb"), "error", 1, "ZeroDivisionError: a b"),
    ],
)
def test_the_outcome_follows_from_the_error(error: BaseException, word: str, code: int, message: str) -> None:
    outcomes: list[Outcome] = []
    with pytest.raises(type(error)), finishing(outcomes.append, "done"):
        raise error
    assert outcomes == [Outcome(word=word, exit_code=code, message=message)]


def test_the_outcome_without_an_error() -> None:
    outcomes: list[Outcome] = []
    with finishing(outcomes.append, "1 run complete"):
        pass
    assert outcomes == [DONE]


def test_the_command_gets_the_outcome_in_its_environment(tmp_path: Path) -> None:
    evil = Outcome(word="failed", exit_code=3, message="$(touch evil); touch evil\0 `touch evil` | 'x \"y")
    assert run(program(WRITE, "a b", "$HOME", "; touch evil"), tmp_path, evil) == []
    words, environment = json.loads((tmp_path / "hook.json").read_text())
    assert words == ["a b", "$HOME", "; touch evil"], "no shell expands the words"
    assert environment["TACBENCH_OUTCOME"] == "failed" and environment["TACBENCH_EXIT_CODE"] == "3"
    assert environment["TACBENCH_MESSAGE"] == "$(touch evil); touch evil  `touch evil` | 'x \"y"
    assert environment["TACBENCH_RUNS"] == str(tmp_path / "runs")
    assert not (tmp_path / "evil").exists()


def test_a_failing_command_is_a_warning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert run(program("raise SystemExit(4)"), tmp_path)[0].endswith("ended with exit code 4")
    assert "could not be started: No such file or directory" in run("missing-program-of-the-test", tmp_path)[0]
    assert "could not be started" in run(program(""), tmp_path / "missing")[0]
    monkeypatch.setattr(finish, "HOOK_S", 0.2)
    assert "more than 0.2 s" in run(program("import time; time.sleep(60)"), tmp_path)[0]


@pytest.mark.parametrize(("command", "message"), [("", "leave out the key"), ("sh 'x", "cannot be split into words")])
def test_a_command_that_is_no_command_is_refused(command: str, message: str) -> None:
    with pytest.raises(InputError, match=rf"on_finish = .+{message}"):
        hook_words(command)
