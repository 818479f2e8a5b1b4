"""Lines of text over a serial port, with a limit on every wait. The lab uses no other access to serial devices.

A port is anything that pyserial opens: the path of a device, ``COM3``, or a URL (``socket://host:port``,
``rfc2217://host:port``). If the port has a file descriptor, reading waits with ``select``. The timeout is then exact,
and the port is never configured again (setting pyserial's own timeout would set unusual baud rates again).

A silence counts only while this program runs and reads. If the program is suspended (SIGSTOP, a laptop that sleeps) or
gets no processor time, the device is not to blame. All timeouts therefore use :meth:`Line.now_s`.
"""

from __future__ import annotations

import contextlib
import errno
import math
import os
import re
import select
import time
from collections.abc import Iterator
from typing import Any

from tacbench_cad.lab.rig.errors import DeviceLostError, NoAnswerError
from tacbench_cad.lab.rig.stage import Closing
from tacbench_cad.util.errors import InputError

#: The longest line, in bytes. Noise without an end of line is cut at this length.
MAX_LINE = 4096
#: The pause between two reads of a port on which ``select`` cannot wait (Windows), in s.
POLL_S = 0.001
#: The longest single wait for bytes, in s. Longer waits consist of several.
WAIT_S = 0.1
#: The longest time between two calls of ``now_s`` that counts, in s. A longer one was a pause of this program.
MAX_COUNTED_S = 0.25


class Line(Closing):
    """A serial port that sends and receives lines.

    Args:
        port: The path, name or pyserial URL of the port.
        baud: The baud rate; without effect for a pseudo-terminal or a socket.
        what: The device, for error messages: ``stage``.
        write_timeout_s: The longest time for a write, in s (``rfc2217://`` does not support it).

    Attributes:
        port: The port.
        what: The device, for error messages.
        torn: Whether an exception interrupted a write, so that the device may have received half a line.

    Raises:
        InputError: The port does not exist, may not be opened, or is in use by another program.
    """

    def __init__(self, port: str, *, baud: int, what: str, write_timeout_s: float = 2.0) -> None:
        self.port = port
        self.what = what
        self.torn = False
        self._buffer = bytearray()
        self._counted_s, self._seen_s = 0.0, time.monotonic()
        self._serial = _opened(port, baud, what, write_timeout_s)
        self._descriptor = _descriptor(self._serial)
        # RFC 2217 uses its socket in its own thread. Its write takes a lock, which a signal handler must not do.
        urgent = self._descriptor or _descriptor(getattr(self._serial, "_socket", None))
        # Windows writes to sockets and ports with other functions.
        self._urgent = urgent if os.name == "posix" else None

    def now_s(self) -> float:
        """Return the time in s since the port was opened, without the pauses of this program."""
        now = time.monotonic()
        self._counted_s += min(now - self._seen_s, MAX_COUNTED_S)
        self._seen_s = now
        return self._counted_s

    def set_baud(self, baud: int) -> None:
        """Change the baud rate without opening the port again, which would reset many boards.

        Raises:
            DeviceLostError: The port is gone.
        """
        try:
            self._serial.baudrate = baud
        except (OSError, ValueError) as error:
            raise self._lost(error) from None
        self._buffer.clear()

    def read_line(self, timeout_s: float) -> str | None:
        """Return the next line without its end of line, or None if no complete line arrived in time.

        Empty lines are skipped. Bytes that are not ASCII become U+FFFD.

        Args:
            timeout_s: The longest wait in s; 0 returns only a line that has already arrived.

        Raises:
            DeviceLostError: The port is gone.
        """
        until = self.now_s() + timeout_s
        while True:
            line = self._cut()
            if line:
                return line
            if line is None:
                left = until - self.now_s()
                if not self._receive(min(max(left, 0.0), WAIT_S)) and left <= 0.0:
                    return None

    def match(self, pattern: re.Pattern[bytes], timeout_s: float) -> str | None:
        """Return the first text that fits a pattern, or None if none arrived in time. Everything before it is dropped.

        Args:
            pattern: The pattern of an answer that no end of line ends.
            timeout_s: The longest wait in s.

        Raises:
            DeviceLostError: The port is gone.
        """
        until = self.now_s() + timeout_s
        while (found := pattern.search(self._buffer)) is None:
            left = until - self.now_s()
            if not self._receive(min(max(left, 0.0), WAIT_S)) and left <= 0.0:
                return None
            del self._buffer[:-MAX_LINE]
        text = found[0].decode("ascii", errors="replace")
        del self._buffer[: found.end()]
        return text

    def lines(self, seconds: float, quiet_s: float = math.inf) -> Iterator[str]:
        """Yield the lines that arrive within a time. It ends earlier after a silence of ``quiet_s``.

        Raises:
            DeviceLostError: The port is gone.
        """
        until = self.now_s() + seconds
        while (left := until - self.now_s()) > 0.0 and (line := self.read_line(min(left, quiet_s))) is not None:
            yield line

    def forget(self) -> None:
        """Discard everything that has arrived.

        Raises:
            DeviceLostError: The port is gone.
        """
        while self._receive(0.0):
            self._buffer.clear()
        self._buffer.clear()

    def write(self, data: bytes) -> None:
        """Send bytes unchanged.

        Raises:
            DeviceLostError: The port is gone.
            NoAnswerError: The device does not accept the bytes.
        """
        import serial

        self.torn = True
        try:
            self._serial.write(data)
        except serial.SerialTimeoutException:
            raise NoAnswerError(f"{self.what} at {self.port}: accepts no data; check that it is on") from None
        except (OSError, TypeError, ValueError) as error:
            raise self._lost(error) from None
        self.torn = False

    def write_now(self, data: bytes) -> None:
        """Send a few bytes immediately. Signal handlers may call this during any other call. Never raises.

        If the port has a file descriptor, this is a single ``write`` of the operating system, which neither waits nor
        takes a lock.
        """
        with contextlib.suppress(Exception):
            if self._urgent is not None:
                os.write(self._urgent, data)
            else:
                self._serial.write(data)

    def close(self) -> None:
        """Close the port. Never raises; a second call has no effect."""
        # The number of the descriptor may soon belong to another file.
        self._descriptor = self._urgent = None
        with contextlib.suppress(Exception):
            self._serial.close()

    def _cut(self) -> str | None:
        """Remove a complete line from the buffer and return it; None if there is none."""
        end = self._buffer.find(b"\n", 0, MAX_LINE)
        if end < 0 and len(self._buffer) < MAX_LINE:
            return None
        line = bytes(self._buffer[:end] if end >= 0 else self._buffer[:MAX_LINE])
        del self._buffer[: end + 1 if end >= 0 else MAX_LINE]
        return line.decode("ascii", errors="replace").strip(" \t\r\0")

    def _receive(self, timeout_s: float) -> bool:
        """Wait for bytes and move them into the buffer; return whether any arrived."""
        try:
            if self._descriptor is not None:
                ready = bool(select.select([self._descriptor], [], [], timeout_s)[0])
                chunk = self._serial.read(MAX_LINE) if ready else b""
            else:
                chunk = self._serial.read(MAX_LINE)
                if not chunk and timeout_s > 0.0:
                    time.sleep(min(POLL_S, timeout_s))
        except (OSError, TypeError, ValueError) as error:
            raise self._lost(error) from None
        self._buffer += chunk
        return bool(chunk)

    def _lost(self, error: Exception) -> DeviceLostError:
        return DeviceLostError(f"{self.what} at {self.port}: is gone (unplugged or switched off): {error}")


def _opened(port: str, baud: int, what: str, write_timeout_s: float) -> Any:
    """Open the port with pyserial, for reading without waiting."""
    import serial

    # The port is opened exclusively if the system allows it. Two programs on one stage would mix their lines.
    own: dict[str, Any] = {"exclusive": True} if os.name == "posix" and "://" not in port else {}
    if not port.startswith("rfc2217:"):
        # pyserial's RFC 2217 does not support a write timeout.
        own["write_timeout"] = write_timeout_s
    try:
        return serial.serial_for_url(port, baudrate=baud, timeout=0.0, **own)
    except serial.SerialException as error:
        raise InputError(f"{what} port", port, _reason(error)) from None
    except (OSError, ValueError) as error:
        raise InputError(f"{what} port", port, f"cannot be opened: {error}") from None


def _reason(error: Any) -> str:
    """Return why a port cannot be opened, and what to do."""
    if error.errno == errno.ENOENT:
        return "does not exist; check that the device is plugged in (`tacbench rig probe` lists the ports)"
    if error.errno in (errno.EACCES, errno.EPERM):
        return "may not be opened; on Linux, add your user to the group that owns it (dialout or uucp)"
    if error.errno in (errno.EAGAIN, errno.EBUSY):
        return "is in use by another program; close that program first"
    return f"cannot be opened: {error}"


def _descriptor(port: Any) -> int | None:
    """Return the file descriptor for the operating system's ``select`` and ``write``, or None if there is none."""
    try:
        return int(port.fileno())
    except (AttributeError, OSError, ValueError):
        return None
