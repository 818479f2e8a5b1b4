"""Talking to GRBL 1.1 or grblHAL: greeting, questions, status reports, resets; alarms and silences by their names."""

from __future__ import annotations

import time

from tacbench_cad.lab.rig import grbl_replies as replies
from tacbench_cad.lab.rig.errors import AlarmError, NoAnswerError, OutOfRangeError, ProtocolError, RigError
from tacbench_cad.lab.rig.grbl_replies import Status
from tacbench_cad.lab.rig.greeting import Greeting
from tacbench_cad.lab.rig.serial_stage import Link
from tacbench_cad.lab.study.spec import Point, plus

#: A status report unanswered for so long is asked for again: two requests close together may earn one answer.
ANSWER_S = 0.3
#: Pause before the next report is asked for, while none had the work offset.
OFFSET_S = 0.01
#: Longest wait for the banner after Ctrl-X; half a second was seen.
RESET_S = 1.5
#: Longest wait for the first answer: the reset that opening a port causes, and a boot loader.
GREETING_S = 8.0
#: Pause before a question without an answer is asked again, while opening.
ATTEMPT_S = 1.0
#: Pause after a banner before the next question: more lines may follow it.
BANNER_S = 0.1
#: The real-time bytes that hold a motion, reset the controller and ask for its status.
HOLD, RESET, ASK = b"!", b"\x18", b"?"


class GrblLink(Link):
    """A line to GRBL; ``firmware`` reads ``GRBL 1.1h.20190825``."""

    _offset: Point | None = None

    def greet(self) -> None:
        """Wait for an answer that proves GRBL 1.1.

        There may be a reset and a banner, a reset whose boot loader swallows what is sent, or neither. After some
        alarms only Ctrl-X helps.

        Raises:
            NoAnswerError: Nothing answers.
            ProtocolError: Something else does.
        """
        greeting = Greeting(
            self.line, self.name, "GRBL 1.1", limit_s=max(GREETING_S, self.timeout_s), attempt_s=ATTEMPT_S
        )
        version, name = "", "GRBL"
        for line in greeting.lines(lambda attempt: self.line.write((RESET if attempt > 3 else b"") + b"\n$I\n")):
            if replies.is_banner(line):
                self.lost = "opening the port reset the firmware"
                greeting.listen(BANNER_S)
            if "HAL" in line.upper() and line[:1] in ("[", "G"):
                name = "grblHAL"
            version = version or replies.version(line) or ""
            greeting.answered = version != ""
            if line != "ok":
                greeting.heard = greeting.heard or line[:60]
            if "Marlin" in line or "Unknown command" in line:
                raise ProtocolError(f"{self.name}: is Marlin, not GRBL; it sent {line[:60]!r}")
        if not version.startswith("1.1"):
            raise ProtocolError(f"{self.name}: GRBL {version!r} is not version 1.1")
        self.firmware = f"{name} {version}"

    def next(self, timeout_s: float) -> Status | str | None:
        """The next report or line; None after a silence.

        Raises:
            AlarmError: It was an alarm.
            PositionLostError: It was the banner of a reset that nobody asked for.
            DeviceLostError: The port is gone.
        """
        line = self.line.read_line(timeout_s)
        if line is None:
            return None
        number = replies.alarm(line)
        if number is not None:
            self.lost = f"ALARM:{number} ({replies.ALARMS.get(number, 'see the list of its firmware')})"
            raise AlarmError(f"{self.name}: {self.lost}; look for the cause, then home")
        if replies.is_banner(line):
            raise self.reset_noticed("was reset")
        report = replies.status(line)
        if report is None:
            return line
        self._offset = report.offset_mm or self._offset
        return report

    def ask(self, command: str) -> list[str]:
        """Send a line at rest; the lines that came until its ``ok``.

        Raises:
            RigError: Refused, silent, lost, reset.
        """
        self.line.write(command.encode("ascii") + b"\n")
        lines: list[str] = []
        until = time.monotonic() + self.timeout_s
        while (left := until - time.monotonic()) > 0.0:
            got = self.next(left)
            if got == "ok":
                return lines
            if isinstance(got, str):
                self.refused(got, command)
                lines.append(got)
        raise self.silence()

    def status(self) -> Status:
        """A report with a position, asked for now.

        Raises:
            RigError: Silent, lost, reset, alarm.
        """
        until = time.monotonic() + self.timeout_s
        answered = False
        while time.monotonic() < until:
            self.line.write(ASK)
            again = time.monotonic() + ANSWER_S
            while (left := again - time.monotonic()) > 0.0:
                got = self.next(left)
                if isinstance(got, Status):
                    if self.machine(got) is not None:
                        return got
                    # Work coordinates: the offset comes with every tenth report or so.
                    answered = True
                    again = min(again, time.monotonic() + OFFSET_S)
        if answered:
            raise ProtocolError(f"{self.name}: reports work coordinates without their offset; send it $10=1")
        raise self.silence()

    def machine(self, report: Status) -> Point | None:
        """Machine position of a report; None while the work offset that it needs was not reported."""
        if report.machine_mm is not None:
            return report.machine_mm
        if report.work_mm is None or self._offset is None:
            return None
        return plus(report.work_mm, self._offset)

    def reset(self) -> None:
        """Ctrl-X, until the banner has come and what was on its way has gone.

        Raises:
            NoAnswerError: No banner came.
            DeviceLostError: The port is gone.
        """
        for _ in range(4):
            self.line.forget()
            self.line.write(RESET)
            for line in self.line.lines(RESET_S):
                if replies.is_banner(line):
                    # A late ok, the hint to unlock; bounded, should the device never be quiet.
                    for _ in self.line.lines(0.5, quiet_s=0.05):
                        pass
                    return
        raise NoAnswerError(f"{self.name}: does not answer a reset")

    def silence(self) -> RigError:
        """What a silence was, told by a reset: after some alarms the firmware answers nothing else."""
        self.lost = "it fell silent"
        try:
            self.reset()
        except NoAnswerError:
            return NoAnswerError(f"{self.name}: no answer within {self.timeout_s:g} s; is its power on?")
        self.lost = "it fell silent and had to be reset"
        return AlarmError(f"{self.name}: was silent until reset, as after an alarm; look for the cause, then home")

    def refused(self, got: str, command: str) -> None:
        """Raise if a line refuses a command.

        Raises:
            OutOfRangeError: Beyond the machine's travel.
            AlarmError: Locked.
            ProtocolError: Any other error.
        """
        number = replies.error(got)
        if number is None:
            return
        message = f"{self.name}: error:{number} ({replies.ERRORS.get(number, 'see its list')}) to {command}"
        if number == 15:
            raise OutOfRangeError(message)
        if number == 9:
            self.lost = "it is locked by an alarm"
            raise AlarmError(message)
        raise ProtocolError(message)

    def not_locked(self, report: Status) -> None:
        """Raise if a report's state forbids motion.

        Raises:
            AlarmError: Alarm, sleep, an open door, or check mode.
        """
        if report.state in ("Alarm", "Sleep"):
            self.lost = self.lost or f"it is in state {report.state}"
            raise AlarmError(f"{self.name}: is locked (state {report.state}); look for the cause, then home")
        if report.state in ("Door", "Check"):
            raise AlarmError(f"{self.name}: is in state {report.state} and does not move")
