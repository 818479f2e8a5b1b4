"""A byte peer over a pseudo-terminal: a thread that sends the answers of a test's function."""

from __future__ import annotations

import os
import pty
import select
import threading
import time
import tty
from collections.abc import Callable, Iterable
from types import TracebackType
from typing import Self

#: Takes a line or a real-time byte and returns the answer: bytes, and pauses in seconds.
Answer = Callable[[bytes], Iterable[bytes | float]]


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
        self._far, near = pty.openpty()
        tty.setraw(near)
        self.port = os.ttyname(near)
        # Both ends stay open, so that a driver can close and reopen the port. The first call of unplug closes them.
        self._ends: tuple[int, ...] = (near, self._far)
        self._lock = threading.Lock()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def say(self, data: bytes) -> None:
        """Send bytes without a request."""
        os.write(self._far, data)

    def wait_for(self, line: bytes, within_s: float = 5.0) -> None:
        """Wait until the thread has read a line."""
        until = time.monotonic() + within_s
        while line not in self.lines:
            assert time.monotonic() < until, f"{line!r} was not sent"
            time.sleep(0.005)

    def unplug(self) -> None:
        """Close both ends, as if the device were unplugged."""
        with self._lock:
            ends, self._ends = self._ends, ()
            self._over.set()
            self._thread.join()
            for end in ends:
                os.close(end)

    def _serve(self) -> None:
        line = bytearray()
        while not self._over.is_set():
            if not select.select([self._far], [], [], 0.02)[0]:
                continue
            data = os.read(self._far, 1024)
            self.received += data
            for byte in data:
                if byte in self.realtime:
                    self._reply(bytes([byte]))
                elif byte == 0x0A:
                    message = bytes(line).strip()
                    line.clear()
                    self.lines.append(message)
                    self._reply(message)
                else:
                    line.append(byte)

    def _reply(self, message: bytes) -> None:
        for part in self.answer(message):
            if isinstance(part, float):
                time.sleep(part)
            else:
                os.write(self._far, part)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.unplug()
