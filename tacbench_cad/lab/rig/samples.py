"""Devices that send one line of values per sample, unrequested. Only new samples count; garbled lines are skipped."""

from __future__ import annotations

import math
import re
import time
from collections import deque
from dataclasses import dataclass, field
from typing import Annotated

from annotated_types import Interval

from tacbench_cad.lab.rig.errors import NoAnswerError, RigError
from tacbench_cad.lab.rig.line import Line
from tacbench_cad.lab.rig.stage import Closing
from tacbench_cad.util.errors import InputError

#: The usual baud rate of boards that send samples.
BAUD = 115_200
#: The longest start of a board after its port was opened, in s of real time.
_START_S = 4.0
#: The number of recent lines among which garbled ones are counted.
_COUNTED = 50
#: The smallest number of lines for which the fraction of garbled lines is checked.
_MIN_COUNTED = 20
#: The fraction of garbled lines above which an error is raised.
_TOO_MANY = 0.3
#: The longest part of a garbled line in an error message, in characters.
_MAX_SHOWN = 40

#: The number of identical samples in a row that mean a stuck device; 0 switches the check off.
StuckSamples = Annotated[int, Interval(ge=0, le=1_000_000)]

_NUMBER = re.compile(r"[+-]?(?:\d{1,20}(?:\.\d{0,20})?|\.\d{1,20})(?:[eE][+-]?\d{1,3})?", re.ASCII)
_BETWEEN = re.compile(r"[ \t]*[,;][ \t]*|[ \t]+")


def require_stuck_samples(count: int) -> None:
    """Check the limit of identical samples. With a limit of 1, every sample would count as stuck.

    Raises:
        InputError: The limit is 1.
    """
    if count == 1:
        raise InputError("stuck_samples", 1, "must be at least 2, or 0 to switch the check off")


def parse_numbers(line: str) -> tuple[float, ...] | None:
    """Parse the values of a line, separated by commas, semicolons, spaces or tabs. A comma or semicolon may end it.

    Args:
        line: Any text, without its end of line.

    Returns:
        At least one finite number; None for any other line, so that a damaged sample is never interpreted.
    """
    text = line.strip(" \t\r\n")
    words = _BETWEEN.split(text[:-1].rstrip(" \t") if text[-1:] in (",", ";") else text)
    if not all(_NUMBER.fullmatch(word) for word in words):
        return None
    numbers = tuple(float(word) for word in words)
    return numbers if all(math.isfinite(number) for number in numbers) else None


@dataclass(kw_only=True, eq=False)
class SampleStream(Closing):
    """The stream of samples of a device.

    Args:
        lines: The port.
        name: The device, for error messages.
        columns: The number of values in a sample.
        timeout_s: The longest wait for a sample, in s of real time.
        stuck_samples: The number of identical samples in a row that mean a stuck device; 0 switches the check off.
        watched: The only column that is checked for this, counted from 1; None for all.

    Attributes:
        garbled: The number of lines so far that were not samples.
    """

    lines: Line
    name: str
    columns: int
    timeout_s: float
    stuck_samples: int = 0
    watched: int | None = None
    garbled: int = field(default=0, init=False)
    _same: int = field(default=0, init=False)
    _last: tuple[float, ...] = field(default=(), init=False)
    _recent: deque[bool] = field(default_factory=lambda: deque(maxlen=_COUNTED), init=False)
    _example: str = field(default="", init=False)

    def wait_for_start(self) -> None:
        """Wait for the first sample. Opening a port restarts many boards, which send some text first.

        Raises:
            RigError: No sample arrives. The port is then closed.
        """
        try:
            self.next(max(self.timeout_s, _START_S))
        except BaseException:
            self.close()
            raise

    def start_fresh(self, latency_s: float = 0.0) -> None:
        """Discard earlier samples, so that every later sample arrived after this call.

        Args:
            latency_s: The time, in s of real time, for which adapters and drivers may hold samples. Samples that arrive
                within this time are discarded too.

        Raises:
            RigError: The device is gone or silent.
        """
        if latency_s > 0.0:
            time.sleep(latency_s)
        self.lines.forget()
        # The next line may be the rest of one that began earlier.
        if self.lines.read_line(self.timeout_s) is None:
            raise self._silent()

    def next(self, timeout_s: float | None = None) -> tuple[float, ...]:
        """Return the next sample.

        Args:
            timeout_s: The longest wait in s of real time; None for the stream's own.

        Raises:
            NoAnswerError: No line arrived.
            RigError: The device is gone or stuck, or too many of the last lines are garbled.
        """
        until = self.lines.now_s() + (self.timeout_s if timeout_s is None else timeout_s)
        while (line := self.lines.read_line(max(until - self.lines.now_s(), 0.0))) is not None:
            numbers = parse_numbers(line)
            sound = numbers is not None and len(numbers) == self.columns
            self.count(sound, line)
            if sound and numbers is not None:
                self._look_for_stuck(numbers if self.watched is None else (numbers[self.watched - 1],))
                return numbers
        if self._recent and not self._recent[-1]:
            raise RigError(f"{self.name}: no valid line in time; the last line was {self._example!r}")
        raise self._silent()

    def count(self, sound: bool, example: str) -> None:
        """Count a line as valid or garbled. A line may be counted as garbled after it was counted as valid.

        Raises:
            RigError: Too many of the last lines are garbled.
        """
        self._recent.append(sound)
        if sound:
            return
        self.garbled += 1
        self._example = example[:_MAX_SHOWN]
        bad = self._recent.count(False)
        if len(self._recent) >= _MIN_COUNTED and bad > _TOO_MANY * len(self._recent):
            raise RigError(
                f"{self.name}: {bad} of the last {len(self._recent)} lines are garbled, for example "
                f"{self._example!r}; check the baud rate and the number of values per line ({self.columns})"
            )

    def close(self) -> None:
        """Close the port. Never raises; a second call has no effect."""
        self.lines.close()

    def _look_for_stuck(self, sample: tuple[float, ...]) -> None:
        """Count identical samples. The samples of a working sensor have noise.

        Raises:
            RigError: There are too many identical samples.
        """
        self._same = self._same + 1 if sample == self._last else 1
        self._last = sample
        if 0 < self.stuck_samples <= self._same:
            shown = ", ".join(f"{number:.10g}" for number in sample)[:_MAX_SHOWN]
            raise RigError(
                f"{self.name}: {self._same} samples in a row are {shown}, so the device is stuck; if its rounding "
                "hides its noise, set its stuck_samples = 0"
            )

    def _silent(self) -> NoAnswerError:
        return NoAnswerError(f"{self.name}: sends no data; check that it is on and that the baud rate is right")
