"""A running virtual rig: the board on one port, the load cell on another, both served by a thread in rig time."""

from __future__ import annotations

import contextlib
import queue
import select
import socket
import tempfile
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Any, TypeVar

from tacbench_cad.extensions.virtual_rig.base import Firmware, earliest
from tacbench_cad.extensions.virtual_rig.faults import Fault
from tacbench_cad.extensions.virtual_rig.loadcell import EmulatedLoadCell, Stimulus
from tacbench_cad.extensions.virtual_rig.setup import Setup
from tacbench_cad.extensions.virtual_rig.transport import Endpoint, Pty, Tcp
from tacbench_cad.lab.rig import Closing, DeviceLostError
from tacbench_cad.lab.study import Point

T = TypeVar("T")
#: The interval, in s of real time, between checks for a host, between batches of samples, and the longest sleep.
_LOOK_S = 0.01
_BATCH_S = 0.001
_SLEEP_S = 1.0


class VirtualRig(Closing):
    """One virtual rig with its ports. Call :meth:`run` or :meth:`start` to serve them.

    Args:
        setup: The settings of the rig.

    Attributes:
        port: The stage's port: a path, or ``socket://...``.
        gauge_port: The load cell's port.
    """

    def __init__(self, setup: Setup) -> None:
        self.setup = setup
        self._board = setup.board()
        self._start_s = time.monotonic()
        self._cell = EmulatedLoadCell(setup.gauge, seed=setup.seed + 2)
        self._stimulus: Stimulus | None = setup.stimulus
        self._known: tuple[Stimulus, Point, float] | None = None
        self._folder = tempfile.TemporaryDirectory(prefix="tacbench-rig-")
        folder = Path(self._folder.name)
        self._stage: Endpoint = Tcp() if setup.tcp else Pty(folder / "stage")
        self._gauge: Endpoint = Tcp() if setup.tcp else Pty(folder / "gauge")
        self.port, self.gauge_port = self._stage.name, self._gauge.name
        self._gauge_faults = [fault for fault in setup.faults if fault.of_gauge]
        self._gauge_back_s: float | None = None
        self._stage_plugged = True
        self._orders: queue.SimpleQueue[tuple[Callable[[], Any], Future[Any]]] = queue.SimpleQueue()
        self._awake, self._waker = socket.socketpair()
        self._awake.setblocking(False)
        self._thread: threading.Thread | None = None
        self._closed = False

    def start(self) -> None:
        """Serve the ports in a thread."""
        self._thread = threading.Thread(target=self.run, name="virtual rig", daemon=True)
        self._thread.start()

    def run(self) -> None:
        """Serve the ports until the rig is closed."""
        while not self._closed:
            # When the buffer is full, the host's write blocks: nothing is read until there is room.
            listens = self._board.room or not self._stage.opened
            ports = (self._awake, self._stage.watched() if listens else None, self._gauge.watched())
            select.select([port for port in ports if port is not None], [], [], self._pause_s())
            with contextlib.suppress(BlockingIOError):
                self._awake.recv(4096)
            self._serve()
            while not self._orders.empty():
                order, answer = self._orders.get()
                answer.set_result(order())

    def close(self) -> None:
        """End the rig and remove its files. Never raises; a second call has no effect."""
        self._closed = True
        with contextlib.suppress(OSError):
            self._waker.send(b".")
        if self._thread is not None:
            self._thread.join()
        for port in (self._stage, self._gauge):
            port.unplug()
        for end in (self._awake, self._waker):
            end.close()
        self._folder.cleanup()

    def inject(self, fault: Fault) -> None:
        """Add a fault, now or at the fault's time.

        Raises:
            DeviceLostError: The rig is closed.
        """

        def add() -> None:
            if fault.of_gauge:
                self._gauge_faults.append(fault)
            else:
                self._board.inject(fault, self._time_s)
            self._serve()

        self._do(add)

    def put(self, stimulus: Stimulus | None) -> None:
        """Replace the object under the carriage; None for nothing."""
        self._do(lambda: setattr(self, "_stimulus", stimulus))

    def true_position(self) -> Point:
        """Return the true position of the carriage in mm, in the frame that the firmware has after homing."""
        return self._do(lambda: (self._firmware(), self._true_mm)[1])

    def reported_position(self) -> Point:
        """Return the position that the firmware's counters give, in mm."""
        return self._do(lambda: self._firmware().reported)

    def force_n(self) -> float:
        """Return the true force on the load cell in N, without noise."""
        return self._do(lambda: (self._firmware(), self._force_n())[1])

    def motors_off(self) -> int:
        """Return how often the motors lost their power at rest."""
        return self._do(lambda: self._firmware().motors_off)

    def now_s(self) -> float:
        """Return the rig time in s."""
        return self._do(lambda: (self._firmware(), self._board.now_s)[1])

    def _do(self, order: Callable[[], T]) -> T:
        """Call a function in the thread that serves the ports.

        Raises:
            DeviceLostError: The rig is closed.
        """
        if self._thread is None or not self._thread.is_alive():
            raise DeviceLostError("the virtual rig is closed")
        answer: Future[T] = Future()
        self._orders.put((order, answer))
        self._waker.send(b".")
        return answer.result()

    def _firmware(self) -> Firmware:
        """Return the firmware after everything until now has happened."""
        self._board.advance(self._time_s)
        return self._board.firmware

    @property
    def _true_mm(self) -> Point:
        return self._board.firmware.carriage.true(self._board.now_s)

    def _force_n(self) -> float:
        """Return the present force on the load cell. It is computed again only after the carriage has moved."""
        here, stimulus = self._true_mm, self._stimulus
        if stimulus is None:
            return 0.0
        if self._known is None or self._known[0] is not stimulus or self._known[1] != here:
            self._known = (stimulus, here, stimulus.force_n(here))
        return self._known[2]

    @property
    def _time_s(self) -> float:
        return (time.monotonic() - self._start_s) * self.setup.speed

    def _pause_s(self) -> float:
        """Return the real time in s until something is due."""
        pause = _SLEEP_S
        if (self._stage.watched() is None and self._board.plugged) or self._gauge.watched() is None:
            pause = _LOOK_S
        now = self._time_s
        due = earliest(self._board.next_event_s(), self._gauge_back_s, *(fault.at_s for fault in self._gauge_faults))
        if due is not None:
            pause = min(pause, (due - now) / self.setup.speed)
        if self._gauge.opened:
            pause = min(pause, max(_BATCH_S, (self._cell.next_s - now) / self.setup.speed))
        return max(0.0, pause)

    def _serve(self) -> None:
        """Transmit bytes in both directions."""
        now = self._time_s
        self._mind_cables(now)
        if self._stage.look():
            self._board.opened(resets=self.setup.resets_on_open, now_s=now)
        data = self._stage.read(self._board.room)
        if data:
            self._board.write(data, now)
        said = self._board.read(now)
        if self._gauge.look():
            self._cell.skip_to(now)
        self._gauge.read(4096)
        if self._gauge.opened:
            self._gauge.write(self._cell.read(now, self._force_n))
        # This comes last: a host that reads of the stage's arrival then finds all earlier samples in the gauge's port.
        self._stage.write(said)

    def _mind_cables(self, now: float) -> None:
        for fault in [fault for fault in self._gauge_faults if fault.at_s is None or fault.at_s <= now]:
            self._gauge_faults.remove(fault)
            if fault.kind == "unplug":
                self._gauge.unplug()
                self._gauge_back_s = None if fault.seconds is None else now + fault.seconds
            else:
                self._cell.inject(fault, now)
        if self._gauge_back_s is not None and now >= self._gauge_back_s:
            self._gauge_back_s = None
            self._gauge.plug()
        self._board.advance(now)
        if self._board.plugged != self._stage_plugged:
            self._stage_plugged = self._board.plugged
            if self._board.plugged:
                self._stage.plug()
            else:
                self._stage.unplug()


def launch(kind: str, **options: Any) -> VirtualRig:
    """Start a virtual rig in a thread. Use it in a ``with`` statement.

    Args:
        kind: The firmware: ``grbl``, ``grblhal``, ``marlin`` or ``arduino``.
        **options: Other fields of ``Setup``, and keyword arguments of the
            firmware: ``settings`` of ``grbl``, ``emergency_parser`` of ``marlin``.

    Raises:
        InputError: An argument is not allowed.
    """
    rig = VirtualRig(Setup.of(kind, **options))
    rig.start()
    return rig
