"""The errors that a user can meet, and their exit codes."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator


class TacbenchError(Exception):
    """Base class of errors whose message is meant for the user. A command prints it as one line, without traceback.

    Attributes:
        exit_code: The exit code of a command that ends with this error.
    """

    exit_code = 2

    def __str__(self) -> str:
        text = super().__str__()
        return text if len(text) <= 1500 else f"{text[:1000]} ... {text[-200:]}"


class InputError(TacbenchError, ValueError):
    """A field has a value that is not allowed.

    Args:
        field: The name of the field, option or file.
        value: The value that was given; None leaves it out of the message.
        allowed: What is allowed, or what to do, as the end of the message.
    """

    def __init__(self, field: str, value: object, allowed: str) -> None:
        self.field = field
        self.value = value
        self.allowed = allowed
        super().__init__(f"{field} = {_shown(value)}: {allowed}" if value is not None else f"{field}: {allowed}")

    def __reduce__(self) -> tuple[type[InputError], tuple[str, object, str]]:
        # For errors raised in another process: pickling an Exception keeps only the message by default.
        return (type(self), (self.field, self.value, self.allowed))


def _shown(value: object) -> str:
    """Write a value for a message as Python does; the middle of a very long value is left out."""
    try:
        text = repr(value)
    except (ValueError, RecursionError):  # a number of thousands of digits, or a very deeply nested list
        return f"({type(value).__name__})"
    return text if len(text) <= 300 else f"{text[:200]} ... {text[-40:]}"


@contextlib.contextmanager
def located(where: str, *, fields: str = "") -> Iterator[None]:
    """Add the name of a file or table to the field of every :class:`InputError` that is raised in the body.

    Args:
        where: The text to add in front of the field: ``"rig.toml: "`` or ``"[protocol] "``.
        fields: Add it only to fields that begin with this text. ``"["`` selects the fields of a file's tables.
    """
    try:
        yield
    except InputError as error:
        if not error.field.startswith(fields):
            raise
        raise InputError(f"{where}{error.field}", error.value, error.allowed) from None


class MissingToolError(TacbenchError):
    """A package or a system library that the user's request needs is not installed."""


class CheckFailedError(TacbenchError):
    """A part or a file did not pass a check."""

    exit_code = 1


@contextlib.contextmanager
def as_input(field: str) -> Iterator[None]:
    """Turn a failed check of a file that is read into an :class:`InputError`, for commands that need the file.

    Args:
        field: The name of the field.
    """
    try:
        yield
    except CheckFailedError as error:
        raise InputError(field, None, str(error)) from None


def one_line(message: object, limit: int | None = None) -> str:
    """Return a message without line breaks, cut to at most ``limit`` characters."""
    return " ".join(str(message).split())[:limit]


def nearest(word: str, allowed: Iterable[str]) -> str:
    """Return a hint that names the allowed word nearest to ``word``, or all allowed words if none is similar.

    Args:
        word: The word that was given.
        allowed: The allowed words.

    Returns:
        ``'did you mean "scale"?'`` or ``'allowed: a, b, c'``.
    """
    import difflib  # only for a wrong word

    words = list(allowed)
    close = difflib.get_close_matches(word, words, n=1, cutoff=0.6)
    if close:
        return f'did you mean "{close[0]}"?'
    return "allowed: " + ", ".join(words)


def require_between(field: str, value: float, low: float, high: float, unit: str = "") -> None:
    """Check that a number lies between two bounds, which are allowed themselves.

    Raises:
        InputError: The number is out of bounds, infinite or NaN.
    """
    if isinstance(value, bool) or not low <= value <= high:
        raise InputError(field, value, f"must be from {low:g} to {high:g}{unit}")


def one_of(field: str, word: str, allowed: Iterable[str]) -> str:
    """Return the word if it is allowed.

    Args:
        field: The name of the field, for the error message.
        word: The word that was given.
        allowed: The allowed words.

    Raises:
        InputError: The word is not allowed. The message names the nearest allowed word.
    """
    words = tuple(allowed)
    if word not in words:
        raise InputError(field, word, nearest(str(word), words) if word else "allowed: " + ", ".join(words))
    return word
