"""Principal components of the augmented training set of every fold, from inner products that all folds share.

A fold's training set is some of the study's readings x_i, with noise e_i on one copy and multiples of the constant
reading 1 on others. Its principal components lie in the span of these 2 n + 1 vectors, so their inner products are all
that components and scores need: those of the readings are computed once a study, those with the noise once a trial, and
no fold ever sees the readings again. The numbers are those of scikit-learn's ``PCA(svd_solver="full")``, fitted to the
written-out training set alone, up to rounding.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacbench_cad.lab.analysis.classification.augment import BLOCK, Augmentation, noise_block
from tacbench_cad.lab.analysis.classification.features import Rows
from tacbench_cad.lab.analysis.classification.gram import RANK, add_products, gram, leading, mirrored
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats, Ints


@dataclass(frozen=True, kw_only=True, eq=False)
class Products:
    """Inner products of all readings, from which the mean reading was taken, and of one trial's noise.

    Args:
        rows: The readings, (n, numbers).
        mean: Their mean, (numbers,).
        plain: Readings with each other, (n, n).
        ones: Readings with the constant reading 1, (n,).
        seed: The trial's seed.
        noise: Standard deviation of the noise, or None.
        cross: Readings with noise, (n, n).
        noisy: Noise with noise, (n, n).
        noise_ones: Noise with 1, (n,).
    """

    rows: Rows
    mean: Floats
    plain: Floats
    ones: Floats
    seed: int = 0
    noise: float | None = None
    cross: Floats | None = None
    noisy: Floats | None = None
    noise_ones: Floats | None = None

    @classmethod
    def of(cls, rows: Rows) -> Products:
        """Those of a study's readings without noise."""
        mean = rows.mean(axis=0, dtype=np.float64)
        if rows.dtype == np.uint8:
            plain = gram(np.asarray(rows, dtype=np.uint8))
            middle = plain.mean(axis=0)
            plain -= middle
            plain -= middle[:, None]
            plain += middle.mean()
        else:
            centred = rows - mean
            plain = centred @ centred.T
        ones = rows.sum(axis=1, dtype=np.float64)
        return cls(rows=rows, mean=mean, plain=plain, ones=ones - ones.mean())

    def with_noise(self, noise: float, seed: int) -> Products:
        """The same with a trial's noise."""
        count, numbers = self.rows.shape
        cross, noisy, sums = np.zeros((count, count)), np.zeros((count, count)), np.zeros(count)
        for first in range(0, numbers, BLOCK):
            block = slice(first, min(first + BLOCK, numbers))
            drawn = noise * noise_block(seed, first, count, block.stop - first).astype(np.float64)
            add_products(cross, self.rows[:, block] - self.mean[block], drawn)
            add_products(noisy, drawn)
            sums += drawn.sum(axis=1)
        return Products(
            rows=self.rows,
            mean=self.mean,
            plain=self.plain,
            ones=self.ones,
            seed=seed,
            noise=noise,
            cross=cross,
            noisy=mirrored(noisy),
            noise_ones=sums,
        )

    def times(self, onto: Onto) -> tuple[Floats, Floats, Floats]:
        """Inner products of sums of readings, noise and 1 with each reading, each noise and 1."""
        numbers = self.rows.shape[1]
        plain = self.plain @ onto.plain + np.outer(self.ones, onto.ones)
        ones = self.ones @ onto.plain + numbers * onto.ones
        if self.cross is None or self.noisy is None or self.noise_ones is None or onto.noise is None:
            return plain, np.zeros((0, plain.shape[1])), ones
        plain += self.cross @ onto.noise
        noisy = self.cross.T @ onto.plain + self.noisy @ onto.noise + np.outer(self.noise_ones, onto.ones)
        return plain, noisy, ones + self.noise_ones @ onto.noise


@dataclass(frozen=True, kw_only=True, eq=False)
class Onto:
    """Vectors as sums.

    Args:
        plain: Weights of the readings, (n, k).
        noise: Weights of their noise, (n, k), or None.
        ones: Weights of the constant reading, (k,).
    """

    plain: Floats
    noise: Floats | None
    ones: Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class FoldScores:
    """Principal component scores of one fold.

    Args:
        train: Of the augmented training set, in the order of ``Augmentation.rows``, (copies x train, components).
        test: Of the test set, as it is, (test, components).
        variance: Variance of the training set along each component (ddof 1), (components,).
    """

    train: Floats
    test: Floats
    variance: Floats


def fold_scores(
    products: Products,
    augmentation: Augmentation,
    folds: Sequence[tuple[Ints, Ints]],
    components: int,
) -> list[FoldScores]:
    """Scores of several folds of one trial, each component's sign as in scikit-learn: its largest weight positive.

    Args:
        products: The trial's.
        augmentation: The copies; its noise must be that of the products.
        folds: Indices of training and of test readings.
        components: Components to keep.

    Raises:
        InputError: There are more components than a fold's training set has directions.
    """
    found = [_solve(products, augmentation, train, test, components) for train, test in folds]
    signs = _signs(products, [one[1] for one in found])
    return [
        FoldScores(train=scores.train * sign, test=scores.test * sign, variance=scores.variance)
        for (scores, _), sign in zip(found, signs, strict=True)
    ]


def _solve(
    products: Products, augmentation: Augmentation, train: Ints, test: Ints, components: int
) -> tuple[FoldScores, Onto]:
    """Scores of a fold up to their signs, and the components as sums."""
    count, copies = len(train), augmentation.count
    offsets = np.array(augmentation.offsets)
    rows = count * copies
    most = min(rows - 1, products.rows.shape[1])
    if not 1 <= components <= most:
        what = f"must be from 1 to {most}: a training set has {rows} rows of {products.rows.shape[1]} numbers"
        raise InputError("components", components, what)

    def sums(vectors: Floats) -> Onto:
        """C' v: sums of the training set's rows as sums of readings, noise and 1."""
        parts = vectors.reshape(copies, count, -1)
        plain = np.zeros((len(products.plain), vectors.shape[1]))
        plain[train] = parts.sum(axis=0)
        noise = None
        if augmentation.noise is not None:
            noise = np.zeros_like(plain)
            noise[train] = parts[1]
        return Onto(plain=plain, noise=noise, ones=offsets @ parts.sum(axis=1))

    def along(plain: Floats, noisy: Floats, ones: Floats) -> Floats:
        """Inner products of the training set's rows with vectors, (rows, k), from those of readings, noise and 1."""
        values = plain[train] + offsets[:, None, None] * ones
        if augmentation.noise is not None:
            values[1] += noisy[train]
        return np.asarray(values.reshape(rows, -1))

    def scatter(vectors: Floats) -> Floats:
        values = along(*products.times(sums(vectors - vectors.mean(axis=0))))
        return np.asarray(values - values.mean(axis=0))

    squares, vectors = leading(scatter, rows, components)
    if squares[-1] <= RANK * max(squares[0], 1.0):
        most = int(np.sum(squares > RANK * max(squares[0], 1.0)))
        raise InputError("components", components, f"must be at most {most}: so many directions do the readings have")
    lengths = np.sqrt(squares)
    onto = sums((vectors - vectors.mean(axis=0)) / lengths)
    plain, noisy, ones = products.times(onto)
    middle = along(plain, noisy, ones).mean(axis=0)
    scores = FoldScores(train=vectors * lengths, test=plain[test] - middle, variance=squares / (rows - 1))
    return scores, onto


def _signs(products: Products, found: Sequence[Onto]) -> list[Floats]:
    """Signs that make each component's largest weight positive; the readings are gone through once for all folds."""
    count, numbers = products.rows.shape
    # Single precision is enough to see which of two weights is larger.
    plain = np.concatenate([one.plain for one in found], axis=1).astype(np.float32)
    ones = np.concatenate([one.ones for one in found]).astype(np.float32)
    noise = None
    if products.noise is not None:
        scaled = [products.noise * one.noise for one in found if one.noise is not None]
        noise = np.concatenate(scaled, axis=1).astype(np.float32)
    peaks = np.zeros(len(ones), dtype=np.float32)
    for first in range(0, numbers, BLOCK):
        block = slice(first, min(first + BLOCK, numbers))
        weights = (products.rows[:, block] - products.mean[block]).astype(np.float32).T @ plain + ones
        if noise is not None:
            weights += noise_block(products.seed, first, count, block.stop - first).T @ noise
        peak = weights[np.argmax(np.abs(weights), axis=0), np.arange(len(peaks))]
        peaks = np.where(np.abs(peak) > np.abs(peaks), peak, peaks)
    return np.split(np.where(peaks < 0, -1.0, 1.0), np.cumsum([len(one.ones) for one in found])[:-1])
