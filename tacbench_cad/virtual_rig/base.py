"""What every virtual firmware is made of: a program that runs and waits, bytes in, bytes out, time given.

A firmware does nothing by itself. Whoever drives it says what time it is, gives it the bytes that arrive then, and
takes the bytes that it sent. The program of a firmware is a generator that yields what it waits for, so that blocking
code ("wait until the planner has room") reads as it does in the original.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator

from tacbench_cad.lab.study.spec import Point
from tacbench_cad.virtual_rig.machine import Carriage, replaced

#: What a program waits for: so many seconds, or until something is true.
Wait = float | Callable[[], bool]
Program = Iterator[Wait]

#: Bytes that the host has not fetched; beyond it they are lost, as on any serial line without flow control.
OUTPUT_BYTES = 65536
#: A program that goes on so often without time passing is at fault; this bound keeps the simulator alive.
_STEPS = 100_000


def earliest(*times_s: float | None) -> float | None:
    """The first of some times; None if none is known."""
    return min((time_s for time_s in times_s if time_s is not None), default=None)


class Firmware(ABC):
    """A state machine that speaks a protocol.

    Args:
        carriage: What it moves.
        boot_s: Seconds from a reset until it listens.

    Attributes:
        now_s: Rig time, as last given.
    """

    #: Symbols per second that the firmware is built for.
    baud: int
    #: Slots of the serial receive buffer.
    rx_bytes = 128

    def __init__(self, carriage: Carriage, *, boot_s: float) -> None:
        self.carriage = carriage
        self.boot_s = boot_s
        self.now_s = 0.0
        self._rx = bytearray()
        self._out = bytearray()
        self._listening = False
        self._wait: Wait | None = None
        self._wake_s: float | None = None
        self._program: Program = iter(())
        self._homing: int | None = None
        self.power_up(0.0)

    # For whoever drives it

    def receive(self, data: bytes, now_s: float) -> None:
        """Bytes arrive at the receiver at ``now_s``."""
        self.advance(now_s)
        if self._listening:
            for byte in data:
                self._arrived(byte)
        self._pump()

    def advance(self, now_s: float) -> None:
        """Let time pass, event by event."""
        while (when := self.next_event_s()) is not None and when <= now_s:
            self.now_s = max(self.now_s, when)
            self._timers()
            moved = self.carriage.moving
            closed = self.carriage.advance(self.now_s)
            if closed is not None:
                self._end_stop(closed)
            if moved and not self.carriage.moving:
                self._stopped()
            self._pump()
        self.now_s = max(self.now_s, now_s)

    def next_event_s(self) -> float | None:
        """When something will happen by itself; None if nothing will."""
        return earliest(self.carriage.next_event_s(), self._wake_s, self._timer_s())

    def take(self) -> bytes:
        """The bytes sent since the last call."""
        sent = bytes(self._out)
        self._out.clear()
        return sent

    def power_up(self, now_s: float) -> None:
        """The reset button, or the reset by the port's opening: all is forgotten, the counters say 0, 0, 0."""
        self.now_s = max(self.now_s, now_s)
        self.carriage.halt(self.now_s)
        self.carriage.count_as((0.0, 0.0, 0.0))
        self._listening = False
        self._rx.clear()
        self._homing = None
        self._forget()
        self._run(self._boot())

    def alarm(self, now_s: float) -> None:
        """Something that this firmware takes for an emergency: an end stop that closes, a failed check, a halt."""
        self.advance(now_s)
        self._alarm()
        self._pump()

    @property
    def reported(self) -> Point:
        """The position that it would report, in mm of its own frame: what its counters say."""
        return self.carriage.counted(self.now_s)

    # For the firmware itself

    @abstractmethod
    def _alarm(self) -> None:
        """See :meth:`alarm`."""

    def _forget(self) -> None:  # noqa: B027
        """Put everything that lies in volatile memory back."""

    @abstractmethod
    def _main(self) -> Program:
        """What runs after the boot loader."""

    def _arrived(self, byte: int) -> None:
        """The receive interrupt: store the byte, or lose it if the buffer is full."""
        if len(self._rx) < self.rx_bytes:
            self._rx.append(byte)

    def _end_stop(self, axis: int) -> None:
        """An end stop closed during motion; to most firmwares it means nothing but in homing."""
        if axis == self._homing:
            self.carriage.halt(self.now_s)

    def _stopped(self) -> None:  # noqa: B027
        """The last stroke ended; most firmwares need not know."""

    def _timer_s(self) -> float | None:
        """When the firmware's own timers are due."""
        return None

    def _timers(self) -> None:  # noqa: B027
        """Do what is due at :attr:`now_s`; what is done must not be due again."""

    def _at_rest(self) -> bool:
        return not self.carriage.moving

    def _shove(self, axis: int, by_mm: float, speed_mm_s: float, acceleration_mm_s2: float) -> None:
        """Move one axis from where the counters say that it is."""
        here = self.carriage.counted(self.now_s)
        self.carriage.go(replaced(here, axis, here[axis] + by_mm), speed_mm_s, acceleration_mm_s2, self.now_s)

    def _count_axis_as(self, axis: int, value_mm: float) -> None:
        """Set the counter of one axis."""
        self.carriage.count_as(replaced(self.carriage.counted(self.now_s), axis, value_mm))

    def _boot(self) -> Program:
        yield self.boot_s
        # The boot loader takes what is sent to it and does nothing with it.
        self._listening = True
        yield from self._main()

    def _run(self, program: Program) -> None:
        """Drop the running program and start another."""
        self._program = program
        self._wait = None
        self._wake_s = self.now_s

    def _send(self, text: str) -> None:
        room = OUTPUT_BYTES - len(self._out)
        self._out += text.encode("ascii", "replace")[: max(0, room)]

    def _pump(self) -> None:
        """Let the program run until it waits for something that is not yet so."""
        for _ in range(_STEPS):
            if self._wake_s is not None:
                if self._wake_s > self.now_s:
                    return
                self._wake_s = None
            elif not (callable(self._wait) and self._wait()):
                return
            program = self._program
            wait = next(program, None)
            if program is not self._program:
                # It was replaced from within: a reset. The new program starts at once.
                continue
            self._wait = wait
            if isinstance(wait, float):
                self._wait, self._wake_s = None, self.now_s + wait
