"""Progress of long work on the standard error: a bar on a terminal, else a line now and then, as a log takes it."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING

from tacbench_cad.cli.common import note

if TYPE_CHECKING:
    from rich.progress import Progress

#: Where the standard error is no terminal, a line is written so often, in seconds.
PLAIN_EVERY_S = 10.0


class ProgressLine:
    """A line that is wiped out when the work ends. Use it in a ``with`` statement.

    Args:
        every_s: Seconds between two lines where there is no terminal.
    """

    def __init__(self, every_s: float = PLAIN_EVERY_S) -> None:
        self._every_s = every_s
        self._written = time.monotonic()
        self._bar: Progress | None = None

    def __enter__(self) -> ProgressLine:
        if sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

            columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
            screen = Console(stderr=True, markup=False, emoji=False)
            self._bar = Progress(
                *columns, TextColumn("{task.description}", markup=False), console=screen, transient=True
            )
            self._task = self._bar.add_task("", total=None)
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def show(self, what: str, done: int = 0, total: int = 0) -> None:
        """So much of it is done; a total of 0 if nobody knows how much there is."""
        if self._bar is not None:
            self._bar.update(self._task, description=what, completed=done, total=total or None)
        elif time.monotonic() - self._written >= self._every_s:
            self._written = time.monotonic()
            note(f"[{done:,}/{total:,}] {what}" if total else what)
