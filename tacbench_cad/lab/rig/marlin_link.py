"""Talking to Marlin 2: numbered lines with checksums, resending, and telling silence, halt and reset apart."""

from __future__ import annotations

import time
from collections.abc import Callable

from tacbench_cad.lab.rig import marlin_replies as replies
from tacbench_cad.lab.rig.errors import (
    AlarmError,
    NoAnswerError,
    NotThereError,
    PositionLostError,
    ProtocolError,
)
from tacbench_cad.lab.rig.line import Line

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
#: How often one line is sent again at most.
RESENDS = 4
#: Number of the line before the first one. A reset counts from 0 again, and so betrays itself.
FIRST = 1000


class MarlinLink:
    """A line to Marlin.

    Args:
        line: The open port.
        timeout_s: Longest silence that is waited through, in real seconds.

    Attributes:
        line: As given.
        name: Who is talked to, for the messages.
        lost: Why nobody knows where the carriage is; empty while that is known.
        firmware: ``Marlin 2.1.2.7``; empty before :meth:`greet`.
        stopping: Motion was stopped on request since the last :meth:`resume`.
    """

    def __init__(self, line: Line, timeout_s: float) -> None:
        self.line = line
        self.name = f"stage at {line.port}"
        self.lost = ""
        self.firmware = ""
        self.stopping = False
        self._timeout_s = timeout_s
        self._stopped_at = 0.0
        self._number = FIRST
        self._previous = b""

    def greet(self, bauds: tuple[int, ...]) -> None:
        """Wait for an answer that proves Marlin 2. Resets are no surprise here.

        Args:
            bauds: Baud rates to try in turn; empty where the rate is known.

        Raises:
            NoAnswerError: Nothing answers.
            ProtocolError: Something else does.
        """
        until = time.monotonic() + max(GREETING_S, self._timeout_s) * max(1, len(bauds))
        attempt, heard, self.firmware = 0, "", ""
        while not self.firmware:
            if time.monotonic() >= until:
                if heard:
                    raise ProtocolError(f"{self.name}: is not Marlin 2, or the baud rate is wrong; it sent {heard!r}")
                raise NoAnswerError(
                    f"{self.name}: nothing answers; power, cable, baud rate, driver? A halted board needs its reset"
                )
            if len(bauds) > 1 and attempt % 3 == 0:
                self.line.set_baud(bauds[attempt // 3 % len(bauds)])
            attempt += 1
            self.line.write(b"\nM115\n")
            next_attempt = time.monotonic() + ATTEMPT_S
            while (left := next_attempt - time.monotonic()) > 0.0:
                line = self.line.read_line(min(left, 0.15) if self.firmware else left)
                if line is None:
                    break
                if replies.is_banner(line):
                    self.lost = "opening the port reset the firmware"
                    # The start-up text has many lines; what is sent meanwhile may vanish.
                    next_attempt = min(until, time.monotonic() + BANNER_S)
                self.firmware = self.firmware or replies.firmware(line) or ""
                heard = heard or line[:60]
        if not self.firmware.startswith("Marlin"):
            raise ProtocolError(f"{self.name}: {self.firmware!r} is not Marlin 2")
        self.renumber()

    def renumber(self) -> None:
        """Agree on the line numbers anew.

        Raises:
            RigError: Silent, lost, reset, halted.
        """
        self._number, self._previous = FIRST - 1, b""
        self.command(f"M110 N{FIRST}")

    def stop(self) -> None:
        """Send ``M410``. Made for signal handlers; never raises."""
        self.stopping = True
        self._stopped_at = time.monotonic()
        self.line.write_now(b"\nM410\n")

    def resume(self) -> None:
        """After :meth:`stop`, or after a line that was cut: wait out the silence and agree on line numbers anew.

        Raises:
            RigError: Silent, lost, reset, halted.
        """
        if not self.stopping and not self.line.torn:
            return
        while (left := self._stopped_at + AFTER_STOP_S - time.monotonic()) > 0.0:
            self._take(self.line.read_line(left))
        self.stopping = False
        # Ends a line that was cut in half; its checksum cannot be right.
        self.line.write(b"\n")
        self.renumber()

    def command(
        self,
        text: str,
        *,
        within_s: float = 0.0,
        limit_s: float | None = None,
        wanted: Callable[[str], bool] | None = None,
    ) -> list[str]:
        """Send a command and wait for its ``ok``.

        A line that the firmware refuses is sent again; so is, once, a line that is met with silence. A firmware that
        has taken it already does not answer it twice: whether it lives then shows in its answer to ``M114``. Every
        ``busy`` lets the silence begin anew.

        Args:
            text: The command.
            within_s: How long the firmware may be at work in silence.
            limit_s: Longest time in all; None: three silences and the resends.
            wanted: An ``ok`` does not count before a line of this kind has come.

        Returns:
            The lines that came before the ``ok``.

        Raises:
            NotThereError: It was stopped on request.
            NoAnswerError, ProtocolError, PositionLostError, AlarmError, DeviceLostError: As their names say.
        """
        self._old_lines()
        self._number += 1
        own = replies.framed(self._number, text)
        self.line.write(own)
        quiet = min(self._timeout_s, QUIET_S) + within_s
        begun = time.monotonic()
        until = begun + (limit_s if limit_s is not None else 4.0 * (quiet + self._timeout_s))
        quiet_until = begun + quiet
        lines: list[str] = []
        again: list[bytes] = []
        # Acknowledgements still to come that are not this command's: a refusal has one of its own.
        resends, foreign, tried, has_come = 0, 0, 0, wanted is None
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
            if number is not None:
                resends, foreign = resends + 1, foreign + 1
                again = self._again(number, own, resends)
            elif replies.is_ok(line):
                if foreign:
                    for one in again:
                        self.line.write(one)
                    foreign += len(again[1:]) - 1
                    again = []
                elif has_come:
                    self._previous = own
                    return lines
            elif not replies.is_busy(line):
                has_come = has_come or (wanted is not None and wanted(line))
                lines.append(line)
        raise NoAnswerError(f"{self.name}: no answer to {text} within {time.monotonic() - begun:.1f} s")

    def _again(self, number: int, own: bytes, resends: int) -> list[bytes]:
        """What to send after a refusal."""
        if resends > RESENDS:
            raise ProtocolError(f"{self.name}: line {number} was garbled {resends} times; look at the cable")
        if number == self._number:
            return [own]
        if number == self._number - 1 and self._previous:
            return [self._previous, own]
        raise self._reset_noticed(f"counts its lines from {number} instead of {self._number}")

    def _old_lines(self) -> None:
        """Pass over what came unasked, unless it tells of a reset or a halt."""
        for _ in range(1000):
            if self._take(self.line.read_line(0.0)) is None:
                return

    def _take(self, line: str | None) -> str | None:
        """A line, unless it tells that nothing is as it was."""
        if line is None:
            return None
        if replies.is_banner(line):
            raise self._reset_noticed("was reset")
        if replies.is_halted(line):
            self.lost = "the firmware halted"
            raise AlarmError(f"{self.name}: halted ({line}); press its reset button, then home")
        return line

    def _reset_noticed(self, how: str) -> PositionLostError:
        self.lost = "the firmware was reset (button, power dip or disturbance)"
        return PositionLostError(f"{self.name}: {how}: where the carriage is, nobody knows; home first")
