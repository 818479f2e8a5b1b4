"""Test the variance table: noise floors, intervals, pooling, unbalanced and insufficient designs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.studies import PRINTERS, SHAPE, texture_image, write_run, write_study
from helpers.studies import Plan as StudyPlan

from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.pixels import Pixels
from tacbench_cad.lab.analysis.variance.cells import ALL_LEVELS, shown_levels
from tacbench_cad.lab.analysis.variance.result import VarianceResult
from tacbench_cad.lab.analysis.variance.table import holm, variance_table
from tacbench_cad.lab.analysis.variance.view import VarianceView
from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.study.presses import Press
from tacbench_cad.lab.study.spec import PrintedBlock
from tacbench_cad.spec.block import Block
from tacbench_cad.util.errors import InputError

#: The true variances of the simulated frames: between prints, between repeats (a new approach), and of noise.
PRINT, APPROACH, NOISE = 4.0, 1.0, 0.25
PIXELS = (5, 20, 20)


def draw_image(printed: PrintedBlock, press: Press | None, rng: np.random.Generator) -> Frame:
    own = np.random.default_rng(list(printed.name.encode()))
    clean = 50.0 + np.sqrt(PRINT) * own.standard_normal(PIXELS)
    return clean + np.sqrt(APPROACH) * rng.standard_normal(PIXELS) + np.sqrt(NOISE) * rng.standard_normal(PIXELS)


def table(folder: Path, **changes: object) -> VarianceResult:
    options = {name: changes.pop(name) for name in ("ddof", "jobs", "seed", "feature") if name in changes}
    write_study(folder, **changes)  # type: ignore[arg-type]
    return variance_table(Collection.open([folder]), **options)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> VarianceResult:
    folder = tmp_path_factory.mktemp("table")
    return table(folder, image=draw_image, shape=PIXELS, units="kPa", copies=3, levels=(1, 2), still=0)


def test_each_row_is_written_once_and_the_pooled_value_is_the_mean(result: VarianceResult) -> None:
    keys = [(cell.force_level, cell.combination, cell.texture) for cell in result.cells]
    assert len(keys) == len(set(keys)) == 3 * 2 * 2
    assert shown_levels(result.cells) == (1, 2, ALL_LEVELS)
    for combination in result.collection.combinations:
        for texture in result.collection.textures:
            first, second, pooled = (result.cell(level, combination, texture) for level in (1, 2, ALL_LEVELS))
            assert first and second and pooled
            assert pooled.variance == pytest.approx((first.variance + second.variance) / 2.0)
            assert (first.prints, first.presses, pooled.prints, pooled.presses) == (3, 24, 3, 48)


def test_variances_and_components_equal_the_true_values(result: VarianceResult) -> None:
    # Each cell has 8,000 pixels and positions but only three prints of 2,000 pixels, so the error is a few per cent.
    within = APPROACH + NOISE
    for cell in result.cells:
        assert cell.variance == pytest.approx((1 - 1 / 3) * PRINT + (1 - 1 / 6) * within, rel=0.08)
        assert cell.unbiased == pytest.approx(cell.variance * 6.0 / 5.0)
    rows = {(row["force_level"], row["component"]): row for row in result.components}
    for level in (1, 2, ALL_LEVELS):
        assert rows[level, "print"]["variance"] == pytest.approx(PRINT, rel=0.05)
        assert rows[level, "repeat"]["variance"] == pytest.approx(within, rel=0.05)
        assert rows[level, "repeat"]["low"] < within < rows[level, "repeat"]["high"]
        assert rows[level, "print"]["low"] < PRINT < rows[level, "print"]["high"]


def test_intervals_contain_their_estimate(result: VarianceResult) -> None:
    for cell in result.cells:
        assert cell.low is not None and cell.high is not None and cell.low < cell.variance < cell.high
        assert cell.floor_removed_low is not None and cell.floor_removed_high is not None
        assert cell.floor_removed is not None
        assert cell.floor_removed_low < cell.floor_removed < cell.floor_removed_high


def test_without_stationary_frames_repeats_give_an_upper_bound_of_the_noise_floor(result: VarianceResult) -> None:
    for cell in result.cells:
        assert cell.floor_from == "repeats (upper bound)"
        assert cell.floor == pytest.approx(APPROACH + NOISE, rel=0.05)
        assert cell.floor is not None and cell.noise_alone == pytest.approx(5.0 / 6.0 * cell.floor)
    assert any("only an upper bound" in line for line in VarianceView.of(result).warnings)


def test_stationary_frames_measure_the_noise_of_the_sensor(tmp_path: Path) -> None:
    result = table(tmp_path, still=6)
    for cell in result.cells:
        assert cell.floor_from == "stationary frames"
        # The noise of 2 counts is rounded down to whole counts; except for noise all stationary frames are equal.
        assert cell.floor == pytest.approx(4.0 + 1.0 / 12.0, rel=0.1)
        assert cell.floor is not None and cell.unbiased is not None
        assert cell.floor_removed == pytest.approx(cell.unbiased - cell.floor)
    assert not any("upper bound" in line for line in VarianceView.of(result).warnings)


def test_ddof_1_divides_by_n_minus_1(tmp_path: Path) -> None:
    zero = table(tmp_path)
    unbiased = variance_table(zero.collection, ddof=1)
    for a, b in zip(zero.cells, unbiased.cells, strict=True):
        assert b.variance == pytest.approx(a.variance * 4.0 / 3.0)
    for key, picture in zero.maps.items():
        np.testing.assert_allclose(unbiased.maps[key], picture * 4.0 / 3.0)
        values = zero.positions[1, key]
        cell = zero.cell(1, *key)
        assert cell is not None and values.mean() == pytest.approx(cell.variance)
    with pytest.raises(InputError, match="ddof"):
        variance_table(zero.collection, ddof=2)


def test_colour_keeps_differences_that_grey_averages(tmp_path: Path) -> None:
    def image(printed: PrintedBlock, press: Press, rng: np.random.Generator) -> Frame:
        return rng.integers(100, 120, (*SHAPE, 3), dtype=np.uint8)

    grey = table(tmp_path, image=image, shape=(*SHAPE, 3))
    colour = variance_table(grey.collection, Pixels(colour=True))
    ratio = grey.cells[0].variance / colour.cells[0].variance
    assert ratio == pytest.approx(0.114**2 + 0.587**2 + 0.299**2, rel=0.1)
    assert grey.maps["ender-3_pla-plus", "texture-1"].shape == SHAPE


def test_one_print_has_a_variance_and_a_warning_but_no_interval(tmp_path: Path) -> None:
    result = table(tmp_path, copies=1, prints=PRINTERS[:1], textures=(1,))
    (cell, pooled) = result.cells
    assert cell.low is None and cell.high is None and cell.prints == 1 and pooled.force_level == ALL_LEVELS
    assert not result.tests
    text = " ".join(VarianceView.of(result).warnings)
    assert (
        "no differences between prints" in text and "only one printer-filament" in text and "only one texture" in text
    )


def test_a_study_without_repeated_presses_is_refused(tmp_path: Path) -> None:
    write_study(tmp_path, copies=1)
    collection = Collection.open([tmp_path])
    with pytest.raises(InputError, match="no position was pressed more than once"):
        variance_table(collection.chosen(collection.repeat == 1))


def test_constant_frames_have_no_variance_and_a_warning(tmp_path: Path) -> None:
    def image(printed: PrintedBlock, press: Press, rng: np.random.Generator) -> Frame:
        return np.full(SHAPE, 7, dtype=np.uint8)

    result = table(tmp_path, image=image)
    assert {cell.variance for cell in result.cells} == {0.0} and {cell.floor for cell in result.cells} == {0.0}
    assert any("check that the sensor works" in line for line in VarianceView.of(result).warnings)


def test_levels_with_different_prints_are_not_pooled_into_an_interval(tmp_path: Path) -> None:
    printer, filament = PRINTERS[0]
    for copy, levels in ((1, (1, 2)), (2, (2,)), (3, (2,))):
        printed = PrintedBlock(block=Block.of(1), printer=printer, filament=filament, copy=copy)
        write_run(tmp_path / str(copy), printed, StudyPlan(levels=levels))
    result = variance_table(Collection.open([tmp_path]))
    first, second, pooled = result.cells
    assert (first.prints, second.prints, pooled.prints) == (1, 3, 3)
    assert first.low is None and second.low is not None and pooled.low is None
    assert pooled.variance == pytest.approx((first.variance + second.variance) / 2.0)
    assert any("different numbers of prints (1, 3)" in line for line in VarianceView.of(result).warnings)
    # Only the level with three prints has maps and positions.
    assert result.passed.maps["ender-3_pla-plus", "texture-1"][1] == 4


def test_the_test_detects_a_printer_with_more_variation(tmp_path: Path) -> None:
    def image(printed: PrintedBlock, press: Press, rng: np.random.Generator) -> Frame:
        deviation = 8.0 if printed.printer == "ender-3" else 1.0
        own = np.random.default_rng(list(printed.name.encode()))
        return 50.0 + deviation * own.standard_normal(PIXELS) + 0.1 * rng.standard_normal(PIXELS)

    result = table(tmp_path, image=image, shape=PIXELS, units="kPa", copies=4, textures=(1, 2, 3), still=0)
    levels = {test.force_level: test for test in result.tests}
    assert set(levels) == {1, ALL_LEVELS}
    outcome = levels[1].outcome
    assert levels[1].first == "ender-3_pla-plus" and outcome.prints == (12, 12)
    assert outcome.ratio == pytest.approx(64.0, rel=0.1) and outcome.p <= 0.002


def test_holm_adjusts_as_published() -> None:
    assert holm([]) == []
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.9, 0.8]) == [1.0, 1.0]


def test_jobs_and_the_order_of_folders_change_no_digit(tmp_path: Path) -> None:
    write_study(tmp_path)
    folders = sorted(path for path in tmp_path.iterdir() if path.is_dir())
    first = variance_table(Collection.open(folders))
    second = variance_table(Collection.open(folders[::-1]), jobs=2)
    assert first.cells == second.cells


def test_a_missing_press_is_allowed(tmp_path: Path) -> None:
    folders = write_study(tmp_path, image=texture_image, copies=3)
    complete = variance_table(Collection.open([tmp_path]))
    (folders[0] / "sensor_images" / "image_2.png").unlink()
    result = variance_table(Collection.open([tmp_path]))
    assert len(result.left_out) == 1 and "image_2.png" in result.left_out[0]
    assert VarianceView.of(result).warnings[0].startswith("1 frame could not be used")
    assert any("presses are missing" in line for line in VarianceView.of(result).warnings)
    for before, after in zip(complete.cells, result.cells, strict=True):
        hit = (after.combination, after.texture) == ("ender-3_pla-plus", "texture-1")
        assert after.presses == before.presses - hit
        assert after.variance == pytest.approx(before.variance, rel=0.2 if hit else 1e-12)
        assert after.low is not None
