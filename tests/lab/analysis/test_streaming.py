"""Test the pass over the frames: equal to NumPy's two passes, independent of processes, and constant in memory."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from helpers.studies import PRINTERS, write_study

from tacbench_cad import lab
from tacbench_cad.lab.analysis.feature import MAP_SIDE, small_map
from tacbench_cad.lab.analysis.study_design import Design
from tacbench_cad.lab.analysis.variance.streaming import Pass, levels_with_most_prints, stream, sum_of_squares
from tacbench_cad.lab.parallel import workers
from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.runs.press_table import read_frame
from tacbench_cad.lab.study.presses import Press
from tacbench_cad.lab.study.spec import PrintedBlock
from tacbench_cad.spec.protocol import PressGrid
from tacbench_cad.util.types import Floats


def passed(study: pd.DataFrame | Design, jobs: int = 1, updates: list[tuple[int, int]] | None = None) -> Pass:
    design = study if isinstance(study, Design) else Design.of(study)
    with workers(jobs) as executor:
        progress = None if updates is None else lambda *at: updates.append(at)
        return stream(design, lab.Pixels().fit(design.presses), executor, progress)


def frames_of(presses: pd.DataFrame) -> Floats:
    """Return the frames with another reader than the analysis, (n, pixels)."""
    return np.stack([read_frame(path).astype(np.float64).ravel() for path in presses["frame"]])


@pytest.fixture(scope="module")
def study(make_study: Callable[..., pd.DataFrame]) -> pd.DataFrame:
    return Design.of(make_study(levels=(1, 3), copies=3)).presses


@pytest.fixture(scope="module")
def streamed(study: pd.DataFrame) -> Pass:
    return passed(study)


@pytest.mark.parametrize("ddof", [0, 1])
def test_each_cell_has_numpys_variance(study: pd.DataFrame, streamed: Pass, ddof: int) -> None:
    cells = study.groupby(["level", "position", "combination", "texture"])
    assert sum(len(place.cells) for place in streamed.places) == len(cells) == 2 * 4 * 4
    for place in streamed.places:
        for key, cell in place.cells.items():
            two_pass = frames_of(cells.get_group((place.level, place.position, *key))).var(axis=0, ddof=ddof).mean()
            assert cell.variance(ddof) == pytest.approx(two_pass, rel=1e-9)
            assert cell.prints == 3 and cell.presses == 6


def test_the_sums_of_a_place_equal_those_of_two_passes(study: pd.DataFrame, streamed: Pass) -> None:
    place = streamed.places[5]
    here = study[(study["level"] == place.level) & (study["position"] == place.position)]
    values, labels = frames_of(here), list(here[["texture", "combination", "copy", "press"]].itertuples(name=None))
    labels = [(texture, combination, copy, index) for index, texture, combination, copy, _ in labels]
    means = [
        np.stack([values[[other[:depth] == label[:depth] for other in labels]].mean(axis=0) for label in labels])
        for depth in range(5)
    ]
    direct = [((fine - coarse) ** 2).sum(axis=0).mean() for coarse, fine in pairwise(means)]
    np.testing.assert_allclose(place.nested.squares, direct, rtol=1e-9)
    # There are 2 textures, 2 printers for each texture, 3 prints for each printer and 2 repeats for each print.
    assert place.nested.dof.tolist() == [1, 2, 8, 12]
    of_cells = [
        frames_of(here[(here[["combination", "texture"]] == list(key)).all(axis=1)]).mean(axis=0) for key in place.cells
    ]
    distances = [[((a - b) ** 2).mean() for a in of_cells] for b in of_cells]
    np.testing.assert_allclose(place.distances, distances, rtol=1e-9, atol=1e-9)


def test_the_noise_floor_is_the_variance_within_the_sessions_of_stationary_frames(
    study: pd.DataFrame, streamed: Pass
) -> None:
    assert len(streamed.floors) == 4
    key = ("ender-3_pla-plus", "texture-2")
    sessions = []
    for run in Design.of(study).runs:
        if (run.info.printed.combination, run.info.printed.texture) == key:
            sessions += [np.stack(run.stationary(when, True)).astype(np.float64) for when in ("start", "end")]
    assert len(sessions) == 6
    squares = sum(((frames - frames.mean(axis=0)) ** 2).sum(axis=0).mean() for frames in sessions)
    assert streamed.floors[key] == pytest.approx(squares / sum(len(frames) - 1 for frames in sessions), rel=1e-9)


def test_processes_change_no_digit_and_progress_ends_at_the_number_of_frames(
    study: pd.DataFrame, streamed: Pass
) -> None:
    updates: list[tuple[int, int]] = []
    other = passed(study, 2, updates)
    assert updates[-1] == (len(study) + 12 * 6, len(study) + 12 * 6)
    for a, b in zip(streamed.places, other.places, strict=True):
        assert (a.level, a.position) == (b.level, b.position)
        assert all(np.array_equal(cell.gram, b.cells[key].gram) for key, cell in a.cells.items())
    assert streamed.floors == other.floors
    assert all(np.array_equal(picture, other.maps[key]) for key, picture in streamed.maps.items())


def test_arrays_are_accepted_and_frames_with_nan_are_excluded_by_name(tmp_path: Path) -> None:
    def image(printed: PrintedBlock, press: Press, rng: np.random.Generator) -> Frame:
        result = 1e-3 * rng.standard_normal((4, 4, 3))
        result[0, 0, 0] += np.nan if (printed.name, press.number) == (name, 3) else 0.0
        return result

    name = "texture-1_paper_x1_ender-3_pla-plus_copy02"
    write_study(tmp_path, image=image, shape=(4, 4, 3), units="kPa", levels=(2,))
    presses = lab.read(tmp_path)
    streamed = passed(presses)
    assert len(streamed.left_out) == 1
    assert f"{name}/sensor_data/reading_3.npy: contains NaN" in streamed.left_out[0]
    cells = {place.position: place.cells["ender-3_pla-plus", "texture-1"] for place in streamed.places}
    assert [cells[position].presses for position in (1, 2, 3, 4)] == [4, 4, 3, 4]
    here = (presses["printer"] == "ender-3") & (presses["texture"] == "texture-1") & (presses["position"] == 3)
    usable = presses[here & ~((presses["run"] == name) & (presses["press"] == 3))]
    assert cells[3].variance() == pytest.approx(frames_of(usable).var(axis=0).mean(), rel=1e-9)
    assert streamed.maps["ender-3_pla-plus", "texture-1"].shape == (4, 4)


def test_only_a_damaged_image_is_excluded_by_name(tmp_path: Path) -> None:
    folders = write_study(tmp_path, textures=(1,))
    clean = passed(lab.read(tmp_path))
    (folders[1] / "sensor_images" / "image_6.png").write_bytes(b"\x89PNG but no more")
    damaged = passed(lab.read(tmp_path))
    assert [folders[1].name in line and "image_6.png" in line for line in damaged.left_out] == [True]
    for before, after in zip(clean.places, damaged.places, strict=True):
        for key, cell in before.cells.items():
            hit = before.position == 2 and key[0] == "ender-3_pla-plus"
            assert after.cells[key].presses == cell.presses - hit
            assert (after.cells[key].variance() == cell.variance()) != hit


def test_a_place_without_usable_frames_is_left_out(tmp_path: Path) -> None:
    write_study(tmp_path, textures=(1,), prints=PRINTERS[:1], copies=1)
    presses = lab.read(tmp_path)
    for path in presses.loc[presses["position"] == 3, "frame"]:
        Path(path).unlink()
    result = passed(presses)
    assert [place.position for place in result.places] == [1, 2, 4] and len(result.left_out) == 2


def test_memory_does_not_grow_with_the_number_of_images(tmp_path: Path) -> None:
    shape = (240, 320)

    def image(printed: PrintedBlock, press: Press, rng: np.random.Generator) -> Frame:
        return np.full(shape, press.number % 251, dtype=np.uint8)

    peaks = []
    for name, side in (("few", 2), ("many", 5)):
        grid = PressGrid(x_mm=tuple(4.0 + i for i in range(side)), y_mm=tuple(18.0 + i for i in range(side)))
        write_study(tmp_path / name, image=image, shape=shape, grid=grid, prints=PRINTERS[:1], still=0)
        design = Design.of(lab.read(tmp_path / name))
        tracemalloc.start()
        try:
            passed(design)
            peaks.append(tracemalloc.get_traced_memory()[1])
        finally:
            tracemalloc.stop()
    # With 32 and 200 images of 77 kB only the records of the sums grow, by about 2 kB for each image.
    assert peaks[1] - peaks[0] < 0.03 * (200 - 32) * 240 * 320


@pytest.mark.parametrize("count", [0, 1, 35])
def test_the_sum_of_squares_of_large_numbers_is_exact(count: int) -> None:
    frames = 1e6 + np.random.default_rng(count).standard_normal((count, 30))
    found, squares = sum_of_squares(frames[start : start + 8] for start in range(0, count, 8))
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
    a, b = ("a", "t"), ("b", "t")
    designs = {(1, a): np.array([1, 1]), (2, a): np.array([1, 1, 2, 2]), (3, b): np.array([1])}
    assert levels_with_most_prints(designs) == {a: (2,), b: (3,)}
