"""Principal components through Gram matrices against scikit-learn's PCA of sets that are written out."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator

import numpy as np
import pytest
import scipy.linalg

pytest.importorskip("sklearn")

from sklearn.decomposition import PCA
from threadpoolctl import threadpool_limits

from tacbench_cad.lab.analysis.classification.augmented_pca import AugmentedPCA
from tacbench_cad.lab.analysis.classification.gram import WRITTEN_OUT, Scores, clipped_scores, gram, leading, stacked
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Bytes, Floats


@pytest.fixture(autouse=True)
def _one_thread() -> Iterator[None]:
    """Matrices this small only lose by threads, much so on a busy machine."""
    with threadpool_limits(limits=1):
        yield


def images_of(count: int, pixels: int, seed: int = 0) -> Bytes:
    """Six kinds of images with some noise."""
    random = np.random.default_rng(seed)
    kinds = random.integers(0, 120, (6, pixels))
    return np.asarray(kinds[np.arange(count) % 6] + random.integers(0, 30, (count, pixels)), dtype=np.uint8)


def explicit_noise(pca: AugmentedPCA, seed: int, found: Scores) -> Floats:
    """Pixels of noise that belong to one draw, (n, pixels).

    Where the images span nothing, the draw only fixes how the noise lies along the components; the rest of the random
    frame may be any, and is chosen here.
    """
    draw = pca._draw(seed)
    solution = pca._solve(draw)
    train = pca.images[pca.chosen].astype(float)
    span = len(pca._lengths)
    seen = (train - train.mean(axis=0)).T @ pca._turn[:, :span] / pca._lengths
    if len(pca._ones) > span:
        seen = np.column_stack([seen, (1 - seen @ pca._ones[:span]) / pca._ones[span]])
    noise = draw.seen @ seen.T
    if pca._beside:
        assert found.components is not None
        weights = found.components.T * np.sign(np.sum(found.components.T * (seen @ solution.seen), axis=0))
        frame = (weights - seen @ (seen.T @ weights)) @ np.linalg.pinv(solution.frame)
        inner = solution.unseen @ np.linalg.pinv(solution.frame)
        rest = scipy.linalg.null_space(np.vstack([seen.T, frame.T]))
        other = scipy.linalg.null_space(inner.T)
        noise = noise + draw.unseen @ (inner @ frame.T + other @ rest[:, : other.shape[1]].T)
    return np.asarray(pca._turn @ noise)


@pytest.mark.parametrize(
    ("count", "chosen", "pixels", "components", "brightness", "noise"),
    [
        pytest.param(40, 20, 200, 6, (10.0, -10.0), 5.0, id="the-paper's-copies"),
        pytest.param(260, 210, 600, 3, (10.0, -10.0), 5.0, id="not-written-out"),
        pytest.param(40, 20, 30, 6, (10.0, -10.0), 5.0, id="noise-with-little-room-beside"),
        pytest.param(40, 20, 24, 22, (10.0, -10.0), 5.0, id="components-in-the-noise"),
        pytest.param(60, 30, 15, 6, (10.0, -10.0), 5.0, id="fewer-pixels-than-images"),
        pytest.param(40, 20, 200, 6, (10.0, 25.0, -4.0), 3.0, id="brightness-unbalanced"),
        pytest.param(40, 20, 200, 6, (), 5.0, id="noise-only"),
        pytest.param(40, 20, 200, 6, (10.0, -10.0), None, id="brightness-only"),
        pytest.param(40, 20, 200, 6, (), None, id="as-they-are"),
        pytest.param(20, 20, 200, 6, (10.0, -10.0), 0.0, id="noise-of-nothing"),
        pytest.param(300, 260, 2500, 25, (10.0, -10.0), 5.0, id="more-than-one-block-of-pixels"),
    ],
)
def test_scores_and_components_are_those_of_the_set_written_out(
    count: int, chosen: int, pixels: int, components: int, brightness: tuple[float, ...], noise: float | None
) -> None:
    images = images_of(count, pixels)
    indices = np.random.default_rng(1).permutation(count)[:chosen]
    pca = AugmentedPCA(images, indices, components=components, noise=noise, brightness=brightness)
    (found,) = pca.fits([5], range(count), keep_components=True)
    train = images[indices].astype(float)
    copies = [train, *(train + level for level in brightness)]
    if noise is not None:
        drawn = explicit_noise(pca, 5, found)
        if noise:
            assert 0.9 < drawn.std() / noise < 1.1
        copies.insert(1, train + drawn)
    full = PCA(components, svd_solver="full").fit(np.concatenate(copies))
    size = np.abs(found.augmented).max()
    augmented = full.transform(np.concatenate(copies)).reshape(found.augmented.shape)
    np.testing.assert_allclose(found.augmented, augmented, atol=1e-8 * size)
    np.testing.assert_allclose(found.others, full.transform(images.astype(float)), atol=1e-8 * size)
    np.testing.assert_allclose(found.components, full.components_, atol=1e-8)
    np.testing.assert_allclose(found.variance, full.explained_variance_, rtol=1e-8)


def test_the_noise_has_the_law_of_drawn_pixels() -> None:
    """Means over many draws agree with those over explicit draws of all pixels, within their standard errors."""
    images = images_of(24, 90)
    train = images[:12].astype(float)
    pca = AugmentedPCA(images, range(12), components=8, noise=20.0)
    random = np.random.default_rng(9)
    ours, theirs = [], []
    for one in pca.fits(range(300), range(12, 24)):
        ours.append(features(one.variance, one.augmented[1], one.others))
    for _ in range(300):
        noisy = train + 20.0 * random.standard_normal(train.shape)
        written = np.concatenate([train, noisy, train + 10, train - 10])
        full = PCA(8, svd_solver="full").fit(written)
        theirs.append(features(full.explained_variance_, full.transform(noisy), full.transform(images[12:])))
    one, other = np.array(ours), np.array(theirs)
    error = np.sqrt((one.var(axis=0) + other.var(axis=0)) / 300)
    assert np.all(np.abs(one.mean(axis=0) - other.mean(axis=0)) < 4.5 * error)
    ratio = one.std(axis=0) / other.std(axis=0)
    assert np.all((ratio > 0.75) & (ratio < 1.33))


def features(variance: Floats, noisy: Floats, others: Floats) -> Floats:
    """Numbers of one trial that do not depend on signs: where noise matters much and little."""
    return np.concatenate([variance, (noisy**2).mean(axis=0), (others**2).mean(axis=0)])


def test_a_draw_depends_on_its_seed_alone() -> None:
    images = images_of(40, 300)
    pca = AugmentedPCA(images, range(0, 40, 2), components=5)
    one, two, three = pca.fits([1, 2, 3], range(40))
    (alone,) = pca.fits([2], range(40))
    np.testing.assert_allclose(alone.augmented, two.augmented, atol=1e-9)
    np.testing.assert_allclose(alone.others, two.others, atol=1e-9)
    assert np.abs(one.augmented - three.augmented).max() > 1
    assert pca.fits([], range(40)) == []
    assert pca.fits([1])[0].others.shape == (0, 5)
    assert alone.components is None


@pytest.mark.parametrize("pixels", [1, 1023, 1024, 3000])
def test_the_gram_matrix_is_exact(pixels: int) -> None:
    random = np.random.default_rng(0)
    images = random.integers(0, 256, (9, pixels), dtype=np.uint8)
    images[0], images[1] = 0, 255
    shifted = images.astype(np.int64) - 128
    assert np.array_equal(gram(images), shifted @ shifted.T)


def test_clipped_copies_are_those_of_the_set_written_out() -> None:
    images = images_of(40, 150)
    images[:, :75] = 3  # a dark background: darker copies are clipped there
    found = clipped_scores(images, range(20), range(40), seed=4, components=5, noise=None)
    train = images[:20].astype(float)
    written = np.concatenate([np.clip(train + level, 0, 255) for level in (0, 10, -10)])
    full = PCA(5, svd_solver="full").fit(written)
    np.testing.assert_allclose(found.augmented.reshape(-1, 5), full.transform(written), atol=1e-8)
    np.testing.assert_allclose(found.others, full.transform(images.astype(float)), atol=1e-8)
    np.testing.assert_allclose(found.components, full.components_, atol=1e-8)
    (unclipped,) = AugmentedPCA(images, range(20), components=5, noise=None).fits([4])
    assert not np.allclose(found.variance, unclipped.variance, rtol=1e-3)


def test_clipped_noise_is_rounded_drawn_by_seed_and_near_the_unclipped_on_bright_images() -> None:
    images = np.asarray(images_of(60, 400) // 2 + 70, dtype=np.uint8)
    one, two, again = (clipped_scores(images, range(40), range(60), seed=s, components=4) for s in (1, 2, 1))
    np.testing.assert_array_equal(one.augmented, again.augmented)
    assert np.abs(one.augmented[1] - two.augmented[1]).max() > 1
    (free,) = AugmentedPCA(images, range(40), components=4).fits([1])
    np.testing.assert_allclose(one.variance, free.variance, rtol=0.05)
    assert one.augmented.shape == free.augmented.shape == (4, 40, 4)


SPECTRA = {
    "falling": np.exp(-np.arange(WRITTEN_OUT + 100) / 20),
    "flat": 1 - 1e-9 * np.arange(WRITTEN_OUT + 100),
    "equal": np.ones(WRITTEN_OUT + 100),
    "several-equal": np.repeat([9.0, 4.0], [6, WRITTEN_OUT + 94]),
    "one-large": np.r_[1e6, np.linspace(1, 0.5, WRITTEN_OUT + 99)],
    "few-directions": np.r_[3.0, 2.0, np.zeros(WRITTEN_OUT + 98)],
    "none": np.zeros(WRITTEN_OUT + 100),
    "written-out": np.exp(-np.arange(WRITTEN_OUT) / 20),
}


@pytest.mark.parametrize("spectrum", SPECTRA)
def test_leading_eigenvectors(spectrum: str) -> None:
    values = SPECTRA[spectrum]
    size = len(values)
    turn = np.linalg.qr(np.random.default_rng(2).standard_normal((size, size)))[0]
    matrix = turn * values @ turn.T
    found, vectors = leading(lambda v: matrix @ v, size, 4)
    np.testing.assert_allclose(found, values[:4], rtol=0, atol=1e-12 * values[0])
    np.testing.assert_allclose(vectors.T @ vectors, np.eye(4), atol=1e-12)
    np.testing.assert_allclose(matrix @ vectors, vectors * found, atol=1e-12 * max(values[0], 1.0))


def test_white_noise_takes_no_more_memory_than_its_eigenvectors() -> None:
    """Its spectrum is flat; a matrix of this size would be 18 MB."""
    noise = np.random.default_rng(3).standard_normal((1500, 300))
    wanted = np.linalg.eigvalsh(noise.T @ noise)[::-1][:25]
    tracemalloc.start()
    found, vectors = leading(lambda v: noise @ (noise.T @ v), 1500, 25)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2e6
    np.testing.assert_allclose(found, wanted, rtol=1e-8)
    np.testing.assert_allclose(noise @ (noise.T @ vectors), vectors * found, atol=1e-8 * wanted[-1])
    again, same = leading(lambda v: noise @ (noise.T @ v), 1500, 25)
    assert np.array_equal(found, again) and np.array_equal(vectors, same)


def test_images_are_stacked_from_an_iterator_once() -> None:
    read = []

    def source() -> Iterator[Bytes]:
        for index in range(5):
            read.append(index)
            yield np.full((3, 4), index, np.uint8)

    assert stacked(source(), 5).tolist() == [[index] * 12 for index in range(5)]
    assert read == [0, 1, 2, 3, 4]


@pytest.mark.parametrize(
    ("rows", "count", "message"),
    [
        ([], 0, "at least one"),
        ([np.zeros(3, np.uint8)], 2, "images = 1: must be 2 images"),
        ([np.zeros(3, np.uint8)] * 3, 2, "image 3"),
        ([np.zeros(3, np.uint8), np.zeros(4, np.uint8)], 2, "image 2 = 'uint8 of 4 pixels': must be uint8 of 3"),
        ([np.zeros(3)], 1, "image 1 = 'float64 of 3 pixels'"),
    ],
)
def test_wrong_images_are_named(rows: list[Bytes], count: int, message: str) -> None:
    with pytest.raises(InputError, match=message):
        stacked(iter(rows), count)


def test_parameters_that_are_not_allowed_are_named() -> None:
    images = images_of(20, 50)
    for options, message in [
        ({"components": 0}, "components = 0: must be from 1 to 50"),
        ({"components": 51}, "components = 51"),
        ({"components": 20, "noise": None, "brightness": ()}, "must be at most"),
        ({"noise": -1.0}, "noise = -1.0"),
        ({"brightness": (float("nan"),)}, "brightness"),
    ]:
        with pytest.raises(InputError, match=message):
            AugmentedPCA(images, range(20), **options)
    with pytest.raises(InputError, match="must be uint8"):
        AugmentedPCA(images.astype(float), range(20))
    with pytest.raises(InputError, match="components = 25: must be from 1 to 19"):
        clipped_scores(images, range(5), seed=1)


def test_constant_images_have_no_directions_but_their_noise_and_brightness() -> None:
    images = np.full((10, 64), 80, np.uint8)
    with pytest.raises(InputError, match="at most 1: so many directions"):
        AugmentedPCA(images, range(10), components=2, noise=None)
    with pytest.raises(InputError, match="at most 1: so many directions"):
        clipped_scores(images, range(10), seed=0, components=2, noise=None)
    (found,) = AugmentedPCA(images, range(10), components=2).fits([0], range(10))
    assert found.variance[0] > found.variance[1] > 0
    assert np.ptp(found.others, axis=0).max() < 1e-9
