"""How long a simulated study takes, what the time goes to, and how much memory the processes hold.

    python benchmarks/simulate_study.py [--study paper] [--jobs 2] [--colour] [--look NAME] [--out FOLDER]

The command's own way: blocks side by side in processes. Claims: the paper's study (12,600 presses at 640 x 480) takes
minutes on two cores, and the memory of a process at the study's end is that of its first quarter.
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

from tacbench_cad.cli.simulate import TIME_SPENT
from tacbench_cad.lab.simulate.blockrun import SimulationOptions
from tacbench_cad.lab.simulate.study import estimate_simulation, require_room, simulate_study, study_of

MAX_MINUTES = 5.0
MAX_GROWTH = 1.1


def main() -> int:
    """Print the figures; the exit code is 1 where a claim does not hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--study", default="paper", help="paper, quick or a TOML file (default paper)")
    parser.add_argument("--jobs", type=int, default=2, help="processes (default 2)")
    parser.add_argument("--colour", action="store_true", help="images in colour")
    parser.add_argument("--look", default="clean", help="what the frames look like (default clean)")
    parser.add_argument("--out", type=Path, help="folder that is kept; default: a temporary one")
    given = parser.parse_args()
    out = given.out or Path(tempfile.mkdtemp(prefix="tacbench-simulate-"))
    options = SimulationOptions(colour=given.colour, look=given.look)
    study = study_of(given.study).study
    needed = estimate_simulation(study, out, options, jobs=given.jobs)
    require_room(out, needed)
    memory: list[tuple[int, int]] = []

    def look(images: int) -> None:
        children = psutil.Process().children()
        memory.append((images, max((child.memory_info().rss for child in children), default=0)))

    began = time.perf_counter()
    try:
        blocks = simulate_study(study, out, options, jobs=given.jobs, progress=look)
        seconds = time.perf_counter() - began
        size = sum(path.stat().st_size for path in out.rglob("*") if path.is_file())
    finally:
        if given.out is None:
            shutil.rmtree(out)
    images = sum(block.images for block in blocks)
    spent = {name: sum(block.seconds[name] for block in blocks) for name in TIME_SPENT}
    total = sum(spent.values())
    print(f"{given.study}: {needed.blocks} blocks, {needed.presses:,} presses, {images:,} images, {size / 1e9:.2f} GB")
    print(f"estimated {needed.gb:.2f} GB and {needed.minutes:.1f} minutes; took {seconds / 60:.2f} minutes", end=" ")
    print(f"in {given.jobs} processes, {1e3 * seconds * given.jobs / images:.1f} ms of a process for each image")
    for name, what in TIME_SPENT.items():
        print(f"  {what:<18}{100 * spent[name] / total:5.1f} %  {1e3 * spent[name] / images:6.2f} ms an image")
    print(f"worst force error {1e3 * max(block.worst_n for block in blocks):.4f} mN")
    early = max(rss for count, rss in memory if count <= images / 4)
    late = max(rss for count, rss in memory if count >= 3 * images / 4)
    print(f"largest process: {early / 1e6:.0f} MB in the first quarter, {late / 1e6:.0f} MB in the last")
    held = late <= MAX_GROWTH * early and (given.study != "paper" or seconds / 60 <= MAX_MINUTES)
    print(f"at most {MAX_MINUTES:g} minutes, memory flat: {'yes' if held else 'NO'}")
    return 0 if held else 1


if __name__ == "__main__":
    raise SystemExit(main())
