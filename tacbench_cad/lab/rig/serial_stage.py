"""The common part of the drivers for stages behind a serial port: the first exchange, moves and homing."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterable, Iterator
from typing import Generic, TypedDict, TypeVar

from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.errors import AlarmError, NoAnswerError, PositionLostError, RigError
from tacbench_cad.lab.rig.line import Line
from tacbench_cad.lab.rig.stage import Closing, no_report
from tacbench_cad.lab.study.spec import Point

T = TypeVar("T")

#: The hint after homing that could not be stopped.
STILL_HOMING = "homing may still go on, so the carriage may still move: keep clear, or switch the motors off"
#: The number of repetitions of a question after an unexpected position.
REPORTS = 4
#: The silence after the answer to the first question, in s, after which no more lines are expected.
SETTLE_S = 0.15


class Link:
    """A connection to a firmware, which also records whether the position of the carriage is known.

    Args:
        line: The open port.
        timeout_s: The longest wait for an answer, in s of real time.

    Attributes:
        line: The open port.
        timeout_s: The longest wait for an answer, in s of real time.
        name: The device, for error messages.
        lost: The reason why the position of the carriage is unknown; empty while it is known.
        firmware: The firmware's name and version; empty until it has answered.
    """

    def __init__(self, line: Line, timeout_s: float) -> None:
        self.line, self.timeout_s = line, timeout_s
        self.name = f"stage at {line.port}"
        self.lost = self.firmware = ""

    def require_known(self) -> None:
        """Check that the position is known before a move.

        Raises:
            PositionLostError: The position is unknown.
        """
        if self.lost:
            raise PositionLostError(f"{self.name}: the position is unknown: {self.lost}; home the stage first")

    def reset_noticed(self, how: str) -> PositionLostError:
        """Return the error for an unexpected reset."""
        self.lost = "the firmware was reset (button, power dip or disturbance)"
        return PositionLostError(
            f"{self.name}: {how}, so the position of the carriage is unknown; home the stage first"
        )


class Greeting:
    """The first exchange with a board that may just have been reset: its identity is asked for until it answers.

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


L = TypeVar("L", bound=Link)


class SerialOptions(TypedDict, total=False):
    """The options of every driver for a stage behind a serial port.

    Args:
        clock: The rig's time; real time by default.
        baud: The baud rate; the firmware's usual one by default.
        timeout_s: The longest wait for an answer, in s of real time; 10 by default.
        home_timeout_s: The longest homing (with Marlin, of one or two axes), in s of real time; 120 by default.
        simulated: The simulated part.
    """

    clock: Clock
    baud: int | None
    timeout_s: float
    home_timeout_s: float
    simulated: str


class SerialStage(Closing, Generic[L]):
    """A stage behind a serial port.

    Args:
        port: The path, name or pyserial URL of the port.
        link: Creates the connection to the firmware.
        bauds: The usual baud rates.
        options: See :class:`SerialOptions`.
    """

    def __init__(
        self, port: str, link: Callable[[Line, float], L], bauds: tuple[int, ...], options: SerialOptions
    ) -> None:
        self.simulated = options.get("simulated", "")
        self._clock = options.get("clock", Clock())
        self._timeout_s = options.get("timeout_s", 10.0)
        self._home_timeout_s = options.get("home_timeout_s", 120.0)
        baud = options.get("baud")
        self._bauds = (baud,) if baud else bauds
        #: The last known position, and the one at which homing ended.
        self._last: Point | None = None
        self._home_mm: Point | None = None
        self._report: Callable[[Point], None] = no_report
        self._line = Line(port, baud=self._bauds[0], what="stage", write_timeout_s=min(self._timeout_s, 2.0))
        self._link = link(self._line, self._timeout_s)

    def report_to(self, receive: Callable[[Point], None]) -> None:
        """See :class:`tacbench_cad.lab.rig.stage.Stage`."""
        self._report = receive

    def stop(self) -> None:
        """See :class:`tacbench_cad.lab.rig.stage.Stage`."""
        raise NotImplementedError

    def close(self) -> None:
        """Close the port. Never raises; a second call has no effect."""
        self._line.close()

    @contextlib.contextmanager
    def _opening(self) -> Iterator[None]:
        """Close the port if the body fails."""
        try:
            yield
        except BaseException:
            self.close()
            raise

    def _require_free_switch(self, clear_mm: float, is_closed: Callable[[], bool]) -> None:
        """Refuse to home if the end stop at the top of z is closed far below it.

        Homing would then move down from it, and press the sensor deeper.

        Args:
            clear_mm: The distance from the end of homing, in mm, from which the end stop must be open.
            is_closed: Returns whether the end stop is closed.

        Raises:
            AlarmError: The end stop is closed although the carriage was last seen below it.
        """
        if self._last is None or self._home_mm is None:
            return
        below_mm = self._home_mm[2] - self._last[2]
        if below_mm > clear_mm and is_closed():
            self._link.lost = "the end stop of z stays closed"
            raise AlarmError(
                f"{self._link.name}: {self._link.lost} although the carriage is {below_mm:.1f} mm below it, so homing "
                "would press the sensor deeper; check the switch and its cable"
            )

    @contextlib.contextmanager
    def _moving(self) -> Iterator[None]:
        """Stop the motion if the body is interrupted, so that no carriage moves unattended."""
        try:
            yield
        except RigError:
            raise
        except BaseException:
            self.stop()
            raise


def confirmed(read: Callable[[], T], is_expected: Callable[[T], bool]) -> T | None:
    """Return the first report that is expected or that comes twice in a row. A single report may be damaged.

    Args:
        read: Requests a report.
        is_expected: Whether a report is trusted at once.

    Returns:
        The report; None if every report was different.
    """
    report = read()
    for _ in range(REPORTS):
        if is_expected(report):
            return report
        before, report = report, read()
        if report == before:
            return report
    return None


def duration_s(start: Point, target: Point, speed_mm_s: float, rates_mm_s: Iterable[float]) -> float:
    """Return the longest duration of a move in s, from its speed and the largest rate of each axis (0: unknown)."""
    seconds = math.dist(start, target) / speed_mm_s
    for a, b, rate in zip(start, target, rates_mm_s, strict=True):
        if rate > 0.0:
            seconds = max(seconds, abs(b - a) / rate)
    return seconds


def is_near(at: Point, target: Point, tolerance_mm: Iterable[float]) -> bool:
    """Return whether each coordinate is within its tolerance."""
    return all(abs(a - b) <= near for a, b, near in zip(at, target, tolerance_mm, strict=True))


def place_text(at: Point) -> str:
    """Return a position as text for messages."""
    return "x {:.3f}, y {:.3f}, z {:.3f} mm".format(*at)
