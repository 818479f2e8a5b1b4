"""Principal components of augmented training sets, without the augmented images.

A training set holds each of its readings several times: as it is, with Gaussian noise, brighter and darker. All of
these rows, and so their principal components, lie in the span of the readings, their noise and the constant reading 1.
Inner products of these vectors are therefore all that components and scores need:

- of the readings and of 1: computed once for a study; for images they are exact, since sums of products of whole
  numbers below 2^24 are exact in float32;
- of the noise: computed once for a trial. Where readings have many more numbers than there are readings, the noise is
  not drawn number by number. A rotation of such noise is such noise, so along the directions that the readings span it
  is drawn as independent normal numbers, and in all other directions only its inner products matter. Their law is
  Wishart's, drawn as L L' with a triangular L of normal numbers and roots of chi squares (Bartlett, 1933). Where single
  directions in that remaining space are needed, they are uniform (Eaton, 1983).

The numbers are those of scikit-learn's ``PCA(svd_solver="full")``, fitted to the written-out training set, up to
rounding and to signs: here the training row with the largest score on a component has a positive one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.sparse.linalg import LinearOperator, eigsh

from tacbench_cad.lab.analysis.classification.augment import BLOCK, Augmentation, noise_block
from tacbench_cad.lab.analysis.classification.features import Rows
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Bytes, Floats, Ints

#: Taken from every pixel before products are summed in float32: 1,024 products of -128..127 stay within 2^24.
MIDDLE = 128
#: Rows of a matrix of inner products that are added to at once.
STRIPE = 512
#: Size up to which a matrix that is known by its products is written out to find its eigenvectors.
WRITTEN_OUT = 400
#: Directions with less than this fraction of the largest squared length are rounding errors.
RANK = 1e-12
#: What is added to the squared length of each reading, as a fraction, where some readings are alike.
JITTER = 1e-10


@dataclass(frozen=True, kw_only=True, eq=False)
class Products:
    """Inner products of the constant reading 1 and of all readings.

    Args:
        rows: The readings, (n, numbers).
    """

    rows: Rows

    @cached_property
    def plain(self) -> Floats:
        """The products, the constant reading first, (n + 1, n + 1)."""
        result = np.zeros((len(self.rows) + 1, len(self.rows) + 1))
        for _, block in _blocks(self.rows, np.float32 if self.rows.dtype == np.uint8 else np.float64):
            add_products(result, block)
        return mirrored(result)

    def compute(self, jobs: int) -> None:
        """Compute the products now, on several threads: those of images are exact in any order."""
        from threadpoolctl import threadpool_limits

        with threadpool_limits(limits=jobs):
            _ = self.plain

    def pool(self, chosen: Ints | None = None, *, noise: bool = True) -> Pool:
        """The readings that training sets are taken from.

        Args:
            chosen: Their indices; None for all.
            noise: Whether noise will be drawn for them.
        """
        count, numbers = self.rows.shape
        inside = np.arange(count) if chosen is None else np.asarray(chosen)
        outside = np.setdiff1d(np.arange(count), inside)
        order = np.concatenate([[0], 1 + inside, 1 + outside])
        ends = len(inside) + 1
        few = numbers <= count + ends
        return Pool(
            rows=self.rows[order[1:] - 1] if few and noise else None,
            inside=inside,
            outside=outside,
            numbers=numbers,
            plain=self.plain if chosen is None else self.plain[np.ix_(order[:ends], order[:ends])],
            outer=self.plain[np.ix_(order[ends:], order[:ends])],
            factor=_factor(self.plain, order) if noise and not few else None,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Pool:
    """Readings that training sets are taken from, m of n, beside the others.

    Args:
        rows: All readings, those of the pool first, if they have so few numbers that noise is drawn for each.
        inside: Indices of the pool's readings, (m,).
        outside: Indices of the others, (n - m,).
        numbers: Numbers of a reading.
        plain: Inner products of 1 and the pool's readings with each other, (m + 1, m + 1).
        outer: Inner products of the others with these, (n - m, m + 1).
        factor: Coordinates of 1, of the pool's readings and of the others in an orthonormal frame, lower triangular,
            (n + 1, n + 1), if noise is drawn along such coordinates.
    """

    rows: Rows | None
    inside: Ints
    outside: Ints
    numbers: int
    plain: Floats
    outer: Floats
    factor: Floats | None

    @property
    def beside(self) -> int:
        """Directions that neither 1 nor the pool's readings have, and along which noise has no coordinates."""
        return 0 if self.factor is None else self.numbers - len(self.plain)

    def coordinates(self) -> Iterator[tuple[int, Floats]]:
        """Coordinates of 1 and of all readings, (n + 1, width), block by block with the first one's number."""
        if self.rows is not None:
            yield from _blocks(self.rows, np.float64)
        elif self.factor is not None:
            for first in range(0, len(self.plain), BLOCK):
                yield first, self.factor[:, first : min(first + BLOCK, len(self.plain))]


@dataclass(frozen=True, kw_only=True, eq=False)
class Noise:
    """One trial's noise on each reading of a pool.

    Args:
        sigma: Its standard deviation.
        seed: The trial's seed.
        cross: Inner products of 1 and the readings with noise, (m + 1, m).
        own: Noise with noise, (m, m).
    """

    sigma: float
    seed: int
    cross: Floats
    own: Floats

    @classmethod
    def of(cls, pool: Pool, sigma: float, seed: int) -> Noise:
        """Draw it."""
        count = len(pool.inside)
        cross, own = np.zeros((count + 1, count)), np.zeros((count, count))
        for first, block in pool.coordinates():
            drawn = sigma * noise_block(seed, first, count, block.shape[1]).astype(np.float64)
            top = 0 if pool.factor is None else first  # the factor is triangular
            add_products(cross[top:], block[top : count + 1], drawn)
            add_products(own, drawn)
        for first in range(0, count if pool.beside else 0, BLOCK):
            random = np.random.default_rng([seed, 1, first])
            width = min(BLOCK, count - first)
            triangle = np.tril(random.standard_normal((count - first, width)))
            np.fill_diagonal(triangle, np.sqrt(random.chisquare(pool.beside - first - np.arange(width))))
            add_products(own[first:, first:], sigma * triangle)
        return cls(sigma=sigma, seed=seed, cross=cross, own=mirrored(own))

    def onto_others(self, pool: Pool, weights: Floats) -> Floats:
        """Inner products of sums of noise with the readings outside of the pool, (n - m, k).

        Args:
            pool: The pool.
            weights: Weights of the noise of each of the pool's readings in each sum, (m, k).
        """
        count = len(pool.inside)
        result = np.zeros((len(pool.outside), weights.shape[1]))
        left = weights.T @ self.own @ weights
        for first, block in pool.coordinates():
            along = self.sigma * (noise_block(self.seed, first, count, block.shape[1]).T @ weights)
            result += block[count + 1 :] @ along
            left -= along.T @ along
        if pool.factor is not None and len(result):
            squares, turn = np.linalg.eigh(left)
            frame = (np.sqrt(np.maximum(squares, 0.0)) * turn).T[-pool.beside :]
            random = np.random.default_rng([self.seed, 2])
            directions = np.linalg.qr(random.standard_normal((pool.beside, weights.shape[1])))[0]
            result += pool.factor[count + 1 :, count + 1 :] @ (directions[: len(result)] @ frame)
        return result


@dataclass(frozen=True, kw_only=True, eq=False)
class Scores:
    """Principal component scores of one training set.

    Args:
        train: Of the augmented training set, in the order of ``Augmentation.rows``, (copies x train, components).
        plain: Of every reading of the study as it is, (n, components).
        variance: Variance of the training set along each component (ddof 1), (components,).
    """

    train: Floats
    plain: Floats
    variance: Floats


def principal_scores(
    pool: Pool, noise: Noise | None, augmentation: Augmentation, components: int, train: Ints | None = None
) -> Scores:
    """Fit principal components to an augmented training set and project all readings onto them.

    Args:
        pool: The readings.
        noise: The trial's; None if the augmentation has no noise.
        augmentation: The copies.
        components: Components to keep.
        train: Places in the pool of the training set; None for the whole pool.

    Raises:
        InputError: There are more components than the training set has directions.
    """
    places = np.arange(len(pool.inside)) if train is None else train
    count, copies = len(places), augmentation.count
    offsets = np.array(augmentation.offsets)[:, None, None]
    rows = count * copies
    require_components(components, rows, pool.numbers)

    def sums(vectors: Floats) -> tuple[Floats, Floats]:
        """C' v: sums of the training set's rows as sums of 1 and readings, and of noise."""
        parts = vectors.reshape(copies, count, -1)
        plain = np.zeros((len(pool.plain), parts.shape[2]))
        plain[0] = (offsets * parts).sum(axis=(0, 1))
        plain[1 + places] = parts.sum(axis=0)
        noisy = np.zeros((len(plain) - 1, parts.shape[2]))
        if noise is not None:
            noisy[places] = parts[1]
        return plain, noisy

    def products(plain: Floats, noisy: Floats) -> tuple[Floats, Floats]:
        """Inner products of such sums with 1 and the readings, and with noise."""
        if noise is None:
            return pool.plain @ plain, noisy
        return pool.plain @ plain + noise.cross @ noisy, noise.cross.T @ plain + noise.own @ noisy

    def along(plain: Floats, noisy: Floats) -> Floats:
        """Those with the training set's rows, (rows, k)."""
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
    plain = np.empty((len(pool.inside) + len(pool.outside), components))
    plain[pool.inside] = inside[1:]
    plain[pool.outside] = pool.outer @ weights[0]
    if noise is not None and len(pool.outside):
        plain[pool.outside] += noise.onto_others(pool, weights[1])
    plain -= along(inside, noisy).mean(axis=0)
    return Scores(train=vectors * lengths, plain=plain, variance=squares / (rows - 1))


def clipped_scores(images: Bytes, chosen: Ints, augmentation: Augmentation, components: int, seed: int) -> Scores:
    """The same for copies that are rounded and clipped to 0 to 255, as image tools save them.

    Clipped copies have no short cut: they are made, in uint8, and components are fitted to them as to readings.

    Args:
        images: All images, (n, pixels).
        chosen: Indices of the training set.
        augmentation: The copies.
        components: Components to keep.
        seed: Seed of the noise.

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
    plain = Products(rows=written).plain[1:, 1:]
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
    """Check how many components there are.

    Raises:
        InputError: More than rows of so many numbers allow.
    """
    most = min(rows - 1, numbers)
    if not 1 <= components <= most:
        what = f"must be from 1 to {most}: a training set has {rows} rows of {numbers} numbers"
        raise InputError("components", components, what)


def leading(apply: Callable[[Floats], Floats], size: int, count: int) -> tuple[Floats, Floats]:
    """Largest eigenvalues of a symmetric positive matrix that is known by its products, falling, with eigenvectors.

    Lanczos with implicit restarts (ARPACK), always from the same vector and down to rounding: each eigenvalue within
    1e-12 of the largest one. Whatever the spectrum, 2 count + 1 vectors are kept: a flat one, as of noise, takes more
    products but no more memory. A small matrix is written out.

    Args:
        apply: The matrix times vectors (size, any).
        size: Its size.
        count: How many eigenvalues.

    Returns:
        Eigenvalues (count,) and unit vectors (size, count), whose largest numbers are positive.

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
    most = int(np.sum(values > RANK * max(values[-1], 1.0)))
    if most < count:
        raise InputError("components", count, f"must be at most {most}: so many directions do the readings have")
    signs = np.sign(vectors[np.argmax(np.abs(vectors), axis=0), np.arange(count)])
    return values[::-1], (vectors * signs)[:, ::-1]


def add_products(products: Floats, left: NDArray[Any], right: NDArray[Any] | None = None) -> None:
    """Add the inner products of vectors to a matrix in place, a stripe of rows at a time.

    ``products += left @ right.T`` would need a second matrix of the same size, which in a study of many readings is
    the largest thing in memory.

    Args:
        products: What is added to, (n, m).
        left: Vectors, (n, numbers).
        right: Vectors, (m, numbers); None for the same ones, of which only the lower triangle is then kept.
    """
    for first in range(0, len(left), STRIPE):
        rows = slice(first, min(first + STRIPE, len(left)))
        others = left[: rows.stop] if right is None else right
        products[rows, : len(others)] += left[rows] @ others.T


def mirrored(products: Floats) -> Floats:
    """A symmetric matrix of which the lower triangle is known: the upper one is filled in, in place."""
    for first in range(0, len(products), STRIPE):
        rows = slice(first, min(first + STRIPE, len(products)))
        products[:first, rows] = products[rows, :first].T
        square = products[rows, rows]
        square[:] = np.tril(square) + np.tril(square, -1).T
    return products


def _blocks(rows: Rows, kind: type[np.floating[Any]]) -> Iterator[tuple[int, NDArray[Any]]]:
    """Columns of the constant reading 1 and of readings, moved towards 0, with the first one's number."""
    middle = np.full(rows.shape[1], MIDDLE) if rows.dtype == np.uint8 else rows.mean(axis=0)
    for first in range(0, rows.shape[1], BLOCK):
        columns = slice(first, min(first + BLOCK, rows.shape[1]))
        block = np.ones((len(rows) + 1, columns.stop - first), kind)
        np.subtract(rows[:, columns], middle[columns], out=block[1:], casting="same_kind", dtype=kind)
        yield first, block


def _factor(products: Floats, order: Ints) -> Floats:
    """Cholesky's factor of a matrix of inner products, taken in some order: the vectors' coordinates."""

    def factor(jitter: float) -> Floats:
        ordered = products[np.ix_(order, order)]
        ordered[np.diag_indices_from(ordered)] += jitter * np.trace(ordered) / len(ordered)
        return np.asarray(scipy.linalg.cholesky(ordered.T, lower=True, overwrite_a=True, check_finite=False))

    try:
        return factor(0.0)
    except scipy.linalg.LinAlgError:  # readings that are alike are set apart by 1e-5 of their length
        return factor(JITTER)
