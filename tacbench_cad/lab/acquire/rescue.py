"""The end of a run whose thread does not return from a device.

Python runs a signal handler in the main thread, and not before a call into the system or into a library has returned.
Signals are therefore also received in a thread of their own, which lifts the sensor and can end the process.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import signal
import socket
import sys
import threading
from collections.abc import Callable, Collection
from pathlib import Path
from types import FrameType, TracebackType
from typing import Self

import tacbench_cad

#: The exit code of a process that a signal has ended.
EXIT_CODE = 130
#: The folder of this project's own code.
_PACKAGE = str(Path(tacbench_cad.__file__).parent)


class Listener:
    """Receives signals in a thread, also while the main thread does not return from a call.

    Args:
        numbers: The numbers of the signals, whose handlers must be installed.
        caught: Called with the name of each signal and the number of signals before it, each time in a new thread.
    """

    def __init__(self, numbers: Collection[int], caught: Callable[[str, int], None]) -> None:
        self._numbers, self._caught = frozenset(numbers), caught
        self._count = itertools.count()

    def __enter__(self) -> Self:
        self._receiver, self._sender = socket.socketpair()
        self._sender.setblocking(False)
        self._previous = signal.set_wakeup_fd(self._sender.fileno(), warn_on_full_buffer=False)
        threading.Thread(target=self._listen, daemon=True).start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        signal.set_wakeup_fd(self._previous)
        self._sender.close()

    def _listen(self) -> None:
        with self._receiver, contextlib.suppress(OSError):
            while data := self._receiver.recv(64):
                for number in filter(self._numbers.__contains__, data):
                    arguments = (signal.Signals(number).name, next(self._count))
                    threading.Thread(target=self._caught, args=arguments, daemon=True).start()


def waiting_place(frame: FrameType | None = None) -> str:
    """Return where the main thread waits: ``read() in my_sensor.py, line 12``.

    Args:
        frame: The innermost frame of the main thread; None to look it up.
    """
    main = threading.main_thread().ident
    frame = frame or (sys._current_frames().get(main) if main is not None else None)
    place = frame
    # The call from our code into a driver tells more than what the driver calls.
    while frame is not None and not frame.f_code.co_filename.startswith(_PACKAGE):
        place, frame = frame, frame.f_back
    if place is None:
        return "a device"
    return f"{place.f_code.co_name}() in {place.f_code.co_filename}, line {place.f_lineno}"


def leave() -> None:
    """End the process at once. A call that does not return would prevent every other end."""
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(Exception):
            stream.flush()
    os._exit(EXIT_CODE)
