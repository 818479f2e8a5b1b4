"""Measure the time of a press at real speed, relative to the time for which its motors move.

    python benchmarks/press_time.py [--driver virtual-grbl virtual-marlin] [--texture 4]

A study is pressed on a virtual rig that is not faster than real time: two positions, the paper's three forces, two
repeats. The first press of the block, which begins without any known height, is not counted. The time of the motion is
computed from every move that the stage was asked for: a stroke from rest to rest with the speed and the acceleration of
the virtual machine. The rest of the time is spent waiting for answers, for forces and for a frame. The table shows
where. Claim: a press takes at most twice the time of its motion, also on a busy machine.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from tacbench_cad.extensions.virtual_rig.machine import Stroke, along_path
from tacbench_cad.lab.acquire.person import Typing
from tacbench_cad.lab.acquire.progress import PressProgress
from tacbench_cad.lab.acquire.session import acquire_study
from tacbench_cad.lab.acquire.study_file import virtual_study
from tacbench_cad.lab.rig.devices import OpenRig, open_rig
from tacbench_cad.lab.rig.gauge import Force
from tacbench_cad.lab.rig.stage import Closing
from tacbench_cad.lab.study.spec import Point, PrintedBlock, RigSettings, WorkFrame
from tacbench_cad.spec.protocol import PressGrid

LIMIT = 2.0
#: The highest speeds and the accelerations of the virtual machines, in mm and s.
MACHINES = {
    "virtual-grbl": ((50.0, 50.0, 15.0), (200.0, 200.0, 100.0)),
    "virtual-marlin": ((100.0, 100.0, 10.0), (500.0, 500.0, 100.0)),
}


class Timed(Closing):
    """A device whose calls are timed.

    Args:
        inner: The device.
        name: Its name in the table.
        parts: The seconds and the number of the calls by the name of the device and of the method.
        machine: The highest speeds and the accelerations of the stage.
    """

    def __init__(self, inner: Any, name: str, parts: Parts, machine: tuple[Point, Point]) -> None:
        self._inner, self._name, self._parts, self._machine = inner, name, parts, machine
        self._at: Point | None = None

    def __getattr__(self, key: str) -> Any:
        value = getattr(self._inner, key)
        if not callable(value):
            return value

        def timed(*values: Any) -> Any:
            start = time.perf_counter()
            try:
                return value(*values)
            finally:
                self._parts.add(f"{self._name}.{key}", time.perf_counter() - start)

        return timed

    def move(self, target_mm: Point, speed_mm_s: float) -> Point:
        """Move, and add the time of the motion."""
        start_mm = self._at or self._inner.position()
        start = time.perf_counter()
        self._at = end_mm = self._inner.move(target_mm, speed_mm_s)
        self._parts.add("stage.move", time.perf_counter() - start)
        peaks, accelerations = self._machine
        if start_mm != end_mm:
            stroke = Stroke(
                start=start_mm,
                end=end_mm,
                peak_mm_s=min(speed_mm_s, along_path(start_mm, end_mm, peaks)),
                acceleration_mm_s2=along_path(start_mm, end_mm, accelerations),
                begin_s=0.0,
            )
            self._parts.add("motion", stroke.end_s)
        return end_mm


class Parts(PressProgress):
    """The parts of the time since the first press."""

    def __init__(self) -> None:
        self.seconds: Counter[str] = Counter()
        self.calls: Counter[str] = Counter()
        self.presses, self.in_band, self.start_s, self.total_s = -1, 0, 0.0, 0.0

    def add(self, name: str, seconds: float) -> None:
        """Add a call."""
        self.seconds[name] += seconds
        self.calls[name] += 1

    def pressed(self, done: int, force: Force | None, in_band: bool | None, reading: Path) -> None:
        """Count a press. The first one starts the measurement."""
        self.presses += 1
        if self.presses == 0:
            self.seconds.clear()
            self.calls.clear()
            self.start_s = time.perf_counter()
        else:
            self.in_band += in_band is True
            self.total_s = time.perf_counter() - self.start_s
            self.last = (self.seconds.copy(), self.calls.copy())


def measure(driver: str, texture: str) -> Parts:
    """Press a small study at real speed."""
    parts = Parts()

    @contextmanager
    def timed_rig(settings: RigSettings, printed: PrintedBlock, frame: WorkFrame) -> Iterator[OpenRig]:
        with open_rig(settings, printed, frame) as rig:
            names = ("stage", "gauge", "sensor", "clock")
            timed: dict[str, Any] = {name: Timed(getattr(rig, name), name, parts, MACHINES[driver]) for name in names}
            yield replace(rig, **timed)

    study = virtual_study(texture=texture, driver=driver, speed=1.0)
    grid = PressGrid(x_mm=(4.0, 9.0), y_mm=(18.0,))
    protocol = study.study.protocol.changed(stationary_frames=0, home_every=0, grid=grid)
    with tempfile.TemporaryDirectory() as out:
        acquire_study(
            replace(study.study, protocol=protocol),
            study.required_rig,
            Path(out),
            person=Typing(lambda prompt: "", print),
            progress=parts,
            opener=timed_rig,
        )
    return parts


def main() -> int:
    """Print the tables; the exit code is 1 if the claim does not hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--driver", nargs="+", default=list(MACHINES), choices=list(MACHINES), help="default: both")
    parser.add_argument("--texture", default="4", help="default 4")
    chosen = parser.parse_args()
    holds = True
    for driver in chosen.driver:
        parts = measure(driver, chosen.texture)
        seconds, calls = parts.last
        presses, ratio = parts.presses, parts.total_s / seconds["motion"]
        holds = holds and ratio <= LIMIT
        print(f"{driver}, texture {chosen.texture}: {presses} presses, {parts.in_band} in their force band")
        print(f"{parts.total_s / presses:.2f} s per press, {seconds['motion'] / presses:.2f} s of motion, ", end="")
        print(f"{ratio:.2f} times the motion\n\n{'part':<20}{'s per press':>12}{'calls':>8}{'ms each':>9}")
        for name, spent_s in seconds.most_common():
            number = calls[name]
            print(f"{name:<20}{spent_s / presses:>12.3f}{number / presses:>8.1f}{1e3 * spent_s / number:>9.1f}")
        print()
    print(f"claimed at most {LIMIT:g} times: {'yes' if holds else 'NO'}")
    return 0 if holds else 1


if __name__ == "__main__":
    raise SystemExit(main())
