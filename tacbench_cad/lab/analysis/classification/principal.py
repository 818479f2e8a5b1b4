"""Principal components of training sets, from the inner products of all frames.

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

import numpy as np

from tacbench_cad.lab.analysis.classification.augment import Augmentation
from tacbench_cad.lab.analysis.classification.features import Rows
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


@dataclass(frozen=True, kw_only=True, eq=False)
class Products:
    """The inner products of n frames, minus a frame that is the same for all of them.

    Args:
        gram: The inner products of the frames with each other, (n, n).
        sums: Their inner products with the constant frame 1, (n,).
        numbers: The number of numbers of a frame.
    """

    gram: Floats
    sums: Floats
    numbers: int

    @classmethod
    def of(cls, rows: Rows) -> Products:
        """Compute the inner products of frames, (n, numbers). Those of images are exact."""
        image, numbers = rows.dtype == np.uint8, rows.shape[1]
        middle = np.full(numbers, MIDDLE) if image else rows.mean(axis=0)
        gram, sums = np.zeros((len(rows), len(rows))), np.zeros(len(rows))
        for first in range(0, numbers, BLOCK):
            columns = slice(first, first + BLOCK)
            block = np.subtract(rows[:, columns], middle[columns], dtype=np.float32 if image else np.float64)
            gram += block @ block.T
            sums += block.sum(axis=1)
        return cls(gram=gram, sums=sums, numbers=numbers)

    def between(self, left: Ints, added: Floats, right: Ints, added_right: Floats) -> Floats:
        """Return the inner products of frames to which constants were added, shape (left, right)."""
        products = self.gram[np.ix_(left, right)]
        products += added[:, None] * self.sums[right]
        products += self.sums[left][:, None] * added_right
        products += added[:, None] * added_right * self.numbers
        return products


def coordinates(
    products: Products, copies: Augmentation, components: int, train: Ints, test: Ints
) -> tuple[Floats, Floats]:
    """Return coordinates of a training set with its brighter and darker copies, and of test frames.

    The coordinates are the scores of the principal components. If noise will be added by :func:`noisy`, these are more
    than the wanted components.

    Args:
        products: The inner products of all frames.
        copies: The copies of training frames.
        components: The number of components.
        train: The indices of the training frames.
        test: The indices of the test frames.

    Raises:
        InputError: There are more components than the rows and their numbers allow.
    """
    from sklearn.decomposition import KernelPCA

    limit = min(len(train) * copies.count - 1, products.numbers)
    if not 1 <= components <= limit:
        what = f"must be from 1 to {limit}: a training set has {limit + 1} rows of {products.numbers} numbers"
        raise InputError("components", components, what)
    added = np.repeat([0.0, *copies.brightness], len(train))
    rows = np.tile(train, 1 + len(copies.brightness))
    count = components if copies.noise is None else max(DIRECTIONS, components)
    count = min(count, len(rows) - 1, products.numbers)
    solver = "dense" if len(rows) <= _DENSE else "arpack" if count <= _FEW else "randomized"
    model = KernelPCA(count, kernel="precomputed", eigen_solver=solver, random_state=0, copy_X=False)
    trained = model.fit_transform(products.between(rows, added, rows, added))
    return trained, model.transform(products.between(test, np.zeros(len(test)), rows, added))


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
    from sklearn.decomposition import PCA

    plain = trained[: len(trained) // (1 + len(copies.brightness))]
    noise = copies.noise * np.random.default_rng(seed).standard_normal(plain.shape)
    rows = np.concatenate([plain, plain + noise, trained[len(plain) :]])
    pca = PCA(min(components, rows.shape[1]), svd_solver="covariance_eigh")
    return pca.fit_transform(rows), pca.transform(tested)
