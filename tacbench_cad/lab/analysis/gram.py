"""Principal components of images through their Gram matrix, and what that rests on.

A study has far fewer images than an image has pixels, so the matrix of the images' inner products is small, and all
that their principal components need. It is exact: sums of products of whole numbers below 2^24 are exact in float32.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tacbench_cad.errors import InputError

Floats = NDArray[np.float64]
Images = NDArray[np.uint8]
Chosen = Sequence[int] | NDArray[np.int64]

#: Taken from every pixel before products are summed in float32: 1,024 products of -128..127 stay within 2^24.
MIDDLE = 128
#: Pixels whose products are summed in float32 before float64 takes over.
EXACT = 1024
#: Pixels that are made float64 at once.
BLOCK = 1024
#: Directions with less than this share of the largest squared length are taken for rounding.
RANK = 1e-12


def stacked(rows: Iterable[NDArray[np.uint8]], count: int) -> Images:
    """Images from an iterator, each read once, as rows (count, pixels) of one array.

    Args:
        rows: uint8 images of one size, any shape.
        count: How many there are.

    Raises:
        InputError: There are more or fewer, none, or one has another type or size.
    """
    images: Images | None = None
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


def gram(images: Images) -> Floats:
    """Inner products of the images after 128 is taken from each pixel, (n, n), exact."""
    count, pixels = images.shape
    products = np.zeros((count, count))
    for first in range(0, pixels, EXACT):
        block = images[:, first : first + EXACT].astype(np.float32)
        block -= MIDDLE
        products += block @ block.T
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
    images: Images,
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
    the order of copies are those of :class:`tacbench_cad.lab.analysis.augmented_pca.AugmentedPCA`.

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

    Block Lanczos with full orthogonalisation (Golub and Van Loan, 10.3.6), started from the first coordinates and 8
    random vectors; a small matrix, or a hard one, is written out.

    Args:
        apply: The matrix times vectors (size, any).
        size: Its size.
        count: How many eigenvalues.

    Returns:
        Eigenvalues (count,) and unit vectors (size, count).
    """
    block = count + 8
    if size > 12 * block:
        most = min(size // 2, 30 * block)
        basis = np.zeros((size, block + 8))
        basis[np.arange(block), np.arange(block)] = 1
        basis[:, block:] = np.random.default_rng(0).standard_normal((size, 8))
        basis = np.linalg.qr(basis)[0]
        images = apply(basis)
        while basis.shape[1] <= most:
            values, inner = np.linalg.eigh(basis.T @ images)
            inner = inner[:, ::-1][:, :block]
            vectors = basis @ inner
            misses = images @ inner - vectors * values[::-1][:block]
            if np.linalg.norm(misses[:, :count], axis=0).max() <= 1e-13 * values[-1]:
                return values[::-1][:count], vectors[:, :count]
            for _ in range(2):
                misses -= basis @ (basis.T @ misses)
                misses = np.linalg.qr(misses)[0]
            basis, images = np.hstack([basis, misses]), np.hstack([images, apply(misses)])
    values, vectors = np.linalg.eigh(apply(np.eye(size)))
    return values[::-1][:count], vectors[:, ::-1][:, :count]
