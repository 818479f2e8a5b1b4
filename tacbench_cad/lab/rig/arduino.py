"""A stage controlled by the paper's own Arduino firmware.

The following is known about the firmware. It uses 921600 baud. It accepts the lines ``RESET`` (home),
``MOVE,x,y,z,step``, ``SHOW`` and others, and ends each reply with a line that contains ``done``. Its units are motor
steps. This driver takes x, y and z as steps counted from the position where ``RESET`` ended, and ``step`` as the pause
between two steps in microseconds. The firmware has no version, checksums, alarms or limits, and it reads nothing while
it moves.

Frame: the coordinates are steps divided by ``steps_per_mm`` (negative for an axis that counts in the other direction),
with 0 where ``RESET`` ended. The driver never sends ``ZERO``, so a taught origin stays valid after the power was off,
once the stage has been homed again.

Proof of a move: if ``SHOW`` answers with three whole numbers, they are the position, and a move is finished when they
equal the target. Otherwise ``done`` is the only answer: the driver trusts it, ``position()`` returns the target of the
last move, and a reset between two moves stays unnoticed. The identity states which of the two cases applies. In both
cases the firmware only counts steps and cannot detect lost steps. A reset sends no message; it appears as a missing
``done`` or as counters at 0.

A garbled target may drive an axis against its end. The counters show this, and the position is then unknown until the
stage is homed. Homing finds the same zero again only if ``RESET`` first moves off a closed end stop and then returns
to it. Test this before the first run: push the switched-off stage against its ends, home it, and check its position.

``stop()`` cannot reach the firmware while it does not read. The driver therefore sends moves in pieces of about half a
second and sends no further piece after a stop. For emergencies, wire a switch into the motors' supply.
"""

from __future__ import annotations

import contextlib
import math
import re
from typing import Unpack

from tacbench_cad.lab.rig.errors import AlarmError, NoAnswerError, PositionLostError, RigError
from tacbench_cad.lab.rig.serial_stage import Link, SerialOptions, SerialStage, confirmed
from tacbench_cad.lab.study.spec import Point
from tacbench_cad.util.errors import InputError

#: The baud rate of the port.
BAUD = 921600
#: The longest wait for the first answer, in s. Opening a port may reset the board and start a boot loader.
GREETING_S = 8.0
#: The pause before an unanswered question is repeated while the port is opened, in s.
ATTEMPT_S = 0.5
#: The longest piece of a move, in s of rig time. A stop may take this long.
PIECE_S = 0.5
#: The allowed duration of a move, as a multiple of the sum of its pauses between steps.
SLOWNESS = 3.0
#: The number of attempts for a question or a command. The line or its answer may be garbled.
ATTEMPTS = 3

Steps = tuple[int, int, int]


def counters(line: str) -> Steps | None:
    """Return the three whole numbers of an answer to ``SHOW``; None if the line does not contain exactly three."""
    numbers = re.findall(r"(?<![\w.])-?\d{1,10}(?![\w.])", line, re.ASCII)
    return (int(numbers[0]), int(numbers[1]), int(numbers[2])) if len(numbers) == 3 else None


def is_done(line: str) -> bool:
    """Return whether a line ends a reply."""
    return "done" in line.lower()


class ArduinoStage(SerialStage[Link]):
    """A three-axis stage with the paper's firmware. See :class:`tacbench_cad.lab.rig.stage.Stage`.

    Args:
        port: The path, name or pyserial URL of the port.
        steps_per_mm: Motor steps per mm of x, y, z; negative if the steps decrease while the coordinate increases.
        options: See :class:`~tacbench_cad.lab.rig.serial_stage.SerialOptions`. The timeout is added to the duration of
            a move.

    Raises:
        InputError: One of ``steps_per_mm`` is 0, or the port cannot be opened.
        NoAnswerError: The device does not answer.
        RigError: The device answers, but it is not the paper's firmware.
    """

    def __init__(self, port: str, *, steps_per_mm: Point, **options: Unpack[SerialOptions]) -> None:
        if not all(steps_per_mm):
            raise InputError("[stage] options steps_per_mm", list(steps_per_mm), "must be three numbers other than 0")
        self._steps_per_mm = steps_per_mm
        super().__init__(port, Link, (BAUD,), options)
        self._link.lost = "the stage was not homed"
        self._stopping = False
        self._counters: Steps = (0, 0, 0)
        with self._opening():
            counts = self._greet()
            self._reports_steps = counts is not None
            if counts is not None and any(counts):
                # The board still has its counters, so nothing has reset it since it moved.
                self._link.lost, self._counters = "", counts
            trust = "SHOW reports the steps" if self._reports_steps else "SHOW reports no position, so done is trusted"
            self.identity = f"arduino: the paper's firmware (no version; {trust}) at {port}"

    def home(self) -> None:
        """Send ``RESET``, which finds the end stops. Afterwards the position is known.

        The firmware decides which axis moves first; make sure that z moves upwards first.

        Raises:
            AlarmError: Homing was stopped on request. The carriage still completes it.
            RigError: The device is gone or silent.
        """
        self._stopping = False
        self._link.lost = "homing was not completed"
        self._reset()
        if self._stopping:
            raise AlarmError(f"{self._link.name}: homing was stopped on request")
        self._counters = self._read_counters() if self._reports_steps else (0, 0, 0)
        self._link.lost = ""

    def move(self, target_mm: Point, speed_mm_s: float) -> Point:
        """Move to a position in a straight line, rounded to whole steps.

        Raises:
            PositionLostError: The board was reset or never homed; home it first.
            RigError: The move was stopped on request, or the counters differ from the target.
            NoAnswerError: The device is silent. The position is then unknown.
            DeviceLostError: The device is unplugged.
        """
        self._stopping = False
        start = self.position()
        pieces = max(1, math.ceil(math.dist(start, target_mm) / (speed_mm_s * PIECE_S)))
        for piece in range(1, pieces + 1):
            fraction = piece / pieces
            x, y, z = (a + fraction * (b - a) for a, b in zip(start, target_mm, strict=True))
            self._step_to(self._steps((x, y, z)), math.dist(start, target_mm) / speed_mm_s / pieces)
            if self._stopping:
                raise RigError(f"{self._link.name}: the move was stopped on request")
            self._report(self._mm(self._counters))
        return self._mm(self._counters)

    def position(self) -> Point:
        """Return the counted position in mm, or the target of the last move if ``SHOW`` reports no position.

        Raises:
            PositionLostError: The position is unknown: the board was reset or never homed.
            RigError: The device is gone or silent.
        """
        self._link.require_known()
        if self._reports_steps:
            at = self._confirmed(self._counters)
            if not any(at) and any(self._counters):
                raise self._link.reset_noticed("reports 0, 0, 0 although it should be elsewhere")
            self._counters = at
        return self._mm(self._counters)

    def stop(self) -> None:
        """End the motion after the current piece. Signal handlers may call this method. Never raises."""
        self._stopping = True

    def _steps(self, at: Point) -> Steps:
        x, y, z = (round(a * per_mm) for a, per_mm in zip(at, self._steps_per_mm, strict=True))
        return (x, y, z)

    def _mm(self, steps: Steps) -> Point:
        x, y, z = (count / per_mm for count, per_mm in zip(steps, self._steps_per_mm, strict=True))
        return (x, y, z)

    def _step_to(self, steps: Steps, seconds: float) -> None:
        """Send one piece of a move and check its result."""
        longest = max(abs(a - b) for a, b in zip(steps, self._counters, strict=True))
        if longest == 0:
            return
        pause_us = max(1, round(1e6 * seconds / longest))
        command = f"MOVE,{steps[0]},{steps[1]},{steps[2]},{pause_us}"
        for attempt in range(ATTEMPTS):
            try:
                self._ask(command, self._timeout_s + SLOWNESS * seconds)
                break
            except NoAnswerError:
                # Either the command or its "done" may have been lost. The counters show which.
                self._link.lost = "a move was not acknowledged"
                at = self._confirmed(steps) if self._reports_steps else None
                if at == steps:
                    break
                if at != self._counters or not any(at) or attempt == ATTEMPTS - 1:
                    raise
        self._link.lost = ""
        if self._reports_steps:
            at = self._confirmed(steps)
            if at != steps:
                # The axis may have hit an end of its travel after a garbled target, and lost steps.
                self._link.lost = (
                    "" if at == self._counters else "a move went to a wrong position (garbled line or reset)"
                )
                kind = RigError if any(at) else PositionLostError
                raise kind(f"{self._link.name}: reports {at} steps instead of {steps}")
        self._counters = steps

    def _confirmed(self, expected: Steps) -> Steps:
        """Return the counters. Unexpected values must arrive twice, since a single answer may be damaged.

        Raises:
            RigError: Each answer has other values.
            RigError: The device is gone or silent.
        """
        at = confirmed(self._read_counters, lambda at: at == expected)
        if at is None:
            raise RigError(f"{self._link.name}: reports other steps each time although it does not move")
        return at

    def _read_counters(self) -> Steps:
        silent: NoAnswerError | None = None
        for _ in range(ATTEMPTS):
            try:
                lines = self._ask("SHOW", self._timeout_s)
            except NoAnswerError as error:
                silent = error
                continue
            for line in lines:
                steps = counters(line)
                if steps is not None:
                    return steps
        raise silent or RigError(f"{self._link.name}: SHOW no longer reports a position")

    def _reset(self) -> None:
        """Send ``RESET`` until the firmware understands it.

        A garbled ``RESET`` gets no answer. The driver then sends ``SHOW``. While homing, the firmware reads nothing and
        therefore answers ``SHOW`` after the ``done`` of ``RESET``; otherwise it answers at once.
        """
        for _ in range(ATTEMPTS if self._reports_steps else 0):
            try:
                self._ask("RESET", min(self._timeout_s, self._home_timeout_s))
                return
            except NoAnswerError:
                self._line.write(b"SHOW\n")
                if not any(counters(line) for line in self._until_done("RESET", self._home_timeout_s)):
                    with contextlib.suppress(NoAnswerError):
                        self._until_done("SHOW", self._timeout_s)
                    return
        self._ask("RESET", self._home_timeout_s)

    def _ask(self, command: str, timeout_s: float) -> list[str]:
        """Send a line and return the lines of the reply, up to ``done``."""
        self._line.forget()
        self._line.write(command.encode("ascii") + b"\n")
        return self._until_done(command, timeout_s)

    def _until_done(self, command: str, timeout_s: float) -> list[str]:
        lines: list[str] = []
        for line in self._line.lines(timeout_s):
            lines.append(line)
            if is_done(line):
                return lines
        raise NoAnswerError(f"{self._link.name}: sent no done for {command} within {timeout_s:.1f} s")

    def _greet(self) -> Steps | None:
        """Wait until ``SHOW`` is answered. Return the counters, or None if the answer does not contain them."""
        until = self._line.now_s() + max(GREETING_S, self._timeout_s)
        while self._line.now_s() < until:
            try:
                lines = self._ask("\nSHOW", ATTEMPT_S)
            except NoAnswerError:
                continue
            # Lines that were sent while the board started may be answered late.
            for _ in self._line.lines(0.5, quiet_s=0.1):
                pass
            reply = " ".join(lines)
            if "echo:" in reply or "error:" in reply.lower():
                raise RigError(f"{self._link.name}: is not the paper's firmware; it sent {reply[:60]!r}")
            return next((steps for line in lines if (steps := counters(line))), None)
        raise NoAnswerError(
            f"{self._link.name}: does not answer SHOW with done. Check power, cable, baud rate and driver"
        )
