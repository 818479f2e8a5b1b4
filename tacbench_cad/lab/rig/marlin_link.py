"""The connection to Marlin 2: numbered lines with checksums, repetition, and detection of silence, halt and reset."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable

from tacbench_cad.lab.rig import marlin_replies as replies
from tacbench_cad.lab.rig.errors import AlarmError, NoAnswerError, RigError
from tacbench_cad.lab.rig.line import Line
from tacbench_cad.lab.rig.serial_stage import STILL_HOMING, Greeting, Link

#: The baud rates to try. Both are common; the first is Marlin's default.
BAUDS = (250000, 115200)
#: The longest wait for the first answer, in s. Opening a port may reset the board and start a boot loader.
GREETING_S = 12.0
#: The pause before an unanswered question is repeated while the port is opened, in s.
ATTEMPT_S = 1.5
#: The silence after the start-up text before the next question, in s.
BANNER_S = 0.3
#: The silence, in s, after which a line counts as lost. Marlin reports every 2 s that it is busy.
QUIET_S = 3.0
#: The longest total wait for a command whose limit restarts with every ``busy``, as a multiple of this limit.
BUSY_LIMITS = 10.0
#: The wait, in s, for a sign that homing has stopped: the acknowledgement or a halt.
HOMING_STOP_S = 3.0
#: The silence after ``M410``, in s. Marlin would execute a command in its first second twice.
AFTER_STOP_S = 1.5
#: The largest number of repetitions of one line, since a disturbance may last some seconds.
RESENDS = 10
#: The longest pause before a line is sent again, in s.
RESEND_PAUSE_S = 0.2
#: The largest number of attempts to agree on new line numbers.
RENUMBERINGS = 5
#: Line numbers continue after the next multiple of this number. After a reset Marlin counts from 0 again, which makes
#: the reset visible. No number is used twice, since Marlin ignores a number that it has already accepted.
NUMBERS = 1000


#: A test of a line.
Test = Callable[[str], bool] | None


def _is_place(line: str) -> bool:
    return replies.place(line) is not None


class _OutOfStepError(Exception):
    """The firmware expects another line number."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


class MarlinLink(Link):
    """The connection to Marlin; ``firmware`` is ``Marlin 2.1.2.7``, for example.

    Attributes:
        stopping: Whether motion was stopped on request since the last :meth:`resume`.
    """

    def __init__(self, line: Line, timeout_s: float) -> None:
        super().__init__(line, timeout_s)
        self.stopping = False
        self._stopped_at = 0.0
        self._number = 0
        self._previous = b""
        self._given_up = 0

    def greet(self, bauds: tuple[int, ...]) -> None:
        """Wait for an answer that proves Marlin 2. Resets are expected here.

        Args:
            bauds: The baud rates to try in turn; empty if the rate is known.

        Raises:
            NoAnswerError: The device does not answer.
            RigError: The device is not Marlin 2.
        """
        patience_s = max(GREETING_S, self.timeout_s) * max(1, len(bauds))
        greeting = Greeting(self.line, self.name, "Marlin 2", limit_s=patience_s, attempt_s=ATTEMPT_S)

        def ask(attempt: int) -> None:
            if len(bauds) > 1 and attempt % 3 == 1:
                self.line.set_baud(bauds[attempt // 3 % len(bauds)])
            self.line.write(b"\nM115\n")

        names: list[str] = []
        for line in greeting.lines(ask, hint=". A halted board needs a reset"):
            if replies.is_banner(line):
                self.lost = "opening the port reset the firmware"
                # The start-up text has many lines, and a question sent meanwhile may be lost.
                greeting.listen(BANNER_S)
            # The firmware repeats a command that it does not understand: here, a disturbed question.
            if line.startswith("Marlin ") or "M115" not in (replies.unknown(line) or "M115"):
                greeting.heard = greeting.heard or line[:60]
            name = replies.firmware(line)
            if name is not None:
                # Another name may be damaged, so it must come twice.
                greeting.answered = greeting.answered or name.startswith("Marlin") or name in names
                names.append(name)
            greeting.unexpected = greeting.unexpected or line[:60]
        self.firmware = next((name for name in names if name.startswith("Marlin")), names[-1])
        if not self.firmware.startswith("Marlin"):
            raise RigError(f"{self.name}: {self.firmware!r} is not Marlin 2")
        self.renumber()

    @property
    def unsure(self) -> bool:
        """Whether the last command was given up without an acknowledgement."""
        return self._given_up > 0

    def renumber(self) -> None:
        """Agree on new line numbers with the firmware.

        Marlin may refuse a garbled ``M110`` because of the old numbers, or acknowledge it as an unknown command.
        Therefore a first line with the new numbers must prove that they are valid. Late answers to earlier commands
        may follow; the position that ``M114`` reports shows where they end.

        Raises:
            RigError: The device is silent or gone, was reset or halted, or lines were garbled too often.
        """
        for _ in range(RENUMBERINGS):
            first = (self._number // NUMBERS + 1) * NUMBERS
            self._number, self._previous, self._given_up = first - 1, b"", 0
            self._exchange(f"M110 N{first}")
            try:
                # This command also makes the firmware report every 2 s that it is busy.
                self._exchange("M113 S2")
                self._exchange("M114", expecting=_is_place)
            except _OutOfStepError:
                # The acknowledgement after a refusal must not count as that of the next line.
                for line in self.line.lines(1.0, quiet_s=0.1):
                    self._take(line)
            else:
                return
        raise RigError(f"{self.name}: does not accept new line numbers; check the cable")

    def stop(self) -> None:
        """Send ``M410``. Signal handlers may call this method. Never raises."""
        self.stopping = True
        self._stopped_at = time.monotonic()
        self.line.write_now(b"\nM410\n")

    def stop_homing(self) -> str:
        """Stop homing, with ``M410`` or else ``M112``, before this program ends. Never raises.

        Returns:
            What became of it, for the user.
        """
        with contextlib.suppress(RigError):
            for stop, seconds in ((self.stop, HOMING_STOP_S), (self._halt, 1.0)):
                stop()
                for line in self.line.lines(seconds):
                    if replies.is_halted(line):
                        return "homing was stopped and the firmware halted; press its reset button"
                    if replies.is_ok(line):
                        return "homing was stopped, so the position is unknown"
        return STILL_HOMING

    def _halt(self) -> None:
        self.line.write_now(b"\nM112\n")

    def resume(self, *, may_reset: bool = False) -> None:
        """Prepare for commands after :meth:`stop`, an interrupted write or a command without answer.

        After a stop it waits. Then it sets new line numbers.

        Args:
            may_reset: Whether a reset is expected; :meth:`greet` must then follow, which sets the line numbers.

        Raises:
            RigError: The device is silent or gone, or was reset or halted.
        """
        if not (self.stopping or self.line.torn or self.unsure):
            return
        for line in self.line.lines(self._stopped_at + AFTER_STOP_S - time.monotonic()):
            if not may_reset:
                self._take(line)
        self.stopping = False
        # This ends a line that was sent only in part. Its checksum cannot be right.
        self.line.write(b"\n")
        if not may_reset:
            self.renumber()

    def command(
        self, text: str, *, within_s: float = 0.0, limit_s: float | None = None, expecting: Test = None
    ) -> list[str]:
        """Send a command and wait for its ``ok``.

        A line is repeated if the firmware refuses it, and repeated once if the firmware is silent. A firmware that has
        already accepted the line does not answer the repetition; its answers to ``M114`` and ``M115`` then show that it
        works. They also show where late answers end: without them, a late ``ok`` would count for the next command.
        Every ``busy`` restarts the waits.

        Args:
            text: The command.
            within_s: The time, in s, that the firmware may work without a message.
            limit_s: The longest time in s, from the last ``busy`` if there was one; None for the waits and repetitions.
            expecting: A test of a line that must arrive before the ``ok`` counts.

        Returns:
            The lines before the ``ok``.

        Raises:
            RigError: The motion was stopped on request.
            RigError: The device is silent, gone or halted, was reset, or lines were garbled too often.
        """
        try:
            return self._exchange(text, within_s, limit_s, expecting)
        except _OutOfStepError as mismatch:
            raise self.reset_noticed(f"expects line {mismatch.number} instead of {self._number}") from None

    def _exchange(
        self, text: str, within_s: float = 0.0, limit_s: float | None = None, expecting: Test = None
    ) -> list[str]:
        """See :meth:`command`.

        Raises:
            _OutOfStepError: The firmware expects a line that was never sent or is too old.
        """
        self._old_lines()
        if self.stopping:
            raise RigError(f"{self.name}: the motion was stopped on request")
        self._number += 1
        # The command counts as given up until it is acknowledged.
        self._given_up += 1
        framed = replies.framed(self._number, text)
        self.line.write(framed)
        quiet = min(self.timeout_s, QUIET_S) + within_s
        begun = self.line.now_s()
        limit = limit_s if limit_s is not None else 4.0 * (quiet + self.timeout_s)
        until, last = begun + limit, begun + BUSY_LIMITS * limit
        quiet_until = begun + quiet
        lines: list[str] = []
        again: list[bytes] = []
        # The number of pending acknowledgements of other lines: each refusal is also acknowledged.
        resends, foreign, tried, has_come, caught_up = 0, 0, 0, expecting is None, True
        while (now := self.line.now_s()) < min(until, last):
            line = self._take(self.line.read_line(0.05))
            if self.stopping:
                raise RigError(f"{self.name}: the motion was stopped on request")
            if line is None:
                if now >= quiet_until:
                    if tried == 2:
                        break
                    self.line.write((framed, b"M114\nM115\n")[tried])
                    tried, quiet_until, caught_up = tried + 1, now + quiet, tried == 0
                continue
            quiet_until = now + quiet
            number = replies.resend(line)
            if number is not None or self._is_garbled(replies.unknown(line), text):
                # If the firmware requests the previous line, that line will not be acknowledged either.
                resends, foreign = resends + 1, 1 if number is not None and number < self._number else foreign + 1
                if resends > RESENDS:
                    raise RigError(f"{self.name}: {text} was garbled {resends} times; check the cable")
                again = [framed]
                if number == self._number + 1 and not text.startswith("M110"):
                    # The firmware has accepted this line, and has refused what a disturbance made of another one.
                    again, caught_up = [b"M114\nM115\n"], False
                elif number is not None and not text.startswith("M110"):
                    again = self._again(number, text, framed)
                    framed = again[-1]
            elif replies.is_ok(line):
                if foreign:
                    if again:
                        self._pause(resends)
                    for data in again:
                        self.line.write(data)
                    foreign += len(again[1:]) - 1
                    again = []
                elif has_come and caught_up:
                    self._previous, self._given_up = framed, 0
                    return lines
            elif replies.is_busy(line):
                until = now + limit
            else:
                caught_up = caught_up or replies.firmware(line) is not None
                has_come = has_come or (expecting is not None and expecting(line))
                lines.append(line)
        raise NoAnswerError(f"{self.name}: no answer to {text} within {self.line.now_s() - begun:.1f} s")

    def _again(self, number: int, text: str, framed: bytes) -> list[bytes]:
        """Return the lines to send when the firmware requests a line: this one, or also the previous one.

        Commands that were given up are never sent again, since their moves are no longer valid. Instead, the present
        command gets the number that the firmware expects.
        """
        if number == self._number:
            return [framed]
        if self._given_up == 1 and number == self._number - 1 and self._previous:
            return [self._previous, framed]
        if self._number - self._given_up <= number < self._number:
            self._given_up -= self._number - number - 1
            self._number = number
            return [replies.framed(number, text)]
        raise _OutOfStepError(number)

    def _is_garbled(self, unknown: str | None, text: str) -> bool:
        """Return whether an unknown command is a garbled line of ours.

        A line whose ``N`` was garbled counts as one without number and checksum. Marlin does not understand it, but
        acknowledges it.
        """
        if unknown is None or text.startswith(unknown):
            return False
        return unknown.encode("ascii", "replace") not in self._previous

    def _pause(self, resends: int) -> None:
        """Wait before a line is repeated, longer for each repetition, but not before the first."""
        until = time.monotonic() + min(0.02 * 2.0 ** (resends - 2), RESEND_PAUSE_S) if resends > 1 else 0.0
        while not self.stopping and (left := until - time.monotonic()) > 0.0:
            time.sleep(min(left, 0.05))

    def _old_lines(self) -> None:
        """Discard lines that arrived unrequested, but raise an error for a reset or a halt."""
        for _ in range(1000):
            if self._take(self.line.read_line(0.0)) is None:
                break

    def _take(self, line: str | None) -> str | None:
        """Return a line, but raise an error if it reports a reset or a halt."""
        if line is not None and replies.is_banner(line):
            raise self.reset_noticed("was reset")
        if line is not None and replies.is_halted(line):
            self.lost = "the firmware halted"
            raise AlarmError(f"{self.name}: halted ({line}); press its reset button, then home the stage")
        return line
