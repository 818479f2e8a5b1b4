"""The ports of a virtual device: a pseudo-terminal behind a link with a stable name, or a TCP port."""

from __future__ import annotations

import contextlib
import errno
import os
import select
import socket
from pathlib import Path

from tacbench_cad.util.errors import MissingToolError


class Pty:
    """A pseudo-terminal behind a link with a stable name, as in ``/dev/serial/by-id``.

    Args:
        link: The path of the link.

    Attributes:
        name: The name that a host opens.
        opened: Whether a host has it open.

    Raises:
        MissingToolError: The system has no pseudo-terminals.
    """

    def __init__(self, link: Path) -> None:
        self.name = str(link)
        self.opened = False
        self._link = link
        self._master: int | None = None
        self.plug()

    def watched(self) -> int | None:
        """Return the descriptor to select on; None if :meth:`look` must be called regularly instead.

        A closed terminal reports a hang-up continuously, so select is of no use then.
        """
        return self._master if self.opened else None

    def look(self) -> bool:
        """Check for hosts that open or close the port; return whether one has opened it since the last call."""
        if self._master is None or self.opened:
            return False
        poll = select.poll()
        poll.register(self._master, select.POLLIN)
        events = poll.poll(0)
        self.opened = not events or bool(events[0][1] & select.POLLIN)
        return self.opened

    def read(self, limit: int) -> bytes:
        """Return at most ``limit`` bytes that the host wrote; empty if there are none."""
        if self._master is None or limit <= 0:
            return b""
        try:
            data = os.read(self._master, limit)
        except BlockingIOError:
            return b""
        except OSError as error:
            if error.errno != errno.EIO:
                raise
            data = b""
        # The last host closed the port: an error on Linux, an end of file elsewhere.
        self.opened = bool(data)
        return data

    def write(self, data: bytes) -> None:
        """Send bytes. Those that no host reads are lost."""
        if self._master is not None and self.opened:
            with contextlib.suppress(OSError):
                os.write(self._master, data)

    def unplug(self) -> None:
        """Pull the cable: the host's port fails, and the bytes in it are lost."""
        if self._master is not None:
            os.close(self._master)
            self._master = None
        self._link.unlink(missing_ok=True)
        self.opened = False

    def plug(self) -> None:
        """Put the cable back: the same name can be opened again."""
        try:
            import tty

            self._master, slave = os.openpty()
        except (ImportError, AttributeError) as error:
            raise MissingToolError("this system has no pseudo-terminals; use --tcp") from error
        tty.setraw(slave)
        device = os.ttyname(slave)
        # The slave is closed here, so that opening and closing by a host can be noticed.
        os.close(slave)
        os.set_blocking(self._master, False)
        self._link.unlink(missing_ok=True)
        self._link.symlink_to(device)


class Tcp:
    """A TCP port on this machine that serves one host at a time; see :class:`Pty`.

    Args:
        port: The number of the port; 0 for any free one.
    """

    def __init__(self, port: int = 0) -> None:
        self.opened = False
        self._port = port
        self._listener: socket.socket | None = None
        self._host: socket.socket | None = None
        self.plug()
        self.name = f"socket://127.0.0.1:{self._port}"

    def watched(self) -> socket.socket | None:
        """See :class:`Pty`."""
        return self._host if self._host is not None else self._listener

    def look(self) -> bool:
        """See :class:`Pty`."""
        if self._listener is None or self._host is not None:
            return False
        try:
            self._host, _ = self._listener.accept()
        except BlockingIOError:
            return False
        self._host.setblocking(False)
        self._host.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.opened = True
        return True

    def read(self, limit: int) -> bytes:
        """See :class:`Pty`."""
        if self._host is None or limit <= 0:
            return b""
        try:
            data = self._host.recv(limit)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._hang_up()
        return data

    def write(self, data: bytes) -> None:
        """See :class:`Pty`."""
        if self._host is not None:
            with contextlib.suppress(OSError):
                self._host.send(data)

    def unplug(self) -> None:
        """See :class:`Pty`."""
        self._hang_up()
        if self._listener is not None:
            self._listener.close()
            self._listener = None

    def plug(self) -> None:
        """See :class:`Pty`."""
        self._listener = socket.create_server(("127.0.0.1", self._port))
        self._listener.setblocking(False)
        self._port = self._listener.getsockname()[1]

    def _hang_up(self) -> None:
        if self._host is not None:
            self._host.close()
        self._host, self.opened = None, False


Endpoint = Pty | Tcp
