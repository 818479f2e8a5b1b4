"""Measure ``tacbench make`` with all parts and formats, and the import of both CAD libraries, in the same run.

    python benchmarks/make_time.py [--runs 3]

The command makes six blocks, holder and jig as STL, 3MF and STEP, reads and checks each file, and draws the pictures.
It then does the same with ``--verify full``. Every process is fresh and every folder is new. The processes take turns,
and the figure is the median. The processor time is measured with one child process, because the command does not wait
for the copies of a child.

Claim: with the default checks and two or more free processors, at most LIMIT_WALL times the time of ``python -c
"import cadquery, build123d"``, and at most LIMIT_CPU times its processor time.
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
LIMIT = 5.0
_TACBENCH = (sys.executable, "-c", "import sys; from tacbench_cad.cli import main; sys.exit(main())")


def seconds(argv: Sequence[str]) -> float:
    """Return the wall time of a process, in s."""
    start = time.perf_counter()
    subprocess.run(argv, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=True)
    return time.perf_counter() - start


def make(*options: str) -> tuple[float, int, int]:
    """Make the whole print set in a new folder.

    Returns:
        Wall time in s, number of files and their bytes.
    """
    with tempfile.TemporaryDirectory() as folder:
        wall_s = seconds([*_TACBENCH, "make", "--out", folder, *options])
        files = [path for path in Path(folder).iterdir() if path.suffix in (".stl", ".3mf", ".step")]
        return wall_s, len(files), sum(path.stat().st_size for path in files)


def main() -> int:
    """Print the table; the exit code is 1 if the claim does not hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=3, help="rounds (default 3)")
    runs = parser.parse_args().runs
    imports, default, full = [], [], []
    seconds([sys.executable, "-c", REFERENCE])  # fills the caches of the file system
    for _ in range(runs):
        imports.append(seconds([sys.executable, "-c", REFERENCE]))
        default.append(make())
        full.append(make("--verify", "full"))
    reference = statistics.median(imports)
    processors = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    print(f"{processors} processors; {default[0][1]} files, {default[0][2] / 1e6:.1f} MB")
    print(f"{'process':<44}{'median (s)':>12}{'times import':>14}")
    rows = (
        (f'python -c "{REFERENCE}"', reference),
        ("tacbench make", statistics.median(run[0] for run in default)),
        ("tacbench make --verify full", statistics.median(run[0] for run in full)),
    )
    for name, median in rows:
        print(f"{name:<44}{median:>12.2f}{median / reference:>14.2f}")
    holds = rows[1][1] <= LIMIT * reference
    print(f"tacbench make at most {LIMIT:g} times: {'yes' if holds else 'NO'}")
    return 0 if holds else 1


if __name__ == "__main__":
    sys.exit(main())
