"""Measure how much the watch page slows a press, on the virtual rig with its drivers and with an open browser.

    python benchmarks/watch_page.py [--speed 50] [--texture 4]

A run of 150 presses is made with the page, which Debian's Chromium shows. The process of the page is stopped (SIGSTOP)
for two presses and continued for the next two, so both kinds of presses belong to the same run. The time of a press is
that of the loop itself: the time of the calls of stage, gauge, sensor and clock is subtracted. Nothing is forced to the
disk. The progress updates, which write the file that the page reads, are part of every press and are also measured
separately. Claim: the page and the updates together take less than 2 ms for each press.
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import statistics
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from playwright.sync_api import sync_playwright
from press_loop import Timed

from tacbench_cad.extensions.watch.link import opened_page
from tacbench_cad.lab.acquire.events import ProgressFile
from tacbench_cad.lab.acquire.person import Typing
from tacbench_cad.lab.acquire.progress import PressProgress, Several
from tacbench_cad.lab.acquire.session import acquire_study
from tacbench_cad.lab.acquire.study_file import virtual_study
from tacbench_cad.lab.rig.devices import OpenRig, open_rig
from tacbench_cad.lab.rig.gauge import Force
from tacbench_cad.lab.study.presses import Press
from tacbench_cad.lab.study.spec import PrintedBlock, RigSettings, WorkFrame

LIMIT_MS = 2.0
#: The presses of a pattern: with the page, without it.
PATTERN = (True, True, False, False)


class Measuring(PressProgress):
    """Stops and continues the page's process, and measures the time of each press and of the progress updates.

    Args:
        inner: The progress updates that are measured.
        page: The number of the page's process.
        seconds: The time that the devices have taken so far.
    """

    def __init__(self, inner: PressProgress, page: int, seconds: Counter[str]) -> None:
        self.inner, self.page, self.seconds = inner, page, seconds
        self.own_ms: dict[bool, list[float]] = {True: [], False: []}
        self.updates_s = 0.0
        self.count = 0
        self._start = (0.0, 0.0)

    def _timed(self, update: Callable[[], None]) -> None:
        start = time.perf_counter()
        update()
        self.updates_s += time.perf_counter() - start

    def before(self, press: Press, check: Callable[[], None]) -> None:
        """Measure the last press."""
        self._end()
        self.count += 1
        os.kill(self.page, signal.SIGCONT if PATTERN[self.count % len(PATTERN)] else signal.SIGSTOP)
        self._start = (time.perf_counter(), sum(self.seconds.values()))
        self._timed(lambda: self.inner.before(press, check))

    def felt(self, z_mm: float, force_n: float) -> None:
        """Measure the update."""
        self._timed(lambda: self.inner.felt(z_mm, force_n))

    def pressed(self, done: int, force: Force | None, in_band: bool | None, image: Path) -> None:
        """Measure the update."""
        self._timed(lambda: self.inner.pressed(done, force, in_band, image))

    def end(self) -> None:
        """Measure the last press."""
        self._end()
        os.kill(self.page, signal.SIGCONT)
        self.inner.end()

    def _end(self) -> None:
        if self.count:
            elapsed = time.perf_counter() - self._start[0] - (sum(self.seconds.values()) - self._start[1])
            self.own_ms[PATTERN[self.count % len(PATTERN)]].append(1e3 * elapsed)


def main() -> int:
    """Print the figures; the exit code is 1 if the claim does not hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--speed", type=float, default=50.0, help="times faster than real time (default 50)")
    parser.add_argument("--texture", default="4", help="default 4")
    chosen = parser.parse_args()
    seconds: Counter[str] = Counter()

    @contextmanager
    def timed_rig(settings: RigSettings, printed: PrintedBlock, frame: WorkFrame) -> Iterator[OpenRig]:
        with open_rig(settings, printed, frame) as rig:
            timed: dict[str, Any] = {
                name: Timed(getattr(rig, name), name, seconds, Counter())
                for name in ("stage", "gauge", "sensor", "clock")
            }
            yield replace(rig, **timed)

    study = virtual_study(texture=chosen.texture, speed=chosen.speed)
    protocol = study.study.protocol.changed(stationary_frames=0)
    person = Typing(lambda prompt: "", print)
    flags = ["--no-sandbox"] if hasattr(os, "geteuid") and os.geteuid() == 0 else []
    said: list[str] = []
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        out, file = Path(folder), ProgressFile(Path(folder))
        with opened_page(
            out, port=0, host="127.0.0.1", browser=False, file=file, terminal=person, say=said.append
        ) as link:
            browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=flags)
            browser.new_page().goto(said[0].split()[1])
            measuring = Measuring(Several(file, link), link.process.pid, seconds)
            acquire_study(
                replace(study.study, protocol=protocol),
                study.required_rig,
                out,
                person=person,
                progress=measuring,
                durable=False,
                opener=timed_rig,
            )
            browser.close()
        file.close()
    medians = {with_page: statistics.median(times) for with_page, times in measuring.own_ms.items()}
    updates_ms = 1e3 * measuring.updates_s / measuring.count
    slower_ms = medians[True] - medians[False]
    total_ms = max(slower_ms, 0.0) + updates_ms
    print(f"{measuring.count} presses, {chosen.speed:g} times real time, without the time of the devices and the disk")
    for with_page, name in ((True, "with the page"), (False, "page stopped")):
        times = measuring.own_ms[with_page]
        print(
            f"{name:<16} {len(times)} presses: median {medians[with_page]:.2f} ms, mean {statistics.mean(times):.2f} ms"
        )
    print(f"progress updates and their file: {updates_ms:.2f} ms for each press")
    holds = total_ms < LIMIT_MS
    print(
        f"the page slows a press by {slower_ms:+.2f} ms, with the updates by {total_ms:.2f} ms, claimed below ", end=""
    )
    load = f"; load {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors"
    print(f"{LIMIT_MS:g}: {'yes' if holds else 'NO'}{load}")
    return 0 if holds else 1


if __name__ == "__main__":
    raise SystemExit(main())
