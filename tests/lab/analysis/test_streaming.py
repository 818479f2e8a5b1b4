"""Test the pass over the frames: equal to NumPy's two passes, independent of processes, and constant in memory."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from helpers.studies import PRINTERS, SHAPE, write_study

from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.pixels import Pixels
from tacbench_cad.lab.analysis.variance.moments import MAP_SIDE, small_map, sum_of_squares
from tacbench_cad.lab.analysis.variance.streaming import Pass, levels_with_most_prints, stream
from tacbench_cad.lab.parallel import workers
from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.study.presses import Press
from tacbench_cad.lab.study.spec import PrintedBlock
from tacbench_cad.spec.protocol import PressGrid
from tacbench_cad.util.types import Floats, Ints


def passed(collection: Collection, jobs: int = 1) -> Pass:
    with workers(jobs) as team:
        return stream(collection, Pixels(), team)


def at(collection: Collection, level: int, position: int) -> Ints:
    return np.flatnonzero((collection.level == level) & (collection.position == position))


def frames_of(collection: Collection, which: Ints) -> Floats:
    return np.stack([collection.frame(int(i)).astype(np.float64).ravel() for i in which])


@pytest.fixture(scope="module")
def study(make_study: Callable[..., Collection]) -> Collection:
    return make_study(levels=(1, 3), copies=3)


@pytest.fixture(scope="module")
def streamed(study: Collection) -> Pass:
    return passed(study)


@pytest.mark.parametrize("ddof", [0, 1])
def test_each_cell_has_numpys_variance(study: Collection, streamed: Pass, ddof: int) -> None:
    assert len(streamed.places) == 2 * 4
    for place in streamed.places:
        assert len(place.cells) == 4
        here = at(study, place.level, place.position)
        for (combination, texture), cell in place.cells.items():
            mine = here[(study.combination[here] == combination) & (study.texture[here] == texture)]
            two_pass = frames_of(study, mine).var(axis=0, ddof=ddof).mean()
            assert cell.variance(ddof) == pytest.approx(two_pass, rel=1e-9)
            assert cell.prints == 3 and cell.presses == 6


def test_the_nested_sums_of_squares_equal_those_of_two_passes(study: Collection, streamed: Pass) -> None:
    for place in streamed.places:
        here = at(study, place.level, place.position)
        values = frames_of(study, here)
        labels = [(study.texture[i], study.combination[i], study.copy[i], i) for i in here]
        means = [
            np.stack([values[[other[:depth] == label[:depth] for other in labels]].mean(axis=0) for label in labels])
            for depth in range(5)
        ]
        direct = [((fine - coarse) ** 2).sum(axis=0).mean() for coarse, fine in pairwise(means)]
        np.testing.assert_allclose(place.nested.squares, direct, rtol=1e-9)
        # There are 2 textures, 2 printers for each texture, 3 prints for each printer and 2 repeats for each print.
        assert place.nested.dof.tolist() == [1, 2, 8, 12]


def test_distances_of_textures_are_distances_of_their_means(study: Collection, streamed: Pass) -> None:
    place = streamed.places[5]
    here = at(study, place.level, place.position)
    for combination, (names, distances) in place.distances.items():
        mine = study.combination[here] == combination
        means = [frames_of(study, here[mine & (study.texture[here] == name)]).mean(axis=0) for name in names]
        assert distances[0, 1] == pytest.approx(((means[0] - means[1]) ** 2).mean(), rel=1e-9)
        assert distances[0, 0] == 0.0


def test_the_noise_floor_is_the_variance_of_the_stationary_frames_of_a_series(
    study: Collection, streamed: Pass
) -> None:
    assert list(streamed.floors) == list(range(12))
    run = study.runs[7]
    series = [np.stack(run.stationary(when, True)).astype(np.float64) for when in ("start", "end")]
    found, dof = streamed.floors[7]
    assert dof == 4
    squares = sum(2.0 * frames.var(axis=0, ddof=1).mean() for frames in series)
    assert found == pytest.approx(squares, rel=1e-9)


def test_maps_are_the_sum_of_the_pixels_variances(study: Collection, streamed: Pass) -> None:
    key = ("ender-3_pla-plus", "texture-2")
    mine = (study.combination == key[0]) & (study.texture == key[1])
    total = np.zeros(SHAPE)
    for level in (1, 3):
        for position in range(1, 5):
            here = np.flatnonzero(mine & (study.level == level) & (study.position == position))
            total += frames_of(study, here).var(axis=0).reshape(SHAPE)
    picture, count = streamed.maps[key]
    assert count == 8
    np.testing.assert_allclose(picture, total, rtol=1e-9)


def test_worker_processes_change_no_digit(study: Collection, streamed: Pass) -> None:
    other = passed(study, jobs=2)
    for ours, theirs in zip(streamed.places, other.places, strict=True):
        assert (ours.level, ours.position) == (theirs.level, theirs.position)
        assert np.array_equal(ours.nested.squares, theirs.nested.squares)
        for key, cell in ours.cells.items():
            assert np.array_equal(cell.gram, theirs.cells[key].gram)
    assert other.frames == streamed.frames == len(study) + 12 * 6


def test_progress_ends_at_the_number_of_frames(study: Collection) -> None:
    updates: list[tuple[int, int]] = []
    with workers(1) as team:
        stream(study, Pixels(), team, lambda done, total: updates.append((done, total)))
    assert updates[-1] == (len(study) + 12 * 6, len(study) + 12 * 6)


def taxels(value: Callable[[PrintedBlock, Press], float]) -> Callable[..., Frame]:
    def read(printed: PrintedBlock, press: Press, rng: np.random.Generator) -> Frame:
        result = 1e-3 * rng.standard_normal((4, 4, 3))
        result[0, 0, 0] += value(printed, press)
        return result

    return read


def test_arrays_are_accepted_and_frames_with_nan_are_excluded_by_name(tmp_path: Path) -> None:
    def value(printed: PrintedBlock, press: Press) -> float:
        return np.nan if (printed.name, press.number) == (name, 3) else 0.0

    name = "texture-1_paper_x1_ender-3_pla-plus_copy02"
    write_study(tmp_path, image=taxels(value), shape=(4, 4, 3), units="kPa", levels=(2,))
    result = Collection.open([tmp_path])
    streamed = passed(result)
    assert len(streamed.left_out) == 1
    assert f"{name}/sensor_data/reading_3.npy: contains NaN" in streamed.left_out[0]
    cells = {place.position: place.cells["ender-3_pla-plus", "texture-1"] for place in streamed.places}
    assert [cells[position].presses for position in (1, 2, 3, 4)] == [4, 4, 3, 4]
    here = np.flatnonzero((result.combination == "ender-3_pla-plus") & (result.texture == "texture-1"))
    usable = [i for i in here if result.position[i] == 3 and np.isfinite(result.frame(int(i))).all()]
    assert cells[3].variance() == pytest.approx(frames_of(result, np.array(usable)).var(axis=0).mean(), rel=1e-9)
    assert streamed.maps["ender-3_pla-plus", "texture-1"][0].shape == (4, 4)


def test_only_a_damaged_image_is_excluded_by_name(tmp_path: Path) -> None:
    folders = write_study(tmp_path, textures=(1,))
    clean = passed(Collection.open([tmp_path]))
    (folders[1] / "sensor_images" / "image_6.png").write_bytes(b"\x89PNG but no more")
    damaged = passed(Collection.open([tmp_path]))
    assert [folders[1].name in line and "image_6.png" in line for line in damaged.left_out] == [True]
    for before, after in zip(clean.places, damaged.places, strict=True):
        for key, cell in before.cells.items():
            hit = before.position == 2 and key[0] == "ender-3_pla-plus"
            assert after.cells[key].presses == cell.presses - hit
            assert (after.cells[key].variance() == cell.variance()) != hit


def peak(collection: Collection) -> int:
    collection.level, collection.repeat, collection.position  # noqa: B018 the table of presses is read before
    tracemalloc.start()
    try:
        passed(collection)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_memory_does_not_grow_with_the_number_of_images(tmp_path: Path) -> None:
    shape = (240, 320)

    def image(printed: PrintedBlock, press: Press, rng: np.random.Generator) -> Frame:
        return np.full(shape, press.number % 251, dtype=np.uint8)

    peaks = []
    for name, side in (("few", 2), ("many", 5)):
        grid = PressGrid(x_mm=tuple(4.0 + i for i in range(side)), y_mm=tuple(18.0 + i for i in range(side)))
        write_study(tmp_path / name, image=image, shape=shape, grid=grid, prints=PRINTERS[:1], still=0)
        peaks.append(peak(Collection.open([tmp_path / name])))
    # With 32 and 200 images of 77 kB only the records of the sums grow, by about 1 kB for each image.
    assert peaks[1] - peaks[0] < 0.03 * (200 - 32) * 240 * 320


@pytest.mark.parametrize("count", [0, 1, 35])
def test_the_sum_of_squares_of_large_numbers_is_exact(count: int) -> None:
    frames = 1e6 + np.random.default_rng(count).standard_normal((count, 30))
    found, squares = sum_of_squares(iter(frames))
    assert found == count
    if count:
        assert squares == pytest.approx(count * frames.var(axis=0).mean(), rel=1e-7, abs=1e-12)


def test_small_maps_keep_means_and_places() -> None:
    values = np.zeros((2 * MAP_SIDE, 640))
    values[100:104, 200:210] = 5.0
    picture = small_map(values.ravel(), values.shape)
    assert picture.shape == (MAP_SIDE, 320) and picture.mean() == pytest.approx(values.mean())
    assert set(zip(*np.nonzero(picture), strict=True)) == {(y, x) for y in (50, 51) for x in range(100, 105)}
    assert small_map(np.arange(5.0), (5,)).tolist() == [[0.0, 1.0, 2.0, 3.0, 4.0]]
    assert small_map(np.arange(12.0), (2, 2, 3)).tolist() == [[1.0, 4.0], [7.0, 10.0]]


def test_levels_with_most_prints() -> None:
    result = levels_with_most_prints({(1, ("a", "t")): [1, 1], (2, ("a", "t")): [1, 1, 2, 2], (3, ("b", "t")): [1]})
    assert result == {("a", "t"): (2,), ("b", "t"): (3,)}
