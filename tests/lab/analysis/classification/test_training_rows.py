"""Compare principal components from inner products with scikit-learn's PCA of the rows themselves."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.cases import mostly_long
from sklearn.decomposition import PCA

from tacbench_cad.lab.analysis.classification.training_rows import (
    PAPER_COPIES,
    Augmentation,
    coordinates,
    inner_products,
    noisy,
)
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats

BRIGHTNESS = Augmentation(brightness=(10.0, -20.0))


def frames(count: int, pixels: int, kind: type) -> np.ndarray:
    """Return images of a few smooth patterns with noise."""
    random = np.random.default_rng(4)
    patterns = random.standard_normal((8, pixels)) * np.arange(8, 0, -1)[:, None]
    rows = 120.0 + 2.0 * random.standard_normal((count, 8)) @ patterns + random.standard_normal((count, pixels))
    return np.clip(np.rint(rows), 0, 255).astype(np.uint8) if kind is np.uint8 else rows


def same_up_to_signs(a: Floats, b: Floats) -> bool:
    return bool(np.allclose(np.abs(a), np.abs(b), atol=1e-7 * np.abs(b).max()))


@pytest.mark.parametrize("kind", [np.uint8, np.float64])
@pytest.mark.parametrize("copies", [Augmentation(), BRIGHTNESS])
@pytest.mark.parametrize(("count", "pixels"), [(60, 3000), (60, 20), (700, 300)])
def test_scores_equal_those_of_the_explicit_training_set(
    kind: type, copies: Augmentation, count: int, pixels: int
) -> None:
    rows = frames(count, pixels, kind)
    train, test = np.arange(0, count - 7), np.arange(count - 9, count)
    trained, tested = coordinates(inner_products(rows), copies, 6, train, test)
    pca = PCA(6, svd_solver="full").fit(copies.rows(rows[train], 0))
    assert same_up_to_signs(trained, pca.transform(copies.rows(rows[train], 0)))
    assert same_up_to_signs(tested, pca.transform(rows[test].astype(float)))
    assert np.allclose(np.sign(tested[:2]), np.sign(trained[count - 9 : count - 7]))


def test_inner_products_of_images_are_exact() -> None:
    rows = np.random.default_rng(0).integers(0, 256, (5, 3001), dtype=np.uint8)
    centred = np.vstack([rows.astype(np.int64) - 128, np.ones(3001, np.int64)])
    assert np.array_equal(inner_products(rows), centred @ centred.T)


@pytest.mark.parametrize(("count", "pixels"), mostly_long([(80, 4000), (400, 2000)], (80, 4000)))
def test_scores_of_noisy_copies_agree_with_drawn_pixels(count: int, pixels: int) -> None:
    rows = frames(count, pixels, np.uint8)
    train, test = np.arange(count - 10), np.arange(count - 10, count)
    found = coordinates(inner_products(rows), PAPER_COPIES, 5, train, test)
    trained, tested = noisy(*found, PAPER_COPIES, 5, seed=1)
    explicit = PAPER_COPIES.rows(rows[train], 1)
    pca = PCA(5, svd_solver="full").fit(explicit)
    expected = pca.transform(explicit)
    assert trained.shape == expected.shape
    assert np.allclose(trained.var(axis=0), expected.var(axis=0), rtol=0.01)
    for a, b in ((tested, pca.transform(rows[test].astype(float))), (trained[: len(train)], expected[: len(train)])):
        assert np.max(np.abs(np.abs(a) - np.abs(b))) < 0.02 * np.abs(b).max()
    noise = trained[len(train) : 2 * len(train)] - trained[: len(train)]
    assert np.all(np.abs(noise.std(axis=0) - 5.0) < 1.5)
    assert np.array_equal(trained, noisy(*found, PAPER_COPIES, 5, seed=1)[0])
    assert not np.allclose(trained, noisy(*found, PAPER_COPIES, 5, seed=2)[0])


@pytest.mark.parametrize("components", [0, 12])
def test_more_components_than_directions_are_refused(components: int) -> None:
    products = inner_products(frames(20, 50, np.uint8))
    with pytest.raises(InputError, match="must be from 1 to 11: a training set has 12 rows of 50 numbers"):
        coordinates(products, Augmentation(), components, np.arange(12), np.arange(12, 20))


def test_copies_have_the_named_noise_and_brightness() -> None:
    assert PAPER_COPIES.names == ("none", "noise 5", "+10", "-10")
    plain = frames(40, 300, np.uint8).astype(float)
    same, noise, brighter, darker = np.split(PAPER_COPIES.rows(plain, 9), 4)
    assert np.array_equal(same, plain) and np.array_equal(brighter, plain + 10) and np.array_equal(darker, plain - 10)
    assert np.array_equal(noise, plain + 5.0 * np.random.default_rng(9).standard_normal(plain.shape))
    for wrong in ({"noise": 0.0}, {"noise": np.inf}, {"brightness": (0.0,)}):
        with pytest.raises(InputError, match="must be"):
            Augmentation(**wrong)  # type: ignore[arg-type]
