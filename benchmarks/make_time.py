"""Measure ``tacbench make`` with all parts and formats, and the import of both CAD libraries, in the same run.

    python benchmarks/make_time.py [--runs 3]

The command makes six blocks, holder and jig as STL, 3MF and STEP, reads and checks each file, and draws the pictures.
It then does the same with ``--verify full``. Every process is fresh and every folder is new. The processes take turns,
and the figure is the median. The processor time is that of all processes.

Claim, for the default checks and two or more processors: at most 2.0 times the time of ``python -c "import cadquery,
build123d"`` if the processors are free. Up to three children import the kernel, each for itself.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

REFERENCE = "import cadquery, build123d"
#: The largest ratio of the time.
LIMIT = 2.0
_TACBENCH = (sys.executable, "-c", "import sys; from tacbench_cad.cli import main; sys.exit(main())")


def seconds(argv: Sequence[str], **variables: str) -> tuple[float, float]:
    """Return the wall time and the processor time of a process, in s."""
    start, before = time.perf_counter(), os.times()
    environment = {**os.environ, **variables}
    subprocess.run(argv, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=True, env=environment)
    wall, after = time.perf_counter() - start, os.times()
    return wall, after.children_user + after.children_system - before.children_user - before.children_system


def make(*options: str, **variables: str) -> tuple[float, float, int, int]:
    """Make the whole print set in a new folder.

    Returns:
        Wall time and processor time in s, number of files and their bytes.
    """
    with tempfile.TemporaryDirectory() as folder:
        times = seconds([*_TACBENCH, "make", "--out", folder, *options], **variables)
        files = [path for path in Path(folder).iterdir() if path.suffix in (".stl", ".3mf", ".step")]
        return *times, len(files), sum(path.stat().st_size for path in files)


def main() -> int:
    """Print the table; the exit code is 1 if a claim does not hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=3, help="rounds (default 3)")
    runs = parser.parse_args().runs
    imports, default, full, alone = [], [], [], []
    seconds([sys.executable, "-c", REFERENCE])  # fills the caches of the file system
    for _ in range(runs):
        imports.append(seconds([sys.executable, "-c", REFERENCE]))
        default.append(make())
        full.append(make("--verify", "full"))
        alone.append(make(PYTHON_CPU_COUNT="1"))
    processors = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    print(f"{processors} processors; {default[0][2]} files, {default[0][3] / 1e6:.1f} MB")
    wall = statistics.median(run[0] for run in imports)
    busy = statistics.median(run[1] for run in imports)
    rows = (
        (f'python -c "{REFERENCE}"', wall, wall),
        ("tacbench make", statistics.median(run[0] for run in default), wall),
        ("tacbench make --verify full", statistics.median(run[0] for run in full), wall),
        ("processor time of the import", busy, busy),
        ("processor time of tacbench make", statistics.median(run[1] for run in alone), busy),
    )
    print(f"{'process':<44}{'median (s)':>12}{'times import':>14}")
    for name, median, reference in rows:
        print(f"{name:<44}{median:>12.2f}{median / reference:>14.2f}")
    holds = rows[1][1] <= LIMIT * wall
    print(f"tacbench make at most {LIMIT:g} times: {'yes' if holds else 'NO'}")
    return 0 if holds else 1


if __name__ == "__main__":
    sys.exit(main())
