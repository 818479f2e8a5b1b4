"""The process of a virtual rig: the board on one port, the load cell on another, and orders on standard input."""

from __future__ import annotations

import contextlib
import json
import os
import queue
import select
import shutil
import socket
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any, TextIO

from tacbench_cad.extensions.virtual_rig.base import earliest
from tacbench_cad.extensions.virtual_rig.faults import Fault
from tacbench_cad.extensions.virtual_rig.loadcell import ForceAtCarriage, LoadCell, stimulus_from
from tacbench_cad.extensions.virtual_rig.setup import Setup
from tacbench_cad.extensions.virtual_rig.transport import Endpoint, Pty, Tcp
from tacbench_cad.util.convert import from_plain
from tacbench_cad.util.errors import InputError, TacbenchError

#: The interval, in s of real time, between checks for a host, between batches of samples, and the longest sleep.
_LOOK_S = 0.01
_BATCH_S = 0.001
_SLEEP_S = 1.0


class Server:
    """One virtual rig with its ports.

    Args:
        setup: The settings of the rig.

    Attributes:
        stage: The port of the board.
        gauge: The port of the load cell.
    """

    def __init__(self, setup: Setup) -> None:
        self.setup = setup
        self.board = setup.board()
        self._start_s = time.monotonic()
        self._cell = LoadCell(setup.gauge, seed=setup.seed + 2)
        stimulus = None if setup.stimulus is None else stimulus_from(setup.stimulus)
        self._force = ForceAtCarriage(lambda: self.board.firmware.carriage.true(self.board.now_s), stimulus)
        self._folder = Path(tempfile.mkdtemp(prefix="tacbench-rig-"))
        self.stage: Endpoint = Tcp() if setup.tcp else Pty(self._folder / "stage")
        self.gauge: Endpoint = Tcp() if setup.tcp else Pty(self._folder / "gauge")
        self._gauge_faults = [fault for fault in setup.faults if fault.of_gauge]
        self._gauge_back_s: float | None = None
        self._wake: list[socket.socket] = []
        self._stage_plugged = True

    def close(self) -> None:
        """Close everything and remove all files."""
        for port in (self.stage, self.gauge):
            port.unplug()
        for end in self._wake:
            end.close()
        shutil.rmtree(self._folder, ignore_errors=True)

    @property
    def now_s(self) -> float:
        """Return the rig time."""
        return (time.monotonic() - self._start_s) * self.setup.speed

    def run(self, orders: TextIO | None = None) -> None:
        """Serve until the orders end (their writer has ended or closed them); without orders, for ever.

        Args:
            orders: One order per line, in JSON. The answers go to the standard output.
        """
        inbox: queue.SimpleQueue[str] = queue.SimpleQueue()
        awake, waker = socket.socketpair()
        awake.setblocking(False)
        self._wake = [awake, waker]
        parent = os.getppid()
        if orders is not None:
            threading.Thread(target=_forward, args=(orders, inbox, waker), daemon=True).start()
        while True:
            # When the buffer is full, the host's write blocks: nothing is read until there is room.
            listens = self.board.room or not self.stage.opened
            ports = (awake, self.stage.watched() if listens else None, self.gauge.watched())
            select.select([port for port in ports if port is not None], [], [], self._pause_s())
            with contextlib.suppress(BlockingIOError):
                awake.recv(4096)
            self._serve()
            while not inbox.empty():
                line = inbox.get()
                if not line:
                    return
                _answer(self._order(line))
            if orders is not None and os.getppid() != parent:
                return

    def _pause_s(self) -> float:
        """Return the real time in s until something is due."""
        pause = _SLEEP_S
        if (self.stage.watched() is None and self.board.plugged) or self.gauge.watched() is None:
            pause = _LOOK_S
        now = self.now_s
        due = earliest(self.board.next_event_s(), self._gauge_back_s, *(fault.at_s for fault in self._gauge_faults))
        if due is not None:
            pause = min(pause, (due - now) / self.setup.speed)
        if self.gauge.opened:
            pause = min(pause, max(_BATCH_S, (self._cell.next_s - now) / self.setup.speed))
        return max(0.0, pause)

    def _serve(self) -> None:
        """Transmit bytes in both directions."""
        now = self.now_s
        self._mind_cables(now)
        if self.stage.look():
            self.board.opened(resets=self.setup.resets_on_open, now_s=now)
        if self.stage.opened and self.setup.check_baud:
            self.board.host_baud = self.stage.host_baud()
        data = self.stage.read(self.board.room)
        if data:
            self.board.write(data, now)
        said = self.board.read(now)
        if self.gauge.look():
            self._cell.skip_to(now)
        self.gauge.read(4096)
        if self.gauge.opened:
            self.gauge.write(self._cell.read(now, self._force))
        # This comes last: a host that reads of the stage's arrival then finds all earlier samples in the gauge's port.
        self.stage.write(said)

    def _mind_cables(self, now: float) -> None:
        for fault in [fault for fault in self._gauge_faults if fault.at_s is None or fault.at_s <= now]:
            self._gauge_faults.remove(fault)
            if fault.kind == "unplug":
                self.gauge.unplug()
                self._gauge_back_s = None if fault.seconds is None else now + fault.seconds
            else:
                self._cell.inject(fault, now)
        if self._gauge_back_s is not None and now >= self._gauge_back_s:
            self._gauge_back_s = None
            self.gauge.plug()
        self.board.advance(now)
        if self.board.plugged != self._stage_plugged:
            self._stage_plugged = self.board.plugged
            if self.board.plugged:
                self.stage.plug()
            else:
                self.stage.unplug()

    def _order(self, line: str) -> dict[str, Any]:
        try:
            order = json.loads(line)
            now = self.now_s
            if order["do"] == "inject":
                fault = Fault.of(order["fault"])
                if fault.of_gauge:
                    self._gauge_faults.append(fault)
                else:
                    self.board.inject(fault, now)
                self._serve()
            elif order["do"] == "put":
                stimulus = order["stimulus"]
                self._force.put(None if stimulus is None else stimulus_from(stimulus))
            elif order["do"] != "look":
                raise InputError("order", order["do"], "must be inject, put or look")
            self.board.advance(self.now_s)
            firmware = self.board.firmware
            return {
                "now_s": self.board.now_s,
                "true_mm": firmware.carriage.true(self.board.now_s),
                "reported_mm": firmware.reported,
                "force_n": self._force(),
                "motors_off": firmware.motors_off,
            }
        except (TacbenchError, ValueError, KeyError, TypeError) as error:
            return {"error": f"{error}"}


def _forward(orders: TextIO, inbox: queue.SimpleQueue[str], waker: socket.socket) -> None:
    """Forward lines, and an empty one at their end. This is a thread, since some systems cannot select on stdin."""
    line = "more"
    while line:
        try:
            line = orders.readline()
        except (OSError, ValueError):
            line = ""
        inbox.put(line)
        with contextlib.suppress(OSError):
            waker.send(b".")


def _answer(values: dict[str, Any]) -> None:
    with contextlib.suppress(BrokenPipeError):
        print(json.dumps(values), flush=True)


def serve_launcher() -> None:
    """Run a launched process: read a setup, then orders on standard input, and answer on standard output."""
    try:
        server = Server(from_plain(Setup, json.loads(sys.stdin.readline())))
    except (TacbenchError, ValueError, TypeError) as error:
        _answer({"error": f"{error}"})
        return
    try:
        _answer({"port": server.stage.name, "gauge_port": server.gauge.name})
        server.run(sys.stdin)
    finally:
        server.close()
