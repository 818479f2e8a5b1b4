"""The first exchange with a board that may just have been reset: its identity is asked for until it answers."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from tacbench_cad.lab.rig.errors import NoAnswerError, RigError
from tacbench_cad.lab.rig.line import Line

#: The silence after the answer, in s, after which no more lines are expected.
SETTLE_S = 0.15


class Greeting:
    """The lines that a board sends while it is being identified.

    Args:
        line: The open port.
        name: The device, for error messages.
        expected: The expected kind of board, for error messages: ``GRBL 1.1``.
        limit_s: The longest wait for the answer. Opening a port may reset the board and start a boot loader.
        attempt_s: The pause before the question is repeated.

    Attributes:
        answered: Whether the answer has come; the caller sets it.
        unexpected: Another text that came instead, for the error message; the caller sets it.
        heard: A line that only the expected board sends, but that is not the answer; the caller sets it.
    """

    def __init__(self, line: Line, name: str, expected: str, *, limit_s: float, attempt_s: float) -> None:
        self.answered = False
        self.unexpected = self.heard = ""
        self._line, self._name, self._expected = line, name, expected
        self._until, self._attempt_s = line.now_s() + limit_s, attempt_s
        self._next_attempt = 0.0

    def listen(self, seconds: float) -> None:
        """Repeat the question after a pause. A board that has sent its banner may have lost the earlier question."""
        self._next_attempt = min(self._until, self._line.now_s() + seconds)

    def lines(self, ask: Callable[[int], None], hint: str = "") -> Iterator[str]:
        """Yield every line that arrives, and repeat the question until the answer has come and the board is silent.

        Args:
            ask: Sends the question; its argument is the number of the attempt, from 1.
            hint: Additional advice if no answer comes.

        Raises:
            NoAnswerError: The board sends no line, or only one that is not an answer.
            RigError: Another board sends lines.
        """
        attempt = 0
        while not self.answered:
            if self._line.now_s() >= self._until:
                raise self._unanswered(hint)
            attempt += 1
            ask(attempt)
            self._next_attempt = self._line.now_s() + self._attempt_s
            while (left := self._next_attempt - self._line.now_s()) > 0.0:
                line = self._line.read_line(min(left, SETTLE_S) if self.answered else left)
                if line is None:
                    break
                yield line

    def _unanswered(self, hint: str) -> NoAnswerError | RigError:
        """Return the error for a board that did not answer in time."""
        if self.heard:
            return NoAnswerError(
                f"{self._name}: sent {self.heard!r} but answers no question, so the line is disturbed or broken; "
                "check the cable"
            )
        if "\ufffd" in self.unexpected or not self.unexpected.isprintable():
            return NoAnswerError(
                f"{self._name}: sent unreadable text, so the line is disturbed or the baud rate is wrong; "
                f"it sent {self.unexpected!r}"
            )
        if self.unexpected:
            return RigError(
                f"{self._name}: is not {self._expected}, the baud rate is wrong, or the line is disturbed; "
                f"it sent {self.unexpected!r}"
            )
        return NoAnswerError(f"{self._name}: does not answer. Check power, cable, baud rate and driver{hint}")
