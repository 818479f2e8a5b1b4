"""Compare principal components from inner products with scikit-learn's PCA of explicit training sets."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg

pytest.importorskip("sklearn")

from sklearn.decomposition import PCA

from tacbench_cad.lab.analysis.classification.augment import PAPER_COPIES, Augmentation, noise_block
from tacbench_cad.lab.analysis.classification.features import Features
from tacbench_cad.lab.analysis.classification.pca import (
    WRITTEN_OUT,
    PixelNoise,
    Pool,
    Scores,
    clipped_scores,
    leading,
    principal_scores,
    trial_scores,
)
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Bytes, Floats

pytestmark = pytest.mark.usefixtures("single_thread")

PLAIN = Augmentation()


def images_of(count: int, pixels: int, seed: int = 0) -> Bytes:
    """Return images of six kinds with some noise."""
    random = np.random.default_rng(seed)
    kinds = random.integers(0, 120, (6, pixels))
    return np.asarray(kinds[np.arange(count) % 6] + random.integers(0, 30, (count, pixels)), dtype=np.uint8)


def scores_of(pool: Pool, augmentation: Augmentation, components: int, seed: int = 7) -> Scores:
    return trial_scores(pool, augmentation, components, [seed])[0]


def assert_equals_scikit_learn(result: Scores, written: Floats, frames: Floats, variance: float = 1e-9) -> None:
    """Check scores against scikit-learn's PCA of an explicit set, with signs by its rows' largest scores."""
    components = result.train.shape[1]
    full = PCA(components, svd_solver="full").fit(written)
    train, plain = full.transform(written), full.transform(frames)
    signs = np.sign(train[np.argmax(np.abs(train), axis=0), np.arange(components)])
    size = np.abs(train).max()
    np.testing.assert_allclose(result.train, train * signs, atol=1e-9 * size)
    np.testing.assert_allclose(result.plain, plain * signs, atol=1e-9 * size)
    np.testing.assert_allclose(result.variance, full.explained_variance_, rtol=variance)


@pytest.mark.parametrize("kind", [np.uint8, np.float64])
@pytest.mark.parametrize(
    ("count", "numbers", "components", "augmentation"),
    [
        pytest.param(40, 30, 6, PAPER_COPIES, id="noise-drawn-number-by-number"),
        pytest.param(60, 15, 6, PAPER_COPIES, id="fewer-numbers-than-readings"),
        pytest.param(40, 24, 22, PAPER_COPIES, id="components-in-the-noise"),
        pytest.param(40, 30, 6, Augmentation(brightness=(10.0, 25.0, -4.0), noise=3.0), id="brightness-unbalanced"),
        pytest.param(40, 30, 6, replace(PAPER_COPIES, brightness=()), id="noise-only"),
        pytest.param(60, 300, 6, replace(PAPER_COPIES, noise=None), id="brightness-only"),
        pytest.param(60, 300, 6, PLAIN, id="as-they-are"),
        pytest.param(260, 2500, 25, replace(PAPER_COPIES, noise=None), id="not-written-out-and-several-blocks"),
    ],
)
def test_scores_equal_those_of_the_explicit_training_set(
    count: int, numbers: int, components: int, augmentation: Augmentation, kind: type
) -> None:
    rows = images_of(count, numbers).astype(kind)
    features = Features(rows=rows, shape=(numbers,))
    chosen = np.random.default_rng(1).permutation(count)[: count // 2]
    # A fold of a pool of all frames: its noise equals that of the copies for other estimators.
    pool = Pool.of(rows, components=components)
    noise = None if augmentation.noise is None else PixelNoise.of(pool, augmentation.noise, 7)
    result = principal_scores(pool, noise, augmentation, components, chosen)
    written = augmentation.rows(features, chosen, 7)
    assert_equals_scikit_learn(result, written, rows.astype(float))
    # A pool of the chosen frames only, with its own noise.
    result = scores_of(Pool.of(rows, chosen, components=components), augmentation, components)
    if augmentation.noise is not None:
        drawn = augmentation.noise * noise_block(7, 0, len(chosen), numbers).astype(float)
        written[len(chosen) : 2 * len(chosen)] = rows[chosen] + drawn
    assert_equals_scikit_learn(result, written, rows.astype(float))


def explicit_noise(pool: Pool, noise: PixelNoise) -> Floats:
    """Return noise with the inner products of a draw, (m, numbers); its directions outside the frames are arbitrary."""
    assert pool.factor is not None
    count = len(pool.inside)
    rows = np.vstack([np.ones(pool.rows.shape[1]), pool.rows[pool.inside].astype(float) - 128.0])
    frame = scipy.linalg.solve_triangular(pool.factor, rows, lower=True)  # orthonormal, (m + 1, numbers)
    along = noise.sigma * noise_block(noise.seed, 0, count, count + 1).astype(float)
    beside = scipy.linalg.cholesky(noise.own - along @ along.T, lower=True)
    rest = scipy.linalg.null_space(frame).T
    return np.asarray(along @ frame + beside @ rest[:count])


def test_training_scores_equal_those_of_noise_with_the_drawn_inner_products() -> None:
    """If noise is not drawn number by number, any noise with the drawn inner products gives the same scores."""
    rows = images_of(45, 400)
    pool = Pool.of(rows, np.arange(0, 45, 2), components=8, seeds=(3,))
    assert pool.factor is not None
    noise = PixelNoise.of(pool, 5.0, 3)
    result = principal_scores(pool, noise, PAPER_COPIES, 8)
    drawn = explicit_noise(pool, noise)
    assert 0.95 < drawn.std() / 5.0 < 1.05
    train = rows[pool.inside].astype(float)
    np.testing.assert_allclose(noise.cross[1:], (train - 128) @ drawn.T, atol=1e-6)
    written = np.concatenate([train, train + drawn, train + 10, train - 10])
    assert_equals_scikit_learn(result, written, train)


#: The number of draws whose means are compared.
DRAWS = 200


def test_the_noise_has_the_distribution_of_drawn_pixels() -> None:
    """Means over many draws agree with means over explicit draws of all pixels, within their standard errors."""
    images = images_of(24, 90)
    train = images[:12].astype(float)
    pool = Pool.of(images, np.arange(12), components=8, seeds=range(DRAWS))
    assert pool.factor is not None
    random = np.random.default_rng(9)
    ours, theirs = [], []
    for seed in range(DRAWS):
        scores = scores_of(pool, replace(PAPER_COPIES, noise=20.0), 8, seed)
        ours.append(features(scores.variance, scores.train[12:24], scores.plain[12:]))
    for _ in range(DRAWS):
        noisy = train + 20.0 * random.standard_normal(train.shape)
        written = np.concatenate([train, noisy, train + 10, train - 10])
        full = PCA(8, svd_solver="full").fit(written)
        theirs.append(features(full.explained_variance_, full.transform(noisy), full.transform(images[12:])))
    mine, other = np.array(ours), np.array(theirs)
    error = np.sqrt((mine.var(axis=0) + other.var(axis=0)) / DRAWS)
    assert np.all(np.abs(mine.mean(axis=0) - other.mean(axis=0)) < 4.5 * error)
    ratio = mine.std(axis=0) / other.std(axis=0)
    assert np.all((ratio > 0.75) & (ratio < 1.33))


def features(variance: Floats, noisy: Floats, others: Floats) -> Floats:
    """Return numbers of a trial that do not depend on signs; noise affects some much and others little."""
    return np.concatenate([variance, (noisy**2).mean(axis=0), (others**2).mean(axis=0)])


def test_a_draw_depends_on_its_seed_only() -> None:
    pool = Pool.of(images_of(40, 300), np.arange(0, 40, 2), components=5, seeds=(1, 2))
    first, second, other = (scores_of(pool, PAPER_COPIES, 5, seed) for seed in (1, 1, 2))
    assert np.array_equal(first.train, second.train) and np.array_equal(first.plain, second.plain)
    assert np.abs(first.train - other.train).max() > 1


@pytest.mark.parametrize("pixels", [1, 1023, 1024, 3000])
def test_inner_products_of_images_are_exact(pixels: int) -> None:
    images = np.random.default_rng(0).integers(0, 256, (9, pixels), dtype=np.uint8)
    images[0], images[1] = 0, 255
    shifted = np.vstack([np.ones(pixels, dtype=np.int64), images.astype(np.int64) - 128])
    assert np.array_equal(Pool.of(images, components=1, noise=False).plain, shifted @ shifted.T)


@pytest.mark.parametrize("numbers", [64, 4000])
def test_a_trial_needs_memory_for_two_more_matrices(numbers: int) -> None:
    """They are frames times noise and noise times noise; for a study of the paper's size each has 0.5 GB."""
    rows = np.random.default_rng(0).integers(0, 256, (1500, numbers), dtype=np.uint8)
    pool = Pool.of(rows, components=5)
    tracemalloc.start()
    PixelNoise.of(pool, 5.0, seed=1)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < (2.6 if numbers == 64 else 4.2) * pool.plain.nbytes


def test_clipped_copies_equal_those_of_the_explicit_training_set() -> None:
    images = images_of(40, 150)
    images[:, :75] = 3  # a dark background: darker copies are clipped there
    augmentation = replace(PAPER_COPIES, noise=None)
    result = clipped_scores(images, np.arange(20), augmentation, 5, seed=4)
    train = images[:20].astype(float)
    written = np.concatenate([np.clip(train + level, 0, 255) for level in (0, 10, -10)])
    assert_equals_scikit_learn(result, written, images.astype(float))
    unclipped = scores_of(Pool.of(images, np.arange(20), components=5, seeds=(7,)), augmentation, 5)
    assert not np.allclose(result.variance, unclipped.variance, rtol=1e-3)


def test_clipped_noise_is_rounded_and_seeded_and_close_to_unclipped_noise_on_bright_images() -> None:
    images = np.asarray(images_of(60, 400) // 2 + 70, dtype=np.uint8)
    first, other, repeated = (clipped_scores(images, np.arange(40), PAPER_COPIES, 4, seed=seed) for seed in (1, 2, 1))
    np.testing.assert_array_equal(first.train, repeated.train)
    assert np.abs(first.train[40:80] - other.train[40:80]).max() > 1
    free = scores_of(Pool.of(images, np.arange(40), components=4, seeds=(7,)), PAPER_COPIES, 4)
    np.testing.assert_allclose(first.variance, free.variance, rtol=0.05)
    assert first.train.shape == free.train.shape == (160, 4)


SPECTRA = {
    "falling": np.exp(-np.arange(WRITTEN_OUT + 100) / 20),
    "flat": 1 - 1e-9 * np.arange(WRITTEN_OUT + 100),
    "equal": np.ones(WRITTEN_OUT + 100),
    "several-equal": np.repeat([9.0, 4.0], [6, WRITTEN_OUT + 94]),
    "one-large": np.r_[1e6, np.linspace(1, 0.5, WRITTEN_OUT + 99)],
    "written-out": np.exp(-np.arange(WRITTEN_OUT) / 20),
}


@pytest.mark.parametrize("spectrum", SPECTRA)
def test_leading_eigenvectors(spectrum: str) -> None:
    values = SPECTRA[spectrum]
    size = len(values)
    turn = np.linalg.qr(np.random.default_rng(2).standard_normal((size, size)))[0]
    matrix = turn * values @ turn.T
    result, vectors = leading(lambda v: matrix @ v, size, 4)
    np.testing.assert_allclose(result, values[:4], rtol=0, atol=1e-12 * values[0])
    np.testing.assert_allclose(vectors.T @ vectors, np.eye(4), atol=1e-12)
    np.testing.assert_allclose(matrix @ vectors, vectors * result, atol=1e-12 * max(values[0], 1.0))
    assert np.all(vectors[np.argmax(np.abs(vectors), axis=0), np.arange(4)] > 0)


@pytest.mark.parametrize(("values", "max_components"), [((3.0, 2.0), 2), ((), 0)])
def test_a_matrix_with_fewer_directions_is_refused(values: tuple[float, ...], max_components: int) -> None:
    diagonal = np.zeros((WRITTEN_OUT + 100, 1))
    diagonal[: len(values), 0] = values
    with pytest.raises(InputError, match=f"components = 4: must be at most {max_components}, the number of directions"):
        leading(lambda v: diagonal * v, len(diagonal), 4)


def test_white_noise_needs_no_more_memory_than_its_eigenvectors() -> None:
    """Its spectrum is flat; a matrix of this size would be 18 MB."""
    noise = np.random.default_rng(3).standard_normal((1500, 300))
    expected = np.linalg.eigvalsh(noise.T @ noise)[::-1][:25]
    tracemalloc.start()
    result, vectors = leading(lambda v: noise @ (noise.T @ v), 1500, 25)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2e6
    np.testing.assert_allclose(result, expected, rtol=1e-8)
    np.testing.assert_allclose(noise @ (noise.T @ vectors), vectors * result, atol=1e-8 * expected[-1])
    repeated, same = leading(lambda v: noise @ (noise.T @ v), 1500, 25)
    assert np.array_equal(result, repeated) and np.array_equal(vectors, same)


def test_more_components_than_directions_are_refused() -> None:
    rows = images_of(20, 50)
    for components, augmentation, message in [
        (0, PAPER_COPIES, "components = 0: must be from 1 to 50"),
        (51, PAPER_COPIES, "components = 51"),
        (20, PLAIN, "components = 20: must be from 1 to 19"),
    ]:
        with pytest.raises(InputError, match=message):
            scores_of(Pool.of(rows, components=components), augmentation, components)
    with pytest.raises(InputError, match="components = 25: must be from 1 to 19"):
        clipped_scores(images_of(20, 50), np.arange(5), PAPER_COPIES, 25, seed=1)


def test_constant_images_vary_only_by_noise_and_brightness() -> None:
    """Equal images have no coordinates of full rank, so the program adds tiny differences."""
    images = np.full((10, 64), 80, np.uint8)
    with pytest.raises(InputError, match="at most 1, the number of directions"):
        scores_of(Pool.of(images, components=2), replace(PAPER_COPIES, noise=None), 2)
    with pytest.raises(InputError, match="at most 1, the number of directions"):
        clipped_scores(images, np.arange(10), replace(PAPER_COPIES, noise=None), 2, seed=0)
    pool = Pool.of(images, np.arange(6), components=2, seeds=(7,))
    assert pool.factor is not None
    result = scores_of(pool, PAPER_COPIES, 2)
    assert result.variance[0] > result.variance[1] > 0
    assert np.ptp(result.plain, axis=0).max() < 1e-2
