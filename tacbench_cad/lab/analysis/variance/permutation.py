"""A permutation test between printers (printer-filaments): is the variance between prints larger for one of them?

The test uses Gram matrices of prints, pooled over pixels, positions and force levels. The values of one print at
different positions are therefore never counted as independent. Textures are kept separate: values are only exchanged
between prints of the same texture.

The deviations of k prints from their mean are not independent, because their sum is zero. If they were permuted, the
test would find differences too often: in simulated studies of six textures it did so in 9 % of cases with six prints
and in 14 % with three, instead of 5 %. Therefore the k - 1 contrasts of the prints of a cell are permuted. They are
independent, and they have equal distributions if both printers vary equally. The directions of the contrasts are drawn
again for every permutation, so the order of the prints does not matter.

p counts the data as one of the permutations: (1 + number as extreme) / (1 + number drawn), for both directions. The
smallest p that a design can reach depends on its number of arrangements, and is part of the result. Three prints of one
texture, for example, can never reach 5 %.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tacbench_cad.util.types import Floats

#: The number of permutations drawn.
DRAWS = 4999
#: A relative difference between two values of the statistic that is only a rounding error.
_SAME = 1e-9


@dataclass(frozen=True, kw_only=True)
class PermutationTest:
    """The outcome of a test between two printers.

    Args:
        statistic: The mean over textures of (a - b) / (a + b), from -1 to 1; a and b are the variances between prints
            of the first and the second printer. They are variances of mean frames, so both contain a part of the
            variance between repeats. The statistic is above 0 if the first printer varies more.
        ratio: The geometric mean over textures of a / b; None if one of them is 0.
        p: The fraction of permutations whose statistic is at least as far from 0.
        least_p: The smallest p that this design can give.
        textures: The number of textures used.
        prints_first: The number of prints of the first printer.
        prints_second: The number of prints of the second printer.
    """

    statistic: float
    ratio: float | None
    p: float
    least_p: float
    textures: int
    prints_first: int
    prints_second: int


def dispersion_test(
    first: Sequence[ArrayLike], second: Sequence[ArrayLike], *, draws: int = DRAWS, seed: int = 0
) -> PermutationTest:
    """Test whether two printers have the same variance between prints.

    Args:
        first: For each texture, the Gram matrix of the first printer's prints about their mean, shape (k, k) with k of
            at least 2; see :meth:`tacbench_cad.lab.analysis.variance.intervals.CellSums.print_gram`.
        second: The matrices of the second printer, for the same textures in the same order.
        draws: The number of permutations.
        seed: The seed of the permutations.
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
    # With equal numbers of prints, exchanging all prints changes only the sign, so it is as extreme.
    smallest_p = min(1.0, max((2 if mirrored else 1) / arrangements, 1.0 / (1.0 + draws)))
    extreme = float((np.abs(drawn) >= abs(observed) * (1.0 - _SAME)).sum())
    return PermutationTest(
        statistic=observed / len(first),
        ratio=None if math.isnan(ratio) else ratio,
        # By chance, the drawn permutations may be extreme less often than all possible permutations.
        p=max(smallest_p, (1.0 + extreme) / (1.0 + draws)),
        least_p=smallest_p,
        textures=len(first),
        prints_first=int(prints[0]),
        prints_second=int(prints[1]),
    )


def _contrasts(gram: Floats) -> Floats:
    """Return the Gram matrix of the k - 1 Helmert contrasts of k prints, (k-1, k-1)."""
    k = len(gram)
    helmert = np.array([[1.0] * i + [-float(i)] + [0.0] * (k - i - 1) for i in range(1, k)])
    helmert /= np.linalg.norm(helmert, axis=1, keepdims=True)
    return np.asarray(helmert @ gram @ helmert.T)


def _squares(gram: Floats, draws: int, random: np.random.Generator) -> Floats:
    """Return the squares of the contrasts, in new random directions for each permutation, (draws, k-1)."""
    n = len(gram)
    turns = np.linalg.qr(random.standard_normal((draws, n, n)))[0]
    return np.asarray(np.einsum("dij,ik,dkj->dj", turns, gram, turns, optimize=True))


def _balance(units: Floats, n: int) -> Floats:
    """Return (a - b) / (a + b), (draws,), with the mean a of the first n units and b of the others; 0 if both are 0."""
    a, b = units[:, :n].mean(axis=1), units[:, n:].mean(axis=1)
    total = a + b
    return np.asarray(np.divide(a - b, total, out=np.zeros_like(total), where=total > 0.0))
