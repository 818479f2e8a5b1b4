"""Principal components of augmented training sets, without the augmented images.

A training set contains each of its frames several times: unchanged, with Gaussian noise, brighter and darker. All of
these rows, and therefore their principal components, are in the span of the frames, their noise and the constant frame
1. Components and scores follow from the inner products of these vectors:

- The inner products of the frames and of 1 are computed once for a study. For images they are exact, because sums of
  products of whole numbers below 2^24 are exact in float32.
- The inner products of the noise are computed once for a trial. If a frame has many more numbers than there are frames,
  the noise is not drawn number by number. Such noise has the same distribution in every rotated coordinate system. In
  the directions that the frames span, it is drawn as independent normal numbers. In all other directions only its inner
  products are needed. They have a Wishart distribution and are drawn as L L', where the triangular L has normal numbers
  and square roots of chi-squared numbers (Bartlett, 1933). Single directions in this remaining space are uniformly
  distributed (Eaton, 1983).

Frames outside of the training set are projected directly onto the components, a block of numbers at a time. This needs
less time than their inner products with the training set, and all trials share one pass over the frames.

The results equal those of scikit-learn's ``PCA(svd_solver="full")``, fitted to the complete training set, except for
rounding and signs: here the training row with the largest absolute score on a component has a positive score.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.sparse.linalg import LinearOperator, eigsh

from tacbench_cad.lab.analysis.classification.augment import BLOCK, Augmentation, noise_block
from tacbench_cad.lab.analysis.classification.features import Rows
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Bytes, Floats, Ints

#: The value that is subtracted from every pixel before products are summed in float32: the sum of 1,024 products of
#: numbers from -128 to 127 is at most 2^24.
MIDDLE = 128
#: The number of rows of a matrix of inner products that are updated at a time.
STRIPE = 256
#: The largest size at which a matrix that is given by its products is written out to compute its eigenvectors.
WRITTEN_OUT = 400
#: A direction with less than this fraction of the largest squared length is a rounding error.
RANK = 1e-12
#: The fraction of its squared length that is added for each frame if some frames are equal.
JITTER = 1e-10


@dataclass(frozen=True, kw_only=True, eq=False)
class Pool:
    """The m of n frames from which training sets are taken, with their inner products.

    Args:
        rows: All frames, (n, numbers).
        inside: The indices of the pool's frames, (m,).
        plain: The inner products of 1 and the pool's frames with each other, (m + 1, m + 1).
        factor: The coordinates of 1 and the pool's frames in an orthonormal basis, lower triangular, (m + 1, m + 1), if
            noise is drawn along such coordinates; None if it is drawn for each number of a frame.
        directions: Random vectors for the seed of each trial. Outside of the span of the pool, their directions are
            uniformly distributed. Stored are their inner products with 1 and the pool's frames (m + 1, components), and
            with each other.
    """

    rows: Rows
    inside: Ints
    plain: Floats
    factor: Floats | None
    directions: Mapping[int, tuple[Floats, Floats]]

    @classmethod
    def of(
        cls,
        rows: Rows,
        inside: Ints | None = None,
        *,
        components: int,
        noise: bool = True,
        seeds: Sequence[int] = (),
        jobs: int = 1,
    ) -> Pool:
        """Compute the inner products.

        Args:
            rows: All frames, (n, numbers).
            inside: The indices of the pool's frames; None for all.
            components: The number of components that will be computed.
            noise: Whether noise will be drawn.
            seeds: The seeds of the noise, if scores of frames outside of the pool will be computed.
            jobs: Threads for the products of images, which are exact in any order.
        """
        from threadpoolctl import threadpool_limits

        chosen = np.arange(len(rows)) if inside is None else np.asarray(inside)
        ends = len(chosen) + 1
        plain = np.zeros((ends, ends))
        along = noise and rows.shape[1] >= ends + max(ends, components)
        needed = seeds if along and len(chosen) < len(rows) else ()
        inner = np.zeros((ends, len(needed) * components))
        own = np.zeros((len(needed), components, components))
        with threadpool_limits(limits=jobs if rows.dtype == np.uint8 else 1):
            for first, block in _blocks(rows, chosen, _exact(rows)):
                add_products(plain, block)
                drawn = [_vectors(seed, first, (block.shape[1], components), block.dtype) for seed in needed]
                if drawn:
                    with threadpool_limits(limits=1):  # these products are not exact: their rounding must not differ
                        inner += block @ np.concatenate(drawn, axis=1)
                    own += [vectors.T @ vectors for vectors in drawn]
        mirrored(plain)
        parts = np.split(inner, max(len(needed), 1), axis=1)
        return cls(
            rows=rows,
            inside=chosen,
            plain=plain,
            factor=_factor(plain) if along else None,
            directions=dict(zip(needed, zip(parts, own, strict=False), strict=False)),
        )

    @property
    def beside(self) -> int:
        """The number of directions outside of the span of 1 and the pool's frames, without coordinates of the noise."""
        return 0 if self.factor is None else self.rows.shape[1] - len(self.plain)

    def coordinates(self) -> Iterator[tuple[int, Floats]]:
        """Yield coordinates of 1 and of the pool's frames, (m + 1, width), with the index of the first coordinate."""
        if self.factor is None:
            yield from _blocks(self.rows, self.inside, np.float64)
        else:
            for first in range(0, len(self.factor), BLOCK):
                yield first, self.factor[:, first : min(first + BLOCK, len(self.factor))]


@dataclass(frozen=True, kw_only=True, eq=False)
class PixelNoise:
    """The noise of one trial on each frame of a pool.

    Args:
        sigma: Its standard deviation.
        seed: The trial's seed.
        cross: The inner products of 1 and the frames with the noise, (m + 1, m).
        own: Noise with noise, (m, m).
    """

    sigma: float
    seed: int
    cross: Floats
    own: Floats

    @classmethod
    def of(cls, pool: Pool, sigma: float, seed: int) -> PixelNoise:
        """Draw the noise."""
        count = len(pool.inside)
        cross, own = np.zeros((count + 1, count)), np.zeros((count, count))
        for first, block in pool.coordinates():
            drawn = sigma * noise_block(seed, first, count, block.shape[1]).astype(np.float64)
            top = 0 if pool.factor is None else first  # the factor is triangular
            add_products(cross[top:], block[top:], drawn)
            add_products(own, drawn)
        for first in range(0, count if pool.beside else 0, BLOCK):
            random = np.random.default_rng([seed, 1, first])
            width = min(BLOCK, count - first)
            triangle = np.tril(random.standard_normal((count - first, width)))
            np.fill_diagonal(triangle, np.sqrt(random.chisquare(pool.beside - first - np.arange(width))))
            add_products(own[first:, first:], sigma * triangle)
        return cls(sigma=sigma, seed=seed, cross=cross, own=mirrored(own))

    def sums(self, pool: Pool, weights: Floats) -> tuple[Floats, Callable[[int, int], Floats]]:
        """Return weighted sums of the noise.

        Args:
            pool: The pool.
            weights: The weight of each frame's noise in each sum, (m, k).

        Returns:
            The weights of 1 and of the pool's frames in each sum, (m + 1, k), and a function. The function takes the
            first number and the count of numbers, and returns the part to add to these sums, (numbers, k).
        """
        if pool.factor is None:
            return np.zeros((len(pool.plain), weights.shape[1])), partial(_sums, self.sigma, self.seed, weights)
        along = np.concatenate(
            [_sums(self.sigma, self.seed, weights, first, part.shape[1]) for first, part in pool.coordinates()]
        )
        # Outside of the span of the pool, inner products are known and all directions are equally probable.
        inner, own = pool.directions[self.seed]
        inside = scipy.linalg.solve_triangular(pool.factor, inner, lower=True)
        squares, turn = np.linalg.eigh(weights.T @ self.own @ weights - along.T @ along)
        frame = np.sqrt(np.maximum(squares, 0.0))[:, None] * turn.T
        mix = scipy.linalg.solve_triangular(np.linalg.cholesky(own - inside.T @ inside).T, frame)
        kept = scipy.linalg.solve_triangular(pool.factor, along - inside @ mix, lower=True, trans=1)
        # The returned function must not keep this noise: a study stores such a function for each trial.
        return kept, partial(_mixed, self.seed, np.dtype(_exact(pool.rows)), mix)


@dataclass(frozen=True, kw_only=True, eq=False)
class Scores:
    """Principal component scores of one training set.

    Args:
        train: The scores of the augmented training set, in the order of ``Augmentation.rows``, (copies x train,
            components).
        plain: The scores of every unchanged frame of the study, or of the pool, (n, components).
        variance: The variance of the training set along each component (ddof 1), (components,).
    """

    train: Floats
    plain: Floats
    variance: Floats


def principal_scores(
    pool: Pool, noise: PixelNoise | None, augmentation: Augmentation, components: int, train: Ints | None = None
) -> Scores:
    """Fit principal components to an augmented training set and project the pool's frames onto them.

    Args:
        pool: The frames.
        noise: The noise of the trial; None if the augmentation has no noise.
        augmentation: The copies.
        components: The number of components to keep.
        train: The indices of the training set in the pool; None for the whole pool.

    Raises:
        InputError: There are more components than the training set has directions.
    """
    return _fit(pool, noise, augmentation, components, train)[0]


def trial_scores(
    pool: Pool, augmentation: Augmentation, components: int, seeds: Sequence[int], jobs: int = 1
) -> list[Scores]:
    """Fit principal components to the whole augmented pool for each trial's noise, and project all frames onto them.

    Args:
        pool: The frames; the pool must be made for these seeds.
        augmentation: The copies.
        components: The number of components to keep.
        seeds: The seed of each trial.
        jobs: The number of threads.

    Raises:
        InputError: There are more components than the pool has directions.
    """
    from joblib import Parallel, delayed
    from threadpoolctl import threadpool_limits

    outside = np.setdiff1d(np.arange(len(pool.rows)), pool.inside)
    ends = len(pool.plain)

    def fit(seed: int) -> tuple[Scores, Floats, Floats, Callable[[int, int], Floats] | None]:
        noise = None if augmentation.noise is None else PixelNoise.of(pool, augmentation.noise, seed)
        scores, weights, noisy, middle = _fit(pool, noise, augmentation, components)
        if noise is None or not len(outside):
            return scores, middle, weights, None
        kept, rest = noise.sums(pool, noisy)
        return scores, middle, weights + kept, rest

    def project(first: int, block: Floats) -> Floats:
        onto = block[:ends].T @ np.concatenate([weights for _, _, weights, _ in fits], axis=1)
        for index, (_, _, _, rest) in enumerate(fits):
            if rest is not None:
                onto[:, index * components : (index + 1) * components] += rest(first, len(onto))
        return np.asarray(block[ends:] @ onto)

    # Each trial, or block, in a thread of its own: threads within each product would mostly wait for each other.
    parallel = Parallel(n_jobs=jobs, backend="threading", return_as="generator")
    with threadpool_limits(limits=1):
        fits = list(parallel(delayed(fit)(seed) for seed in seeds))
        if not len(outside):
            return [scores for scores, *_ in fits]
        blocks = _blocks(pool.rows, np.concatenate([pool.inside, outside]), np.float64)
        others = sum(parallel(delayed(project)(first, block) for first, block in blocks))
    result = []
    for (scores, middle, _, _), other in zip(fits, np.split(others, len(fits), axis=1), strict=True):
        plain = np.empty((len(pool.rows), components))
        plain[pool.inside], plain[outside] = scores.plain, other - middle
        result.append(replace(scores, plain=plain))
    return result


def _fit(
    pool: Pool, noise: PixelNoise | None, augmentation: Augmentation, components: int, train: Ints | None = None
) -> tuple[Scores, Floats, Floats, Floats]:
    """Return the scores of the pool, each component's weights of 1 and frames, its weights of noise, and the middle."""
    places = np.arange(len(pool.inside)) if train is None else train
    count, copies = len(places), augmentation.count
    offsets = np.array(augmentation.offsets)[:, None, None]
    rows = count * copies
    require_components(components, rows, pool.rows.shape[1])

    def sums(vectors: Floats) -> tuple[Floats, Floats]:
        """Return C' v: sums of the training set's rows, as weights of 1 and the frames, and weights of the noise."""
        parts = vectors.reshape(copies, count, -1)
        plain = np.zeros((len(pool.plain), parts.shape[2]))
        plain[0] = (offsets * parts).sum(axis=(0, 1))
        plain[1 + places] = parts.sum(axis=0)
        noisy = np.zeros((len(plain) - 1, parts.shape[2]))
        if noise is not None:
            noisy[places] = parts[1]
        return plain, noisy

    def products(plain: Floats, noisy: Floats) -> tuple[Floats, Floats]:
        """Return the inner products of such sums with 1 and the frames, and with the noise."""
        if noise is None:
            return pool.plain @ plain, noisy
        return pool.plain @ plain + noise.cross @ noisy, noise.cross.T @ plain + noise.own @ noisy

    def along(plain: Floats, noisy: Floats) -> Floats:
        """Return the inner products of such sums with the training set's rows, (rows, k)."""
        values = plain[1 + places] + offsets * plain[0]
        if noise is not None:
            values[1] += noisy[places]
        return np.asarray(values.reshape(rows, -1))

    def scatter(vectors: Floats) -> Floats:
        values = along(*products(*sums(vectors - vectors.mean(axis=0))))
        return np.asarray(values - values.mean(axis=0))

    squares, vectors = leading(scatter, rows, components)
    lengths = np.sqrt(squares)
    weights = sums((vectors - vectors.mean(axis=0)) / lengths)
    inside, noisy = products(*weights)
    middle = along(inside, noisy).mean(axis=0)
    scores = Scores(train=vectors * lengths, plain=inside[1:] - middle, variance=squares / (rows - 1))
    return scores, *weights, middle


def clipped_scores(images: Bytes, chosen: Ints, augmentation: Augmentation, components: int, seed: int) -> Scores:
    """Fit principal components to copies that are rounded and clipped to 0 to 255, as in image files.

    There is no faster method for clipped copies: they are made in uint8, and components are fitted to them directly.

    Args:
        images: All images, (n, pixels).
        chosen: The indices of the training set.
        augmentation: The copies.
        components: The number of components to keep.
        seed: The seed of the noise.

    Raises:
        InputError: There are more components than the training set has directions.
    """
    random = np.random.default_rng([seed, 0])
    copies = np.empty((augmentation.count, len(chosen), images.shape[1]), np.uint8)
    for index, image in enumerate(images[chosen]):
        changed = image + np.array(augmentation.offsets)[:, None]
        if augmentation.noise is not None:
            changed[1] += augmentation.noise * random.standard_normal(image.size)
        copies[:, index] = np.clip(np.rint(changed), 0, 255)
    written = copies.reshape(-1, images.shape[1])
    require_components(components, *written.shape)
    plain = Pool.of(written, components=components, noise=False).plain[1:, 1:]
    plain -= plain.mean(axis=0)
    plain -= plain.mean(axis=1)[:, None]
    squares, vectors = leading(lambda v: np.asarray(plain @ v), len(written), components)
    scores = np.zeros((len(images), components))
    middle = written.mean(axis=0)
    for first in range(0, images.shape[1], BLOCK):
        block = slice(first, first + BLOCK)
        weights = (written[:, block] - middle[block]).T @ (vectors / np.sqrt(squares))
        scores += (images[:, block] - middle[block]) @ weights
    return Scores(train=vectors * np.sqrt(squares), plain=scores, variance=squares / (len(written) - 1))


def require_components(components: int, rows: int, numbers: int) -> None:
    """Check the number of components.

    Raises:
        InputError: There are more components than the rows and their numbers allow.
    """
    limit = min(rows - 1, numbers)
    if not 1 <= components <= limit:
        what = f"must be from 1 to {limit}: a training set has {rows} rows of {numbers} numbers"
        raise InputError("components", components, what)


def leading(apply: Callable[[Floats], Floats], size: int, count: int) -> tuple[Floats, Floats]:
    """Compute the largest eigenvalues of a symmetric positive matrix that is given by its products with vectors.

    The method is Lanczos with implicit restarts (ARPACK). It always starts with the same vector, and each eigenvalue is
    exact to 1e-12 of the largest one. It needs 2 count + 1 vectors for any spectrum: a flat spectrum, as of noise,
    needs more products but no more memory. A small matrix is written out instead.

    Args:
        apply: A function that multiplies the matrix by vectors (size, any).
        size: The size of the matrix.
        count: The number of eigenvalues.

    Returns:
        The eigenvalues (count,) in falling order, and unit eigenvectors (size, count), whose largest numbers are
        positive.

    Raises:
        InputError: The matrix has fewer eigenvalues above rounding errors.
    """
    if size <= max(WRITTEN_OUT, 4 * count):
        values, vectors = scipy.linalg.eigh(apply(np.eye(size)), subset_by_index=(size - count, size - 1))
    else:
        start = np.random.default_rng(0).standard_normal(size)
        if not np.any(apply(start[:, None])):  # ARPACK knows no matrix of zeros
            values, vectors = np.zeros(count), np.eye(size, count)
        else:
            operator = LinearOperator((size, size), matvec=lambda v: apply(v.reshape(-1, 1)).ravel(), dtype=np.float64)
            values, vectors = eigsh(operator, count, which="LA", v0=start)
    limit = int(np.sum(values > RANK * max(values[-1], 1.0)))
    if limit < count:
        raise InputError("components", count, f"must be at most {limit}, the number of directions of the frames")
    signs = np.sign(vectors[np.argmax(np.abs(vectors), axis=0), np.arange(count)])
    return values[::-1], (vectors * signs)[:, ::-1]


def add_products(products: Floats, left: NDArray[Any], right: NDArray[Any] | None = None) -> None:
    """Add the inner products of vectors to a matrix in place, a stripe of rows at a time.

    ``products += left @ right.T`` would need a second matrix of the same size, which is the largest array in memory for
    a study with many frames.

    Args:
        products: The matrix to which the products are added, (n, m).
        left: The left vectors, (n, numbers).
        right: The right vectors, (m, numbers). None for the same vectors; then only the lower triangle is computed.
    """
    for first in range(0, len(left), STRIPE):
        rows = slice(first, min(first + STRIPE, len(left)))
        others = left[: rows.stop] if right is None else right
        products[rows, : len(others)] += left[rows] @ others.T


def mirrored(products: Floats) -> Floats:
    """Copy the lower triangle of a symmetric matrix to its upper triangle, in place."""
    for first in range(0, len(products), STRIPE):
        rows = slice(first, min(first + STRIPE, len(products)))
        products[:first, rows] = products[rows, :first].T
        square = products[rows, rows]
        square[:] = np.tril(square) + np.tril(square, -1).T
    return products


def _exact(rows: Rows) -> type[np.floating[Any]]:
    """Return the type in which products of frames are summed within a block."""
    return np.float32 if rows.dtype == np.uint8 else np.float64


def _blocks(rows: Rows, order: Ints, kind: type[np.floating[Any]]) -> Iterator[tuple[int, NDArray[Any]]]:
    """Yield columns of the constant frame 1 and of some frames minus a middle value, with the first column's index."""
    middle = np.full(rows.shape[1], MIDDLE) if rows.dtype == np.uint8 else rows.mean(axis=0)
    for first in range(0, rows.shape[1], BLOCK):
        columns = slice(first, min(first + BLOCK, rows.shape[1]))
        block = np.empty((len(order) + 1, columns.stop - first), kind)
        block[0] = 1.0
        np.subtract(rows[order, columns], middle[columns], out=block[1:], casting="same_kind", dtype=kind)
        yield first, block


def _vectors(seed: int, first: int, shape: tuple[int, int], kind: np.dtype[Any]) -> NDArray[Any]:
    """Draw normal numbers; equal arguments give equal numbers."""
    return np.random.default_rng([seed, 2, first]).standard_normal(shape, dtype=kind.type)


def _sums(sigma: float, seed: int, weights: Floats, first: int, width: int) -> Floats:
    """Return some coordinates of sums of noise, (width, k)."""
    return np.asarray(sigma * (noise_block(seed, first, len(weights), width).T @ weights))


def _mixed(seed: int, kind: np.dtype[Any], mix: Floats, first: int, width: int) -> Floats:
    """Return some numbers of sums of a trial's random vectors, (width, k)."""
    return np.asarray(_vectors(seed, first, (width, len(mix)), kind) @ mix)


def _factor(products: Floats) -> Floats:
    """Return the Cholesky factor of a matrix of inner products: the coordinates of the vectors."""
    try:
        return np.asarray(scipy.linalg.cholesky(products, lower=True, check_finite=False))
    except scipy.linalg.LinAlgError:  # equal frames are made different by 1e-5 of their length
        apart = products + JITTER * np.trace(products) / len(products) * np.eye(len(products))
        return np.asarray(scipy.linalg.cholesky(apart, lower=True, check_finite=False))
