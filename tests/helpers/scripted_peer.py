"""The far end of a serial line, which sends the answers of a test's function on the clock of ``rig_time``."""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from types import TracebackType
from typing import Self

from helpers import rig_here

#: Takes a line or a real-time byte and returns the answer: bytes, and pauses in seconds.
Answer = Callable[[bytes], Iterable[bytes | float]]
_NUMBERS = itertools.count()


class Peer:
    """The far end of a serial line.

    Args:
        answer: The function that is called with each line (without its end) and each real-time byte.
        realtime: The bytes that are taken out of the stream at once, as firmware does.
    """

    def __init__(self, answer: Answer, realtime: bytes = b"?!~\x18\x85") -> None:
        self.answer = answer
        self.realtime = realtime
        self.received = bytearray()
        self.lines: list[bytes] = []
        self._end = rig_here.MemoryPort(Path(f"peer-{next(_NUMBERS)}") / "port")
        self._end.serve = self._serve
        self.port = self._end.name
        self._line = bytearray()
        self._waiting: deque[bytes] = deque()
        self._reply: Iterator[bytes | float] | None = None

    def say(self, data: bytes) -> None:
        """Send bytes without a request."""
        self._end.sent += data

    def unplug(self) -> None:
        """Take the device away."""
        self._end.unplug()

    def _serve(self) -> None:
        data = self._end.read(len(self._end.received))
        self.received += data
        for byte in data:
            if byte in self.realtime:
                self._waiting.append(bytes([byte]))
            elif byte == 0x0A:
                self._waiting.append(bytes(self._line).strip() + b"\n")
                self._line.clear()
            else:
                self._line.append(byte)
        self._work()

    def _work(self) -> None:
        while self._reply is None and self._waiting:
            message = self._waiting.popleft()
            if message.endswith(b"\n"):
                message = message[:-1]
                self.lines.append(message)
            self._reply = iter(self.answer(message))
            self._go_on()

    def _go_on(self) -> None:
        for part in self._reply or ():
            if isinstance(part, float):
                rig_here.clock().after(part, self._resume)
                return
            self._end.sent += part
        self._reply = None

    def _resume(self) -> None:
        self._go_on()
        self._work()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.unplug()
