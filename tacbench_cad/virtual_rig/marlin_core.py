"""Marlin without its commands: line numbers, the queue, busy lines, the quick stop, halting and automatic reports."""

from __future__ import annotations

import re
from abc import abstractmethod
from collections import deque
from functools import reduce
from operator import xor

from tacbench_cad.lab.study.spec import Point, minus, plus
from tacbench_cad.virtual_rig.base import Firmware, Program, earliest
from tacbench_cad.virtual_rig.machine import Carriage

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
_EMERGENCY = re.compile(rb"\s*(?:N\d+\s*)?(M410|M112)(?!\d)")


class MarlinCore(Firmware):
    """Marlin without the interpretation of its commands.

    Args:
        carriage: The carriage. After ``G28``, x and y are 0 at their end stops and z is at its upper end.
        boot_s: The time from a reset to the first line, in s.
        emergency_parser: Whether the build handles ``M410`` and ``M112`` before they are queued.
        m114_realtime: Whether the build answers ``M114 R`` with the true step count.
        baud: The baud rate of the build; 115200 is common too.
    """

    baud = 250000

    def __init__(
        self,
        carriage: Carriage,
        *,
        boot_s: float = 1.5,
        emergency_parser: bool = False,
        m114_realtime: bool = False,
        baud: int = 250000,
    ) -> None:
        self.baud = baud
        self.emergency_parser = emergency_parser
        self.m114_realtime = m114_realtime
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
        self._absolute = True
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
        self.carriage.halt(self.now_s)
        self._planned = self._logical(self.carriage.counted(self.now_s))
        if not self.emergency_parser:
            self._quiet_until_s = self.now_s + _QUICK_STOP_S
            self._quick_stopped, self._again = True, False
            self._busy_s = None

    def _kill(self) -> None:
        self.carriage.halt(self.now_s)
        self._killed = True
        self._busy_s = self._auto_s = None
        self._send("Error:Printer halted. kill() called!\n")
        self._run(iter(()))

    # Events

    def _timer_s(self) -> float | None:
        return earliest(self._busy_s, self._auto_s, self._quiet_until_s)

    def _timers(self) -> None:
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

    # The plan

    def _native(self, logical: Point) -> Point:
        return plus(logical, self._shift)

    def _logical(self, native: Point) -> Point:
        return minus(native, self._shift)

    def _report(self, native: Point | None = None) -> None:
        native = self._native(self._planned) if native is None else native
        x, y, z = (value + 0.0 for value in self._logical(native))
        steps = [round(value * axis.steps_per_mm) for value, axis in zip(native, self.carriage.axes, strict=True)]
        self._send(f"X:{x:.2f} Y:{y:.2f} Z:{z:.2f} E:0.00 Count X:{steps[0]} Y:{steps[1]} Z:{steps[2]}\n")


def _leading_number(text: str) -> int:
    """Return the whole number at the start of a text, as ``strtol`` does; 0 if there is none."""
    number = re.match(r"\s*([+-]?\d{1,18})", text, re.ASCII)
    return int(number[1]) if number else 0
