"""Marlin without its commands: line numbers, queue, planner, busy lines, quick stop, halt and automatic reports."""

from __future__ import annotations

import math
import re
from abc import abstractmethod
from collections import deque
from dataclasses import dataclass, replace
from functools import reduce
from operator import xor

from tacbench_cad.extensions.virtual_rig.base import Firmware, Program, earliest
from tacbench_cad.extensions.virtual_rig.machine import VirtualCarriage
from tacbench_cad.lab.study import Point, minus, plus

#: The reported version.
VERSION = "2.1.2.7"
#: The number of lines in the queue, and the largest number of characters in a line.
_QUEUE_LINES = 4
_LINE_SIGNS = 95
#: The interval of busy messages during a long command, in s.
_BUSY_S = 2.0
#: The time after a quick stop during which the planner refuses everything, in s.
_QUICK_STOP_S = 1.0
_LINE_S = 0.0005
#: The number of blocks in the planner at which the first one starts at once.
_BLOCKS_TO_START = 3
#: Two blocks whose directions agree this well (cosine of the angle) are run without a stop between them.
_STRAIGHT = 0.9999
_EMERGENCY = re.compile(rb"\s*(?:N\d+\s*)?(M410|M112)(?!\d)")


@dataclass(frozen=True)
class _Block:
    """A planned move that the motors have not begun."""

    start: Point
    end: Point
    speed_mm_s: float
    acceleration_mm_s2: float

    def continues(self, before: _Block) -> bool:
        """Return whether the move continues another one in the same direction at the same speed."""
        one, other = minus(before.end, before.start), minus(self.end, self.start)
        along = sum(a * b for a, b in zip(one, other, strict=True))
        return self.speed_mm_s == before.speed_mm_s and along >= _STRAIGHT * math.hypot(*one) * math.hypot(*other)


class MarlinCore(Firmware):
    """Marlin without the interpretation of its commands.

    Args:
        carriage: The carriage. After ``G28``, x and y are 0 at their end stops and z is at its upper end.
        boot_s: The time from a reset to the first line, in s.
        emergency_parser: Whether the build handles ``M410`` and ``M112`` before they are queued.
        baud: The baud rate of the build; 115200 is common too.
        min_steps: The number of motor steps below which a move is withheld until further moves add up to more
            (``MIN_STEPS_PER_SEGMENT``).
        first_move_s: The time in s for which the first move waits for others, unless two more follow it
            (``BLOCK_DELAY_FOR_1ST_MOVE``).
        idle_s: The time in s without motion after which the motors are switched off; ``M84 S`` changes it, and 0 means
            never (``DEFAULT_STEPPER_INACTIVE_TIME``).
        idle_drop_mm: The distance by which z drops when its motor is switched off.
        z_steps_per_mm: The motor steps of z per mm.
    """

    baud = 250000

    def __init__(
        self,
        carriage: VirtualCarriage,
        *,
        boot_s: float = 1.5,
        emergency_parser: bool = False,
        baud: int = 250000,
        min_steps: int = 6,
        first_move_s: float = 0.1,
        idle_s: float = 120.0,
        idle_drop_mm: float = 0.3,
        z_steps_per_mm: float = 400.0,
    ) -> None:
        self.baud = baud
        self.emergency_parser = emergency_parser
        self.min_steps = min_steps
        self.first_move_s = first_move_s
        self.default_idle_s, self.idle_drop_mm = idle_s, idle_drop_mm
        *xy, z = carriage.axes
        carriage.axes = (*xy, replace(z, steps_per_mm=z_steps_per_mm))
        super().__init__(carriage, boot_s=boot_s)

    # Reported state

    @property
    def reported(self) -> Point:
        """The planned position, as in ``M114``."""
        return self._planned

    def _alarm(self) -> None:
        """Halt after a failed check of the machine."""
        self._kill()

    # Memory

    def _forget(self) -> None:
        self._planned: Point = (0.0, 0.0, 0.0)
        self._shift: Point = (0.0, 0.0, 0.0)
        self._homed = [False, False, False]
        self._absolute = self._soft_stops = True
        self._feed_mm_s = 25.0
        self._last_n = 0
        self._line = bytearray()
        self._commands: deque[str] = deque()
        self._quiet_until_s: float | None = None
        self._quick_stopped = False
        self._again = False
        self._busy_s: float | None = None
        self._auto_s: float | None = None
        self._auto_every_s = 0.0
        self._killed = False
        self._seen = bytearray()
        self._blocks: list[_Block] = []
        self._start_s: float | None = None
        self._idle_s = self.default_idle_s
        self._off_s: float | None = None

    # The receive interrupt and the reader of lines

    def _arrived(self, byte: int) -> None:
        if self._killed:
            return
        if self.emergency_parser:
            self._watch(byte)
        super()._arrived(byte)
        self._read_lines()

    def _watch(self, byte: int) -> None:
        """Run the emergency parser: it executes its commands at the end of their line, before anything is queued."""
        if byte not in b"\r\n":
            self._seen = (self._seen + bytes((byte,)))[-_LINE_SIGNS:]
            return
        match = _EMERGENCY.match(bytes(self._seen))
        self._seen = bytearray()
        if match:
            self._rush(match.group(1).decode())

    def _read_lines(self) -> None:
        """Move lines from the receive buffer into the queue while it has room."""
        while self._rx and len(self._commands) < _QUEUE_LINES and not self._killed:
            byte = self._rx.pop(0)
            if byte not in b"\r\n":
                if len(self._line) < _LINE_SIGNS:
                    self._line.append(byte)
                continue
            line, self._line = bytes(self._line).decode("latin-1").split(";")[0].strip(), bytearray()
            if line:
                self._accept(line)

    def _accept(self, line: str) -> None:
        """Check number and checksum, and queue the command."""
        if line.startswith("N"):
            body, star, checksum = line.rpartition("*")
            numbered = body if star else line
            number = _leading_number(numbered[1:])
            if "M110" in numbered:
                given = numbered.rpartition("N")
                number = _leading_number(given[2])
            elif number != self._last_n + 1:
                # The line belongs to a repetition that was sent too late. Marlin ignores it without an answer.
                if number not in (self._last_n - 1, self._last_n):
                    self._refuse("Line Number is not Last Line Number+1")
                return
            if not star:
                self._refuse("No Checksum with line number")
                return
            if reduce(xor, body.encode("latin-1"), 0) != _leading_number(checksum):
                self._refuse("checksum mismatch")
                return
            self._last_n = number
            line = numbered[1:].lstrip("0123456789- ")
        word = line.upper().split(" ")[0]
        if word == "M410" and not self.emergency_parser:
            self._rush(word)
            self._commands.append(line)
        elif word == "M112" and not self.emergency_parser:
            self._rush(word)
        else:
            if self._quiet_until_s is not None and self._quick_stopped:
                self._again = True
            self._commands.append(line)

    def _refuse(self, reason: str) -> None:
        self._send(f"Error:{reason}, Last Line: {self._last_n}\n")
        self._rx.clear()
        self._line.clear()
        self._send(f"Resend: {self._last_n + 1}\nok\n")

    def _rush(self, word: str) -> None:
        """Execute commands that do not wait for the queue."""
        if word == "M112":
            self._kill()
            return
        self._halt_motion()
        self._planned = self._logical(self.carriage.counted(self.now_s))
        if not self.emergency_parser:
            self._quiet_until_s = self.now_s + _QUICK_STOP_S
            self._quick_stopped, self._again = True, False
            self._busy_s = None

    def _kill(self) -> None:
        self._halt_motion()
        self._killed = True
        self._busy_s = self._auto_s = self._off_s = None
        self._send("Error:Printer halted. kill() called!\n")
        self._run(iter(()))

    # Events

    def _timer_s(self) -> float | None:
        return earliest(self._busy_s, self._auto_s, self._quiet_until_s, self._start_s, self._off_s)

    def _timers(self) -> None:
        if self._start_s is not None and self.now_s >= self._start_s:
            self._start_blocks()
        if self._off_s is not None and self.now_s >= self._off_s:
            self._switch_off()
        if self._quiet_until_s is not None and self.now_s >= self._quiet_until_s:
            self._quiet_until_s = None
        if self._busy_s is not None and self.now_s >= self._busy_s:
            self._busy_s = self.now_s + _BUSY_S
            self._send("echo:busy: processing\n")
        if self._auto_s is not None and self.now_s >= self._auto_s:
            self._auto_s = self.now_s + self._auto_every_s
            if self._quiet_until_s is None:
                self._report()

    # The program

    def _main(self) -> Program:
        self._send(
            "start\n"
            f"Marlin {VERSION}\n"
            f"echo: Last Updated: 2026-01-01 | Author: (simulated)\n"
            "echo: Compiled: Jan  1 2026\n"
            "echo: Free Memory: 3893  PlannerBufferBytes: 1200\n"
            "echo:Hardcoded Default Settings Loaded\n"
        )
        while True:
            yield lambda: bool(self._commands) and self._quiet_until_s is None
            # The command keeps its place in the queue until it is finished, as in the original.
            line = self._commands[0]
            yield _LINE_S
            yield from self._command(line)
            self._commands.popleft()
            self._read_lines()

    def _command(self, line: str) -> Program:
        self._busy_s = self.now_s + _BUSY_S
        word = line.upper().split(" ")[0]
        if word == "M410" and not self.emergency_parser:
            yield from self._acknowledge_stop()
            return
        times = 2 if self._again else 1
        self._again = False
        for _ in range(times):
            yield from self._do(line)
            yield lambda: self._quiet_until_s is None
            self._busy_s = None
            self._send("ok\n")

    def _acknowledge_stop(self) -> Program:
        """End an M410: send its ``ok``, unless another command came during the silence and took its place."""
        self._busy_s = None
        self._quick_stopped = False
        if not self._again:
            self._send("ok\n")
        yield 0.0

    @abstractmethod
    def _do(self, line: str) -> Program:
        """Execute a command. Its ``ok`` follows."""

    # The planner

    @property
    def _planned_native(self) -> Point:
        """The position after the last move that was not withheld."""
        return self._blocks[-1].end if self._blocks else self.carriage.planned

    def _plan(self, target: Point, speed_mm_s: float, acceleration_mm_s2: float) -> None:
        """Queue a move to a target in native coordinates, unless it is withheld."""
        start = self._planned_native
        steps = max(
            abs(round(b * axis.steps_per_mm) - round(a * axis.steps_per_mm))
            for a, b, axis in zip(start, target, self.carriage.axes, strict=True)
        )
        if steps < max(self.min_steps, 1):
            return
        self._blocks.append(_Block(start, target, speed_mm_s, acceleration_mm_s2))
        self._off_s = None
        if self.carriage.moving or len(self._blocks) >= _BLOCKS_TO_START:
            self._start_blocks()
        elif self._start_s is None:
            self._start_s = self.now_s + self.first_move_s

    def _start_blocks(self) -> None:
        """Pass the planned moves to the motors. Moves that continue each other are joined, as by the look-ahead."""
        blocks, self._blocks, self._start_s = self._blocks, [], None
        while blocks:
            block = blocks.pop(0)
            while blocks and blocks[0].continues(block):
                block = replace(block, end=blocks.pop(0).end)
            self.carriage.go(block.end, block.speed_mm_s, block.acceleration_mm_s2, self.now_s)

    def _halt_motion(self) -> None:
        """Stop without deceleration, and forget the planned moves."""
        self._blocks, self._start_s = [], None
        self.carriage.halt(self.now_s)
        self._stopped()

    def _at_rest(self) -> bool:
        return not self.carriage.moving and not self._blocks

    def _stopped(self) -> None:
        """Begin the time after which the idle motors are switched off."""
        self._off_s = self.now_s + self._idle_s if self._idle_s > 0.0 else None

    def _switch_off(self) -> None:
        """Switch the motors off. The weight of the tool turns the screw of z."""
        self._off_s = None
        self.motors_off += 1
        self.carriage.slip(2, -self.idle_drop_mm, self.now_s)

    # The plan

    def _native(self, logical: Point) -> Point:
        return plus(logical, self._shift)

    def _logical(self, native: Point) -> Point:
        return minus(native, self._shift)

    def _report(self) -> None:
        """Send the planned position, and the steps of the planner without withheld moves."""
        x, y, z = (value + 0.0 for value in self._planned)
        motors = zip(self._planned_native, self.carriage.axes, strict=True)
        steps = [round(value * axis.steps_per_mm) for value, axis in motors]
        self._send(f"X:{x:.2f} Y:{y:.2f} Z:{z:.2f} E:0.00 Count X:{steps[0]} Y:{steps[1]} Z:{steps[2]}\n")


def _leading_number(text: str) -> int:
    """Return the whole number at the start of a text, as ``strtol`` does; 0 if there is none."""
    number = re.match(r"\s*([+-]?\d{1,18})", text, re.ASCII)
    return int(number[1]) if number else 0
