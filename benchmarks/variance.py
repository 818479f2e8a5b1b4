"""Measure the time of ``lab.variance`` compared with decoding the same files, its memory and its numerical error.

    python benchmarks/variance.py RUNS... [--jobs 1] [--check 200]

RUNS are the run folders of a study. The claims are about the paper's, ``tacbench simulate --study paper --out RUNS``,
with 12,600 presses: in the quick study with 1,296 presses, loading the tables, intervals and tests take a third of the
decoding. Both measurements use the same number of processes:

* decode: every frame, also the stationary frames in contact, is read from the disk, decoded and made grey, as any
  program has to;
* variance: the whole analysis (decoding, table, intervals, components, distances, tests, maps).

Claims: the analysis takes at most 1.5 times as long as decoding; memory grows by no more than the records of the sums,
2 kB for each image; the variance of each cell at each position agrees with NumPy's two-pass result to 1e-9.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pandas as pd
from joblib import Parallel, delayed

from tacbench_cad import lab
from tacbench_cad.lab.runs.press_table import stationary

LIMIT, FLAT_KB, DIGITS = 1.5, 2.0, 1e-9


def in_child(function: Callable[..., Any], *arguments: Any) -> Any:
    """Compute a result in a separate process, so that its peak memory is its own."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(function, arguments)


def peak_mb(presses: pd.DataFrame) -> float:
    """Return the peak memory of the analysis in one process in MB."""
    tracemalloc.start()
    lab.variance(presses)
    return tracemalloc.get_traced_memory()[1] / 2**20


def seconds(function: Callable[[], Any]) -> tuple[float, Any]:
    """Return the wall time of a call in s, and its result."""
    start = time.perf_counter()
    result = function()
    return time.perf_counter() - start, result


def decode(pixels: lab.Pixels, frames: pd.DataFrame) -> None:
    """Read and decode some frames and make them grey."""
    for row in frames.itertuples(index=False):
        pixels.of_press(row)


def largest_difference(presses: pd.DataFrame, positions: pd.DataFrame, count: int) -> float:
    """Return the largest relative difference between the variance of a cell at a position and NumPy's two-pass result.

    A random sample of the rows of ``positions.csv`` is compared.
    """
    worst, pixels = 0.0, lab.Pixels().fit(presses)
    keys = ["printer", "filament", "texture", "force_level", "position"]
    for row in positions.sample(min(count, len(positions)), random_state=0).itertuples():
        mine = presses[(presses[keys] == [getattr(row, key) for key in keys]).all(axis=1)]
        two_pass = float(pixels.transform(mine).astype(np.float64).var(axis=0).mean())
        worst = max(worst, abs(row.variance - two_pass) / two_pass)
    return worst


def main() -> int:
    """Print the figures; the exit code is 1 if a claim does not hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", type=Path, nargs="+", help="run folders, or folders that contain run folders")
    parser.add_argument("--jobs", type=int, default=1, help="processes (default 1)")
    parser.add_argument("--check", type=int, default=200, help="cells compared with NumPy (default 200)")
    options = parser.parse_args()
    presses = lab.read(options.runs)
    still = stationary(presses)
    frames = pd.concat([presses[["frame", "folder"]], still.loc[still["in_contact"], ["frame", "folder"]]])
    pixels = lab.Pixels().fit(presses)
    parts = [frames.iloc[part :: 4 * options.jobs] for part in range(4 * options.jobs)]
    times: dict[str, list[float]] = {"decode": [], "variance": []}
    for _ in range(2):  # the better of two rounds counts; the first round also fills the disk cache
        calls = (delayed(decode)(pixels, part) for part in parts)
        times["decode"].append(seconds(lambda calls=calls: Parallel(n_jobs=options.jobs)(calls))[0])
        wall_s, result = seconds(lambda: lab.variance(presses, jobs=options.jobs))
        times["variance"].append(wall_s)
    best = {name: min(values) for name, values in times.items()}
    ratio = best["variance"] / best["decode"]
    print(f"{len(presses):,} images and {len(frames) - len(presses):,} stationary frames, {options.jobs} process(es)")
    print(f"reading and decoding alone: {best['decode']:.1f} s")
    print(f"the analysis: {best['variance']:.1f} s, {ratio:.2f} times as long")
    positions = presses["position"].unique()
    fewer = presses[presses["position"].isin(positions[: max(1, len(positions) // 8)])]
    few, many = (in_child(peak_mb, of) for of in (fewer, presses))
    growth_kb = 1024.0 * (many - few) / (len(presses) - len(fewer))
    for of, megabytes in ((fewer, few), (presses, many)):
        print(f"peak memory of the analysis in one process, {len(of):,} images: {megabytes:.0f} MB")
    worst = largest_difference(presses, result.tables["positions"], options.check)
    print(f"largest relative difference from NumPy's two passes, {options.check} cells: {worst:.1e}")
    claims = (
        (f"the analysis takes at most {LIMIT:g} times as long as decoding", ratio <= LIMIT),
        (
            f"memory grows by at most {FLAT_KB:g} kB for each image (an image has 307 kB): {growth_kb:.1f}",
            growth_kb <= FLAT_KB,
        ),
        (f"equal to NumPy to {DIGITS:g}", worst <= DIGITS),
    )
    for words, holds in claims:
        print(f"{words}: {'yes' if holds else 'NO'}")
    return 0 if all(holds for _, holds in claims) else 1


if __name__ == "__main__":
    sys.exit(main())
