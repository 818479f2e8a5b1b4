"""A minimal Marlin for the tests of the driver. It arrives at once; a test can change its answers."""

from __future__ import annotations

import functools
import operator
import re
from collections.abc import Callable, Iterable, Iterator

from helpers.scripted_peer import Peer

BANNER = b"start\nMarlin 2.1.2.7\necho: Last Updated: 2025-01-01 | Author: (none)\necho: Compiled: Jan  1 2025\n"
FIRMWARE = b"FIRMWARE_NAME:Marlin 2.1.2.7 (Jan  1 2025) SOURCE_CODE_URL:x PROTOCOL_VERSION:1.0 EXTRUDER_COUNT:1\n"
Handler = Callable[[bytes], Iterable[bytes | float]]


class ScriptedMarlin:
    """A Marlin that checks line numbers and checksums, is homed at 0, 0, 100 and arrives at once.

    Attributes:
        on: Functions whose bytes replace the usual answer to a command, by the command's first word.
        steps_per_mm: The steps per mm for the ``Count`` of ``M114``; None for a build that reports no counts.
        soft: The soft limit below which target coordinates are clamped; None for no limit.
    """

    def __init__(self) -> None:
        self.at = (10.0, 20.0, 30.0)
        self.steps_per_mm: tuple[float, float, float] | None = (80.0, 80.0, 400.0)
        self.soft: float | None = None
        self.top = True
        self.last = 0
        self.mute = False
        self.on: dict[bytes, Handler] = {}
        self.accepted: list[bytes] = []

    def peer(self) -> Peer:
        """Return a peer that serves this firmware over a port in memory."""
        return Peer(self.answer, realtime=b"")

    def reset(self) -> bytes:
        """Forget the position and the line number, and return the banner."""
        self.at, self.last = (0.0, 0.0, 0.0), 0
        return BANNER

    def report(self) -> bytes:
        """Return the answer to M114."""
        x, y, z = self.at
        line = f"X:{x:.2f} Y:{y:.2f} Z:{z:.2f} E:0.00"
        if self.steps_per_mm:
            a, b, c = (
                round(coordinate * per_mm) for coordinate, per_mm in zip(self.at, self.steps_per_mm, strict=True)
            )
            line += f" Count X:{a} Y:{b} Z:{c}"
        return line.encode() + b"\n"

    def answer(self, line: bytes) -> Iterator[bytes | float]:
        """Yield the answer to a line."""
        if self.mute or not line:
            return
        if line.startswith(b"N"):
            body, _, checksum = line.rpartition(b"*")
            number, _, command = body[1:].partition(b" ")
            if b"M110" in command:
                self.last = int(command.partition(b"N")[2])
                yield b"ok\n"
                return
            if int(number) in (self.last, self.last - 1):
                return
            if functools.reduce(operator.xor, body, 0) != int(checksum):
                yield self.refusal("checksum mismatch")
                return
            if int(number) != self.last + 1:
                yield self.refusal("Line Number is not Last Line Number+1")
                return
            self.last = int(number)
            line = command
        self.accepted.append(line)
        word = line.split(b" ")[0]
        yield from self.on[word](line) if word in self.on else self.obey(line)

    def refusal(self, why: str) -> bytes:
        """Return the three lines that answer a refused line."""
        return f"Error:{why}, Last Line: {self.last}\nResend: {self.last + 1}\nok\n".encode()

    def obey(self, command: bytes) -> Iterator[bytes | float]:
        """Yield the usual answer to a command."""
        word = command.split(b" ")[0]
        if word == b"G1":
            self.go(command)
        elif word == b"G28":
            axis = command[-1:]
            x, y, z = self.at
            self.at = (0.0 if axis == b"X" else x, 0.0 if axis == b"Y" else y, 100.0 if axis == b"Z" else z)
        elif word == b"M114":
            yield self.report()
        elif word == b"M115":
            yield FIRMWARE
        elif word == b"M119":
            yield (
                b"Reporting endstop status\nx_min: open\ny_min: open\nz_"
                + (b"max" if self.top else b"min")
                + b": open\n"
            )
        elif word == b"M92" and self.steps_per_mm:
            yield "echo:  M92 X{:.2f} Y{:.2f} Z{:.2f} E93.00\n".format(*self.steps_per_mm).encode()
        elif word == b"M203":
            yield b"echo:  M203 X300.00 Y300.00 Z10.00 E25.00\n"
        elif word not in (b"G90", b"G91", b"M84", b"M400", b"M113"):
            yield b'echo:Unknown command: "' + command + b'"\n'
        yield b"ok\n"

    def go(self, command: bytes) -> None:
        """Set the position to the target of a move."""
        position = dict(zip("XYZ", self.at, strict=True))
        for letter, value in re.findall(rb"([XYZ])(-?[\d.]+)", command):
            position[letter.decode()] = float(value) if self.soft is None else max(float(value), self.soft)
        self.at = (position["X"], position["Y"], position["Z"])
