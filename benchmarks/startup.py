"""Measure the start time of light commands and the import of NumPy, in the same run.

    python benchmarks/startup.py [--runs 15]

Every command is a fresh process. The commands take turns, so a busy machine slows all of them alike. The figure is the
median. Claim: a command takes at most 3 times as long as ``python -c "import numpy"``.
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import time
from collections.abc import Sequence

REFERENCE = "import numpy"
LIMIT = 3.0
COMMANDS = ("--help", "textures", "--version", "make --help")
#: The commands of the claim; the others are only shown.
CLAIMED = ("--help", "textures")


def seconds(argv: Sequence[str]) -> float:
    """Return the wall time of a process, in s."""
    start = time.perf_counter()
    subprocess.run(argv, stdout=subprocess.DEVNULL, check=True)
    return time.perf_counter() - start


def command_line(command: str) -> list[str]:
    """Return the command line of the process that an entry point would start."""
    return [sys.executable, "-c", "import sys; from tacbench_cad.cli import main; sys.exit(main())", *command.split()]


def main() -> int:
    """Print the table; the exit code is 1 if the claim does not hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=15, help="rounds (default 15)")
    runs = parser.parse_args().runs
    times: dict[str, list[float]] = {name: [] for name in (REFERENCE, *COMMANDS)}
    for _ in range(runs + 1):
        times[REFERENCE].append(seconds([sys.executable, "-c", REFERENCE]))
        for command in COMMANDS:
            times[command].append(seconds(command_line(command)))
    medians = {name: statistics.median(values[1:]) for name, values in times.items()}  # the first round fills caches
    print(f"{'process':<24}{'median (s)':>12}{'times NumPy':>14}")
    for name, median in medians.items():
        label = f'python -c "{name}"' if name == REFERENCE else f"tacbench {name}"
        print(f"{label:<24}{median:>12.3f}{median / medians[REFERENCE]:>14.2f}")
    holds = all(medians[name] <= LIMIT * medians[REFERENCE] for name in CLAIMED)
    print(f"tacbench --help and tacbench textures at most {LIMIT:g} times: {'yes' if holds else 'NO'}")
    return 0 if holds else 1


if __name__ == "__main__":
    sys.exit(main())
