"""Signals: SIGINT, SIGTERM and SIGHUP end a run in an orderly way, also if a device does not return.

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
import time
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import tacbench_cad
from tacbench_cad.lab.acquire.safety import DEVICE_S, RETRY_S, Carriage, RunInterruptedError, undisturbed

#: The time in s that the main thread has to handle a signal before another thread stops the stage.
HANDLER_S = 0.02
#: The time in s that the thread of the run has to notice a signal before another thread lifts the sensor.
GRACE_S = 0.5
#: The longest wait for the end of a lift after a second signal, in s.
LIFT_S = 20.0
#: The exit code of a process that a signal has ended.
EXIT_CODE = 130
#: The folder of this project's own code.
_PACKAGE = str(Path(tacbench_cad.__file__).parent)


class Signals:
    """Turns SIGINT, SIGTERM and SIGHUP into an orderly end.

    While a block is pressed, the signals go to the carriage, which stops. At other times (a question to the user, the
    opening of devices) they raise a ``RunInterruptedError`` at once. Outside the main thread, no signal is handled.

    If the main thread does not return from a device, another thread lifts the sensor after the first signal. The second
    signal, or a time limit, gives the device up: if no exception can reach the main thread, the process ends.

    Args:
        give_up: Called in another thread before the process ends, with the interruption.
    """

    def __init__(self, give_up: Callable[[RunInterruptedError], None] = lambda error: None) -> None:
        self._give_up, self._leaving = give_up, threading.Lock()
        self._carriage: Carriage | None = None
        self._say: Callable[[str], None] = lambda message: None
        self._ignoring: object = None
        self._previous: dict[int, Any] = {}
        self._listening = contextlib.ExitStack()
        #: Whether the sensor was lifted at the end of the last block; None before the first one.
        self._lifted: bool | None = None
        #: The number of signals that the main thread has handled, and this number when the carriage was given.
        self._handled = self._first = 0
        self._left = threading.Event()

    def __enter__(self) -> Signals:
        if threading.current_thread() is threading.main_thread():
            names = [name for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
            for number in (getattr(signal, name) for name in names):
                self._previous[number] = signal.signal(number, self._caught)
            self._listening.enter_context(_heard(self._previous, self._heard))
        return self

    def __exit__(self, *_: object) -> None:
        self._listening.close()
        for number, handler in self._previous.items():
            signal.signal(number, handler)
        self._previous.clear()

    @contextlib.contextmanager
    def sent_to(self, carriage: Carriage, say: Callable[[str], None] = lambda message: None) -> Iterator[None]:
        """Send the signals to a carriage while the body runs.

        Args:
            carriage: The carriage.
            say: Receives a message if the main thread does not return from a device.
        """
        self._carriage, self._say, self._first = carriage, undisturbed(say), self._handled
        carriage.go_on()
        self._left.clear()
        try:
            yield
        finally:
            self._carriage, self._lifted = None, carriage.lifted
            self._left.set()

    @contextlib.contextmanager
    def raised(self) -> Iterator[None]:
        """Raise signals at once while the body asks the person. The sensor must be lifted."""
        carriage, self._carriage = self._carriage, None
        try:
            yield
        finally:
            self._carriage = carriage

    @contextlib.contextmanager
    def ignored(self) -> Iterator[None]:
        """Ignore the signals while the body lifts the sensor, but not for ever."""
        self._ignoring = object()
        try:
            yield
        finally:
            self._ignoring = None

    def _caught(self, number: int, frame: FrameType | None) -> None:
        """Handle a signal in the main thread."""
        name, carriage = signal.Signals(number).name, self._carriage
        self._handled += 1
        if self._ignoring:
            return
        if carriage is None:
            error = RunInterruptedError(name)
            error.lifted = self._lifted
            raise error
        carriage.interrupt(name)
        if self._handled > self._first + 1 and not carriage.noticed.is_set() and not carriage.is_in_use:
            error = RunInterruptedError(name)
            error.gave_up = _waiting_place(frame)
            raise error

    def _heard(self, name: str, before: int) -> None:
        """Handle a signal in a thread of its own, since the main thread may not return from a call.

        Args:
            name: The signal.
            before: The number of signals before it.
        """
        carriage, first = self._carriage, self._first
        ignoring = self._ignoring
        if before < first:
            return
        time.sleep(HANDLER_S)
        if carriage is not None and self._handled <= before:
            carriage.interrupt(name)
        if ignoring is not None:
            time.sleep(RETRY_S)
            if self._ignoring is not ignoring:
                return
        elif carriage is None:
            time.sleep(GRACE_S if before else DEVICE_S)
            if self._handled > before:
                return
        elif before == first:
            if carriage.noticed.wait(GRACE_S) or first != self._first:
                return
            lifted = carriage.rescue() or "the sensor is lifted"
            if not carriage.noticed.is_set():
                self._say(f"{lifted}; waiting {DEVICE_S:g} s for {_waiting_place()}; another Ctrl-C gives it up")
            if carriage.noticed.wait(DEVICE_S):
                return
        elif carriage.noticed.wait(GRACE_S):
            # The main thread lifts the sensor or checks the position, and then ends.
            if self._left.wait(LIFT_S):
                return
        else:
            carriage.rescued.wait(LIFT_S)
        if self._leaving.acquire(blocking=False):
            error = RunInterruptedError(name)
            error.lifted = self._lifted if carriage is None else carriage.lifted
            error.gave_up = _waiting_place()
            try:
                self._give_up(error)
            finally:
                _leave()


@contextlib.contextmanager
def _heard(numbers: Collection[int], caught: Callable[[str, int], None]) -> Iterator[None]:
    """Receive signals in a thread during the body, also while the main thread does not return from a call.

    Args:
        numbers: The numbers of the signals, whose handlers must be installed.
        caught: Called with the name of each signal and the number of signals before it, each time in a new thread.
    """
    receiver, sender = socket.socketpair()
    sender.setblocking(False)
    count = itertools.count()

    def listen() -> None:
        with receiver, contextlib.suppress(OSError):
            while data := receiver.recv(64):
                for number in filter(numbers.__contains__, data):
                    arguments = (signal.Signals(number).name, next(count))
                    threading.Thread(target=caught, args=arguments, daemon=True).start()

    previous = signal.set_wakeup_fd(sender.fileno(), warn_on_full_buffer=False)
    threading.Thread(target=listen, daemon=True).start()
    try:
        yield
    finally:
        signal.set_wakeup_fd(previous)
        sender.close()


def _waiting_place(frame: FrameType | None = None) -> str:
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


def _leave() -> None:
    """End the process at once. A call that does not return would prevent every other end."""
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(Exception):
            stream.flush()
    os._exit(EXIT_CODE)
