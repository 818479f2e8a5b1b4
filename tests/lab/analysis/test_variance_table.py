"""Test the variance table: noise floors, intervals, pooling, matrices, unbalanced and insufficient designs."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from helpers.studies import PRINTERS, SHAPE, texture_image, write_run, write_study
from helpers.studies import Plan as StudyPlan

from tacbench_cad import lab
from tacbench_cad.lab.analysis.variance.cells import ALL_LEVELS, cells_of, shown_levels
from tacbench_cad.lab.analysis.variance.table import holm
from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.runs.press_table import read_frame
from tacbench_cad.lab.study.presses import Press
from tacbench_cad.lab.study.spec import PrintedBlock
from tacbench_cad.spec.block import Block
from tacbench_cad.util.errors import InputError

#: The true variances of the simulated frames: between prints, between repeats (a new approach), and of noise.
PRINT, APPROACH, NOISE = 4.0, 1.0, 0.25
PIXELS = (5, 20, 20)
KEY = ("ender-3_pla-plus", "texture-1")


def draw_image(printed: PrintedBlock, press: Press | None, rng: np.random.Generator) -> Frame:
    own = np.random.default_rng(list(printed.name.encode()))
    clean = 50.0 + np.sqrt(PRINT) * own.standard_normal(PIXELS)
    return clean + np.sqrt(APPROACH) * rng.standard_normal(PIXELS) + np.sqrt(NOISE) * rng.standard_normal(PIXELS)


def constant(printed: PrintedBlock, press: Press, rng: np.random.Generator) -> Frame:
    return np.full(SHAPE, 7, dtype=np.uint8)


def table(folder: Path, **changes: Any) -> lab.Variance:
    write_study(folder, **changes)
    return lab.variance(lab.read(folder))


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> lab.Variance:
    folder = tmp_path_factory.mktemp("table")
    return table(folder, image=draw_image, shape=PIXELS, units="kPa", copies=3, levels=(1, 2), still=0)


def test_each_row_is_written_once_and_the_pooled_value_is_the_mean(result: lab.Variance) -> None:
    cells = cells_of(result.table)
    assert len(cells) == len(result.table) == 3 * 2 * 2
    assert shown_levels(result.table) == (1, 2, ALL_LEVELS)
    for key in {key for _, key in cells}:
        first, second, pooled = (cells[level, key] for level in (1, 2, ALL_LEVELS))
        assert pooled.variance == pytest.approx((first.variance + second.variance) / 2.0)
        assert (first.prints, first.presses, pooled.prints, pooled.presses) == (3, 24, 3, 48)


def test_variances_and_components_equal_the_true_values(result: lab.Variance) -> None:
    # Each cell has 8,000 pixels and positions but only three prints of 2,000 pixels, so the error is a few per cent.
    within = APPROACH + NOISE
    cells = result.table
    np.testing.assert_allclose(cells["variance"], (1 - 1 / 3) * PRINT + (1 - 1 / 6) * within, rtol=0.08)
    np.testing.assert_allclose(cells["unbiased"], cells["variance"] * 6.0 / 5.0)
    components = result.tables["components"].set_index("component")
    for name, true in (("print", PRINT), ("repeat", within)):
        np.testing.assert_allclose(components.loc[name, "variance"], true, rtol=0.05)
        assert (components.loc[name, "low"] < true).all() and (true < components.loc[name, "high"]).all()


def test_intervals_contain_their_estimate(result: lab.Variance) -> None:
    cells = result.table
    assert ((cells["low"] < cells["variance"]) & (cells["variance"] < cells["high"])).all()
    removed = cells["floor_removed"]
    assert ((cells["floor_removed_low"] < removed) & (removed < cells["floor_removed_high"])).all()


def test_without_stationary_frames_repeats_give_an_upper_bound_of_the_noise_floor(result: lab.Variance) -> None:
    assert set(result.table["floor_from"]) == {"repeats (upper bound)"}
    np.testing.assert_allclose(result.table["floor"], APPROACH + NOISE, rtol=0.05)
    np.testing.assert_allclose(result.table["noise_alone"], 5.0 / 6.0 * result.table["floor"])
    assert any("only an upper bound" in line for line in result.warnings)


def test_stationary_frames_measure_the_noise_of_the_sensor(tmp_path: Path) -> None:
    result = table(tmp_path, still=6)
    cells = result.table
    assert set(cells["floor_from"]) == {"stationary frames"}
    # The noise of 2 counts is rounded down to whole counts; except for noise all stationary frames are equal.
    np.testing.assert_allclose(cells["floor"], 4.0 + 1.0 / 12.0, rtol=0.1)
    np.testing.assert_allclose(cells["floor_removed"], cells["unbiased"] - cells["floor"])
    assert not any("upper bound" in line for line in result.warnings)


def test_ddof_1_divides_by_n_minus_1(tmp_path: Path) -> None:
    write_study(tmp_path)
    presses = lab.read(tmp_path)
    zero, one = (lab.variance(presses, ddof=ddof) for ddof in (0, 1))
    np.testing.assert_allclose(one.table["variance"], zero.table["variance"] * 4.0 / 3.0)
    for key, picture in zero.maps.items():
        np.testing.assert_allclose(one.maps[key], picture * 4.0 / 3.0)
    cell = ["printer", "filament", "texture"]
    means = zero.tables["positions"].groupby(cell)["variance"].mean()
    alone = zero.table[zero.table["force_level"] == 1].set_index(cell)["variance"]
    np.testing.assert_allclose(means.loc[alone.index], alone)
    with pytest.raises(InputError, match="ddof"):
        lab.variance(presses, ddof=2)


def test_colour_keeps_differences_that_grey_averages(tmp_path: Path) -> None:
    def image(printed: PrintedBlock, press: Press, rng: np.random.Generator) -> Frame:
        return rng.integers(100, 120, (*SHAPE, 3), dtype=np.uint8)

    grey = table(tmp_path, image=image, shape=(*SHAPE, 3))
    colour = lab.variance(lab.read(tmp_path), lab.Pixels(colour=True))
    ratio = grey.table["variance"][0] / colour.table["variance"][0]
    assert ratio == pytest.approx(0.114**2 + 0.587**2 + 0.299**2, rel=0.1)
    assert grey.maps[KEY].shape == SHAPE


def test_one_print_has_a_variance_and_a_warning_but_no_interval(tmp_path: Path) -> None:
    result = table(tmp_path, copies=1, prints=PRINTERS[:1], textures=(1,))
    assert result.table["force_level"].tolist() == [1, ALL_LEVELS] and set(result.table["prints"]) == {1}
    assert result.table[["low", "high"]].isna().all(axis=None) and result.tables["permutation"].empty
    text = " ".join(result.warnings)
    for words in ("no differences between prints", "only one printer-filament", "only one texture"):
        assert words in text


def test_a_study_without_repeated_presses_is_refused(tmp_path: Path) -> None:
    write_study(tmp_path, copies=1)
    presses = lab.read(tmp_path)
    with pytest.raises(InputError, match="no position was pressed more than once"):
        lab.variance(presses[presses["repeat"] == 1])


def test_constant_frames_have_no_variance_and_a_warning(tmp_path: Path) -> None:
    result = table(tmp_path, image=constant)
    assert (result.table[["variance", "floor"]] == 0.0).all(axis=None)
    assert any("check that the sensor works" in line for line in result.warnings)


def test_levels_with_different_prints_are_not_pooled_into_an_interval(tmp_path: Path) -> None:
    printer, filament = PRINTERS[0]
    for copy, levels in ((1, (1, 2)), (2, (2,)), (3, (2,))):
        printed = PrintedBlock(block=Block.of(1), printer=printer, filament=filament, copy=copy)
        write_run(tmp_path / str(copy), printed, StudyPlan(levels=levels))
    presses = lab.read(tmp_path)
    result = lab.variance(presses)
    first, second, pooled = result.table.itertuples()
    assert (first.prints, second.prints, pooled.prints) == (1, 3, 3)
    assert math.isnan(first.low) and not math.isnan(second.low) and math.isnan(pooled.low)
    assert pooled.variance == pytest.approx((first.variance + second.variance) / 2.0)
    assert any("different numbers of prints (1, 3)" in line for line in result.warnings)
    # Only the level with three prints is in the maps.
    alone = lab.variance(presses[presses["force_level"] == 2])
    np.testing.assert_array_equal(result.maps[KEY], alone.maps[KEY])


def test_the_test_detects_a_printer_with_more_variation(tmp_path: Path) -> None:
    def image(printed: PrintedBlock, press: Press, rng: np.random.Generator) -> Frame:
        deviation = 8.0 if printed.printer == "ender-3" else 1.0
        own = np.random.default_rng(list(printed.name.encode()))
        return 50.0 + deviation * own.standard_normal(PIXELS) + 0.1 * rng.standard_normal(PIXELS)

    result = table(tmp_path, image=image, shape=PIXELS, units="kPa", copies=4, textures=(1, 2, 3), still=0)
    first, _ = tests = list(result.tables["permutation"].itertuples())
    assert [test.force_level for test in tests] == [1, ALL_LEVELS]
    assert first.first == "ender-3_pla-plus" and (first.prints_first, first.prints_second) == (12, 12)
    assert first.ratio == pytest.approx(64.0, rel=0.1) and first.p <= 0.002


def test_holm_adjusts_as_published() -> None:
    assert holm([]) == []
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.9, 0.8]) == [1.0, 1.0]


def test_jobs_and_the_order_of_folders_change_no_digit(tmp_path: Path) -> None:
    folders = sorted(write_study(tmp_path))
    first = lab.variance(lab.read(folders))
    second = lab.variance(lab.read(folders[::-1]), jobs=2)
    pd.testing.assert_frame_equal(first.table, second.table, check_exact=True)


def test_a_missing_press_is_allowed(tmp_path: Path) -> None:
    folders = write_study(tmp_path, image=texture_image, copies=3)
    before = lab.variance(lab.read(tmp_path))
    (folders[0] / "sensor_images" / "image_2.png").unlink()
    after = lab.variance(lab.read(tmp_path))
    assert len(after.left_out) == 1 and "image_2.png" in after.left_out[0]
    assert after.warnings[0].startswith("1 frame could not be used")
    assert any("presses are missing" in line for line in after.warnings)
    old = cells_of(before.table)
    for at, cell in cells_of(after.table).items():
        assert cell.presses == old[at].presses - (at[1] == KEY)
        assert cell.variance == pytest.approx(old[at].variance, rel=0.2 if at[1] == KEY else 1e-12)
        assert not math.isnan(cell.low)


@pytest.mark.parametrize("ddof", [0, 1])
def test_each_pair_of_textures_has_the_variance_over_both(tmp_path: Path, ddof: int) -> None:
    write_study(tmp_path, textures=(1, 2, 4), levels=(1, 2))
    presses = lab.read(tmp_path)
    result = lab.variance(presses, ddof=ddof)
    rows = result.tables["between_textures"]
    assert len(rows) == 2 * 3 * (3 + 3)
    values = dict(zip(rows[rows.columns[:5]].itertuples(index=False, name=None), rows["variance"], strict=True))
    for row in rows.itertuples():
        same = (presses[["printer", "filament"]] == [row.printer, row.filament]).all(axis=1)
        mine = presses[same & presses["texture"].isin([row.texture, row.other_texture])]
        if row.force_level == ALL_LEVELS:
            levels = [values[row.printer, row.filament, level, row.texture, row.other_texture] for level in (1, 2)]
            assert row.variance == pytest.approx(np.mean(levels))
            continue
        places = mine[mine["force_level"] == row.force_level].groupby("position")["frame"]
        stacks = [np.stack([read_frame(path).astype(np.float64) for path in paths]) for _, paths in places]
        assert row.variance == pytest.approx(np.mean([stack.var(axis=0, ddof=ddof) for stack in stacks]), rel=1e-9)
        assert row.presses == (16 if row.texture == row.other_texture else 32)


def test_a_texture_without_prints_of_a_printer_has_no_entry(tmp_path: Path) -> None:
    write_study(tmp_path, prints=PRINTERS[:1])
    printer, filament = PRINTERS[1]
    write_run(tmp_path / "one", PrintedBlock(block=Block.of(2), printer=printer, filament=filament), StudyPlan())
    result = lab.variance(lab.read(tmp_path))
    rows = result.tables["between_textures"]
    mine = rows[(rows["printer"] == printer) & (rows["force_level"] == 1)]
    assert mine[["texture", "other_texture", "presses"]].to_numpy().tolist() == [["texture-2", "texture-2", 8]]
    assert any("texture-1 is missing" in line for line in result.warnings)
