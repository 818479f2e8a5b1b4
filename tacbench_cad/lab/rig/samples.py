"""Devices that send a line of numbers for each sample, unasked: only new samples, garbled ones skipped and counted."""

from __future__ import annotations

import math
import re
import time
from collections import deque
from dataclasses import dataclass, field
from typing import Annotated

from tacbench_cad.lab.rig.errors import NoAnswerError, RigError
from tacbench_cad.lab.rig.line import Line
from tacbench_cad.lab.rig.stage import Closing
from tacbench_cad.util.convert import Bounds
from tacbench_cad.util.errors import InputError

#: Usual rate of boards that send a line a sample.
BAUD = 115_200
#: Longest real time that a board needs to start after its port was opened.
_START_S = 4.0
#: Lines over which garbled ones are counted.
_COUNTED = 50
#: Least lines before a fraction of them means anything.
_MIN_COUNTED = 20
#: Fraction of garbled lines that is one too many.
_TOO_MANY = 0.3
#: Longest piece of a garbled line that a message shows.
_SHOWN = 40

#: So many identical samples in a row mean that a device is stuck.
StuckSamples = Annotated[int, Bounds(0, 1_000_000)]

_NUMBER = re.compile(r"[+-]?(?:\d{1,20}(?:\.\d{0,20})?|\.\d{1,20})(?:[eE][+-]?\d{1,3})?", re.ASCII)
_BETWEEN = re.compile(r"[ \t]*[,;][ \t]*|[ \t]+")


def require_stuck_samples(count: int) -> None:
    """Refuse a count by which every sample would be a stuck one.

    Raises:
        InputError: It is 1.
    """
    if count == 1:
        raise InputError("stuck_samples", 1, "must be at least 2, or 0 to switch the check off")


def parse_numbers(line: str) -> tuple[float, ...] | None:
    """The numbers of a line, with commas, semicolons, spaces or tabs between them; one may follow the last.

    Args:
        line: Any text, without its end.

    Returns:
        At least one finite number, or None for anything else. There is no guessing at a damaged sample.
    """
    text = line.strip(" \t\r\n")
    words = _BETWEEN.split(text[:-1].rstrip(" \t") if text[-1:] in (",", ";") else text)
    if not all(_NUMBER.fullmatch(word) for word in words):
        return None
    numbers = tuple(float(word) for word in words)
    return numbers if all(math.isfinite(number) for number in numbers) else None


@dataclass(kw_only=True, eq=False)
class SampleStream(Closing):
    """The samples of a device, as they come.

    Args:
        lines: Where they come from.
        name: What the device is, for the messages.
        columns: How many numbers a sample has.
        timeout_s: Longest real time to wait for a sample.
        error: What is raised when too many lines are garbled, or the device is stuck.
        stuck_samples: So many identical samples in a row mean that it is stuck; 0 switches the check off.
        watched: The only column that is looked at for that, from 1; None for all.

    Attributes:
        garbled: Lines so far that were no sample.
    """

    lines: Line
    name: str
    columns: int
    timeout_s: float
    error: type[RigError]
    stuck_samples: int = 0
    watched: int | None = None
    garbled: int = field(default=0, init=False)
    _same: int = field(default=0, init=False)
    _last: tuple[float, ...] = field(default=(), init=False)
    _recent: deque[bool] = field(default_factory=lambda: deque(maxlen=_COUNTED), init=False)
    _example: str = field(default="", init=False)

    def wait_for_start(self) -> None:
        """Wait for the first sample: opening a port restarts many boards, which then say a few words first.

        Raises:
            RigError: None comes. The port is let go of.
        """
        try:
            self.next(max(self.timeout_s, _START_S))
        except BaseException:
            self.close()
            raise

    def start_fresh(self, latency_s: float = 0.0) -> None:
        """Forget what has come, so that every sample from now on arrived after this call.

        Args:
            latency_s: Real time for which samples may lie in adapters and drivers; what comes within it is dropped.

        Raises:
            RigError: The device is gone or silent.
        """
        if latency_s > 0.0:
            time.sleep(latency_s)
        self.lines.forget()
        # What comes next may be the rest of a line that had begun before.
        if self.lines.read_line(self.timeout_s) is None:
            raise self._silent()

    def next(self, timeout_s: float | None = None) -> tuple[float, ...]:
        """The next sample.

        Args:
            timeout_s: Longest real time to wait; the stream's own if None.

        Raises:
            NoAnswerError: None came.
            RigError: Of the stream's kind: stuck, or too many of the last lines are garbled. Or the device is gone.
        """
        until = time.monotonic() + (self.timeout_s if timeout_s is None else timeout_s)
        while (line := self.lines.read_line(max(until - time.monotonic(), 0.0))) is not None:
            numbers = parse_numbers(line)
            sound = numbers is not None and len(numbers) == self.columns
            self.count(sound, line)
            if sound and numbers is not None:
                self._look_for_stuck(numbers if self.watched is None else (numbers[self.watched - 1],))
                return numbers
        if self._recent and not self._recent[-1]:
            raise self.error(f"{self.name}: no sound line in time; the last one was {self._example!r}")
        raise self._silent()

    def count(self, sound: bool, example: str) -> None:
        """Count a line, or take one back that turned out to be damaged.

        Raises:
            RigError: Of the stream's kind: too many of the last lines are garbled.
        """
        self._recent.append(sound)
        if sound:
            return
        self.garbled += 1
        self._example = example[:_SHOWN]
        bad = self._recent.count(False)
        if len(self._recent) >= _MIN_COUNTED and bad > _TOO_MANY * len(self._recent):
            raise self.error(
                f"{self.name}: {bad} of the last {len(self._recent)} lines are garbled, as {self._example!r}; is the "
                f"baud rate right, and are there {self.columns} number(s) a line?"
            )

    def close(self) -> None:
        """Let go of the device. Never raises; a second call does nothing."""
        self.lines.close()

    def _look_for_stuck(self, sample: tuple[float, ...]) -> None:
        """Count identical samples: a living sensor has noise.

        Raises:
            RigError: Of the stream's kind: there are too many.
        """
        self._same = self._same + 1 if sample == self._last else 1
        self._last = sample
        if 0 < self.stuck_samples <= self._same:
            shown = ", ".join(f"{number:.10g}" for number in sample)[:_SHOWN]
            raise self.error(
                f"{self.name}: {self._same} samples in a row are {shown}: it is stuck. If it rounds its noise away, "
                "set its stuck_samples = 0"
            )

    def _silent(self) -> NoAnswerError:
        return NoAnswerError(f"{self.name}: sends nothing; is it switched on, and is the baud rate right?")
