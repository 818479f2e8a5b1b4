"""Progress of long work: one line on the standard error that is written over, or a line now and then in a log."""

from __future__ import annotations

import sys
import time

from tacbench_cad.cli.common import note

#: Where the standard error is no terminal, a line is written so often, in seconds.
PLAIN_EVERY_S = 10.0


class ProgressLine:
    """A line that is wiped out when the work ends. Use it in a ``with`` statement."""

    def __init__(self) -> None:
        self._over = sys.stderr.isatty()
        self._written = time.monotonic()
        self._width = 0

    def __enter__(self) -> ProgressLine:
        return self

    def __exit__(self, *_: object) -> None:
        if self._width:
            sys.stderr.write("\r" + " " * self._width + "\r")
            sys.stderr.flush()

    def show(self, what: str, done: int, total: int) -> None:
        """So much of it is done; a total of 0 if nobody knows how much there is."""
        self.say(f"{what}: {done:,} of {total:,}" if total else what)

    def say(self, line: str) -> None:
        """Put this in place of the line before."""
        if self._over:
            sys.stderr.write("\r" + line.ljust(self._width))
            sys.stderr.flush()
            self._width = max(self._width, len(line))
        elif time.monotonic() - self._written >= PLAIN_EVERY_S:
            self._written = time.monotonic()
            note(line)
