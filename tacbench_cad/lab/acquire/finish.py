"""The end of a session: its outcome, which is written to the progress file and shown on the page."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from tacbench_cad.lab.acquire.interruption import RunInterruptedError
from tacbench_cad.util.errors import CheckFailedError, InputError, TacbenchError, one_line

#: The words for the exit codes of other errors.
_FAILED, _REFUSED = "failed", "refused"


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """The outcome of a session.

    Args:
        word: ``done``; ``faults`` (all presses are made, but a run has faults); ``failed`` (a device failed, and the
            run was stopped safely); ``interrupted``; ``refused`` (wrong input); ``error`` (an unexpected error).
        message: What happened, in one line.
    """

    word: str
    message: str

    @classmethod
    def of(cls, error: BaseException) -> Outcome:
        """Return the outcome of a session that ended with an error."""
        message = one_line("; ".join([str(error), *getattr(error, "__notes__", ())]))
        if isinstance(error, KeyboardInterrupt):
            said = message if isinstance(error, RunInterruptedError) else ""
            return cls(word="interrupted", message=said or "interrupted")
        if isinstance(error, CheckFailedError):
            return cls(word="faults", message=message)
        if isinstance(error, TacbenchError):
            word = _REFUSED if error.exit_code == InputError.exit_code else _FAILED
            return cls(word=word, message=message)
        return cls(word="error", message=f"{type(error).__name__}: {message}")


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
    end(Outcome(word="done", message=done))
