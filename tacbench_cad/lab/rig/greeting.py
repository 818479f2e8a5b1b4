"""The beginning with a board that may just have been reset: it is asked who it is until it answers."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

from tacbench_cad.lab.rig.errors import NoAnswerError, ProtocolError
from tacbench_cad.lab.rig.line import Line

#: Silence after the answer until nothing more is on its way.
SETTLE_S = 0.15


class Greeting:
    """What a board sends while it is asked who it is.

    Args:
        line: The open port.
        name: Who is talked to, for the messages.
        expected: What the board is expected to be, for the messages: ``GRBL 1.1``.
        limit_s: Longest wait for the answer: a reset that opening the port causes, and a boot loader.
        attempt_s: Pause before the question is asked again.

    Attributes:
        answered: Whether the answer has come; the caller says so.
        heard: What came instead, for the message that nothing did; the caller says what counts.
    """

    def __init__(self, line: Line, name: str, expected: str, *, limit_s: float, attempt_s: float) -> None:
        self.answered = False
        self.heard = ""
        self._line, self._name, self._expected = line, name, expected
        self._until, self._attempt_s = time.monotonic() + limit_s, attempt_s
        self._next_attempt = 0.0

    def listen(self, seconds: float) -> None:
        """Ask again after so long: a board that has sent its banner listens now, and what was sent before is lost."""
        self._next_attempt = min(self._until, time.monotonic() + seconds)

    def lines(self, ask: Callable[[int], None], hint: str = "") -> Iterator[str]:
        """Every line that comes, the question asked time and again, until after the answer nothing more comes.

        Args:
            ask: Asks; it is told which attempt this is, from 1.
            hint: What may help where nothing answers.

        Raises:
            NoAnswerError: Nothing answers.
            ProtocolError: Something came, but no answer.
        """
        attempt = 0
        while not self.answered:
            if time.monotonic() >= self._until:
                if self.heard:
                    raise ProtocolError(
                        f"{self._name}: is not {self._expected}, or the baud rate is wrong; it sent {self.heard!r}"
                    )
                raise NoAnswerError(f"{self._name}: nothing answers; power, cable, baud rate, driver?{hint}")
            attempt += 1
            ask(attempt)
            self._next_attempt = time.monotonic() + self._attempt_s
            while (left := self._next_attempt - time.monotonic()) > 0.0:
                line = self._line.read_line(min(left, SETTLE_S) if self.answered else left)
                if line is None:
                    break
                yield line
