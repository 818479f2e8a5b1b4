"""The end of a session: its outcome, and the command that tells somebody about it."""

from __future__ import annotations

import os
import shlex
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from tacbench_cad.lab.acquire.safety import RunInterruptedError
from tacbench_cad.util.errors import CheckFailedError, InputError, TacbenchError, one_line

#: The longest time of the command, in s.
HOOK_S = 60.0
#: The longest message that the command gets, in characters. Systems limit the length of environment variables.
_MAX_MESSAGE = 2000
_INTERRUPTED, _UNEXPECTED = 130, 1
#: The words for the exit codes of other errors.
_FAILED, _REFUSED = "failed", "refused"


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """The outcome of a session.

    Args:
        word: ``done``; ``faults`` (all presses are made, but a run has faults); ``failed`` (a device failed, and the
            run was stopped safely); ``interrupted``; ``refused`` (wrong input); ``error`` (an unexpected error).
        exit_code: The exit code of the command.
        message: What happened, in one line.
    """

    word: str
    exit_code: int
    message: str

    @classmethod
    def of(cls, error: BaseException) -> Outcome:
        """Return the outcome of a session that ended with an error."""
        message = one_line("; ".join([str(error), *getattr(error, "__notes__", ())]), _MAX_MESSAGE)
        if isinstance(error, KeyboardInterrupt):
            said = message if isinstance(error, RunInterruptedError) else ""
            return cls(word="interrupted", exit_code=_INTERRUPTED, message=said or "interrupted")
        if isinstance(error, CheckFailedError):
            return cls(word="faults", exit_code=error.exit_code, message=message)
        if isinstance(error, TacbenchError):
            word = _REFUSED if error.exit_code == InputError.exit_code else _FAILED
            return cls(word=word, exit_code=error.exit_code, message=message)
        return cls(word="error", exit_code=_UNEXPECTED, message=f"{type(error).__name__}: {message}")


@contextmanager
def finishing(end: Callable[[Outcome], None], done: str) -> Iterator[None]:
    """Report the outcome of the body.

    Args:
        end: Receives the outcome.
        done: The message after a body without an error.
    """
    try:
        yield
    except BaseException as error:
        end(Outcome.of(error))
        raise
    end(Outcome(word="done", exit_code=0, message=done))


def hook_words(command: str) -> tuple[str, ...]:
    """Split the value of ``on_finish`` into program and arguments, with the quotes of a POSIX shell.

    Raises:
        InputError: The text is empty, or a quote is not closed.
    """
    try:
        words = tuple(shlex.split(command))
    except ValueError as error:
        raise InputError("on_finish", command, f"cannot be split into words: {error}") from None
    if not words:
        raise InputError("on_finish", command, "must be a program and its arguments; leave out the key for no command")
    return words


def run_hook(command: str, folder: Path, outcome: Outcome, out: Path, say: Callable[[str], None]) -> None:
    """Run the command of ``on_finish``. A failure gives a warning and does not change the outcome.

    No shell is used, and the outcome is passed in environment variables, so a message cannot become a command:
    ``TACBENCH_OUTCOME``, ``TACBENCH_EXIT_CODE``, ``TACBENCH_MESSAGE`` and ``TACBENCH_RUNS``.

    Args:
        command: The program and its arguments.
        folder: The folder in which the command runs: that of the study file.
        outcome: The outcome of the session.
        out: The folder of the runs.
        say: Receives the warning.
    """
    values = {
        "TACBENCH_OUTCOME": outcome.word,
        "TACBENCH_EXIT_CODE": str(outcome.exit_code),
        "TACBENCH_MESSAGE": outcome.message.replace("\0", " "),
        "TACBENCH_RUNS": str(out.absolute()),
    }
    try:
        result = subprocess.run(
            hook_words(command),
            cwd=folder.absolute(),
            env={**os.environ, **values},
            stdin=subprocess.DEVNULL,
            timeout=HOOK_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        say(f"warning: on_finish = {command!r} was ended because it took more than {HOOK_S:g} s")
    except OSError as error:
        say(f"warning: on_finish = {command!r} could not be started: {error.strerror or error}")
    else:
        if result.returncode:
            say(f"warning: on_finish = {command!r} ended with exit code {result.returncode}")
