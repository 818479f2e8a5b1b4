"""Registration finds known offsets of blocks, and does not take other differences between prints for offsets."""

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

#: How far each copy's block lies off, mm; their mean is 0.
SEATS = {1: (0.15, -0.05), 2: (-0.10, 0.10), 3: (-0.05, -0.05)}
TRUE_GRID = PressGrid(x_mm=(4.0, 5.25, 6.5, 7.75, 9.0), y_mm=(18.0, 19.25, 20.5, 21.75, 23.0))
Height = Callable[[float, float], np.ndarray]


def both_axes(x: float, y: float) -> np.ndarray:
    """Eight taxels that see a wave of 20 mm along x and another along y."""
    phase = np.arange(8.0)
    return 10.0 * np.sin(2 * np.pi * x / 20.0 + phase) + 6.0 * np.cos(2 * np.pi * y / 24.0 + 1.7 * phase)


def only_x(x: float, y: float) -> np.ndarray:
    return 10.0 * np.sin(2 * np.pi * x / 20.0 + np.arange(8.0))


def sensor(field: Height, seated: bool, print_sd: float = 0.0) -> Callable[..., Frame]:
    def read(printed: PrintedBlock, press: Press, rng: np.random.Generator) -> Frame:
        sx, sy = SEATS[printed.copy] if seated else (0.0, 0.0)
        own = np.random.default_rng([printed.copy, press.position])
        # A block that lies further along is met at a place of it that comes earlier.
        clean = field(press.x_mm - sx, press.y_mm - sy)
        return clean + print_sd * own.standard_normal(8) + 0.02 * rng.standard_normal(8)

    return read


def study(folder: Path, image: Callable[..., Frame], **changes: object) -> Collection:
    plan = {"textures": (1,), "prints": PRINTERS[:1], "copies": 3, "grid": TRUE_GRID, "shape": (8,), "units": "kPa"}
    write_study(folder, image=image, **{**plan, **changes})  # type: ignore[arg-type]
    return Collection.open([folder])


@pytest.mark.parametrize("ddof", [0, 1])
def test_seats_are_found_and_explain_the_variance_between_prints(tmp_path: Path, ddof: int) -> None:
    collection = study(tmp_path, sensor(both_axes, seated=True))
    (result,) = register(collection, ddof=ddof)
    for copy, seat in SEATS.items():
        np.testing.assert_allclose(result.offsets_mm[copy], seat, atol=0.01)
    table = variance_table(collection, ddof=ddof)
    assert result.variance == pytest.approx(table.cells[0].variance, rel=1e-4)
    assert result.seating > 0.95 * (result.variance - 0.02**2)
    assert result.remaining == pytest.approx(result.variance - result.seating)


def test_prints_that_differ_from_place_to_place_are_no_seats(tmp_path: Path) -> None:
    (result,) = register(study(tmp_path, sensor(both_axes, seated=False, print_sd=0.5)))
    # Two offsets a print are fitted to 8 x 25 numbers: by chance they explain about a hundredth.
    assert result.seating < 0.05 * result.variance
    assert max(abs(offset) for pair in result.offsets_mm.values() for offset in pair if offset is not None) < 0.05


def test_an_axis_along_which_nothing_changes_is_not_seen(tmp_path: Path) -> None:
    (result,) = register(study(tmp_path, sensor(only_x, seated=True)))
    for copy, (x, y) in result.offsets_mm.items():
        assert x == pytest.approx(SEATS[copy][0], abs=0.01) and y is None
    rows = list(result.rows())
    assert [row["copy"] for row in rows] == [1, 2, 3]


def test_processes_change_nothing_and_single_prints_are_left_out(tmp_path: Path) -> None:
    collection = study(tmp_path, sensor(both_axes, seated=True), textures=(1, 2), levels=(1, 2))
    serial, parallel = register(collection), register(collection, jobs=2)
    assert [(s.force_level, s.texture, s.seating) for s in serial] == [
        (s.force_level, s.texture, s.seating) for s in parallel
    ]
    assert len(serial) == 4
    with pytest.raises(InputError, match="two prints"):
        register(collection.chosen(collection.copy == 2))


def test_a_damaged_reading_changes_little(tmp_path: Path) -> None:
    collection = study(tmp_path, sensor(both_axes, seated=True))
    (before,) = register(collection)
    (collection.runs[0].folder / "sensor_data" / "reading_5.npy").write_bytes(b"")
    (after,) = register(collection)
    np.testing.assert_allclose(after.offsets_mm[1], before.offsets_mm[1], atol=0.01)


def test_one_position_shows_no_shift(tmp_path: Path) -> None:
    grid = PressGrid(x_mm=(4.0,), y_mm=(18.0,))
    with pytest.raises(InputError, match="two columns or two rows"):
        register(study(tmp_path, sensor(both_axes, seated=True), grid=grid))
