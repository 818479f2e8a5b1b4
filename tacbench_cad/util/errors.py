"""The errors a user can meet, and the exit code each one ends a command with."""

from __future__ import annotations

import contextlib
import difflib
from collections.abc import Iterable, Iterator


class TacbenchError(Exception):
    """Any error with a message meant for the user: one line, no traceback.

    Attributes:
        exit_code: What a command ends with (0 is success, 130 an interruption).
    """

    exit_code = 2

    def __str__(self) -> str:
        text = super().__str__()
        return text if len(text) <= 1500 else f"{text[:1000]} ... {text[-200:]}"


class InputError(TacbenchError):
    """A field has a value that is not allowed.

    Args:
        field: Name of the field, option or file.
        value: The value that was given.
        allowed: What would be allowed, as the end of a sentence.
    """

    def __init__(self, field: str, value: object, allowed: str) -> None:
        self.field = field
        self.value = value
        self.allowed = allowed
        super().__init__(f"{field} = {_shown(value)}: {allowed}" if value is not None else f"{field}: {allowed}")

    def __reduce__(self) -> tuple[type[InputError], tuple[str, object, str]]:
        # Raised in another process, it comes back by these three; Exception's own way has only the message.
        return (type(self), (self.field, self.value, self.allowed))


def _shown(value: object) -> str:
    """A value for a message: as Python writes it, without the middle of one that is very long."""
    try:
        text = repr(value)
    except (ValueError, RecursionError):  # a whole number of thousands of digits, a list nested as deep
        return f"({type(value).__name__})"
    return text if len(text) <= 300 else f"{text[:200]} ... {text[-40:]}"


@contextlib.contextmanager
def located(where: str, *, fields: str = "") -> Iterator[None]:
    """Put a file or a table in front of the field of every :class:`InputError` that comes out of the body.

    Args:
        where: ``"rig.toml: "`` or ``"[protocol] "``.
        fields: Only in front of fields that begin so: ``"["`` for those of a file's tables.
    """
    try:
        yield
    except InputError as error:
        if not error.field.startswith(fields):
            raise
        raise InputError(f"{where}{error.field}", error.value, error.allowed) from None


class MissingToolError(TacbenchError):
    """Something asked for needs a package or a system library that is not there."""


class CheckFailedError(TacbenchError):
    """A part or a file was examined and found wrong."""

    exit_code = 1


def one_line(message: object, limit: int | None = None) -> str:
    """The message without line breaks, cut off after so many characters."""
    return " ".join(str(message).split())[:limit]


def nearest(word: str, allowed: Iterable[str]) -> str:
    """Return a hint naming the allowed word nearest to ``word``, or the whole list.

    Args:
        word: What was written.
        allowed: The words that would have been accepted.

    Returns:
        ``'did you mean "scale"?'`` or ``'allowed: a, b, c'``.
    """
    words = list(allowed)
    close = difflib.get_close_matches(word, words, n=1, cutoff=0.6)
    if close:
        return f'did you mean "{close[0]}"?'
    return "allowed: " + ", ".join(words)


def require_between(field: str, value: float, low: float, high: float, unit: str = "") -> None:
    """Refuse a number out of bounds, infinity and NaN among them; both bounds are allowed.

    Raises:
        InputError: It is out of bounds, or not a number.
    """
    if isinstance(value, bool) or not low <= value <= high:
        raise InputError(field, value, f"must be from {low:g} to {high:g}{unit}")


def one_of(field: str, word: str, allowed: Iterable[str]) -> str:
    """The word, if it is allowed.

    Args:
        field: What it stands for, for the message.
        word: What was given.
        allowed: What may be given.

    Raises:
        InputError: It is not; the message names the nearest one.
    """
    words = tuple(allowed)
    if word not in words:
        raise InputError(field, word, nearest(str(word), words) if word else "allowed: " + ", ".join(words))
    return word
