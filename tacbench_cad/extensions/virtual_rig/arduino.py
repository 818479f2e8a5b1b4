"""The paper's own stage firmware (an Arduino sketch), as far as its protocol is known.

The following is known. It uses 921600 baud and lines of ASCII that end in a line feed. Its commands are ``RESET``,
``CALIB``, ``ZERO``, ``MOVE,x,y,z,step``, ``CENTRE`` and ``SHOW``. A reply ends with a line that contains ``done``. The
units are motor steps. The rest is our interpretation: x, y, z are steps from the zero, ``step`` is the pause between
two steps in microseconds, ``SHOW`` returns the three counters, ``RESET`` moves off a closed end stop before it looks
for it, and ``CALIB`` is ``RESET`` followed by ``CENTRE``. As in a simple sketch, the firmware reads nothing while it
moves, checks nothing, takes a missing number as 0, ignores unknown commands, and can be stopped only by a reset.
"""

from __future__ import annotations

import re

from tacbench_cad.extensions.virtual_rig.base import Firmware, Program
from tacbench_cad.extensions.virtual_rig.machine import VirtualCarriage

_LINE_SIGNS = 200
_PEAK_MM_S = 40.0
_HOME_MM_S = 20.0
_ACCELERATION_MM_S2 = 400.0
#: The distance moved off a closed end stop before homing, in mm; more than an axis can move beyond it.
_BACK_OFF_MM = 5.0
_MAX_STEPS = 2**31 - 1


class Arduino(Firmware):
    """The paper's firmware.

    Args:
        carriage: The carriage. ``RESET`` sets the counters to 0 at the end stops, with z at the top.
        boot_s: The time from a reset until it reads, in s. It sends nothing then.
    """

    baud = 921600
    rx_bytes = 64

    def __init__(self, carriage: VirtualCarriage, *, boot_s: float = 1.0) -> None:
        super().__init__(carriage, boot_s=boot_s)

    def _alarm(self) -> None:
        """Hang until a reset."""
        self.carriage.halt(self.now_s)
        self._listening = False
        self._run(iter(()))

    def _main(self) -> Program:
        line = ""
        while True:
            yield lambda: bool(self._rx)
            sign = chr(self._rx.pop(0))
            if sign != "\n":
                line += sign if len(line) < _LINE_SIGNS else ""
                continue
            command, line = line.strip(), ""
            yield from self._do(command)

    def _do(self, command: str) -> Program:
        word, *rest = command.split(",")
        if word == "RESET":
            yield from self._home()
        elif word == "CALIB":
            yield from self._home()
            yield from self._centre()
        elif word == "ZERO":
            self.carriage.count_as((0.0, 0.0, 0.0))
        elif word == "MOVE":
            numbers = [_whole(word) for word in [*rest, "", "", "", ""][:4]]
            yield from self._move(numbers[:3], numbers[3])
        elif word == "CENTRE":
            yield from self._centre()
        elif word == "SHOW":
            x, y, z = self._steps()
            self._send(f"{x},{y},{z}\n")
        else:
            return
        self._send("done\n")

    def _steps(self) -> list[int]:
        counted = self.carriage.counted(self.now_s)
        return [round(value * axis.steps_per_mm) for value, axis in zip(counted, self.carriage.axes, strict=True)]

    def _move(self, steps: list[int], pause_us: int) -> Program:
        x, y, z = (count / axis.steps_per_mm for count, axis in zip(steps, self.carriage.axes, strict=True))
        per_mm = min(axis.steps_per_mm for axis in self.carriage.axes)
        speed = min(_PEAK_MM_S, 1e6 / (max(1, pause_us) * per_mm))
        self.carriage.go((x, y, z), speed, _ACCELERATION_MM_S2, self.now_s)
        yield self._at_rest

    def _centre(self) -> Program:
        x, y, _ = ((axis.low_mm + axis.high_mm) / 2.0 * axis.steps_per_mm for axis in self.carriage.axes)
        yield from self._move([round(x), round(y), self._steps()[2]], 1)

    def _home(self) -> Program:
        for i in (2, 0, 1):
            axis = self.carriage.axes[i]
            self._homing = i
            # First off the end stop: a carriage that was driven beyond it would otherwise have its zero there.
            away = [-_BACK_OFF_MM] if i in self.carriage.pressed(self.now_s) else []
            for by_mm in (*away, 1.5 * axis.travel_mm):
                self._shove(i, by_mm * axis.home, _HOME_MM_S, _ACCELERATION_MM_S2)
                yield self._at_rest
        self._homing = None
        self.carriage.count_as((0.0, 0.0, 0.0))


def _whole(text: str) -> int:
    """Return the whole number at the start of a text, limited to 32 bits; 0 if there is none."""
    digits = re.match(r"\s*(-?\d{1,12})", text, re.ASCII)
    number = int(digits[1]) if digits else 0
    return max(-_MAX_STEPS, min(_MAX_STEPS, number))
