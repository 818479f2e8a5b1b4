"""Messages to a terminal or a pipe that may be lost: its window was closed, or the program that reads it has ended."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from typing import TextIO


@contextlib.contextmanager
def droppable(stream: TextIO) -> Iterator[None]:
    """Drop what the body writes if the stream is lost, and everything that is written to the stream later.

    Args:
        stream: The standard output or the standard error, or another stream.
    """
    try:
        yield
    except OSError:
        drop(stream)


def drop(stream: TextIO) -> None:
    """Drop everything that is written to a stream from now on, and what it has not written yet."""
    with contextlib.suppress(OSError, ValueError):
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, stream.fileno())
        os.close(null)
