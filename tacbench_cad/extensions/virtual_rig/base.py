"""The common part of all virtual firmwares: a program that runs and waits, with bytes as input and output.

A firmware does nothing by itself. The caller tells it the time, passes the bytes that arrive, and takes the bytes that
it sent. Its program is a generator that yields its waits, so that blocking code ("wait until the planner has room")
reads as in the original firmware.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator

from tacbench_cad.extensions.virtual_rig.machine import VirtualCarriage, replaced
from tacbench_cad.lab.study import Point

#: A wait of a program: a duration in s, or a condition.
Wait = float | Callable[[], bool]
Program = Iterator[Wait]

#: The largest number of bytes that the host has not read. Further bytes are lost, as on a line without flow control.
OUTPUT_BYTES = 65536
#: The largest number of steps of a program without time passing. A program that exceeds it has an error.
_STEPS = 100_000


def earliest(*times_s: float | None) -> float | None:
    """Return the earliest of some times; None if none is known."""
    return min((time_s for time_s in times_s if time_s is not None), default=None)


class Firmware(ABC):
    """A state machine with a serial protocol.

    Args:
        carriage: The carriage that it moves.
        boot_s: The time from a reset until it reads, in s.

    Attributes:
        now_s: The rig time of the last call.
        motors_off: How often the motors lost their power at rest.
    """

    #: The baud rate of the firmware.
    baud: int
    #: The size of the serial receive buffer, in bytes.
    rx_bytes = 128

    def __init__(self, carriage: VirtualCarriage, *, boot_s: float) -> None:
        self.carriage = carriage
        self.boot_s = boot_s
        self.now_s = 0.0
        self.motors_off = 0
        self._rx = bytearray()
        self._out = bytearray()
        self._listening = False
        self._wait: Wait | None = None
        self._wake_s: float | None = None
        self._program: Program = iter(())
        self._homing: int | None = None
        self.power_up(0.0)

    # For the caller

    def receive(self, data: bytes, now_s: float) -> None:
        """Receive bytes at ``now_s``."""
        self.advance(now_s)
        if self._listening:
            for byte in data:
                self._arrived(byte)
        self._pump()

    def advance(self, now_s: float) -> None:
        """Let time pass, from event to event."""
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
        """Return the time of the next event without input; None if there is none."""
        return earliest(self.carriage.next_event_s(), self._wake_s, self._timer_s())

    def take(self) -> bytes:
        """Return the bytes that were sent since the last call."""
        sent = bytes(self._out)
        self._out.clear()
        return sent

    def power_up(self, now_s: float) -> None:
        """Reset by the button or by opening the port. All state is lost, and the counters are 0, 0, 0."""
        self.now_s = max(self.now_s, now_s)
        self.carriage.halt(self.now_s)
        self.carriage.count_as((0.0, 0.0, 0.0))
        self._listening = False
        self._rx.clear()
        self._homing = None
        self._forget()
        self._run(self._boot())

    def alarm(self, now_s: float) -> None:
        """Raise the firmware's emergency: a closed end stop, a failed check, or a halt."""
        self.advance(now_s)
        self._alarm()
        self._pump()

    def end_stop(self, axis: int, now_s: float) -> None:
        """Close an end stop by itself, without motion."""
        self.advance(now_s)
        if self._listening:
            self._end_stop(axis)
        self._pump()

    @property
    def reported(self) -> Point:
        """The position that the firmware's counters give, in mm of its own frame."""
        return self.carriage.counted(self.now_s)

    # For the firmware itself

    @abstractmethod
    def _alarm(self) -> None:
        """See :meth:`alarm`."""

    def _forget(self) -> None:  # noqa: B027
        """Reset everything in volatile memory."""

    @abstractmethod
    def _main(self) -> Program:
        """Run the firmware after the boot loader."""

    def _arrived(self, byte: int) -> None:
        """Handle the receive interrupt: store the byte, or lose it if the buffer is full."""
        if len(self._rx) < self.rx_bytes:
            self._rx.append(byte)

    def _end_stop(self, axis: int) -> None:
        """Handle an end stop that closes during motion. Most firmwares ignore it except while homing."""
        if axis == self._homing:
            self.carriage.halt(self.now_s)

    def _stopped(self) -> None:  # noqa: B027
        """Handle the end of the last stroke. Most firmwares need not know."""

    def _timer_s(self) -> float | None:
        """Return the time of the firmware's next timer."""
        return None

    def _timers(self) -> None:  # noqa: B027
        """Run the timers that are due at :attr:`now_s`, and set them to later times."""

    def _at_rest(self) -> bool:
        return not self.carriage.moving

    def _shove(self, axis: int, by_mm: float, speed_mm_s: float, acceleration_mm_s2: float) -> None:
        """Move one axis relative to its counter."""
        here = self.carriage.counted(self.now_s)
        self.carriage.go(replaced(here, axis, here[axis] + by_mm), speed_mm_s, acceleration_mm_s2, self.now_s)

    def _count_axis_as(self, axis: int, value_mm: float) -> None:
        """Set the counter of one axis."""
        self.carriage.count_as(replaced(self.carriage.counted(self.now_s), axis, value_mm))

    def _boot(self) -> Program:
        yield self.boot_s
        # The boot loader receives bytes and ignores them.
        self._listening = True
        yield from self._main()

    def _run(self, program: Program) -> None:
        """Replace the running program by another."""
        self._program = program
        self._wait = None
        self._wake_s = self.now_s

    def _send(self, text: str) -> None:
        room = OUTPUT_BYTES - len(self._out)
        self._out += text.encode("ascii", "replace")[: max(0, room)]

    def _pump(self) -> None:
        """Run the program until it waits for something that is not yet true."""
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
                # The program was replaced from within, by a reset. The new program starts at once.
                continue
            self._wait = wait
            if isinstance(wait, float):
                self._wait, self._wake_s = None, self.now_s + wait
