"""A byte peer over a pseudo-terminal: a thread that answers what a test's function says. Kinder than no firmware."""

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

#: Takes one line, or one real-time byte; returns what is sent: bytes, and seconds of silence.
Answer = Callable[[bytes], Iterable[bytes | float]]


class Peer:
    """The far end of a serial line.

    Args:
        answer: Called with each line (without its end) and each real-time byte.
        realtime: Bytes that are taken out of the stream at once, as firmware does.
    """

    def __init__(self, answer: Answer, realtime: bytes = b"?!~\x18\x85") -> None:
        self.answer = answer
        self.realtime = realtime
        self.received = bytearray()
        self.lines: list[bytes] = []
        self._far, near = pty.openpty()
        tty.setraw(near)
        self.port = os.ttyname(near)
        # Held open, so that a driver may close and open the port again; closed once, by whoever unplugs first.
        self._ends: tuple[int, ...] = (near, self._far)
        self._lock = threading.Lock()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def say(self, data: bytes) -> None:
        """Send something unasked."""
        os.write(self._far, data)

    def wait_for(self, line: bytes, within_s: float = 5.0) -> None:
        """Until a line has been read here, which the thread does in its own time."""
        until = time.monotonic() + within_s
        while line not in self.lines:
            assert time.monotonic() < until, f"{line!r} was not sent"
            time.sleep(0.005)

    def unplug(self) -> None:
        """The device is gone."""
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
                    whole = bytes(line).strip()
                    line.clear()
                    self.lines.append(whole)
                    self._reply(whole)
                else:
                    line.append(byte)

    def _reply(self, got: bytes) -> None:
        for part in self.answer(got):
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
