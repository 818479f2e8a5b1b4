"""A host for the tests of virtual firmware that exchanges bytes at given times, without any port."""

from __future__ import annotations

from typing import Any

from tacbench_cad.extensions.virtual_rig.board import Board
from tacbench_cad.extensions.virtual_rig.faults import Fault
from tacbench_cad.extensions.virtual_rig.setup import Setup

Point = tuple[float, float, float]


class Host:
    """A host that drives a board in simulated time.

    Args:
        kind: The firmware.
        wake: Whether the board boots first; its message is kept in ``greeting``.
        options: The options of :class:`Setup`.
    """

    def __init__(self, kind: str, *, wake: bool = True, **options: Any) -> None:
        self.board: Board = Setup(kind=kind, **options).board()
        self.now_s = 0.0
        self.greeting = self.wait(3.0) if wake else b""

    def send(self, data: bytes) -> None:
        self.board.write(data, self.now_s)

    def wait(self, seconds: float) -> bytes:
        """Return the bytes that arrive within the given time."""
        self.now_s += seconds
        return self.board.read(self.now_s)

    def ask(self, data: bytes, seconds: float = 0.1) -> bytes:
        self.send(data)
        return self.wait(seconds)

    def until(self, mark: bytes, timeout_s: float = 120.0, step_s: float = 0.01) -> bytes:
        """Return the bytes that arrive until they contain ``mark``.

        Raises:
            AssertionError: ``mark`` does not arrive in time.
        """
        received = b""
        end = self.now_s + timeout_s
        while mark not in received:
            assert self.now_s < end, (mark, received)
            received += self.wait(step_s)
        return received

    @property
    def true(self) -> Point:
        return self.board.firmware.carriage.true(self.board.now_s)

    @property
    def reported(self) -> Point:
        return self.board.firmware.reported

    def inject(self, kind: str, **values: Any) -> None:
        self.board.inject(Fault(kind=kind, **values), self.now_s)


def homed(kind: str, **options: Any) -> Host:
    """Return a host whose board is homed and idle."""
    host = Host(kind, **options)
    host.send({"grbl": b"$H\n", "grblhal": b"$H\n", "marlin": b"G28\n", "arduino": b"RESET\n"}[kind])
    host.until(b"done" if kind == "arduino" else b"ok")
    host.wait(0.5)
    return host


def near(a: Point, b: Point, within: float = 0.01) -> bool:
    return all(abs(x - y) <= within for x, y in zip(a, b, strict=True))
