"""A board: a firmware on a serial line with a limited speed, to which faults can be added."""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Iterable

from tacbench_cad.extensions.virtual_rig.base import OUTPUT_BYTES, Firmware, earliest
from tacbench_cad.extensions.virtual_rig.faults import BYTE_KINDS, Fault, Spoiler

#: The size of the host's send buffer in bytes. When it is full, the host's write blocks.
SEND_BYTES = 4096
_BITS_PER_BYTE = 10


class Board:
    """Transmits bytes to and from a firmware, each at the time at which a serial line would deliver it.

    Args:
        firmware: The firmware of the board.
        seed: The seed for random faults.
        faults: Faults that occur at their time.
        late_s: The range of the time by which each reply comes late, in s. The replies keep their order.

    Attributes:
        plugged: Whether the cable is connected.
        now_s: The rig time.
    """

    def __init__(
        self,
        firmware: Firmware,
        *,
        seed: int = 0,
        faults: Iterable[Fault] = (),
        late_s: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        self.firmware = firmware
        self.plugged = True
        self.now_s = 0.0
        self._late_s = late_s
        self._random = random.Random(seed)
        self._spoiler = Spoiler(self._random)
        self._in: deque[tuple[float, int]] = deque()
        self._out: deque[tuple[float, bytes]] = deque()
        self._out_bytes = 0
        self._out_free_s = 0.0
        self._received = 0
        self._waiting: list[Fault] = list(faults)
        self._ends: list[tuple[float, Fault]] = []

    @property
    def room(self) -> int:
        """The number of bytes that the host can write before its write blocks."""
        return max(0, SEND_BYTES - len(self._in))

    def write(self, data: bytes, now_s: float) -> None:
        """Receive bytes from the host. Bytes beyond :attr:`room` are lost."""
        self.advance(now_s)
        if not self.plugged:
            return
        per_byte = _BITS_PER_BYTE / self.firmware.baud
        arrival = max(now_s, self._in[-1][0] if self._in else 0.0)
        for byte in data[: self.room]:
            arrival += per_byte
            self._in.append((arrival, byte))

    def read(self, now_s: float) -> bytes:
        """Return the bytes that have reached the host."""
        self.advance(now_s)
        data = bytearray()
        while self._out and self._out[0][0] <= now_s:
            data += self._out.popleft()[1]
        self._out_bytes -= len(data)
        return bytes(data)

    def inject(self, fault: Fault, now_s: float) -> None:
        """Add a fault."""
        self.advance(now_s)
        self._waiting.append(fault)
        self._change_faults()

    def opened(self, *, resets: bool, now_s: float) -> None:
        """Handle the opening of the port by the host. Bytes in transit are lost, and the board may be reset."""
        self.advance(now_s)
        self._in.clear()
        self._drop_output()
        if resets:
            self.firmware.power_up(now_s)

    def next_event_s(self) -> float | None:
        """Return the time of the next event without input."""
        lines = (queue[0][0] if queue else None for queue in (self._in, self._out))
        return earliest(self._fault_s(), self.firmware.next_event_s(), *lines)

    def advance(self, now_s: float) -> None:
        """Let time pass, and handle deliveries, the firmware and faults in the order of time."""
        while True:
            pending = self._in[0][0] if self._in else None
            when = earliest(pending, self.firmware.next_event_s(), self._fault_s())
            if when is None or when > now_s:
                break
            self.now_s = max(self.now_s, when)
            self._change_faults()
            if self._in and self._in[0][0] <= when:
                self._deliver(self._in.popleft()[1])
                self._change_faults()
            else:
                self.firmware.advance(self.now_s)
            self._collect()
        self.now_s = max(self.now_s, now_s)
        self._change_faults()
        self.firmware.advance(self.now_s)
        self._collect()

    def _deliver(self, byte: int) -> None:
        self._received += 1
        data = self._spoiler.spoil(bytes((byte,)), "in", self.now_s)
        self.firmware.receive(data, self.now_s)

    def _collect(self) -> None:
        data = self.firmware.take()
        if not data or not self.plugged:
            return
        data = self._spoiler.spoil(data, "out", self.now_s)
        data = data[: max(0, OUTPUT_BYTES - self._out_bytes)]
        begin_s = self.now_s + (self._random.uniform(*self._late_s) if any(self._late_s) else 0.0)
        self._out_free_s = max(begin_s, self._out_free_s) + len(data) * _BITS_PER_BYTE / self.firmware.baud
        self._out.append((self._out_free_s, data))
        self._out_bytes += len(data)

    def _drop_output(self) -> None:
        self._out.clear()
        self._out_bytes = 0
        self._out_free_s = 0.0

    # Faults

    def _fault_s(self) -> float | None:
        return earliest(*(fault.at_s for fault in self._waiting), *(when for when, _ in self._ends))

    def _change_faults(self) -> None:
        for when, fault in [end for end in self._ends if end[0] <= self.now_s]:
            self._ends.remove((when, fault))
            self._end(fault)
        for fault in [fault for fault in self._waiting if self._is_due(fault)]:
            self._waiting.remove(fault)
            self._begin(fault)

    def _is_due(self, fault: Fault) -> bool:
        if fault.after_bytes is not None:
            return self._received >= fault.after_bytes
        return fault.at_s is None or self.now_s >= fault.at_s

    def _begin(self, fault: Fault) -> None:
        self.firmware.advance(self.now_s)
        self._collect()
        carriage, axis = self.firmware.carriage, "xyz".index(fault.axis)
        if fault.kind in BYTE_KINDS:
            self._spoiler.add(fault, self.now_s)
            return
        if fault.kind == "reset":
            self.firmware.power_up(self.now_s)
        elif fault.kind == "alarm":
            self.firmware.alarm(self.now_s)
        elif fault.kind == "slip":
            carriage.slip(axis, fault.mm, self.now_s)
        elif fault.kind == "stall":
            carriage.turn_only(axis, 0.0, self.now_s)
        elif fault.kind == "switch":
            carriage.stuck_switches.add(axis)
            self.firmware.end_stop(axis, self.now_s)
        elif fault.kind == "unplug":
            self.plugged = False
            self._in.clear()
            self._drop_output()
        if fault.seconds is not None:
            self._ends.append((self.now_s + fault.seconds, fault))
        self._collect()

    def _end(self, fault: Fault) -> None:
        if fault.kind == "stall":
            self.firmware.carriage.turn_only("xyz".index(fault.axis), 1.0, self.now_s)
        elif fault.kind == "switch":
            self.firmware.carriage.stuck_switches.discard("xyz".index(fault.axis))
        elif fault.kind == "unplug":
            self.plugged = True
