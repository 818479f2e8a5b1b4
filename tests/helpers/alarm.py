"""An alarm of the system, which interrupts a test in the middle of a call."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager


def interrupt() -> None:
    """Do what Ctrl-C does."""
    raise KeyboardInterrupt


@contextmanager
def alarm(after_s: float, action: Callable[[], object] = interrupt) -> Iterator[None]:
    """Call a function in a signal handler while the body runs.

    Args:
        after_s: The time from the start of the body, in s.
        action: The function.
    """
    before = signal.signal(signal.SIGALRM, lambda number, frame: action())
    try:
        signal.setitimer(signal.ITIMER_REAL, after_s)
        yield
    finally:
        signal.signal(signal.SIGALRM, before)
