"""Talking to Marlin 2: numbered lines with checksums, resending, and telling silence, halt and reset apart."""

from __future__ import annotations

import time
from collections.abc import Callable

from tacbench_cad.lab.rig import marlin_replies as replies
from tacbench_cad.lab.rig.errors import AlarmError, NoAnswerError, NotThereError, ProtocolError
from tacbench_cad.lab.rig.greeting import Greeting
from tacbench_cad.lab.rig.line import Line
from tacbench_cad.lab.rig.serial_stage import Link

#: Both are common; the first is Marlin's own default.
BAUDS = (250000, 115200)
#: Longest wait for the first answer: the reset that opening a port causes, and a boot loader.
GREETING_S = 12.0
#: Pause before a question without an answer is asked again, while opening.
ATTEMPT_S = 1.5
#: Silence after the start-up text before the next question.
BANNER_S = 0.3
#: Silence after which a line is taken for lost. Marlin says that it is busy every 2 s.
QUIET_S = 3.0
#: Silence that follows ``M410``; a command sent within the first second of it would run twice.
AFTER_STOP_S = 1.5
#: How often one line is sent again at most, and the longest pause before it is: a disturbance may last some seconds.
RESENDS = 10
#: The longest pause before a line is sent again, in seconds.
RESEND_PAUSE_S = 0.2
#: How often new line numbers are asked for at most.
RENUMBERINGS = 5
#: Line numbers begin beyond a multiple of this. A reset counts from 0 again, and so betrays itself; and no number is
#: used twice, since a line whose number was accepted before is passed over without an answer.
NUMBERS = 1000


#: Whether a line is of some kind.
Test = Callable[[str], bool] | None


class _OutOfStepError(Exception):
    """The firmware counts its lines otherwise: this is the one that it expects."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


class MarlinLink(Link):
    """A line to Marlin; ``firmware`` reads ``Marlin 2.1.2.7``.

    Attributes:
        stopping: Motion was stopped on request since the last :meth:`resume`.
    """

    def __init__(self, line: Line, timeout_s: float) -> None:
        super().__init__(line, timeout_s)
        self.stopping = False
        self._stopped_at = 0.0
        self._number = 0
        self._previous = b""
        self._given_up = 0

    def greet(self, bauds: tuple[int, ...]) -> None:
        """Wait for an answer that proves Marlin 2. Resets are no surprise here.

        Args:
            bauds: Baud rates to try in turn; empty where the rate is known.

        Raises:
            NoAnswerError: Nothing answers.
            ProtocolError: Something else does.
        """
        patience_s = max(GREETING_S, self.timeout_s) * max(1, len(bauds))
        greeting = Greeting(self.line, self.name, "Marlin 2", limit_s=patience_s, attempt_s=ATTEMPT_S)

        def ask(attempt: int) -> None:
            if len(bauds) > 1 and attempt % 3 == 1:
                self.line.set_baud(bauds[attempt // 3 % len(bauds)])
            self.line.write(b"\nM115\n")

        self.firmware = ""
        for line in greeting.lines(ask, hint=" A halted board needs its reset"):
            if replies.is_banner(line):
                self.lost = "opening the port reset the firmware"
                # The start-up text has many lines; what is sent meanwhile may vanish.
                greeting.listen(BANNER_S)
            self.firmware = self.firmware or replies.firmware(line) or ""
            greeting.answered = self.firmware != ""
            greeting.heard = greeting.heard or line[:60]
        if not self.firmware.startswith("Marlin"):
            raise ProtocolError(f"{self.name}: {self.firmware!r} is not Marlin 2")
        self.renumber()

    @property
    def unsure(self) -> bool:
        """Whether the last command was given up."""
        return self._given_up > 0

    def renumber(self) -> None:
        """Agree on the line numbers again.

        A garbled ``M110`` is refused by the old numbers, or taken for an unknown command and acknowledged. So a first
        line by the new numbers must prove that they hold.

        Raises:
            RigError: Silent, lost, reset, halted, or garbled time and again.
        """
        for _ in range(RENUMBERINGS):
            first = (self._number // NUMBERS + 1) * NUMBERS
            self._number, self._previous, self._given_up = first - 1, b"", 0
            self._exchange(f"M110 N{first}")
            try:
                # Useful besides: it makes the firmware say every 2 s that it is busy.
                self._exchange("M113 S2")
            except _OutOfStepError:
                # The acknowledgement that follows a refusal must not be taken for that of the next line.
                for line in self.line.lines(1.0, quiet_s=0.1):
                    self._take(line)
            else:
                return
        raise ProtocolError(f"{self.name}: does not take new line numbers; look at the cable")

    def stop(self) -> None:
        """Send ``M410``. Made for signal handlers; never raises."""
        self.stopping = True
        self._stopped_at = time.monotonic()
        self.line.write_now(b"\nM410\n")

    def resume(self) -> None:
        """After :meth:`stop`, or after a line that was cut: wait out the silence and agree on line numbers again.

        Raises:
            RigError: Silent, lost, reset, halted.
        """
        if not self.stopping and not self.line.torn:
            return
        for line in self.line.lines(self._stopped_at + AFTER_STOP_S - time.monotonic()):
            self._take(line)
        self.stopping = False
        # Ends a line that was cut in half; its checksum cannot be right.
        self.line.write(b"\n")
        self.renumber()

    def command(
        self, text: str, *, within_s: float = 0.0, limit_s: float | None = None, expecting: Test = None
    ) -> list[str]:
        """Send a command and wait for its ``ok``.

        A line that the firmware refuses is sent again; so is, once, a line that is met with silence. A firmware that
        has taken it already does not answer it twice: whether it lives then shows in its answer to ``M114``. Every
        ``busy`` lets the silence begin again.

        Args:
            text: The command.
            within_s: How long the firmware may be at work in silence.
            limit_s: Longest time in all; None: three silences and the resends.
            expecting: An ``ok`` does not count before a line of this kind has come.

        Returns:
            The lines that came before the ``ok``.

        Raises:
            NotThereError: It was stopped on request.
            NoAnswerError, ProtocolError, PositionLostError, AlarmError, DeviceLostError: As their names say.
        """
        try:
            return self._exchange(text, within_s, limit_s, expecting)
        except _OutOfStepError as mismatch:
            raise self.reset_noticed(f"counts its lines from {mismatch.number} instead of {self._number}") from None

    def _exchange(
        self, text: str, within_s: float = 0.0, limit_s: float | None = None, expecting: Test = None
    ) -> list[str]:
        """See :meth:`command`.

        Raises:
            _OutOfStepError: The firmware expects a line that was never sent, or long ago.
        """
        self._old_lines()
        self._number += 1
        # Until it is acknowledged.
        self._given_up += 1
        own = replies.framed(self._number, text)
        self.line.write(own)
        quiet = min(self.timeout_s, QUIET_S) + within_s
        begun = time.monotonic()
        until = begun + (limit_s if limit_s is not None else 4.0 * (quiet + self.timeout_s))
        quiet_until = begun + quiet
        lines: list[str] = []
        again: list[bytes] = []
        # Acknowledgements still to come that are not this command's: a refusal has one of its own.
        resends, foreign, tried, has_come = 0, 0, 0, expecting is None
        while (now := time.monotonic()) < until:
            line = self._take(self.line.read_line(0.05))
            if self.stopping:
                raise NotThereError(f"{self.name}: was stopped on request")
            if line is None:
                if now >= quiet_until:
                    if tried == 2:
                        break
                    self.line.write((own, b"M114\n")[tried])
                    tried, quiet_until = tried + 1, now + quiet
                continue
            quiet_until = now + quiet
            number = replies.resend(line)
            if number is not None or self._is_garbled(replies.unknown(line), text):
                # Where the line before is asked for, it will not be acknowledged either.
                resends, foreign = resends + 1, 1 if number is not None and number < self._number else foreign + 1
                if resends > RESENDS:
                    raise ProtocolError(f"{self.name}: {text} was garbled {resends} times; look at the cable")
                again = [own]
                if number is not None and not text.startswith("M110"):
                    again = self._again(number, text, own)
                    own = again[-1]
            elif replies.is_ok(line):
                if foreign:
                    if again:
                        self._pause(resends)
                    for data in again:
                        self.line.write(data)
                    foreign += len(again[1:]) - 1
                    again = []
                elif has_come:
                    self._previous, self._given_up = own, 0
                    return lines
            elif not replies.is_busy(line):
                has_come = has_come or (expecting is not None and expecting(line))
                lines.append(line)
        raise NoAnswerError(f"{self.name}: no answer to {text} within {time.monotonic() - begun:.1f} s")

    def _again(self, number: int, text: str, own: bytes) -> list[bytes]:
        """What to send when the firmware asks for a line: this one, or the one before and this one.

        Lines that were given up are never sent again, since their moves are no longer wanted: the command gets the
        number that the firmware expects.
        """
        if number == self._number:
            return [own]
        if self._given_up == 1 and number == self._number - 1 and self._previous:
            return [self._previous, own]
        if self._number - self._given_up <= number < self._number:
            self._given_up -= self._number - number - 1
            self._number = number
            return [replies.framed(number, text)]
        raise _OutOfStepError(number)

    def _is_garbled(self, unknown: str | None, text: str) -> bool:
        """Whether an unknown command is what a disturbance made of a line.

        A line whose ``N`` was garbled counts as one without a number and checksum: it is not understood, and
        acknowledged.
        """
        if unknown is None or text.startswith(unknown):
            return False
        return unknown.encode("ascii", "replace") not in self._previous

    def _pause(self, resends: int) -> None:
        """Wait before a line is sent again, longer each time, but not when it is the first."""
        until = time.monotonic() + min(0.02 * 2.0 ** (resends - 2), RESEND_PAUSE_S) if resends > 1 else 0.0
        while not self.stopping and (left := until - time.monotonic()) > 0.0:
            time.sleep(min(left, 0.05))

    def _old_lines(self) -> None:
        """Pass over what came unasked, unless it tells of a reset or a halt."""
        for _ in range(1000):
            if self._take(self.line.read_line(0.0)) is None:
                break

    def _take(self, line: str | None) -> str | None:
        """A line, unless it tells that nothing is as it was."""
        if line is not None and replies.is_banner(line):
            raise self.reset_noticed("was reset")
        if line is not None and replies.is_halted(line):
            self.lost = "the firmware halted"
            raise AlarmError(f"{self.name}: halted ({line}); press its reset button, then home")
        return line
