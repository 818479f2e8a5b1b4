"""A stage run by the paper's own Arduino firmware.

What is known of it: 921600 baud; lines ``RESET`` (home), ``MOVE,x,y,z,step``, ``SHOW`` and others; a reply ends with
a line that holds ``done``; units are motor steps. Read as: x, y, z are steps counted from where ``RESET`` ended, and
``step`` is the pause between two steps in microseconds. It has neither version, checksums, alarms nor limits, and
reads nothing while it moves.

Frame: steps divided by ``steps_per_mm`` (negative where an axis counts the other way), 0 where ``RESET`` ended.
``ZERO`` is never sent, so a taught origin stays valid after the power was off, once the stage is homed again.

Trust: where ``SHOW`` answers with three whole numbers, they are the position, and a move is done when they are the
target's. Where it does not, ``done`` is all there is: a move is then believed on its word, ``position()`` is where
the last one went, and a reset between two moves goes unseen. The identity says which of the two it is. In both cases
steps are counted, not seen. A reset says nothing; it shows as a missing ``done`` or as counters at 0.

A garbled target may drive an axis against its end. The counters then tell, and the position is unknown until homed;
but only a ``RESET`` that leaves a closed end stop first, and comes back to it, finds the same zero again. Try that
before the first run: push the switched-off stage against its ends, home, and look where it stands.

``stop()`` cannot reach a firmware that is not reading. Moves are sent in pieces of about half a second, and none
follows after a stop; for an emergency wire a switch to the motors' supply.
"""

from __future__ import annotations

import contextlib
import math
import re
import time
from typing import Unpack

from tacbench_cad.lab.rig.errors import AlarmError, NoAnswerError, NotThereError, PositionLostError, ProtocolError
from tacbench_cad.lab.rig.serial_stage import Link, SerialOptions, SerialStage, confirmed
from tacbench_cad.lab.study.spec import Point
from tacbench_cad.util.errors import InputError

#: Speed of the line, in baud.
BAUD = 921600
#: Longest wait for the first answer: the reset that opening a port causes, and a boot loader.
GREETING_S = 8.0
#: Pause before a question without an answer is asked again, while opening.
ATTEMPT_S = 0.5
#: Longest piece of a move, in rig time: so long may a stop take.
PIECE_S = 0.5
#: How much a move may take in comparison with its steps' pauses.
SLOWNESS = 3.0
#: How often a question is asked, or an order given that nothing came of: either may be garbled, or its answer.
ATTEMPTS = 3

Steps = tuple[int, int, int]


def counters(line: str) -> Steps | None:
    """The three whole numbers of an answer to ``SHOW``; None if a line does not hold just three."""
    numbers = re.findall(r"(?<![\w.])-?\d{1,10}(?![\w.])", line, re.ASCII)
    return (int(numbers[0]), int(numbers[1]), int(numbers[2])) if len(numbers) == 3 else None


def is_done(line: str) -> bool:
    """Whether a line ends a reply."""
    return "done" in line.lower()


class ArduinoStage(SerialStage[Link]):
    """A three-axis stage behind the authors' firmware. See :class:`tacbench_cad.lab.rig.stage.Stage`.

    Args:
        port: Path, name or pyserial URL.
        steps_per_mm: Motor steps per mm of x, y, z; negative where steps count down as the coordinate grows.
        options: See :class:`~tacbench_cad.lab.rig.serial_stage.SerialOptions`; the timeout counts beyond what a move
            takes.

    Raises:
        InputError: ``steps_per_mm`` is missing or wrong, or the port cannot be opened.
        NoAnswerError: Nothing answers.
        ProtocolError: Something else answers.
    """

    def __init__(self, port: str, *, steps_per_mm: object = None, **options: Unpack[SerialOptions]) -> None:
        self._steps_per_mm = _checked(steps_per_mm)
        super().__init__(port, Link, (BAUD,), options)
        self._link.lost = "it was not homed"
        self._stopping = False
        self._at: Steps = (0, 0, 0)
        with self._opening():
            shown = self._greet()
            self._shows = shown is not None
            if shown is not None and any(shown):
                # Counters that survived: nothing has reset the board since it moved.
                self._link.lost, self._at = "", shown
            trust = "SHOW tells the steps" if self._shows else "SHOW tells no position, done is believed"
            self.identity = f"arduino: the paper's firmware (no version; {trust}) at {port}"

    def home(self) -> None:
        """``RESET``: find the end stops. Afterwards the position is known.

        Which axis goes first is the firmware's: see to it that z goes upwards first.

        Raises:
            AlarmError: Homing was stopped on request; it goes on to its end all the same.
            RigError: Lost or silent.
        """
        self._stopping = False
        self._link.lost = "homing was not finished"
        self._reset()
        if self._stopping:
            raise AlarmError(f"{self._link.name}: homing was stopped on request")
        self._at = self._shown() if self._shows else (0, 0, 0)
        self._link.lost = ""

    def move(self, target_mm: Point, speed_mm_s: float) -> Point:
        """Go there in a straight line, to the nearest whole steps.

        Raises:
            PositionLostError: The board was reset, or never homed; home first.
            NotThereError: Stopped on request, or the counters are not the target's.
            NoAnswerError: Silent; the position is unknown then.
            DeviceLostError: Unplugged.
        """
        self._stopping = False
        start = self.position()
        pieces = max(1, math.ceil(math.dist(start, target_mm) / (speed_mm_s * PIECE_S)))
        for piece in range(1, pieces + 1):
            fraction = piece / pieces
            x, y, z = (a + fraction * (b - a) for a, b in zip(start, target_mm, strict=True))
            self._step_to(self._steps((x, y, z)), math.dist(start, target_mm) / speed_mm_s / pieces)
            if self._stopping:
                raise NotThereError(f"{self._link.name}: was stopped on request on its way")
        return self._mm(self._at)

    def position(self) -> Point:
        """The counted position in mm; where ``SHOW`` tells none, where the last move went.

        Raises:
            PositionLostError: It is unknown: reset, or never homed.
            RigError: Lost or silent.
        """
        self._link.require_known()
        if self._shows:
            at = self._confirmed(self._at)
            if not any(at) and any(self._at):
                raise self._link.reset_noticed("counts 0, 0, 0 although it was left elsewhere")
            self._at = at
        return self._mm(self._at)

    def stop(self) -> None:
        """End the motion after the piece that is under way; from a signal handler too. Never raises."""
        self._stopping = True

    def _steps(self, at: Point) -> Steps:
        x, y, z = (round(a * per_mm) for a, per_mm in zip(at, self._steps_per_mm, strict=True))
        return (x, y, z)

    def _mm(self, steps: Steps) -> Point:
        x, y, z = (count / per_mm for count, per_mm in zip(steps, self._steps_per_mm, strict=True))
        return (x, y, z)

    def _step_to(self, steps: Steps, seconds: float) -> None:
        """One piece of a move, and the proof of it."""
        longest = max(abs(a - b) for a, b in zip(steps, self._at, strict=True))
        if longest == 0:
            return
        pause_us = max(1, round(1e6 * seconds / longest))
        command = f"MOVE,{steps[0]},{steps[1]},{steps[2]},{pause_us}"
        for attempt in range(ATTEMPTS):
            try:
                self._ask(command, self._timeout_s + SLOWNESS * seconds)
                break
            except NoAnswerError:
                # The done may have been lost on the way, or the order: the counters tell.
                self._link.lost = "a move was not acknowledged"
                at = self._confirmed(steps) if self._shows else None
                if at == steps:
                    break
                if at != self._at or not any(at) or attempt == ATTEMPTS - 1:
                    raise
        self._link.lost = ""
        if self._shows:
            at = self._confirmed(steps)
            if at != steps:
                # Without limits, a garbled target may have driven it against an end of its travel: steps were lost.
                self._link.lost = "" if at == self._at else "a move went elsewhere (garbled on its way, or a reset)"
                kind = NotThereError if any(at) else PositionLostError
                raise kind(f"{self._link.name}: counts {at} steps instead of {steps}")
        self._at = steps

    def _confirmed(self, expected: Steps) -> Steps:
        """The counters; others than expected are believed only when they were told twice: an answer may be damaged.

        Raises:
            ProtocolError: They are others each time.
            RigError: Lost or silent.
        """
        at = confirmed(self._shown, lambda at: at == expected)
        if at is None:
            raise ProtocolError(f"{self._link.name}: counts other steps each time it is asked, at rest")
        return at

    def _shown(self) -> Steps:
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
        raise silent or ProtocolError(f"{self._link.name}: SHOW no longer tells a position")

    def _reset(self) -> None:
        """Send ``RESET`` until it is understood.

        One that was garbled earns no answer. A ``SHOW`` sent after it tells: while homing, nothing is read, so that
        it is answered after the ``done`` of ``RESET``; otherwise it is answered at once.
        """
        for _ in range(ATTEMPTS if self._shows else 0):
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
        """Send a line; the lines that came until ``done``."""
        self._line.forget()
        self._line.write(command.encode("ascii") + b"\n")
        return self._until_done(command, timeout_s)

    def _until_done(self, command: str, timeout_s: float) -> list[str]:
        lines: list[str] = []
        for line in self._line.lines(timeout_s):
            lines.append(line)
            if is_done(line):
                return lines
        raise NoAnswerError(f"{self._link.name}: no done to {command} within {timeout_s:.1f} s")

    def _greet(self) -> Steps | None:
        """Wait until ``SHOW`` is answered; the counters, if it tells them."""
        until = time.monotonic() + max(GREETING_S, self._timeout_s)
        while time.monotonic() < until:
            try:
                lines = self._ask("\nSHOW", ATTEMPT_S)
            except NoAnswerError:
                continue
            # What was sent before it listened may be answered late.
            for _ in self._line.lines(0.5, quiet_s=0.1):
                pass
            heard = " ".join(lines)
            if "echo:" in heard or "error:" in heard.lower():
                raise ProtocolError(f"{self._link.name}: is not the paper's firmware; it sent {heard[:60]!r}")
            return next((steps for line in lines if (steps := counters(line))), None)
        raise NoAnswerError(f"{self._link.name}: nothing answers SHOW with done; power, cable, baud rate, driver?")


def _checked(steps_per_mm: object) -> Point:
    allowed = "must be three numbers, none of them 0: motor steps per mm of x, y, z, negative for a turned axis"
    if not isinstance(steps_per_mm, list | tuple) or len(steps_per_mm) != 3:
        raise InputError("[stage] options steps_per_mm", steps_per_mm, allowed)
    for number in steps_per_mm:
        if isinstance(number, bool) or not isinstance(number, int | float) or not math.isfinite(number) or number == 0:
            raise InputError("[stage] options steps_per_mm", number, allowed)
    x, y, z = map(float, steps_per_mm)
    return (x, y, z)
