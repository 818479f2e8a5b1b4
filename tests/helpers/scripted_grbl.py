"""A minimal GRBL for the tests of the driver. It arrives at once; a test can change its answers."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator

from helpers.scripted_peer import Peer

BANNER = b"\r\nGrbl 1.1h ['$' for help]\r\n"
SETTINGS = b"$10=1\r\n$13=0\r\n$22=1\r\n$27=1.000\r\n$100=250.000\r\n$101=250.000\r\n$102=400.000\r\n$130=200\r\n"


class ScriptedGrbl:
    """A GRBL that is homed at -1, -1, -1 and arrives at once.

    Attributes:
        on_move: Takes the target and yields the bytes that are sent instead of ``ok``; the position does not change.
        on_status: Yields the bytes that are sent instead of a status report.
        on_home: Yields the bytes that are sent instead of the answer to homing.
        on_reset: Yields the bytes that are sent instead of the banner.
    """

    def __init__(self) -> None:
        self.at = (-1.0, -1.0, -1.0)
        self.state = "Idle"
        self.banner = BANNER
        self.version = b"[VER:1.1h.20190825:]\r\n[OPT:V,15,128]\r\nok\r\n"
        self.settings = SETTINGS
        self.deaf = False
        self.on_move: Callable[[tuple[float, float, float]], Iterable[bytes | float]] | None = None
        self.on_status: Callable[[], Iterable[bytes | float]] | None = None
        self.on_home: Callable[[], Iterable[bytes | float]] | None = None
        self.on_reset: Callable[[], Iterable[bytes | float]] | None = None

    def peer(self) -> Peer:
        """Return a peer that serves this firmware over a port in memory."""
        return Peer(self.answer)

    def report(self) -> bytes:
        """Return a status report."""
        return f"<{self.state}|MPos:{self.at[0]:.3f},{self.at[1]:.3f},{self.at[2]:.3f}|FS:0,0>\r\n".encode()

    def answer(self, command: bytes) -> Iterator[bytes | float]:
        """Yield the answer to a line or a real-time byte."""
        if command == b"\x18":
            self.deaf = False
            self.state = "Idle"
            yield from self.on_reset() if self.on_reset else [self.banner]
        elif self.deaf:
            return
        elif command == b"?":
            yield from self.on_status() if self.on_status else [self.report()]
        elif command == b"!":
            self.state = "Hold:0"
        elif command == b"$I":
            yield self.version
        elif command == b"$$":
            yield self.settings + b"ok\r\n"
        elif command == b"$H":
            yield from self.on_home() if self.on_home else self._home()
        elif match := re.search(rb"X(-?[\d.]+)Y(-?[\d.]+)Z(-?[\d.]+)", command):
            target = (float(match[1]), float(match[2]), float(match[3]))
            if self.on_move:
                yield from self.on_move(target)
            else:
                self.at = target
                yield b"ok\r\n"
        else:
            yield b"ok\r\n"

    def _home(self) -> Iterator[bytes | float]:
        self.at = (-1.0, -1.0, -1.0)
        yield b"<Home|MPos:-1.000,-1.000,-1.000|FS:0,0>\r\nok\r\n"
