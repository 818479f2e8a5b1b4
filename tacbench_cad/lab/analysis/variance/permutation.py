"""A permutation test between printers (printer-filaments): does one vary more from print to print than the other?

It takes Gram matrices of prints, pooled over pixels, positions and force levels, so that what a print does at one place
and at another is never counted as independent, and keeps textures apart: what is exchanged between two printers stays
in its texture.

Deviations of k prints from their mean are no independent units (they add to zero): permuting them would find
differences too often (in simulated studies of six textures in 9 % of cases with six prints and in 14 % with three,
where 5 % are meant). What is permuted instead is the k - 1 contrasts that the prints of a cell give, which are
independent and alike if both printers vary alike. In which directions contrasts are taken is drawn again for every
permutation, so that no order of the prints matters.

p counts the data as one of the permutations: (1 + as extreme) / (1 + drawn), both directions. The least p that a design
can reach depends on its number of arrangements and is given: three prints of one texture cannot reach 5 % whatever
they do.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tacbench_cad.util.types import Floats

#: Permutations drawn.
DRAWS = 4999
#: Values of the statistic that differ by less are the same one, rounded differently.
_SAME = 1e-9


@dataclass(frozen=True, kw_only=True)
class PermutationTest:
    """The outcome of a test between two printers.

    Args:
        statistic: Mean over textures of (a - b) / (a + b), a and b being the two variances between prints (of mean
            readings, so that part of the repeats' variance is in both); from -1 to 1, above 0 where the first varies
            more.
        ratio: Geometric mean over textures of a / b; None where one of them is 0.
        p: Fraction of permutations at least as far from 0.
        least_p: The least p that this design could have given.
        textures: Textures that entered.
        prints: Prints of the first and of the second printer.
    """

    statistic: float
    ratio: float | None
    p: float
    least_p: float
    textures: int
    prints: tuple[int, int]


def dispersion_test(
    first: Sequence[ArrayLike], second: Sequence[ArrayLike], *, draws: int = DRAWS, seed: int = 0
) -> PermutationTest:
    """Whether two printers vary alike from print to print.

    Args:
        first: For each texture the Gram matrix of the first printer's prints about their mean, shape (k, k) with k of
            at least 2:
            :meth:`tacbench_cad.lab.analysis.variance.intervals.CellSums.print_gram`.
        second: The second printer's, for the same textures in the same order.
        draws: Permutations.
        seed: Seed of the permutations.
    """
    random = np.random.default_rng(seed)
    observed, drawn, logs, arrangements, mirrored = 0.0, np.zeros(draws), [], 1, True
    prints = np.zeros(2, dtype=np.int64)
    for pair in zip(first, second, strict=True):
        both = [_contrasts(np.asarray(gram, dtype=np.float64)) for gram in pair]
        n, m = (len(gram) for gram in both)
        observed += float(_balance(np.concatenate([np.diag(gram) for gram in both])[None, :], n)[0])
        units = np.concatenate([_squares(gram, draws, random) for gram in both], axis=1)
        drawn += _balance(random.permuted(units, axis=1), n)
        arrangements *= math.comb(n + m, n)
        mirrored = mirrored and n == m
        prints += (n + 1, m + 1)
        a, b = (float(np.trace(gram)) / len(gram) for gram in both)
        logs.append(math.log(a / b) if a > 0.0 and b > 0.0 else math.nan)
    ratio = math.exp(float(np.mean(logs)))
    # With as many prints on both sides, changing all of them over turns the sign and is as extreme.
    smallest_p = min(1.0, max((2 if mirrored else 1) / arrangements, 1.0 / (1.0 + draws)))
    extreme = float((np.abs(drawn) >= abs(observed) * (1.0 - _SAME)).sum())
    return PermutationTest(
        statistic=observed / len(first),
        ratio=None if math.isnan(ratio) else ratio,
        # Drawn permutations may by chance be less often extreme than all of them would be.
        p=max(smallest_p, (1.0 + extreme) / (1.0 + draws)),
        least_p=smallest_p,
        textures=len(first),
        prints=(int(prints[0]), int(prints[1])),
    )


def _contrasts(gram: Floats) -> Floats:
    """Gram matrix of the k - 1 Helmert contrasts of k prints, (k-1, k-1)."""
    k = len(gram)
    helmert = np.array([[1.0] * i + [-float(i)] + [0.0] * (k - i - 1) for i in range(1, k)])
    helmert /= np.linalg.norm(helmert, axis=1, keepdims=True)
    return np.asarray(helmert @ gram @ helmert.T)


def _squares(gram: Floats, draws: int, random: np.random.Generator) -> Floats:
    """Squares of the contrasts, in directions drawn again for each permutation, (draws, k-1)."""
    n = len(gram)
    turns = np.linalg.qr(random.standard_normal((draws, n, n)))[0]
    return np.asarray(np.einsum("dij,ik,dkj->dj", turns, gram, turns, optimize=True))


def _balance(units: Floats, n: int) -> Floats:
    """(a - b) / (a + b) for the means a of the first n units and b of the others; 0 where nothing varies; (draws,)."""
    a, b = units[:, :n].mean(axis=1), units[:, n:].mean(axis=1)
    total = a + b
    return np.asarray(np.divide(a - b, total, out=np.zeros_like(total), where=total > 0.0))
