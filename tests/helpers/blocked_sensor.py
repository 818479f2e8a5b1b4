"""A user's sensor whose ``read`` blocks for ever in one of several ways, once the file ``block`` names the way."""

from __future__ import annotations

import contextlib
import ctypes
import os
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tacbench_cad.lab.rig.stage import Closing


def in_sleep() -> None:
    time.sleep(1e6)


def in_a_lock() -> None:
    lock = threading.Lock()
    lock.acquire()
    lock.acquire()


def in_a_pipe() -> None:
    os.read(os.pipe()[0], 1)


def in_a_pipe_that_is_read_again_after_every_exception() -> None:
    pipe, _ = os.pipe()
    while True:
        with contextlib.suppress(BaseException):
            os.read(pipe, 1)


def in_a_call_of_c_that_no_signal_ends() -> None:
    mutex = ctypes.create_string_buffer(64)
    library = ctypes.CDLL(None)
    library.pthread_mutex_lock(mutex)
    library.pthread_mutex_lock(mutex)


def by_raising() -> None:
    raise KeyError("lens")


WAYS: dict[str, Callable[[], None]] = {
    way.__name__: way
    for way in (
        in_sleep,
        in_a_lock,
        in_a_pipe,
        in_a_pipe_that_is_read_again_after_every_exception,
        in_a_call_of_c_that_no_signal_ends,
        by_raising,
    )
}


class Sensor(Closing):
    """Random images. The frame of the fifth press, after the reference, blocks."""

    def __init__(self) -> None:
        self.name, self.units, self.shape, self.simulated = "blocked", "counts", (48, 64), ""
        self.settings: dict[str, Any] = {"requested": {}, "actual": {}}
        self.count = 0
        self.random = np.random.default_rng(time.time_ns())

    def read(self) -> np.ndarray:
        self.count += 1
        order = Path("block")
        if self.count == 6 and order.exists():
            way = order.read_text()
            order.rename("blocking")
            WAYS[way]()
        return self.random.integers(0, 255, self.shape, dtype=np.uint8)

    def close(self) -> None: ...
