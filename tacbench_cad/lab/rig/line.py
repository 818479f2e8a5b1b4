"""Lines of text over a serial port, every wait bounded: the one way in which the lab talks to serial devices.

A port is anything that pyserial opens: a device's path, ``COM3``, or a URL (``socket://host:port``,
``rfc2217://host:port``). Reading waits with ``select`` on the port's descriptor where there is one, so that a timeout
is exact and the port is never configured again (setting pyserial's own timeout sets odd baud rates again).
"""

from __future__ import annotations

import contextlib
import errno
import math
import os
import select
import time
from collections.abc import Iterator
from typing import Any

from tacbench_cad.lab.rig.errors import DeviceLostError, NoAnswerError
from tacbench_cad.lab.rig.stage import Closing
from tacbench_cad.util.errors import InputError

#: Longest line that is waited for; noise without a line's end is cut there.
LONGEST_LINE = 4096
#: Pause between two looks at a port that ``select`` cannot wait for (Windows), in seconds.
LOOK_S = 0.001


class Line(Closing):
    """A serial port that sends and receives lines.

    Args:
        port: Path, name or pyserial URL.
        baud: Symbols per second; of no meaning for a pseudo-terminal or a socket.
        what: What is at the other end, for the messages: ``stage``.
        write_timeout_s: Longest time that writing may be held up (``rfc2217://`` knows no such limit).

    Attributes:
        port: As given.
        what: As given.
        torn: A write was cut short by an exception, so that the device may hold half a line.

    Raises:
        InputError: There is no such port, it may not be opened, or another program holds it.
    """

    def __init__(self, port: str, *, baud: int, what: str, write_timeout_s: float = 2.0) -> None:
        self.port = port
        self.what = what
        self.torn = False
        self._buffer = bytearray()
        self._serial = _opened(port, baud, what, write_timeout_s)
        self._descriptor = _descriptor(self._serial)
        # RFC 2217 keeps its socket to a thread of its own; its write takes a lock, which a signal handler must not.
        urgent = self._descriptor or _descriptor(getattr(self._serial, "_socket", None))
        # Windows writes to sockets and ports in other ways.
        self._urgent = urgent if os.name == "posix" else None

    def set_baud(self, baud: int) -> None:
        """Change the symbols per second without opening the port again (which would reset many boards).

        Raises:
            DeviceLostError: The port is gone.
        """
        try:
            self._serial.baudrate = baud
        except (OSError, ValueError) as error:
            raise self._lost(error) from None
        self._buffer.clear()

    def read_line(self, timeout_s: float) -> str | None:
        """The next line without its end, or None if none was complete in time.

        Empty lines are passed over. Bytes that are not ASCII come as U+FFFD.

        Args:
            timeout_s: Longest wait; 0 takes only what has come already.

        Raises:
            DeviceLostError: The port is gone.
        """
        until = time.monotonic() + timeout_s
        while True:
            line = self._cut()
            if line:
                return line
            if line is None:
                left = until - time.monotonic()
                if not self._receive(max(left, 0.0)) and left <= 0.0:
                    return None

    def lines(self, seconds: float, quiet_s: float = math.inf) -> Iterator[str]:
        """The lines that come within a time, which ends early with a silence of ``quiet_s``.

        Raises:
            DeviceLostError: The port is gone.
        """
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0.0 and (line := self.read_line(min(left, quiet_s))) is not None:
            yield line

    def forget(self) -> None:
        """Throw away whatever has come.

        Raises:
            DeviceLostError: The port is gone.
        """
        while self._receive(0.0):
            self._buffer.clear()
        self._buffer.clear()

    def write(self, data: bytes) -> None:
        """Send bytes as they are.

        Raises:
            DeviceLostError: The port is gone.
            NoAnswerError: The device takes no bytes.
        """
        import serial

        self.torn = True
        try:
            self._serial.write(data)
        except serial.SerialTimeoutException:
            raise NoAnswerError(f"{self.what} at {self.port}: takes no bytes; is it switched on?") from None
        except (OSError, TypeError, ValueError) as error:
            raise self._lost(error) from None
        self.torn = False

    def write_now(self, data: bytes) -> None:
        """Send a few bytes at once, from a signal handler too, in the middle of any other call. Never raises.

        Where the port has a descriptor this is a single ``write`` of the operating system, which neither waits nor
        takes a lock.
        """
        with contextlib.suppress(Exception):
            if self._urgent is not None:
                os.write(self._urgent, data)
            else:
                self._serial.write(data)

    def close(self) -> None:
        """Let go of the port. Never raises; a second call does nothing."""
        # The descriptor's number may soon belong to another file.
        self._descriptor = self._urgent = None
        with contextlib.suppress(Exception):
            self._serial.close()

    def _cut(self) -> str | None:
        """A whole line off the buffer; None if there is none."""
        end = self._buffer.find(b"\n", 0, LONGEST_LINE)
        if end < 0 and len(self._buffer) < LONGEST_LINE:
            return None
        line = bytes(self._buffer[:end] if end >= 0 else self._buffer[:LONGEST_LINE])
        del self._buffer[: end + 1 if end >= 0 else LONGEST_LINE]
        return line.decode("ascii", errors="replace").strip(" \t\r\0")

    def _receive(self, timeout_s: float) -> bool:
        """Move what has come into the buffer, waiting for it; whether anything came."""
        try:
            if self._descriptor is not None:
                ready = bool(select.select([self._descriptor], [], [], timeout_s)[0])
                chunk = self._serial.read(LONGEST_LINE) if ready else b""
            else:
                chunk = self._serial.read(LONGEST_LINE)
                if not chunk and timeout_s > 0.0:
                    time.sleep(min(LOOK_S, timeout_s))
        except (OSError, TypeError, ValueError) as error:
            raise self._lost(error) from None
        self._buffer += chunk
        return bool(chunk)

    def _lost(self, error: Exception) -> DeviceLostError:
        return DeviceLostError(f"{self.what} at {self.port}: is gone (unplugged or switched off): {error}")


def _opened(port: str, baud: int, what: str, write_timeout_s: float) -> Any:
    """The open pyserial object, read without waiting."""
    import serial

    # Held exclusively where the system can: two programs on one stage would mix their lines.
    own: dict[str, Any] = {"exclusive": True} if os.name == "posix" and "://" not in port else {}
    if not port.startswith("rfc2217:"):
        # pyserial's RFC 2217 has none.
        own["write_timeout"] = write_timeout_s
    try:
        return serial.serial_for_url(port, baudrate=baud, timeout=0.0, **own)
    except serial.SerialException as error:
        raise InputError(f"{what} port", port, _reason(error)) from None
    except (OSError, ValueError) as error:
        raise InputError(f"{what} port", port, f"cannot be opened: {error}") from None


def _reason(error: Any) -> str:
    """Why a port cannot be opened, and what to do."""
    if error.errno == errno.ENOENT:
        return "there is no such port; is it plugged in? `tacbench rig probe` lists the ports"
    if error.errno in (errno.EACCES, errno.EPERM):
        return "may not be opened; on Linux your user must be in the group that owns it (dialout or uucp)"
    if error.errno in (errno.EAGAIN, errno.EBUSY):
        return "is held by another program; close that first"
    return f"cannot be opened: {error}"


def _descriptor(port: Any) -> int | None:
    """The descriptor that ``select`` and ``write`` of the operating system take, if the port has one."""
    try:
        return int(port.fileno())
    except (AttributeError, OSError, ValueError):
        return None
