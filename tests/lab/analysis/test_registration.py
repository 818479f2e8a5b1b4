"""Test the registration: it finds known offsets of blocks and does not take other differences for offsets."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from helpers.studies import PRINTERS, write_study

from tacbench_cad import lab
from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.study.presses import Press
from tacbench_cad.lab.study.spec import PrintedBlock
from tacbench_cad.spec.protocol import PressGrid
from tacbench_cad.util.errors import InputError

#: The offset of each copy's block, in mm; the mean is 0.
OFFSETS_MM = {1: (0.15, -0.05), 2: (-0.10, 0.10), 3: (-0.05, -0.05)}
TRUE_GRID = PressGrid(x_mm=(4.0, 5.25, 6.5, 7.75, 9.0), y_mm=(18.0, 19.25, 20.5, 21.75, 23.0))
Field = Callable[[float, float], np.ndarray]


def both_axes(x: float, y: float) -> np.ndarray:
    """Return the values of eight taxels that measure a wave of 20 mm along x and a wave of 24 mm along y."""
    phase = np.arange(8.0)
    return 10.0 * np.sin(2 * np.pi * x / 20.0 + phase) + 6.0 * np.cos(2 * np.pi * y / 24.0 + 1.7 * phase)


def only_x(x: float, y: float) -> np.ndarray:
    return 10.0 * np.sin(2 * np.pi * x / 20.0 + np.arange(8.0))


def sensor(field: Field, shifted: bool, print_sd: float = 0.0) -> Callable[..., Frame]:
    def read(printed: PrintedBlock, press: Press, rng: np.random.Generator) -> Frame:
        sx, sy = OFFSETS_MM[printed.copy] if shifted else (0.0, 0.0)
        own = np.random.default_rng([printed.copy, press.position])
        # If the block is shifted along an axis, the press hits it at a smaller coordinate.
        clean = field(press.x_mm - sx, press.y_mm - sy)
        return clean + print_sd * own.standard_normal(8) + 0.02 * rng.standard_normal(8)

    return read


def study(folder: Path, image: Callable[..., Frame], **changes: object) -> pd.DataFrame:
    plan = {"textures": (1,), "prints": PRINTERS[:1], "copies": 3, "grid": TRUE_GRID, "shape": (8,), "units": "kPa"}
    write_study(folder, image=image, **{**plan, **changes})  # type: ignore[arg-type]
    return lab.read(folder)


def registered(presses: pd.DataFrame, **settings: Any) -> pd.DataFrame:
    return lab.variance(presses, register=True, **settings).tables["registration"]


@pytest.mark.parametrize("ddof", [0, 1])
def test_block_offsets_are_found_and_explain_the_variance_between_prints(tmp_path: Path, ddof: int) -> None:
    result = lab.variance(study(tmp_path, sensor(both_axes, shifted=True)), register=True, ddof=ddof)
    rows = result.tables["registration"]
    assert rows["copy"].tolist() == [1, 2, 3]
    np.testing.assert_allclose(rows[["x_mm", "y_mm"]], list(OFFSETS_MM.values()), atol=0.01)
    np.testing.assert_allclose(rows["variance"], result.table["variance"][0], rtol=1e-4)
    assert (rows["seating"] > 0.95 * (rows["variance"] - 0.02**2)).all()
    np.testing.assert_allclose(rows["variance_without_seating"], rows["variance"] - rows["seating"])


def test_differences_between_prints_are_not_taken_for_offsets(tmp_path: Path) -> None:
    rows = registered(study(tmp_path, sensor(both_axes, shifted=False, print_sd=0.5)))
    # Two offsets are fitted to the 8 x 25 numbers of each print, so by chance they explain about 1 % of the variance.
    assert (rows["seating"] < 0.05 * rows["variance"]).all()
    assert rows[["x_mm", "y_mm"]].abs().max(axis=None) < 0.05


def test_an_axis_without_changes_has_no_offsets(tmp_path: Path) -> None:
    rows = registered(study(tmp_path, sensor(only_x, shifted=True)))
    np.testing.assert_allclose(rows["x_mm"], [x for x, _ in OFFSETS_MM.values()], atol=0.01)
    assert rows["y_mm"].isna().all()


def test_worker_processes_give_the_same_result_and_single_prints_are_excluded(tmp_path: Path) -> None:
    presses = study(tmp_path, sensor(both_axes, shifted=True), textures=(1, 2), levels=(1, 2))
    serial, parallel = registered(presses), registered(presses, jobs=2)
    pd.testing.assert_frame_equal(serial, parallel)
    assert len(serial) == 4 * 3
    with pytest.raises(InputError, match="two prints"):
        registered(presses[presses["copy"] == 2])


def test_a_damaged_frame_changes_the_result_little(tmp_path: Path) -> None:
    presses = study(tmp_path, sensor(both_axes, shifted=True))
    before = registered(presses)
    Path(presses["frame"][4]).write_bytes(b"")
    np.testing.assert_allclose(registered(presses)["x_mm"], before["x_mm"], atol=0.01)


def test_one_position_is_refused(tmp_path: Path) -> None:
    grid = PressGrid(x_mm=(4.0,), y_mm=(18.0,))
    with pytest.raises(InputError, match="two columns or two rows"):
        registered(study(tmp_path, sensor(both_axes, shifted=True), grid=grid))
