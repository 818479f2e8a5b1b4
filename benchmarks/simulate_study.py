"""Measure the time of a simulated study, the time of its steps, and the memory of its processes.

    python benchmarks/simulate_study.py [--study paper] [--jobs 2] [--colour] [--look NAME] [--out FOLDER]

It works as the command does: each process simulates one block after another. Claims: the paper's study (12,600 presses
at 640 x 480) takes minutes on two cores, and a process needs no more memory at the end than in the first quarter.
"""

from __future__ import annotations

import argparse
import os
import shutil
import tempfile
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command sets it

import psutil

from tacbench_cad.lab.simulate.study import (
    SimulationOptions,
    estimate_simulation,
    require_room,
    simulate_study,
    study_of,
)

MAX_MINUTES = 5.0
MAX_GROWTH = 1.1


def main() -> int:
    """Print the figures; the exit code is 1 if a claim does not hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--study", default="paper", help="paper, quick or a TOML file (default paper)")
    parser.add_argument("--jobs", type=int, default=2, help="processes (default 2)")
    parser.add_argument("--colour", action="store_true", help="images in colour")
    parser.add_argument("--look", default="clean", help="look of the frames (default clean)")
    parser.add_argument("--out", type=Path, help="folder for the runs; default: a temporary one")
    options = parser.parse_args()
    out = options.out or Path(tempfile.mkdtemp(prefix="tacbench-simulate-"))
    simulation = SimulationOptions(colour=options.colour, look=options.look)
    study = study_of(options.study).study
    needed = estimate_simulation(study, out, simulation, jobs=options.jobs)
    require_room(out, needed)
    memory: list[tuple[int, int]] = []

    def measure_memory(images: int) -> None:
        children = psutil.Process().children()
        memory.append((images, max((child.memory_info().rss for child in children), default=0)))

    start = time.perf_counter()
    try:
        simulate_study(study, out, simulation, jobs=options.jobs, progress=measure_memory)
        seconds = time.perf_counter() - start
        size = sum(path.stat().st_size for path in out.rglob("*") if path.is_file())
    finally:
        if options.out is None:
            shutil.rmtree(out)
    images = needed.missing
    print(
        f"{options.study}: {needed.blocks} blocks, {needed.presses:,} presses, {images:,} images, {size / 1e9:.2f} GB"
    )
    minutes = needed.seconds / 60
    print(f"estimated {needed.gb:.2f} GB and {minutes:.1f} minutes; took {seconds / 60:.2f} minutes", end=" ")
    print(f"in {options.jobs} processes, {1e3 * seconds * options.jobs / images:.1f} ms of processing for each image")
    early = max(rss for count, rss in memory if count <= images / 4)
    late = max(rss for count, rss in memory if count >= 3 * images / 4)
    print(f"largest process: {early / 1e6:.0f} MB in the first quarter, {late / 1e6:.0f} MB in the last")
    holds = late <= MAX_GROWTH * early and (options.study != "paper" or seconds / 60 <= MAX_MINUTES)
    print(f"at most {MAX_MINUTES:g} minutes, memory does not grow: {'yes' if holds else 'NO'}")
    return 0 if holds else 1


if __name__ == "__main__":
    raise SystemExit(main())
