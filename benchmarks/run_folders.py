"""Measure run folders: writing a press, checking the paper's 8,100 images, importing the authors' files.

    python benchmarks/run_folders.py [--runs 54]

The images are 640 x 480 grey with 133 bright markers and read noise, like those of a TacTip. The check reads hard
links to one run of 150 images, so the speed of the disk does not count. The memory of the import is the peak of its
process, mapped files included. Claims: 8,100 images are checked within a minute on four cores, and importing six
blocks takes no more memory than importing two.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from tacbench_cad.lab.runs.checking import check_run
from tacbench_cad.lab.runs.info import RunInfo
from tacbench_cad.lab.runs.run_writer import RunWriter
from tacbench_cad.lab.study.spec import HolderRim, PrintedBlock, Protocol, WorkFrame
from tacbench_cad.spec.block import Block

#: The number of markers in each ring, 133 in total.
PINS = (1, 12, 12, 12, 24, 24, 24, 24)
LIMIT_S = 60.0
LIMIT_GROWTH = 1.1
#: A program that imports blocks one after the other and prints its peak memory in bytes.
IMPORT = """
import resource, sys
from pathlib import Path
from tacbench_cad.lab import import_samples
import_samples([Path(path) for path in sys.argv[2:]], Path(sys.argv[1]))
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024)
"""


def image(random: np.random.Generator) -> np.ndarray:
    """Return a grey image similar to an image of a TacTip, uint8, shape (480, 640)."""
    y, x = np.mgrid[:480, :640]
    brightness = np.full((480, 640), 8.0)
    for ring in range(8):
        for azimuth in np.arange(PINS[ring]) * (2.0 * np.pi / PINS[ring]):
            px, py = 320 + 20 * ring * np.cos(azimuth), 240 + 20 * ring * np.sin(azimuth)
            brightness += 200.0 * np.exp(-((x - px) ** 2 + (y - py) ** 2) / 18.0)
    return np.clip(brightness + random.normal(0.0, 1.4, brightness.shape), 0, 255).astype(np.uint8)


def main() -> int:
    """Print the figures; the exit code is 1 if a claim does not hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=54, help="runs that are checked (default 54: 8,100 images)")
    runs = parser.parse_args().runs
    with tempfile.TemporaryDirectory() as folder:
        holds = _write_and_check(Path(folder), runs) & _import(Path(folder))
    return 0 if holds else 1


def _write_and_check(folder: Path, runs: int) -> bool:
    info = RunInfo(
        printed=PrintedBlock(block=Block.of(4), printer="ender-3", filament="petg"),
        levels=(1, 2, 3),
        protocol=Protocol().changed(stationary_frames=0),
        grid_spacing="even",
        holder=HolderRim(),
        frame=WorkFrame(origin_mm=(0.0, 0.0, 0.0)),
        slot=0,
        stage={"simulated": "benchmark"},
        gauge={},
        sensor={"name": "benchmark", "units": "counts", "shape": (480, 640)},
    )
    random = np.random.default_rng(0)
    base = image(random).astype(np.int16)
    with RunWriter.open(folder / "run-0", info) as writer:
        writer.reference(image(random), datetime.now(UTC))
        elapsed_s = 0.0
        for press in info.presses:
            frame = np.clip(base + random.normal(0.0, 1.4, base.shape), 0, 255).astype(np.uint8)
            start = time.perf_counter()
            writer.press(press, (press.x_mm, press.y_mm, -1.0), frame, time_utc=datetime.now(UTC))
            elapsed_s += time.perf_counter() - start
        count = len(info.presses)
    print(f"writing a press: {elapsed_s / count * 1e3:.1f} ms")
    copies = [folder / f"run-{number}" for number in range(runs)]
    for copy in copies[1:]:
        shutil.copytree(copies[0], copy, copy_function=os.link)
    start = time.perf_counter()
    findings = sum(len(check_run(copy).findings) for copy in copies)
    seconds = time.perf_counter() - start
    holds = seconds <= LIMIT_S * max(1.0, runs / 54) and findings == 0
    rate = runs * count / seconds
    print(f"checking {runs * count} images: {seconds:.1f} s on {os.cpu_count()} cores, {rate:.0f} images/s; ", end="")
    print(f"within {LIMIT_S:g} s: {'yes' if holds else 'NO'}")
    return holds


def _import(folder: Path) -> bool:
    paths: list[Path] = []
    for number in range(6):
        for level in ("P30", "P40", "P50"):
            paths.append(folder / f"PLAminus_z{number}_{level}_Bambu.npy")
            content = image(np.random.default_rng(len(paths)))  # two files of the same content are refused
            np.save(paths[-1], np.broadcast_to(content[None, :, :, None], (50, 480, 640, 3)))
    peaks = []
    for blocks in (2, 6):
        start = time.perf_counter()
        words = [sys.executable, "-c", IMPORT, str(folder / f"out-{blocks}"), *map(str, paths[: 3 * blocks])]
        peaks.append(int(subprocess.run(words, capture_output=True, check=True, text=True).stdout) / 1e6)
        seconds = time.perf_counter() - start
        print(f"importing {blocks} blocks, {blocks * 138} MB: {seconds:.1f} s, {peaks[-1]:.0f} MB of peak memory")
    holds = peaks[1] <= LIMIT_GROWTH * peaks[0]
    print(f"memory does not grow: {'yes' if holds else 'NO'}")
    return holds


if __name__ == "__main__":
    sys.exit(main())
