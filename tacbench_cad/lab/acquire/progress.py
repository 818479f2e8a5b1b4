"""What a person sees while blocks are pressed."""

from __future__ import annotations

import contextlib
import shutil
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TextIO

from tacbench_cad.lab.rig.gauge import Force
from tacbench_cad.util.files import TEMPORARY_PREFIX
from tacbench_cad.util.text import counted

#: A stream that is no terminal gets a line every so many seconds.
PLAIN_EVERY_S = 10.0


class PressProgress:
    """Receives what happens in a run; this one does nothing with it."""

    def begin(self, name: str, done: int, total: int) -> None:
        """A block's run is begun or resumed.

        Args:
            name: Name of the run.
            done: Presses that are there.
            total: Presses that it will have.
        """

    def pressed(self, done: int, force: Force | None, in_band: bool | None, image: Path) -> None:
        """One more press is on the disk.

        Args:
            done: Presses that are there now.
            force: The measured force, None without a gauge.
            in_band: Whether it lies in its band, None without a gauge.
            image: The file of the sensor's frame.
        """

    def end(self) -> None:
        """The block's run was left, finished or not."""

    def say(self, message: str) -> None:
        """Something else that the person should know."""


#: Shows nothing.
Silent = PressProgress


class ProgressLines(PressProgress):
    """One line that is written over on a terminal, and a new line every ten seconds elsewhere.

    Args:
        out: Folder of the runs: the last image is copied there as ``last.png``, for a viewer that watches one file.
        stream: Where to write; the standard error if None.
        now_s: Seconds, never going back.
    """

    def __init__(self, out: Path, stream: TextIO | None = None, now_s: Callable[[], float] = time.monotonic) -> None:
        self.out = out
        self.stream = stream if stream is not None else sys.stderr
        self.now_s = now_s
        self._over = self.stream.isatty()
        self._name = ""
        self._total = self._width = 0
        self._written = 0.0
        self._first: tuple[float, int] | None = None

    def begin(self, name: str, done: int, total: int) -> None:
        """See :class:`PressProgress`."""
        self._name, self._total = name, total
        self._first, self._written = None, -PLAIN_EVERY_S
        self.say(f"{name}: {f'{done} of ' if done else ''}{counted(total, 'press')}{' there' if done else ''}")

    def pressed(self, done: int, force: Force | None, in_band: bool | None, image: Path) -> None:
        """See :class:`PressProgress`."""
        self._show(image)
        now = self.now_s()
        if self._first is not None and not self._over and done < self._total and now - self._written < PLAIN_EVERY_S:
            return
        self._written = now
        left = self._left(now, done)
        felt = "" if force is None else f"  {force.mean_n:z.4f} N" + ("" if in_band is not False else " (out of band)")
        self._line(f"{self._name}  {done}/{self._total}{left}{felt}  {image.name}")

    def end(self) -> None:
        """See :class:`PressProgress`."""
        if self._width:
            self.stream.write("\n")
            self._width = 0

    def say(self, message: str) -> None:
        """See :class:`PressProgress`."""
        self.end()
        self.stream.write(f"{message}\n")
        self.stream.flush()

    def _left(self, now: float, done: int) -> str:
        """The time left at the pace since the session's first press; nothing is known at that press."""
        if self._first is None:
            self._first = (now, done)
            return ""
        began, before = self._first
        return f"  {_duration((now - began) / (done - before) * (self._total - done))} left"

    def _line(self, text: str) -> None:
        if self._over:
            self.stream.write("\r" + text.ljust(self._width))
            self._width = len(text)
        else:
            self.stream.write(f"{text}\n")
        self.stream.flush()

    def _show(self, image: Path) -> None:
        """Copy the last image. A copy that fails is no reason to stop a run."""
        if image.suffix == ".png":
            with contextlib.suppress(OSError):
                temporary = self.out / f"{TEMPORARY_PREFIX}last.png"
                shutil.copyfile(image, temporary)
                temporary.replace(self.out / "last.png")


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}"
