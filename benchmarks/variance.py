"""Measure the time of ``tacbench variance`` compared with decoding the same files, its memory and its numerical error.

    python benchmarks/variance.py RUNS... [--jobs 1] [--check 200]

RUNS are the run folders of a study. The claim is about 8,100 images: ``tacbench simulate --study paper --out RUNS``.
Only copy 1 of each print is taken, which gives 8,100 of the 12,600 presses. Both use the same number of processes:

* decode: every image is read from the disk, decoded and made grey, as any program has to;
* variance: the whole pass of ``tacbench variance`` (decoding, table, components, distances, maps), and the stationary
  frames in contact for its noise floor. These are more frames, so the times are compared for each frame.

Claims: a frame takes at most twice as long as its decoding; memory grows by no more than the records of the sums, 2 kB
for each image; the variance of each cell agrees with NumPy's two-pass result to 1e-9.
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
from tacbench_cad.lab.analysis.pixels import Pixels
from tacbench_cad.lab.analysis.variance.streaming import stream
from tacbench_cad.lab.parallel import workers

LIMIT, FLAT_KB, DIGITS = 2.0, 2.0, 1e-9


def opened(folders: list[Path], divisor: int) -> Collection:
    """Return copy 1 of every block, 8,100 images of the paper's study, at all positions or at a fraction of them."""
    collection = Collection.open(folders)
    collection = collection.chosen(collection.copy == 1)
    positions = np.unique(collection.position)
    return collection.chosen(np.isin(collection.position, positions[: max(1, len(positions) // divisor)]))


def in_child(function: Callable[..., Any], *arguments: Any) -> Any:
    """Compute a result in a separate process, so that its peak memory is its own."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(function, arguments)


def pass_once(folders: list[Path], divisor: int) -> tuple[int, float]:
    """Return the number of images, and the peak memory of the pass in one process in MB, without the press table."""
    collection = opened(folders, divisor)
    collection.level, collection.position, collection.repeat  # noqa: B018 reads the press table now
    tracemalloc.start()
    with workers(1) as executor:
        stream(collection, Pixels(), executor)
    return len(collection), tracemalloc.get_traced_memory()[1] / 2**20


def seconds(function: Callable[[], Any]) -> tuple[float, Any]:
    """Return the wall time of a call in s, and its result."""
    start = time.perf_counter()
    result = function()
    return time.perf_counter() - start, result


def decode(collection: Collection, part: np.ndarray[Any, Any]) -> None:
    """Read and decode some frames and make them grey."""
    for index in part.tolist():
        grey(collection, index)


def grey(collection: Collection, index: int) -> np.ndarray[Any, Any]:
    """Return the grey pixels of the frame of a press."""
    (path,) = collection.paths(index)
    return Pixels().transform(collection.runs[int(collection.run[index])], path)


def largest_difference(collection: Collection, places: Any, cells: int) -> float:
    """Return the largest relative difference between the variance of a cell and NumPy's two-pass result.

    A random sample of the cells is compared.
    """
    random = np.random.default_rng(0)
    worst = 0.0
    for number in random.permutation(len(places) * len(places[0].cells))[:cells]:
        place = places[number % len(places)]
        key = list(place.cells)[number // len(places) % len(place.cells)]
        chosen = (collection.level == place.level) & (collection.position == place.position)
        chosen &= (collection.combination == key[0]) & (collection.texture == key[1])
        stack = np.stack([grey(collection, int(i)) for i in np.flatnonzero(chosen)]).astype(np.float64)
        two_pass = float(stack.var(axis=0).mean())
        worst = max(worst, abs(place.cells[key].variance() - two_pass) / two_pass)
    return worst


def main() -> int:
    """Print the figures; the exit code is 1 if a claim does not hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", type=Path, nargs="+", help="run folders, or folders that contain run folders")
    parser.add_argument("--jobs", type=int, default=1, help="processes (default 1)")
    parser.add_argument("--check", type=int, default=200, help="cells compared with NumPy (default 200)")
    options = parser.parse_args()
    collection = opened(options.runs, 1)
    parts = np.array_split(np.arange(len(collection)), 4 * options.jobs)
    frames = sum(1 for run in collection.runs for frame in run.stationary_frames if frame.in_contact)
    times: dict[str, list[float]] = {"decode": [], "variance": []}
    sums = None
    for _ in range(2):  # the better of two rounds counts; the first round also fills the disk cache
        calls = (delayed(decode)(collection, part) for part in parts)
        times["decode"].append(seconds(lambda calls=calls: Parallel(n_jobs=options.jobs)(calls))[0])
        with workers(options.jobs) as executor:
            wall_s, sums = seconds(lambda executor=executor: stream(collection, Pixels(), executor))
        times["variance"].append(wall_s)
    assert sums is not None
    best = {name: min(values) for name, values in times.items()}
    total_s = sum(sums.seconds.values())
    per_frame = best["variance"] / sums.frames / (best["decode"] / len(collection))
    print(f"{len(collection):,} images and {frames:,} stationary frames, {options.jobs} process(es)")
    print(f"reading and decoding the images alone: {best['decode']:.1f} s")
    print(f"the whole pass, stationary frames too:  {best['variance']:.1f} s ({sums.frames:,} frames)")
    print(f"decoding, as part of the pass: {100.0 * sums.seconds['decode'] / total_s:.0f} %")
    print(f"a frame in the pass takes {per_frame:.2f} times as long as its decoding")
    few, many = (in_child(pass_once, options.runs, divisor) for divisor in (8, 1))
    growth_kb = 1024.0 * (many[1] - few[1]) / (many[0] - few[0])
    for images, megabytes in (few, many):
        print(f"peak memory of the pass in one process, {images:,} images: {megabytes:.0f} MB")
    worst = largest_difference(collection, sums.places, options.check)
    print(f"largest relative difference from NumPy's two passes, {options.check} cells: {worst:.1e}")
    claims = (
        (f"a frame takes at most {LIMIT:g} times its decoding", per_frame <= LIMIT),
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
