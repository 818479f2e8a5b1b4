"""Measure how often the 95 % intervals of accuracies contain the true accuracy, and how wide they are.

    python benchmarks/accuracy_intervals.py [--studies 2000] [--presses 50] [--alone]

A simulated study has eight textures with the true accuracies 50 to 99.9 %. The accuracy of each print is drawn from a
beta distribution around that of its texture. Its width is given by the correlation of two presses of one print (0: all
prints are equal; 0.3: at a true accuracy of 70 %, prints have a standard deviation of 25 points). One correlation is
estimated from the whole table, as ``tacbench classify`` and ``score`` do. With ``--alone`` each texture is a table of
its own.

Claims: at least 93 % of the intervals contain the true accuracy, for 2, 4, 6 and 12 prints of each texture; and at most
97 % do for true accuracies from 60 to 90 % and 6 or more prints, as a mean over the correlations. A table of a single
texture has wider intervals (``--alone``), of which at least 92 % contain it; two prints alone have no interval.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tacbench_cad.lab.analysis.classification.accuracy_intervals import correlation_of, interval_of
from tacbench_cad.util.types import Floats

TRUE = (0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99, 0.999)
CORRELATIONS = (0.0, 0.05, 0.1, 0.2, 0.3)
PRINTS = (2, 4, 6, 12)
LEAST, LEAST_ALONE, MOST = 0.93, 0.92, 0.97


class Cell(NamedTuple):
    """The intervals of one true accuracy: the fractions given and covering, and the mean width of those given."""

    given: float
    covered: float
    width: float


def studied(prints: int, correlation: float, studies: int, presses: int, true: Sequence[float] = TRUE) -> list[Cell]:
    """Simulate studies of one design, and return the intervals of each texture."""
    rng = np.random.default_rng([prints, round(1000 * correlation)])
    ends = np.full((studies, len(true), 2), np.nan)
    mean = np.repeat(true, prints)
    s = 1.0 / correlation - 1.0 if correlation else 0.0
    textures, units = np.repeat(np.arange(len(true)), prints * presses), np.repeat(np.arange(len(mean)), presses)
    sizes, ones = np.full(prints, presses), np.ones(len(units))
    for study in range(studies):
        accuracy = rng.beta(mean * s, (1.0 - mean) * s) if correlation else mean
        right = (rng.random((len(mean), presses)) < accuracy[:, None]).ravel()
        pooled = correlation_of(right, ones, units, textures)
        for index, fraction in enumerate(right.reshape(len(true), -1).mean(axis=1)):
            ends[study, index] = [np.nan if end is None else end for end in interval_of(fraction, sizes, pooled)]
    return [_cell(ends[:, index], value) for index, value in enumerate(true)]


def _cell(ends: Floats, true: float) -> Cell:
    known = ends[~np.isnan(ends[:, 0])]
    if not len(known):
        return Cell(0.0, np.nan, np.nan)
    inside = (known[:, 0] <= true) & (true <= known[:, 1])
    return Cell(len(known) / len(ends), float(inside.mean()), float(np.ptp(known, axis=1).mean()))


def main() -> int:
    """Print the table; the exit code is 1 if a claim does not hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--studies", type=int, default=2000, help="simulated studies for each row (default 2000)")
    parser.add_argument("--presses", type=int, default=50, help="presses of each print (default 50)")
    parser.add_argument("--alone", action="store_true", help="each texture is a table of its own")
    options = parser.parse_args()
    size = (options.studies, options.presses)
    print(f"% of the intervals that contain the true accuracy / mean width in points; {size[1]} presses of each print")
    print("prints  correlation " + "".join(f"{100 * true:>13g}" for true in TRUE))
    failed = False
    for prints in PRINTS:
        cells = []
        for correlation in CORRELATIONS:
            alone = [(value,) for value in TRUE] if options.alone else [TRUE]
            row = [cell for true in alone for cell in studied(prints, correlation, *size, true)]
            cells.append(row)
            texts = (f"{100 * cell.covered:6.1f} / {100 * cell.width:4.1f}" for cell in row)
            some = min(cell.given for cell in row)
            few = f"   too few groups in up to {100 * (1 - some):.0f} % of the studies" if some < 1 else ""
            print(f"{prints:6} {correlation:12} " + "".join(f"{text:>13}" for text in texts) + few, flush=True)
        covered = np.array([[cell.covered for cell in row] for row in cells])
        failed |= bool(np.nanmin(covered, initial=1.0) < (LEAST_ALONE if options.alone else LEAST))
        failed |= prints >= 6 and bool(covered[:, 1:5].mean() > MOST)
    print("a claim does not hold" if failed else "all claims hold")
    return int(failed)


if __name__ == "__main__":
    raise SystemExit(main())
