"""Progress of long work on the standard error: a bar on a terminal, otherwise a line every few seconds."""

from __future__ import annotations

import sys
import time
from datetime import timedelta
from typing import TYPE_CHECKING

from tacbench_cad.cli.common import note

if TYPE_CHECKING:
    from rich.progress import Progress

#: Seconds between two lines if the standard error is not a terminal.
PLAIN_EVERY_S = 10.0


class ProgressLine:
    """A progress bar that disappears when the work ends. Use it in a ``with`` statement.

    Args:
        every_s: Seconds between two lines if there is no terminal.
    """

    def __init__(self, every_s: float = PLAIN_EVERY_S) -> None:
        self._every_s = every_s
        self._written = time.monotonic()
        self._first: tuple[float, int] | None = None
        self._bar: Progress | None = None

    def __enter__(self) -> ProgressLine:
        if sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

            columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
            text = TextColumn("{task.description}", markup=False)
            self._bar = Progress(*columns, text, console=Console(stderr=True, emoji=False), transient=True)
            self._task = self._bar.add_task("", total=None)
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def show(self, what: str, done: int = 0, total: int = 0) -> None:
        """Show the progress: ``done`` of ``total``. A total of 0 means that the total is unknown."""
        now = time.monotonic()
        if self._first is None or done < self._first[1]:
            self._first = (now, done)
        left = self._left(now, done, total)
        if self._bar is not None:
            self._bar.update(self._task, description=what + left, completed=done, total=total or None)
        elif now - self._written >= self._every_s:
            self._written = now
            note(f"[{done:,}/{total:,}] {what}{left}" if total else what)

    def _left(self, now: float, done: int, total: int) -> str:
        """The remaining time at the speed so far; empty until the speed is known."""
        began, before = self._first or (now, done)
        if done <= before or now - began < PLAIN_EVERY_S:
            return ""
        return f", {timedelta(seconds=round((now - began) / (done - before) * (total - done)))} left"
