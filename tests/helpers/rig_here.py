"""Virtual rigs in the process of the test, on a fake clock: nothing waits, and the same things happen on every run.

The fixture ``rig_time`` gives the clock. Ports and waits are those of the drivers; only the time, the process and the
pseudo-terminal are replaced.
"""

from __future__ import annotations

import errno
import heapq
import itertools
import math
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import pytest
import serial

from tacbench_cad.extensions import virtual_rig
from tacbench_cad.extensions.virtual_rig import drivers, server
from tacbench_cad.extensions.virtual_rig.setup import Setup
from tacbench_cad.lab.rig import line
from tacbench_cad.lab.rig.errors import DeviceLostError

T = TypeVar("T")
#: The time that one look at the clock takes, in s, so that a loop that only looks at the clock ends.
TICK_S = 1e-6
#: The shortest wait for bytes, in s: about what a port of the operating system takes.
SHORTEST_S = 1e-4
_PORTS: dict[str, MemoryPort] = {}
_RIGS: list[RigHere] = []
_CLOCKS: list[FakeTime] = []
#: The bytes that a port keeps until the host reads them, as a pseudo-terminal does. Others are lost.
KEPT_BYTES = 4096


class FakeTime:
    """A clock that goes on only while somebody waits. It stands for the module ``time`` in the drivers."""

    def __init__(self) -> None:
        self._now_s = 1000.0
        self._order = itertools.count()
        self._due: list[tuple[float, int, Callable[[], object]]] = []

    def monotonic(self) -> float:
        self._now_s += TICK_S
        return self._now_s

    def sleep(self, seconds: float) -> None:
        if threading.current_thread() is not threading.main_thread():
            time.sleep(seconds)  # the threads that watch over an interrupted run wait for the main thread
            return
        end_s = self._now_s + seconds
        while self._due and self._due[0][0] <= end_s:
            due_s, _, action = heapq.heappop(self._due)
            self._now_s = max(self._now_s, due_s)
            action()
        self._now_s = max(self._now_s, end_s)

    @property
    def next_s(self) -> float:
        """The time until the next function is called."""
        return self._due[0][0] - self._now_s if self._due else math.inf

    def after(self, seconds: float, action: Callable[[], object]) -> None:
        """Call a function as soon as somebody waits beyond this time. Its exception is raised in that wait."""
        heapq.heappush(self._due, (self._now_s + seconds, next(self._order), action))

    def interrupt(self, seconds: float) -> None:
        """Do what Ctrl-C does, after a time."""

        def ctrl_c() -> None:
            raise KeyboardInterrupt

        self.after(seconds, ctrl_c)


class LineTime:
    """The time of :mod:`tacbench_cad.lab.rig.line`: like ``select``, a wait ends as soon as bytes arrive."""

    def __init__(self, clock: FakeTime) -> None:
        self._clock = clock
        self.reading: MemoryPort | None = None

    def monotonic(self) -> float:
        return self._clock.monotonic()

    def sleep(self, seconds: float) -> None:
        end_s = self.monotonic() + seconds
        while (left := end_s - self.monotonic()) > 0.0 and not (self.reading and self.reading.sent):
            pauses = [self._clock.next_s, *(rig.pause_s(self.reading) for rig in _RIGS)]
            self._clock.sleep(min(left, max(SHORTEST_S, min(pauses))))
            for rig in list(_RIGS):
                rig.serve()


class MemoryPort:
    """A port of a virtual rig without an operating system. The methods are those of ``transport.Pty``."""

    def __init__(self, link: Path) -> None:
        self.name = f"memory://{link.parent.name}/{link.name}"
        self.opened = False
        self.host: HostPort | None = None
        self.received, self.sent = bytearray(), bytearray()
        self.serve: Callable[[], None] = lambda: None
        self.plug()

    def watched(self) -> int:
        return 0

    def look(self) -> bool:
        if self.opened or self.host is None:
            return False
        self.opened = True
        return True

    def read(self, limit: int) -> bytes:
        data = bytes(self.received[: max(limit, 0)])
        del self.received[: len(data)]
        return data

    def write(self, data: bytes) -> None:
        if self.opened:
            self.sent += data[: KEPT_BYTES - len(self.sent)]

    def unplug(self) -> None:
        self.hang_up()
        _PORTS.pop(self.name, None)

    def plug(self) -> None:
        _PORTS[self.name] = self

    def hang_up(self) -> None:
        self.host, self.opened = None, False
        self.received.clear()
        self.sent.clear()


class HostPort:
    """The host's end of a port, with the methods of pyserial that :class:`tacbench_cad.lab.rig.line.Line` calls."""

    def __init__(self, port: MemoryPort, baudrate: int, time: LineTime) -> None:
        self._port, self.baudrate, self._time = port, baudrate, time
        port.host = self
        port.serve()

    def read(self, size: int) -> bytes:
        self._serve()
        self._time.reading = self._port
        data = bytes(self._port.sent[:size])
        del self._port.sent[: len(data)]
        return data

    def write(self, data: bytes) -> None:
        self._serve()
        self._port.received += data
        self._serve()

    def close(self) -> None:
        if self._port.host is self:
            self._port.hang_up()

    def _serve(self) -> None:
        self._port.serve()
        if self._port.host is not self:
            raise OSError(errno.EIO, "the port is gone")


class RigHere(server.VirtualRig):
    """A virtual rig that is served whenever the test's clock goes on, instead of by a thread."""

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        for port in (self._stage, self._gauge):
            assert isinstance(port, MemoryPort), "use the fixture rig_time"
            port.serve = self.serve
        self._still_until_s = 0.0
        _RIGS.append(self)

    def close(self) -> None:
        if self in _RIGS:
            _RIGS.remove(self)
        super().close()

    def stand_still(self, seconds: float) -> None:
        """Let the firmware do nothing for a time, as if its processor stood still."""
        self._still_until_s = server.time.monotonic() + seconds

    def serve(self) -> None:
        """Transmit bytes in both directions."""
        if not self._closed and server.time.monotonic() >= self._still_until_s:
            self._serve()

    def pause_s(self, reading: MemoryPort | None) -> float:
        """Return the time until the rig has something to do. Samples are made when the gauge is read."""
        gauge = self._gauge
        opened, gauge.opened = gauge.opened, gauge is reading
        try:
            return max(self._pause_s(), self._still_until_s - server.time.monotonic())
        finally:
            gauge.opened = opened

    def _do(self, order: Callable[[], T]) -> T:
        if self._closed:
            raise DeviceLostError("the virtual rig is closed")
        self.serve()
        return order()


def clock() -> FakeTime:
    """Return the clock of the fixture ``rig_time``."""
    return _CLOCKS[-1]


def launch(kind: str, **options: Any) -> RigHere:
    """Do what :func:`tacbench_cad.extensions.virtual_rig.launch` does, in this process."""
    return RigHere(Setup.of(kind, **options))


def fake_time(monkeypatch: pytest.MonkeyPatch) -> FakeTime:
    """Replace the time of the drivers and the ports of virtual rigs until the end of the test."""
    fake, real_port = FakeTime(), serial.serial_for_url
    waiting = LineTime(fake)
    monkeypatch.setattr(sys.modules[__name__], "_CLOCKS", [fake])

    def opened(name: str, *, baudrate: int, **options: Any) -> Any:
        for rig in _RIGS:
            rig.serve()
        if name in _PORTS:
            return HostPort(_PORTS[name], baudrate, waiting)
        if name.startswith("memory://"):
            raise serial.SerialException(errno.ENOENT, "No such file or directory")
        return real_port(name, baudrate=baudrate, **options)

    for name, module in list(sys.modules.items()):
        ours = name.startswith(("tacbench_cad.lab.rig.", "tacbench_cad.lab.acquire.", "tacbench_cad.extensions."))
        if ours and getattr(module, "time", None) is time:
            monkeypatch.setattr(module, "time", fake)
    monkeypatch.setattr(line, "time", waiting)
    monkeypatch.setattr(line, "POLL_S", line.WAIT_S)
    monkeypatch.setattr(server, "Pty", MemoryPort)
    for module in (virtual_rig, server, drivers):
        monkeypatch.setattr(module, "launch", launch)
    monkeypatch.setattr(serial, "serial_for_url", opened)
    return fake
