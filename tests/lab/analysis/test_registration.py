"""Test the registration: it finds known offsets of blocks and does not take other differences for offsets."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from helpers.studies import PRINTERS, write_study

from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.variance.registration import register
from tacbench_cad.lab.analysis.variance.table import variance_table
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


def study(folder: Path, image: Callable[..., Frame], **changes: object) -> Collection:
    plan = {"textures": (1,), "prints": PRINTERS[:1], "copies": 3, "grid": TRUE_GRID, "shape": (8,), "units": "kPa"}
    write_study(folder, image=image, **{**plan, **changes})  # type: ignore[arg-type]
    return Collection.open([folder])


@pytest.mark.parametrize("ddof", [0, 1])
def test_block_offsets_are_found_and_explain_the_variance_between_prints(tmp_path: Path, ddof: int) -> None:
    collection = study(tmp_path, sensor(both_axes, shifted=True))
    (result,) = register(collection, ddof=ddof)
    for copy, offset in OFFSETS_MM.items():
        np.testing.assert_allclose(result.offsets_mm[copy], offset, atol=0.01)
    table = variance_table(collection, ddof=ddof)
    assert result.variance == pytest.approx(table.cells[0].variance, rel=1e-4)
    assert result.seating > 0.95 * (result.variance - 0.02**2)
    assert result.remaining == pytest.approx(result.variance - result.seating)


def test_differences_between_prints_are_not_taken_for_offsets(tmp_path: Path) -> None:
    (result,) = register(study(tmp_path, sensor(both_axes, shifted=False, print_sd=0.5)))
    # Two offsets are fitted to the 8 x 25 numbers of each print, so by chance they explain about 1 % of the variance.
    assert result.seating < 0.05 * result.variance
    assert max(abs(offset) for pair in result.offsets_mm.values() for offset in pair if offset is not None) < 0.05


def test_an_axis_without_changes_has_no_offsets(tmp_path: Path) -> None:
    (result,) = register(study(tmp_path, sensor(only_x, shifted=True)))
    for copy, (x, y) in result.offsets_mm.items():
        assert x == pytest.approx(OFFSETS_MM[copy][0], abs=0.01) and y is None
    rows = list(result.rows())
    assert [row["copy"] for row in rows] == [1, 2, 3]


def test_worker_processes_give_the_same_result_and_single_prints_are_excluded(tmp_path: Path) -> None:
    collection = study(tmp_path, sensor(both_axes, shifted=True), textures=(1, 2), levels=(1, 2))
    serial, parallel = register(collection), register(collection, jobs=2)
    assert [(s.force_level, s.texture, s.seating) for s in serial] == [
        (s.force_level, s.texture, s.seating) for s in parallel
    ]
    assert len(serial) == 4
    with pytest.raises(InputError, match="two prints"):
        register(collection.chosen(collection.copy == 2))


def test_a_damaged_frame_changes_the_result_little(tmp_path: Path) -> None:
    collection = study(tmp_path, sensor(both_axes, shifted=True))
    (before,) = register(collection)
    (collection.runs[0].folder / "sensor_data" / "reading_5.npy").write_bytes(b"")
    (after,) = register(collection)
    np.testing.assert_allclose(after.offsets_mm[1], before.offsets_mm[1], atol=0.01)


def test_one_position_is_refused(tmp_path: Path) -> None:
    grid = PressGrid(x_mm=(4.0,), y_mm=(18.0,))
    with pytest.raises(InputError, match="two columns or two rows"):
        register(study(tmp_path, sensor(both_axes, shifted=True), grid=grid))
