"""Measure the time of each part of a run: 150 presses on the virtual rig, with its drivers and pseudo-terminal.

    python benchmarks/press_loop.py [--driver virtual-grbl] [--speed 50] [--texture 4] [--out DIR]

Every call of the stage, the gauge, the sensor and the clock is timed. The files are not forced to the disk. The rest of
the time is the time of the loop: planning, searching, checking, encoding, hashing and writing rows. There are no
stationary frames, so the times are for presses and for a reference frame after every 600 s of the rig's time. Claim:
less than 20 ms for each press.
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

from tacbench_cad.lab.acquire.person import Typing
from tacbench_cad.lab.acquire.progress import PressProgress
from tacbench_cad.lab.acquire.session import acquire_study
from tacbench_cad.lab.acquire.study_file import virtual_study
from tacbench_cad.lab.rig.devices import OpenRig, open_rig
from tacbench_cad.lab.rig.stage import Closing
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.lab.study.spec import PrintedBlock, RigSettings, WorkFrame

LIMIT_MS = 20.0


class Timed(Closing):
    """A device whose calls are timed. Its attributes are those of the inner device.

    Args:
        inner: The device.
        name: Its name in the table.
        seconds: Its time is added here.
        calls: Its calls are counted here.
    """

    def __init__(self, inner: Any, name: str, seconds: Counter[str], calls: Counter[str]) -> None:
        self._inner, self._name, self._seconds, self._calls = inner, name, seconds, calls

    def __getattr__(self, key: str) -> Any:
        value = getattr(self._inner, key)
        if not callable(value):
            return value

        def timed(*values: Any) -> Any:
            start = time.perf_counter()
            try:
                return value(*values)
            finally:
                self._seconds[self._name] += time.perf_counter() - start
                self._calls[self._name] += 1

        return timed


def main() -> int:
    """Print the table; the exit code is 1 if the claim does not hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--driver", default="virtual-grbl", help="virtual-grbl or virtual-marlin")
    parser.add_argument("--speed", type=float, default=50.0, help="times faster than real time (default 50)")
    parser.add_argument("--texture", default="4", help="default 4")
    parser.add_argument("--out", type=Path, help="keep the run here; default: a temporary folder")
    chosen = parser.parse_args()
    seconds: Counter[str] = Counter()
    calls: Counter[str] = Counter()
    opening = closing = 0.0

    @contextmanager
    def timed_rig(settings: RigSettings, printed: PrintedBlock, frame: WorkFrame) -> Iterator[OpenRig]:
        nonlocal opening, closing
        start = time.perf_counter()
        with open_rig(settings, printed, frame) as rig:
            opening = time.perf_counter() - start
            timed: dict[str, Any] = {
                name: Timed(getattr(rig, name), name, seconds, calls) for name in ("stage", "gauge", "sensor", "clock")
            }
            yield replace(rig, **timed)
            start = time.perf_counter()
        closing = time.perf_counter() - start

    with tempfile.TemporaryDirectory() as temporary:
        out = chosen.out or Path(temporary)
        study = virtual_study(texture=chosen.texture, driver=chosen.driver, speed=chosen.speed)
        protocol = study.study.protocol.changed(stationary_frames=0)
        run_start = time.perf_counter()
        (result,) = acquire_study(
            replace(study.study, protocol=protocol),
            study.required_rig,
            out,
            person=Typing(lambda prompt: "", print),
            progress=PressProgress(),
            opener=timed_rig,
            durable=False,
        )
        total_s = time.perf_counter() - run_start
        rows = Run.open(result.folder).rows
    presses = result.presses
    parts = {
        "opening and homing the rig": opening,
        "closing it": closing,
        "waiting for the stage": seconds["stage"],
        "waiting for the gauge": seconds["gauge"],
        "waiting for the sensor": seconds["sensor"],
        "waiting for a step to settle": seconds["clock"],
    }
    rest = total_s - sum(parts.values())
    print(f"{chosen.driver}, texture {chosen.texture}, {chosen.speed:g} times real time: {presses} presses, ", end="")
    print(f"{sum(row.in_band is True for row in rows)} in their force band, {total_s:.1f} s")
    print(f"{calls['stage'] / presses:.0f} stage, {calls['gauge'] / presses:.0f} gauge calls for each press\n")
    print(f"{'part':<32}{'s':>8}{'ms per press':>14}{'%':>7}")
    for name, elapsed_s in {**parts, "the rest of the loop": rest}.items():
        print(f"{name:<32}{elapsed_s:>8.2f}{1e3 * elapsed_s / presses:>14.2f}{100.0 * elapsed_s / total_s:>7.1f}")
    own_ms = 1e3 * rest / presses
    holds = own_ms < LIMIT_MS
    print(
        f"\nthe loop's own time: {own_ms:.1f} ms per press, claimed below {LIMIT_MS:g}: ",
        end="",
    )
    print("yes" if holds else "NO")
    return 0 if holds else 1


if __name__ == "__main__":
    raise SystemExit(main())
