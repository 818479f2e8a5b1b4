"""The rows of training sets: copies of frames, and principal components from the inner products of all frames.

Copies are made for training sets only: with noise, brighter, darker.

A frame has many more numbers than a study has frames, and a study has many training sets. The inner products of all
frames are therefore computed once, and scikit-learn's ``KernelPCA`` finds the components of each training set from
them. The result equals that of scikit-learn's ``PCA`` on the rows themselves, except for the signs of components, and
for components without variance: they are exactly 0 here. In ``PCA`` they are rounding errors, which scaling would turn
into noise as strong as the other components.

Brighter and darker copies of a frame need no images either: their inner products follow from those with the constant
frame 1. Noisy copies are made in coordinates: Gaussian noise has the same distribution along any orthonormal
directions, and only the noise along the first :data:`DIRECTIONS` directions of the training set is drawn. Noise in the
other directions changes the leading components very little, because it is spread over thousands of directions.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.decomposition import PCA, KernelPCA

from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats, Ints

#: The number of directions along which noise is drawn.
DIRECTIONS = 300
#: The number of columns that are multiplied at a time. The sum of 1,024 products of numbers from -128 to 127 is exact
#: in 32 bits.
BLOCK = 1024
MIDDLE = 128
#: The largest training set of which all eigenvectors are computed, and the largest number of components for ARPACK.
_DENSE, _FEW = 500, 100


@dataclass(frozen=True, kw_only=True)
class Augmentation:
    """The copies that are added to each training frame; they are not clipped. By default there are none.

    Args:
        noise: The standard deviation of the Gaussian noise on one copy, in the unit of the frames; None for no noisy
            copy.
        brightness: The amounts that are added to all numbers of a frame, one for each further copy.

    Raises:
        InputError: A number is not allowed.
    """

    noise: float | None = None
    brightness: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if self.noise is not None and not (np.isfinite(self.noise) and self.noise > 0):
            raise InputError("noise", self.noise, "must be a standard deviation above 0, or none")
        if not np.isfinite(self.brightness).all() or 0.0 in self.brightness:
            raise InputError("brightness", list(self.brightness), "must be numbers other than 0, or none")

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the copies, in their order: ``none``, ``noise 5``, ``+10``, ``-10``."""
        noisy = () if self.noise is None else (f"noise {self.noise:g}",)
        return ("none", *noisy, *(f"{level:+g}" for level in self.brightness))

    @property
    def count(self) -> int:
        """The number of rows for each training frame, including the frame itself."""
        return len(self.names)

    def rows(self, frames: NDArray[Any], seed: int) -> Floats:
        """Make the copies of some frames.

        Args:
            frames: The frames, (n, numbers).
            seed: The seed of the noise.

        Returns:
            First the unchanged frames, then the frames with noise, then each brightness; (copies x n, numbers).
        """
        plain = frames.astype(np.float64)
        random = np.random.default_rng(seed)
        noise = [] if self.noise is None else [plain + self.noise * random.standard_normal(plain.shape)]
        return np.concatenate([plain, *noise, *(plain + level for level in self.brightness)])


#: The copies of the paper's text.
PAPER_COPIES = Augmentation(noise=5.0, brightness=(10.0, -10.0))


def inner_products(rows: NDArray[Any]) -> Floats:
    """Return the inner products of frames, (n, numbers), minus a frame that is the same for all of them.

    Those of images are exact.

    Returns:
        The products of all frames and of the constant frame 1, which is the last; (n + 1, n + 1).
    """
    image, numbers = rows.dtype == np.uint8, rows.shape[1]
    middle = np.full(numbers, MIDDLE) if image else rows.mean(axis=0)
    products = np.zeros((len(rows) + 1, len(rows) + 1))
    for first in range(0, numbers, BLOCK):
        columns = slice(first, first + BLOCK)
        block = np.subtract(rows[:, columns], middle[columns], dtype=np.float32 if image else np.float64)
        block = np.vstack([block, np.ones_like(block[:1])])
        products += block @ block.T
    return products


def coordinates(
    products: Floats, copies: Augmentation, components: int, train: Ints, test: Ints
) -> tuple[Floats, Floats]:
    """Return coordinates of a training set with its brighter and darker copies, and of test frames.

    The coordinates are the scores of the principal components. If noise will be added by :func:`noisy`, these are more
    than the wanted components.

    Args:
        products: The inner products of all frames, from :func:`inner_products`.
        copies: The copies of training frames.
        components: The number of components.
        train: The indices of the training frames.
        test: The indices of the test frames.

    Raises:
        InputError: There are more components than the rows and their numbers allow.
    """
    numbers = int(products[-1, -1])
    limit = min(len(train) * copies.count - 1, numbers)
    if not 1 <= components <= limit:
        what = f"must be from 1 to {limit}: a training set has {limit + 1} rows of {numbers} numbers"
        raise InputError("components", components, what)
    added = np.repeat([0.0, *copies.brightness], len(train))
    rows = np.tile(train, 1 + len(copies.brightness))

    def with_rows(left: Ints, constant: Floats) -> Floats:
        """Return the inner products of frames to which constants are added with the rows of the training set."""
        found = products[np.ix_(left, rows)]
        found += np.outer(constant, products[-1, rows])
        found += np.outer(products[left, -1] + numbers * constant, added)
        return found

    count = components if copies.noise is None else max(DIRECTIONS, components)
    count = min(count, len(rows) - 1, numbers)
    solver = "dense" if len(rows) <= _DENSE else "arpack" if count <= _FEW else "randomized"
    model = KernelPCA(count, kernel="precomputed", eigen_solver=solver, random_state=0, copy_X=False)
    trained = model.fit_transform(with_rows(rows, added))
    return trained, model.transform(with_rows(test, np.zeros(len(test))))


def noisy(trained: Floats, tested: Floats, copies: Augmentation, components: int, seed: int) -> tuple[Floats, Floats]:
    """Add a noisy copy of each training frame, and return the principal scores of all training rows and test frames.

    Args:
        trained: The coordinates of the training set with its brighter and darker copies.
        tested: The coordinates of the test frames.
        copies: The copies of training frames. Without noise, the coordinates are returned unchanged.
        components: The number of components.
        seed: The seed of the noise.
    """
    if copies.noise is None:
        return trained, tested
    plain = trained[: len(trained) // (1 + len(copies.brightness))]
    noise = copies.noise * np.random.default_rng(seed).standard_normal(plain.shape)
    rows = np.concatenate([plain, plain + noise, trained[len(plain) :]])
    pca = PCA(min(components, rows.shape[1]), svd_solver="covariance_eigh")
    return pca.fit_transform(rows), pca.transform(tested)
