"""Progress messages for the person while blocks are pressed."""

from __future__ import annotations

import contextlib
import shutil
import sys
import time
from collections.abc import Callable
from datetime import timedelta
from pathlib import Path
from typing import Any, TextIO

from tacbench_cad.lab.rig.gauge import Force
from tacbench_cad.lab.study.presses import Press
from tacbench_cad.lab.study.spec import PrintedBlock, Study
from tacbench_cad.util.files import TEMPORARY_PREFIX
from tacbench_cad.util.output import droppable
from tacbench_cad.util.text import counted

#: The interval between progress lines if the stream is not a terminal, in s.
PLAIN_EVERY_S = 10.0


class PressProgress:
    """The interface for progress updates of a run. This class ignores them all."""

    def start(self, study: Study, saved: int) -> None:
        """Report that a session begins. No device is open yet.

        Args:
            study: The study.
            saved: The number of presses of the study that are already saved.
        """

    def ask(self, printed: PrintedBlock, label: str, slot: int | None) -> None:
        """Report that the person is asked to put a block in.

        Args:
            printed: The block.
            label: The text on its underside.
            slot: The slot of the tray, from 1; None if there is only one.
        """

    def answered(self) -> None:
        """Report that the block is in."""

    def begin(self, name: str, done: int, total: int) -> None:
        """Report that a block's run begins or is resumed.

        Args:
            name: The name of the run.
            done: The number of presses that are already saved.
            total: The number of presses of the run.
        """

    def before(self, press: Press, check: Callable[[], None]) -> None:
        """Report the next press. The sensor is lifted, so this method may wait until a person continues the run.

        Args:
            press: The press.
            check: Raises :class:`~tacbench_cad.lab.acquire.safety.RunInterruptedError` if a signal came. A method
                that waits calls it again and again.
        """

    def felt(self, z_mm: float, force_n: float) -> None:
        """Report a measured contact force.

        Args:
            z_mm: The height of the sensor's summit in the work frame.
            force_n: The force.
        """

    def pressed(self, done: int, force: Force | None, in_band: bool | None, image: Path) -> None:
        """Report that one more press is saved.

        Args:
            done: The number of saved presses.
            force: The measured force; None without a gauge.
            in_band: Whether the force is in its band; None without a gauge.
            image: The file of the sensor's frame.
        """

    def end(self) -> None:
        """Report the end of a block's run, complete or not."""

    def say(self, message: str) -> None:
        """Report another message for the person."""


class Several(PressProgress):
    """Passes every progress update on to several receivers.

    Args:
        *receivers: The receivers, in the order in which they get each update.
    """

    def __init__(self, *receivers: PressProgress) -> None:
        self.receivers = receivers

    def __getattribute__(self, name: str) -> Any:
        if name.startswith("_") or name not in vars(PressProgress):
            return super().__getattribute__(name)

        def call(*values: Any) -> None:
            for receiver in self.receivers:
                getattr(receiver, name)(*values)

        return call


class ProgressLines(PressProgress):
    """One line that is rewritten on a terminal; elsewhere, a new line every ten seconds.

    The run goes on if the terminal is lost.

    Args:
        out: The folder of the runs. The last image is copied there as ``last.png``, for a viewer that shows one file.
        stream: The output stream; None for the standard error.
        now_s: Returns a time in seconds that never decreases.
    """

    def __init__(
        self,
        out: Path,
        *,
        stream: TextIO | None = None,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self.last = out / "last.png"
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
        self.say(f"{name}: {f'{done} of ' if done else ''}{counted(total, 'press')}{' done' if done else ''}")

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
            self._write("\n")
            self._width = 0

    def say(self, message: str) -> None:
        """See :class:`PressProgress`."""
        self.end()
        self._write(f"{message}\n")

    def _left(self, now: float, done: int) -> str:
        """Return the remaining time, at the pace since the session's first press; empty before the second press."""
        if self._first is None:
            self._first = (now, done)
            return ""
        began, before = self._first
        left_s = (now - began) / (done - before) * (self._total - done)
        return f"  {timedelta(seconds=round(left_s))} left"

    def _line(self, text: str) -> None:
        if self._over:
            self._write("\r" + text.ljust(self._width))
            self._width = len(text)
        else:
            self._write(f"{text}\n")

    def _write(self, text: str) -> None:
        with droppable(self.stream):
            self.stream.write(text)
            self.stream.flush()

    def _show(self, image: Path) -> None:
        """Copy the last image. A failed copy does not stop the run."""
        if image.suffix == ".png":
            with contextlib.suppress(OSError):
                temporary = self.last.with_name(f"{TEMPORARY_PREFIX}{self.last.name}")
                shutil.copyfile(image, temporary)
                temporary.replace(self.last)
