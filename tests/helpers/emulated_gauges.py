"""Emulated force gauges on a pseudo-terminal. Each answers as the manual of its make says. They are no recordings."""

from __future__ import annotations

import os
import select
import threading
import tty
from collections.abc import Callable

import numpy as np


class EmulatedGauge:
    """A gauge that answers each question.

    Args:
        question: The question that it understands.
        answer: Returns the answer for a force in N, which is positive in compression.
    """

    def __init__(self, question: bytes, answer: Callable[[float], bytes]) -> None:
        self.question, self.answer = question, answer
        self.force_n, self.silent, self.asked = 0.0, False, 0
        self._random = np.random.default_rng(4)
        self._master, slave = os.openpty()
        tty.setraw(slave)
        self._slave, self.port = slave, os.ttyname(slave)
        self._running = True
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._running = False
        self._thread.join()
        os.close(self._master)
        os.close(self._slave)

    def put(self, mass_g: float) -> None:
        self.force_n = 9.80665e-3 * mass_g

    def _serve(self) -> None:
        heard = b""
        while self._running:
            if not select.select([self._master], [], [], 0.01)[0]:
                continue
            heard += os.read(self._master, 256)
            while self.question in heard:
                _, _, heard = heard.partition(self.question)
                self.asked += 1
                if not self.silent:
                    os.write(self._master, self.answer(self.force_n + float(self._random.normal(0.0, 0.0005))))


def mark_10() -> EmulatedGauge:
    """A Mark-10 gauge in newtons."""
    return EmulatedGauge(b"?\r\n", lambda force_n: f"{force_n:.3f} N\r\n".encode())


def sauter() -> EmulatedGauge:
    """A Sauter FH gauge in newtons: 0 for compression, then six characters without an end of line."""
    return EmulatedGauge(b"9", lambda force_n: f"{0 if force_n >= 0 else 1}{abs(force_n):06.3f}".encode())


def imada() -> EmulatedGauge:
    """An Imada DST gauge in newtons, showing the present value."""
    return EmulatedGauge(b"D\r", lambda force_n: f"{force_n:+08.3f}NTO\r".encode())
