"""Measure the import of images with a table, and a plain loop that reads, decodes and copies the same files.

    python benchmarks/import_images.py [--images 1000] [--suffix .png]

The images are 640 x 480 BGR: a smooth scene with camera noise. Both programs write into a folder of the same disk.
Each runs twice, and the faster time counts. Claim: the import takes at most 1.5 times as long as the loop.
"""

from __future__ import annotations

import argparse
import csv
import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from tacbench_cad.lab import import_samples

LIMIT = 1.5
TURNS = 2


def write_images(folder: Path, count: int, suffix: str) -> None:
    """Write a folder of images and their table ``labels.csv``."""
    random = np.random.default_rng(0)
    y, x = np.mgrid[:480, :640]
    (folder / "frames").mkdir()
    with (folder / "labels.csv").open("w", newline="") as stream:
        table = csv.writer(stream)
        table.writerow(("image", "label", "print", "position"))
        for number in range(count):
            scene = 120.0 + 60.0 * np.sin((x + number) / 40.0) * np.cos(y / 50.0)
            frame = np.clip(scene[..., None] + random.normal(0.0, 1.4, (480, 640, 3)), 0, 255).astype(np.uint8)
            cv2.imwrite(str(folder / "frames" / f"{number}{suffix}"), frame)
            table.writerow((f"{number}{suffix}", f"texture {number % 6}", number // 6 % 4, number // 24 % 25))


def plain_loop(folder: Path, out: Path) -> None:
    """Read each file, decode it and write a copy."""
    out.mkdir()
    for path in sorted((folder / "frames").iterdir()):
        data = path.read_bytes()
        assert cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) is not None
        (out / path.name).write_bytes(data)


def imported(folder: Path, out: Path) -> None:
    """Import the images with the package."""
    assert import_samples([folder / "frames", folder / "labels.csv"], out).ok


def seconds(work: Callable[[Path, Path], None], folder: Path) -> tuple[float, float]:
    """Return the wall time of the work and the processor time of all its threads, in s.

    The time to remove the output is not included.
    """
    out = folder / "out"
    start, processor_start = time.perf_counter(), time.process_time()
    work(folder, out)
    times = (time.perf_counter() - start, time.process_time() - processor_start)
    shutil.rmtree(out)
    return times


def main() -> int:
    """Print the figures; the exit code is 1 if the claim does not hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=int, default=1000)
    parser.add_argument("--suffix", default=".png", choices=(".png", ".jpg", ".bmp"))
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_images(folder, chosen.images, chosen.suffix)
        turns = [(seconds(plain_loop, folder), seconds(imported, folder)) for _ in range(TURNS)]
    loop_s, import_s = (min(wall for wall, _ in times) for times in zip(*turns, strict=True))
    loop_processor_s, import_processor_s = (min(busy for _, busy in times) for times in zip(*turns, strict=True))
    ratio, processor_ratio = import_s / loop_s, import_processor_s / loop_processor_s
    print(f"{chosen.images:,} images ({chosen.suffix}), seconds (processor time): ", end="")
    print(f"plain loop {loop_s:.2f} ({loop_processor_s:.2f}),")
    print(f"import {import_s:.2f} ({import_processor_s:.2f}): {ratio:.2f} times ({processor_ratio:.2f} times)")
    return int(import_s > LIMIT * loop_s)


if __name__ == "__main__":
    raise SystemExit(main())
