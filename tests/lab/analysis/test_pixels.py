"""Test pixels against OpenCV, and the variance of regions of interest against NumPy."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.studies import write_study

from tacbench_cad import lab
from tacbench_cad.lab.runs.press_table import runs_of
from tacbench_cad.lab.runs.region import parse_region, store_region
from tacbench_cad.lab.runs.region_search import region_of
from tacbench_cad.util.errors import InputError


def test_grey_and_resolution_equal_opencv() -> None:
    image = np.random.default_rng(1).integers(0, 256, (48, 64, 3), dtype=np.uint8)
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    assert np.array_equal(lab.Pixels().numbers(image), grey)
    assert np.array_equal(lab.Pixels(colour=True).numbers(image), image)
    small = lab.Pixels(resolution=0.5).numbers(image)
    assert small.shape == (24, 32) and small.dtype == np.uint8
    # At half the resolution a pixel is the mean of four pixels.
    assert np.abs(small - grey.reshape(24, 2, 32, 2).mean(axis=(1, 3))).max() <= 0.5
    assert lab.Pixels(resolution=0.4).numbers(np.zeros((480, 640), np.uint8)).shape == (192, 256)


def test_other_arrays_are_not_changed() -> None:
    taxels = np.arange(16.0).reshape(4, 4)
    assert np.array_equal(lab.Pixels(resolution=0.5).numbers(taxels), taxels)


@pytest.mark.parametrize("colour", [False, True])
def test_variance_of_a_region_equals_numpys_of_its_pixels(tmp_path: Path, colour: bool) -> None:
    shape = (24, 32, 3) if colour else (24, 32)
    write_study(
        tmp_path, shape=shape, image=lambda printed, press, rng: rng.integers(0, 256, shape, dtype=np.uint8), still=2
    )
    presses = lab.read(tmp_path)
    result = lab.variance(presses, lab.Pixels(roi="circle:15,11,7", colour=colour))
    y, x = np.mgrid[:24, :32]
    mask = (x - 15) ** 2 + (y - 11) ** 2 <= 49
    for cell in result.table[:-4].to_dict("records"):
        here = presses[(presses["texture"] == cell["texture"]) & (presses["printer"] == cell["printer"])]
        frames = (lab.frames(of_position) for _, of_position in here.groupby("position"))
        parts = [np.var(of_position[:, mask], axis=0).mean() for of_position in frames]
        assert cell["variance"] == pytest.approx(np.mean(parts), rel=1e-9)
    picture = next(iter(result.maps.values()))
    assert picture.shape == (24, 32)
    assert np.array_equal(np.isfinite(picture), mask)
    assert result.table["published"].isna().all()


def test_a_stored_region_is_used_unless_another_is_chosen(tmp_path: Path) -> None:
    folders = write_study(tmp_path)
    presses = lab.read(tmp_path)
    runs = runs_of(presses)
    for folder in folders[:-1]:
        store_region(folder, parse_region("rect:2,2,20,20", 24, 32))
    assert region_of(runs) is None
    store_region(folders[-1], parse_region("rect:10,2,28,20", 24, 32))
    region = region_of(runs)
    assert region is not None
    assert region.mask.sum() == 11 * 19 == lab.Pixels().fit(presses).shape_[0]
    assert region_of(runs, "none") is None
    store_region(folders[-1], parse_region("rect:10,2,28,20", 48, 64))
    with pytest.raises(InputError, match="different sizes"):
        region_of(runs)


def test_settings_that_are_not_allowed_are_refused(tmp_path: Path) -> None:
    write_study(tmp_path, textures=(1,), copies=1)
    with pytest.raises(InputError, match="resolution"):
        lab.Pixels(resolution=0.0).fit(lab.read(tmp_path))
