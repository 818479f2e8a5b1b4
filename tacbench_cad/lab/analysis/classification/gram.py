"""Principal components of images through their Gram matrix, and what that rests on.

A study has far fewer images than an image has pixels, so the matrix of the images' inner products is small, and all
that their principal components need. It is exact: sums of products of whole numbers below 2^24 are exact in float32.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.sparse.linalg import LinearOperator, eigsh

from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Bytes, Floats, Ints

Chosen = Sequence[int] | Ints

#: Taken from every pixel before products are summed in float32: 1,024 products of -128..127 stay within 2^24.
MIDDLE = 128
#: Pixels whose products are summed in float32 before float64 takes over.
EXACT = 1024
#: Pixels that are made float64 at once.
BLOCK = 1024
#: Rows of a matrix of inner products that are added to at once.
STRIPE = 512
#: Size up to which a matrix that is known by its products is written out to find its eigenvectors.
WRITTEN_OUT = 400
#: Directions with less than this share of the largest squared length are taken for rounding.
RANK = 1e-12


def stacked(rows: Iterable[Bytes], count: int) -> Bytes:
    """Images from an iterator, each read once, as rows (count, pixels) of one array.

    Args:
        rows: uint8 images of one size, any shape.
        count: How many there are.

    Raises:
        InputError: There are more or fewer, none, or one has another type or size.
    """
    images: Bytes | None = None
    index = -1
    for index, row in enumerate(rows):
        if images is None:
            images = np.empty((count, row.size), np.uint8)
        if row.dtype != np.uint8 or row.size != images.shape[1] or index >= count:
            what = f"{row.dtype} of {row.size} pixels"
            raise InputError(f"image {index + 1}", what, f"must be uint8 of {images.shape[1]}, {count} images in all")
        images[index] = row.ravel()
    if images is None or index + 1 != count:
        raise InputError("images", index + 1, f"must be {count} images, and at least one")
    return images


def gram(images: Bytes) -> Floats:
    """Inner products of the images after 128 is taken from each pixel, (n, n), exact."""
    count, pixels = images.shape
    products = np.zeros((count, count))
    for first in range(0, pixels, EXACT):
        block = images[:, first : first + EXACT].astype(np.float32)
        block -= MIDDLE
        add_products(products, block)
    return mirrored(products)


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


@dataclass(frozen=True, kw_only=True, eq=False)
class Scores:
    """Principal component scores of one trial, each component's sign as in scikit-learn: its largest weight positive.

    Args:
        augmented: Of the augmented set, (copies, n, components); as it is, then the noise copy, then the others.
        others: Of other images, as they are, (others, components).
        variance: The augmented set's variance along each component (ddof 1), (components,).
        components: Unit vectors in pixels, (components, pixels), if asked for.
    """

    augmented: Floats
    others: Floats
    variance: Floats
    components: Floats | None = None


def clipped_scores(
    images: Bytes,
    chosen: Chosen,
    others: Chosen = (),
    *,
    seed: int,
    components: int = 25,
    noise: float | None = 5.0,
    brightness: Sequence[float] = (10.0, -10.0),
) -> Scores:
    """Scores of an augmented set whose copies are rounded and clipped to uint8, as image tools save them.

    Clipped copies have no short cut: they are made, in uint8, and their Gram matrix with them. The law of the noise and
    the order of copies are those of :class:`tacbench_cad.lab.analysis.classification.augmented_pca.AugmentedPCA`.

    Args:
        images: All images, (N, pixels).
        chosen: Indices of those that are augmented.
        others: Indices of images to project as they are.
        seed: Seed of the noise.
        components: Components to keep.
        noise: Standard deviation of the noise copy; None leaves it out.
        brightness: What is added to every pixel of each other copy.

    Raises:
        InputError: There are more components than dimensions.
    """
    train = images[np.asarray(chosen, dtype=np.int64)]
    random = np.random.default_rng([seed, 0])
    count = 1 + (noise is not None) + len(brightness)
    copies = np.empty((count, *train.shape), np.uint8)
    for index, image in enumerate(train):
        changed = [image] if noise is None else [image, image + noise * random.standard_normal(image.size)]
        changed += [image + level for level in brightness]
        copies[:, index] = np.clip(np.rint(changed), 0, 255)
    rows = copies.reshape(-1, train.shape[1])
    products = gram(rows)
    mean = products.mean(axis=0)
    products -= mean
    products -= mean[:, None]
    products += mean.mean()
    most = min(rows.shape[0] - 1, rows.shape[1])
    if not 1 <= components <= most:
        raise InputError("components", components, f"must be from 1 to {most}")
    squares, vectors = leading(lambda v: np.asarray(products @ v), len(rows), components)
    if squares[-1] <= RANK * max(squares[0], 1.0):
        most = int(np.sum(squares > RANK * max(squares[0], 1.0)))
        raise InputError("components", components, f"must be at most {most}: so many directions do the images have")
    lengths = np.sqrt(squares)
    onto = (vectors - vectors.mean(axis=0)) / lengths
    indices = np.asarray(others, dtype=np.int64)
    scores = np.zeros((len(indices), components))
    weights = np.empty((components, rows.shape[1]))
    for first in range(0, rows.shape[1], BLOCK):
        block = slice(first, first + BLOCK)
        pixels = rows[:, block].astype(np.float64) - MIDDLE
        found = pixels.T @ onto
        weights[:, block] = found.T
        scores += (images[indices, block].astype(np.float64) - (MIDDLE + pixels.mean(axis=0))) @ found
    signs = np.where(weights[np.arange(components), np.argmax(np.abs(weights), axis=1)] < 0, -1.0, 1.0)
    return Scores(
        augmented=(vectors * lengths * signs).reshape(count, -1, components),
        others=scores * signs,
        variance=squares / (len(rows) - 1),
        components=weights * signs[:, None],
    )


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
        Eigenvalues (count,) and unit vectors (size, count).
    """
    if size <= max(WRITTEN_OUT, 4 * count):
        values, vectors = scipy.linalg.eigh(apply(np.eye(size)), subset_by_index=(size - count, size - 1))
    else:
        start = np.random.default_rng(0).standard_normal(size)
        if not np.any(apply(start[:, None])):
            return np.zeros(count), np.eye(size, count)  # ARPACK knows no matrix of zeros
        operator = LinearOperator((size, size), matvec=lambda v: apply(v.reshape(-1, 1)).ravel(), dtype=np.float64)
        values, vectors = eigsh(operator, count, which="LA", v0=start)
    return values[::-1], vectors[:, ::-1]
