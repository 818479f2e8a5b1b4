"""What the variance of a study takes, against reading and decoding its files; whether memory is flat and digits agree.

    python benchmarks/variance.py RUNS... [--jobs 1] [--check 200]

RUNS are the run folders of a study; the claim is about 8,100 images: ``tacbench simulate --study paper --out RUNS``.
Only copy 1 of each print is taken, which leaves 8,100 of its 12,600 presses. In the same number of processes:

* decode: every image is read from the disk, decoded and made grey, as any program has to;
* variance: the whole pass of ``tacbench variance`` (decoding, table, components, distances, maps), and the
  stationary frames in contact for its noise floor: more readings, so that times are compared for each reading.

Claims: a reading takes at most twice its decoding; memory grows by no more than the sums' records, 2 kB an
image; and the variance of each cell is NumPy's two-pass result to 1e-9.
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
from joblib import Parallel, delayed

from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.preprocess import Preprocess
from tacbench_cad.lab.analysis.variance.streaming import stream
from tacbench_cad.lab.parallel import workers

LIMIT, FLAT_KB, DIGITS = 2.0, 2.0, 1e-9


def opened(folders: list[Path], share: int) -> Collection:
    """Copy 1 of every block: 8,100 images of the paper's study; or an eighth of its positions."""
    collection = Collection.open(folders)
    collection = collection.chosen(collection.copy == 1)
    positions = np.unique(collection.position)
    return collection.chosen(np.isin(collection.position, positions[: max(1, len(positions) // share)]))


def in_child(function: Callable[..., Any], *arguments: Any) -> Any:
    """A result from a process of its own, so that its peak memory is its own."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(function, arguments)


def pass_once(folders: list[Path], share: int) -> tuple[int, float]:
    """Images, and the peak memory (MB) that the pass takes in one process, beside the table of presses."""
    collection = opened(folders, share)
    collection.level, collection.position, collection.repeat  # noqa: B018 the table of presses, read before
    tracemalloc.start()
    with workers(1) as team:
        stream(collection, Preprocess(), team)
    return len(collection), tracemalloc.get_traced_memory()[1] / 2**20


def seconds(function: Callable[[], Any]) -> tuple[float, Any]:
    """Wall time of a call, and what it gave."""
    began = time.perf_counter()
    found = function()
    return time.perf_counter() - began, found


def decode(collection: Collection, part: np.ndarray[Any, Any]) -> None:
    """Read, decode and grey some readings."""
    grey = Preprocess()
    for index in part.tolist():
        grey(collection.frame(index))


def largest_difference(collection: Collection, places: Any, cells: int) -> float:
    """Largest relative difference of a cell's variance from NumPy's two passes, over some cells at some places."""
    random = np.random.default_rng(0)
    worst = 0.0
    for number in random.permutation(len(places) * len(places[0].cells))[:cells]:
        place = places[number % len(places)]
        key = list(place.cells)[number // len(places) % len(place.cells)]
        mine = (collection.level == place.level) & (collection.position == place.position)
        mine &= (collection.combination == key[0]) & (collection.texture == key[1])
        stack = np.stack([Preprocess()(collection.frame(int(i))) for i in np.flatnonzero(mine)]).astype(np.float64)
        two_pass = float(stack.var(axis=0).mean())
        worst = max(worst, abs(place.cells[key].variance() - two_pass) / two_pass)
    return worst


def main() -> int:
    """Print the figures; the exit code is 1 where a claim does not hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", type=Path, nargs="+", help="run folders, or folders that hold some")
    parser.add_argument("--jobs", type=int, default=1, help="processes (default 1)")
    parser.add_argument("--check", type=int, default=200, help="cells compared with NumPy (default 200)")
    options = parser.parse_args()
    collection = opened(options.runs, 1)
    parts = np.array_split(np.arange(len(collection)), 4 * options.jobs)
    frames = sum(1 for run in collection.runs for one in run.stationary_frames if one.in_contact)
    times: dict[str, list[float]] = {"decode": [], "variance": []}
    done = None
    for _ in range(2):  # interleaved, the better of two; the first round also fills the disk's cache
        calls = (delayed(decode)(collection, part) for part in parts)
        times["decode"].append(seconds(lambda calls=calls: Parallel(n_jobs=options.jobs)(calls))[0])
        with workers(options.jobs) as team:
            taken, done = seconds(lambda team=team: stream(collection, Preprocess(), team))
        times["variance"].append(taken)
    assert done is not None
    best = {name: min(values) for name, values in times.items()}
    spent = sum(done.seconds.values())
    per_reading = best["variance"] / done.readings / (best["decode"] / len(collection))
    print(f"{len(collection):,} images and {frames:,} stationary frames, {options.jobs} process(es)")
    print(f"reading and decoding the images alone: {best['decode']:.1f} s")
    print(f"the whole pass, stationary frames too:  {best['variance']:.1f} s ({done.readings:,} readings)")
    print(f"share of decoding in the pass: {100.0 * done.seconds['decode'] / spent:.0f} %")
    print(f"a reading in the pass takes {per_reading:.2f} times what decoding one takes")
    few, many = (in_child(pass_once, options.runs, share) for share in (8, 1))
    growth_kb = 1024.0 * (many[1] - few[1]) / (many[0] - few[0])
    for images, megabytes in (few, many):
        print(f"memory that the pass takes in one process, {images:,} images: {megabytes:.0f} MB at its peak")
    worst = largest_difference(collection, done.places, options.check)
    print(f"largest relative difference from NumPy's two passes, {options.check} cells: {worst:.1e}")
    claims = (
        (f"a reading takes at most {LIMIT:g} times its decoding", per_reading <= LIMIT),
        (f"memory grows by at most {FLAT_KB:g} kB an image (one has 307 kB): {growth_kb:.1f}", growth_kb <= FLAT_KB),
        (f"equal to NumPy to {DIGITS:g}", worst <= DIGITS),
    )
    for words, held in claims:
        print(f"{words}: {'yes' if held else 'NO'}")
    return 0 if all(held for _, held in claims) else 1


if __name__ == "__main__":
    sys.exit(main())
