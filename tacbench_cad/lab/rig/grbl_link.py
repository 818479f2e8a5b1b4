"""The connection to GRBL 1.1 or grblHAL: greeting, questions, status reports, resets, alarms and silence."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from contextlib import suppress

from tacbench_cad.lab.rig import grbl_replies as replies
from tacbench_cad.lab.rig.errors import AlarmError, NoAnswerError, OutOfRangeError, RigError
from tacbench_cad.lab.rig.grbl_replies import Status
from tacbench_cad.lab.rig.line import Line
from tacbench_cad.lab.rig.serial_stage import Greeting, Link

#: The shortest wait, in s, before an unanswered status request is repeated. Two requests close together may get one
#: answer. The wait grows with the time that the device takes to answer, up to a quarter of the timeout.
ANSWER_S = 0.3
#: The longest wait for the banner after Ctrl-X, in s. Half a second was observed.
RESET_S = 1.5
#: The longest wait for the first answer, in s. Opening a port may reset the board and start a boot loader.
GREETING_S = 8.0
#: The pause before an unanswered question is repeated while the port is opened, in s.
ATTEMPT_S = 1.0
#: The pause after a banner before the next question, in s. More lines may follow the banner.
BANNER_S = 0.1
#: The wait for the lines after an unexpected banner, in s. They tell whether an end stop is closed.
AFTER_BANNER_S = 0.3
#: The largest number of attempts to read the settings.
READINGS = 5
#: The longest wait for the rest of an answer that has begun, in s.
ACCEPTANCE_S = 2.0
#: The number of GRBL's error for a command that is allowed only at rest.
NOT_IDLE = 8
#: The beginning of the mark in the text that GRBL stores for its user (``$I=``). It is followed by the numbers of the
#: settings that have to be switched on again if the program was killed.
MARK = "TACBENCH:"
#: The real-time bytes for a feed hold, a reset and a status request.
HOLD, RESET, ASK = b"!", b"\x18", b"?"


class GrblLink(Link):
    """The connection to GRBL; ``firmware`` is ``GRBL 1.1h.20190825``, for example.

    Attributes:
        options: The letters of the build's options, for example ``VZ``; None if unknown.
        answer_s: The wait before an unanswered status request is repeated, in s.
        marked: The numbers of the settings that a killed program has left switched off; see :meth:`mark`.
    """

    def __init__(self, line: Line, timeout_s: float) -> None:
        super().__init__(line, timeout_s)
        self.options: str | None = None
        self.answer_s = ANSWER_S
        self._unreadable, self._unreadable_s = "", -math.inf
        self.marked: tuple[int, ...] = ()
        self._text = ""
        # The number of status requests whose answers may still come, and the time of the first of them.
        self._pending, self._asked_s = 0, 0.0
        self._after_banner = False

    def greet(self) -> None:
        """Wait for an answer that proves GRBL 1.1.

        Opening the port may cause a reset and a banner, a reset with a boot loader that loses the question, or neither.
        After some alarms the firmware reacts only to Ctrl-X.

        Raises:
            NoAnswerError: The device does not answer.
            RigError: The device is not GRBL 1.1.
        """
        greeting = Greeting(
            self.line, self.name, "GRBL 1.1", limit_s=max(GREETING_S, self.timeout_s), attempt_s=ATTEMPT_S
        )
        version, name, moving = "", "GRBL", False

        def ask(attempt: int) -> None:
            # A board that has sent a line is alive and only slow. It must not be reset, unless it was moving.
            self.line.write((RESET if moving or (attempt > 3 and not greeting.heard) else b"") + b"\n$I\n")

        for line in greeting.lines(ask):
            if replies.is_banner(line):
                self.lost = "opening the port reset the firmware"
                greeting.listen(BANNER_S)
            if replies.error(line) == NOT_IDLE and not moving:
                # A program that was killed left the carriage moving. It is stopped, and later reset.
                self.line.write(HOLD)
                moving = True
            if replies.is_banner(line) or line == "ok" or replies.error(line) is not None:
                greeting.heard = greeting.heard or line
            self.options = replies.options(line) or self.options
            if "HAL" in line.upper() and line[:1] in ("[", "G"):
                name = "grblHAL"
            version = version or replies.version(line) or ""
            greeting.answered = version != ""
            if line != "ok":
                greeting.unexpected = greeting.unexpected or line[:60]
            if "Marlin" in line or "Unknown command" in line:
                raise RigError(f"{self.name}: is Marlin, not GRBL; it sent {line[:60]!r}")
        if not version.startswith("1.1"):
            raise RigError(f"{self.name}: GRBL {version!r} is not supported; version 1.1 is needed")
        version, _, marked = version.partition(MARK)
        self.marked = tuple(int(number) for number in re.findall(r"\b\d+\b", marked))
        self._text = version.partition(":")[2]
        self.firmware = f"{name} {version.strip(':')}"

    def next(self, timeout_s: float) -> Status | str | None:
        """Return the next report or line; None if none arrives in time.

        Raises:
            AlarmError: The line was an alarm.
            PositionLostError: The line was the banner of an unexpected reset.
            DeviceLostError: The port is gone.
        """
        line = self.line.read_line(timeout_s)
        if line is None:
            return None
        number = replies.alarm(line)
        if number is not None:
            self.lost = f"ALARM:{number} ({replies.ALARMS.get(number, 'see the manual of its firmware')})"
            raise AlarmError(f"{self.name}: {self.lost}; find the cause, then home the stage")
        if self._after_banner and replies.is_hint(line):
            return line
        if replies.is_banner(line) or replies.is_limit(line):
            raise self._unexpected_reset(line)
        self._after_banner = False
        report = replies.status(line)
        if report is None:
            if not replies.is_known(line):
                self._unreadable, self._unreadable_s = line[:60], self.line.now_s()
            return line
        if self._pending:
            took_s = self.line.now_s() - self._asked_s
            self.answer_s = max(ANSWER_S, min(max(2.0 * took_s, 0.8 * self.answer_s), self.timeout_s / 4.0))
            self._pending -= 1
        return report

    def _unexpected_reset(self, line: str) -> RigError:
        """Return the error for a banner that nobody asked for. The lines after it may report a closed end stop."""
        self._after_banner = True
        if replies.is_limit(line) or any(map(replies.is_limit, self.line.lines(AFTER_BANNER_S))):
            self.lost = "an end stop was hit or stays closed"
            return AlarmError(
                f"{self.name}: {self.lost}, and the firmware was reset ([MSG:Check Limits]); find the cause, then home "
                "the stage"
            )
        return self.reset_noticed("was reset")

    def settings(self) -> dict[int, float]:
        """Ask for the numbered settings, while the stage is at rest.

        Raises:
            RigError: The firmware refuses to answer, is silent or gone, or was reset.
        """
        for _ in range(READINGS):
            # The empty line ends whatever was left of an earlier line. Answers to earlier lines may come first.
            self.line.write(b"\n$$\n")
            lines: list[str] = []
            until = self.line.now_s() + self.timeout_s
            while (left := until - self.line.now_s()) > 0.0:
                answer = self.next(min(left, ACCEPTANCE_S) if lines else left)
                if answer is None and lines:
                    break
                if answer is None:
                    raise self.silence()
                if isinstance(answer, str):
                    lines.append(answer)
                    settings = replies.settings(lines)
                    if answer == "ok" and settings:
                        return settings
                    if replies.error(answer) is not None:
                        break
        raise RigError(f"{self.name}: does not list its settings; it sent {lines[-1]!r} after $$")

    def set(self, number: int, value: float) -> None:
        """Change a numbered setting, while the stage is at rest.

        Raises:
            RigError: The firmware refuses the setting, is silent or gone, or was reset.
        """
        if self._store(f"${number}={value:g}") and self.settings().get(number) != value:
            raise RigError(f"{self.name}: did not store ${number}={value:g}; {self.disturbance or 'set it by hand'}")

    def mark(self, numbers: Iterable[int]) -> None:
        """Store in the firmware which settings have to be switched on again, after the text of its user (``$I=``).

        A build without this command stores nothing.

        Args:
            numbers: The settings; none to remove the mark.

        Raises:
            RigError: The firmware is silent or gone, or was reset.
        """
        mark = ",".join(str(number) for number in numbers)
        with suppress(RigError):
            self._store(f"$I={self._text}{MARK if mark else ''}{mark}")

    def _store(self, command: str) -> bool:
        """Send a command that may be repeated, until it is confirmed. Return whether it was repeated."""
        refusal = ""
        for attempt in range(READINGS):
            self.line.write(f"\n{command}\n".encode("ascii"))
            until = self.line.now_s() + self.timeout_s
            # The empty line is answered by an ok of its own.
            confirmations, answered = 0, False
            while (left := until - self.line.now_s()) > 0.0:
                answer = self.next(min(left, ACCEPTANCE_S) if answered else left)
                if answer is None and answered:
                    # A disturbance has changed the command or one of the confirmations.
                    break
                if answer is None:
                    raise self.silence()
                answered = True
                confirmations += answer == "ok"
                if confirmations == 2:
                    return attempt > 0
                if isinstance(answer, str) and replies.error(answer) is not None:
                    refusal = answer
                    break
        why = self.disturbance or (f"it sent {refusal!r}" if refusal else "it did not confirm it")
        raise RigError(f"{self.name}: did not accept {command}; {why}")

    @property
    def disturbance(self) -> str:
        """The line that could not be read a short time ago, for error messages; empty if there was none."""
        if self.line.now_s() - self._unreadable_s > 2.0 * self.timeout_s:
            return ""
        return f"the line is disturbed: {self._unreadable!r} was received; check the cable"

    def request(self) -> None:
        """Send a status request, without waiting for the report.

        Raises:
            DeviceLostError: The port is gone.
        """
        if not self._pending:
            self._asked_s = self.line.now_s()
        self._pending += 1
        self.line.write(ASK)

    def status(self) -> Status:
        """Request a report and return the first one. Reports of earlier requests are discarded.

        Raises:
            RigError: The firmware is silent or gone, was reset, raised an alarm, or reports work coordinates.
        """
        until = self.line.now_s() + self.answer_s
        while self._pending and (left := until - self.line.now_s()) > 0.0:
            self.next(left)
        self._pending = 0
        until = self.line.now_s() + self.timeout_s
        while self.line.now_s() < until:
            self.request()
            again = self.line.now_s() + self.answer_s
            while (left := again - self.line.now_s()) > 0.0:
                answer = self.next(left)
                if isinstance(answer, Status):
                    if answer.machine_mm is None:
                        raise RigError(f"{self.name}: reports work coordinates; send it $10=1")
                    return answer
        raise self.silence()

    def reset(self) -> None:
        """Send Ctrl-X, and wait for the banner and for the end of earlier lines.

        Raises:
            NoAnswerError: No banner came.
            DeviceLostError: The port is gone.
        """
        self._pending = 0
        for _ in range(4):
            self.line.forget()
            self.line.write(RESET)
            for line in self.line.lines(max(RESET_S, self.answer_s)):
                if replies.is_banner(line):
                    self._after_banner = True
                    # A late ok and the hint to unlock may follow. The wait is bounded in case the device never pauses.
                    for _ in self.line.lines(0.5, quiet_s=0.05):
                        pass
                    return
        raise NoAnswerError(f"{self.name}: does not answer a reset")

    def silence(self) -> RigError:
        """Return the error for a silence. A reset shows its kind: after some alarms only Ctrl-X is answered."""
        self.lost = "the firmware did not answer"
        disturbance = self.disturbance
        try:
            self.reset()
        except NoAnswerError:
            return NoAnswerError(
                f"{self.name}: no answer within {self.timeout_s:g} s; {disturbance or 'check its power'}"
            )
        self.lost = "the firmware did not answer and had to be reset"
        why = disturbance or "an alarm had stopped it, or it was too slow; find the cause"
        return AlarmError(
            f"{self.name}: did not answer within {self.timeout_s:g} s, but after a reset; {why}, then home the stage"
        )

    def refused(self, answer: str, command: str) -> None:
        """Raise an error if a line refuses a command.

        Raises:
            OutOfRangeError: The target is beyond the machine's travel.
            AlarmError: The firmware is locked.
            RigError: The line is another error.
        """
        number = replies.error(answer)
        if number is None:
            return
        message = f"{self.name}: error:{number} ({replies.ERRORS.get(number, 'see its manual')}) after {command}"
        if number == 15:
            raise OutOfRangeError(message)
        if number == 9:
            self.lost = "an alarm has locked the firmware"
            raise AlarmError(message)
        raise RigError(message)

    def not_locked(self, report: Status) -> None:
        """Raise an error if a report's state does not allow motion.

        Raises:
            AlarmError: The state is alarm, sleep, an open door, or check mode.
        """
        if report.state in ("Alarm", "Sleep"):
            self.lost = self.lost or f"the firmware is in state {report.state}"
            raise AlarmError(f"{self.name}: is locked (state {report.state}); find the cause, then home the stage")
        if report.state in ("Door", "Check"):
            raise AlarmError(f"{self.name}: is in state {report.state} and does not move")
