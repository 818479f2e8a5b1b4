"""The comparison of the printed top with the formula, for prints with known errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.cases import mostly_long
from helpers.gcode_writer import write_gcode

from tacbench_cad.extensions.slicing.comparison import AsSliced, compare
from tacbench_cad.extensions.slicing.gcode import read_gcode
from tacbench_cad.extensions.slicing.printed_surface import BedPlace, staircase
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.sines import Wave
from tacbench_cad.spec.textures import Texture
from tacbench_cad.spec.top_points import points_of
from tacbench_cad.spec.waves import WaveSum
from tacbench_cad.util.errors import InputError

TWO = Block.of(2)


@pytest.fixture(scope="module")
def printed(tmp_path_factory: pytest.TempPathFactory) -> AsSliced:
    """Return the comparison for texture 2, sliced by the simplest method in layers of 0.2 mm."""
    path = write_gcode(tmp_path_factory.mktemp("gcode") / "two.gcode", TWO)
    return compare(read_gcode(path), TWO)


@pytest.fixture(scope="module")
def coarse(printed: AsSliced) -> AsSliced:
    """Return the same comparison at fewer points."""
    return compare(printed.sliced, TWO, pitch_mm=0.1)


def with_heights(comparison: AsSliced, heights: np.ndarray, block: Block = TWO) -> AsSliced:
    """Return the same comparison for other printed heights or another block."""
    x, y = points_of(block)
    formula = block.datum_mm + block.surface.grid(x, y)
    return AsSliced(
        sliced=comparison.sliced,
        block=block,
        frame=comparison.frame,
        x_mm=x,
        y_mm=y,
        printed_mm=heights,
        formula_mm=formula,
        ideal_mm=staircase(comparison.sliced, formula),
    )


def test_a_simple_slicer_is_close_to_the_ideal_staircase(printed: AsSliced) -> None:
    assert printed.ideal_rms_mm == pytest.approx(0.2 / np.sqrt(12.0), rel=0.02)
    assert printed.rms_mm == pytest.approx(printed.ideal_rms_mm, rel=0.1)
    assert printed.mean_mm == pytest.approx(0.0, abs=0.02)
    assert printed.sideways is not None
    assert printed.sideways.ideal_rms_mm == pytest.approx(0.2 / np.sqrt(12.0) / 1.08, rel=0.1)
    assert printed.sideways.missing_fraction == 0.0
    assert (printed.peaks.count, printed.peaks.missed) == (9, 0)
    assert (printed.valleys.count, printed.valleys.missed) == (9, 0)
    assert printed.warnings == ()
    assert printed.frame.quarters == 0 and printed.frame.x_mm == pytest.approx(90.0, abs=0.01)


@pytest.mark.parametrize(
    ("dialect", "relative", "quarters"),
    mostly_long([("cura", False, 1), ("bambu", True, 2), ("prusa", False, 3)], ("bambu", True, 2)),
)
def test_dialects_and_rotations_give_the_same_comparison(
    coarse: AsSliced, tmp_path: Path, dialect: str, relative: bool, quarters: int
) -> None:
    path = write_gcode(
        tmp_path / "a.gcode", TWO, dialect=dialect, relative=relative, quarters=quarters, corner_mm=(7.0, 12.3)
    )
    comparison = compare(read_gcode(path), TWO, pitch_mm=0.1)
    assert comparison.frame.quarters == quarters
    assert comparison.rms_mm == pytest.approx(coarse.rms_mm, rel=2e-3)
    assert sum(comparison.sliced.left_out.values()) == sum(coarse.sliced.left_out.values())
    assumed = [warning for warning in comparison.warnings if "filament" in warning]
    assert len(assumed) == (dialect == "cura") and len(comparison.warnings) == len(assumed)


def test_a_misplaced_frame_increases_the_height_error(printed: AsSliced) -> None:
    rms = []
    for dx, dy in ((0.1, 0.0), (0.0, -0.1)):
        frame = BedPlace(x_mm=printed.frame.x_mm + dx, y_mm=printed.frame.y_mm + dy)
        comparison = compare(printed.sliced, TWO, frame, pitch_mm=0.1)
        assert comparison.frame is frame
        assert comparison.rms_mm is not None
        rms.append(comparison.rms_mm)
    assert printed.rms_mm is not None and min(rms) > 1.1 * printed.rms_mm
    assert max(rms) == pytest.approx(printed.misplaced_rms_mm, rel=0.1)


def test_the_height_error_is_measured_on_the_flat_part_only(printed: AsSliced) -> None:
    raised = with_heights(printed, printed.formula_mm + np.where(printed.slope < 1.0, 0.03, 0.5))
    assert raised.rms_mm == pytest.approx(0.03) and raised.mean_mm == pytest.approx(0.03)
    assert 0.9 < raised.flat_fraction < 0.95


def wave(amplitude: float, f: float, g: float = 0.0) -> Texture:
    """Return a texture of one wave."""
    return Texture(name="one-wave", equation="a wave", surface=WaveSum((Wave(amplitude=amplitude, f=f, g=g),)))


@pytest.mark.parametrize("shift", [0.05, -0.12])
def test_the_sideways_error_is_the_shift_of_a_wall(printed: AsSliced, shift: float) -> None:
    """If a wave along x is moved along x, its walls are displaced by the same distance."""
    block = Block.of(wave(1.0, 3.0))
    x, y = points_of(block)
    comparison = with_heights(printed, block.datum_mm + block.surface.grid(x + shift, y), block)
    assert comparison.sideways is not None and comparison.sideways.missing_fraction == 0.0
    assert comparison.sideways.rms_mm == pytest.approx(abs(shift), rel=0.01)


def test_a_lost_peak_and_a_filled_valley(printed: AsSliced) -> None:
    peak, valley = (np.unravel_index(k, printed.formula_mm.shape) for k in _middle_extremes(printed))
    heights = printed.printed_mm.copy()
    for (i, j), change in ((peak, -0.25), (valley, 0.3)):
        heights[i - 8 : i + 9, j - 8 : j + 9] += change
    comparison = with_heights(printed, heights)
    assert (comparison.peaks.missed, comparison.valleys.missed) == (1, 1)
    assert comparison.peaks.worst_mm == pytest.approx(0.25, abs=0.01)
    assert comparison.peaks.missed_mm == pytest.approx(
        np.array([[printed.x_mm[peak[0]], printed.y_mm[peak[1]]]]), abs=0.051
    )
    assert comparison.valleys.worst_mm > 0.2


def _middle_extremes(comparison: AsSliced) -> tuple[int, int]:
    """Return the flat indices of the highest and the lowest point in the middle of the block."""
    x, y = comparison.x_mm[:, None], comparison.y_mm[None, :]
    middle = (np.abs(x - 10.0) < 6.0) & (np.abs(y - 15.0) < 6.0)
    high = int(np.argmax(np.where(middle, comparison.formula_mm, -np.inf)))
    return high, int(np.argmin(np.where(middle, comparison.formula_mm, np.inf)))


def test_missing_tops_are_lost_peaks(tmp_path: Path) -> None:
    block = Block.of(2, scale=0.5)
    path = write_gcode(tmp_path / "a.gcode", block, layer_mm=0.1, highest_mm=3.1)
    comparison = compare(read_gcode(path), block)
    assert comparison.peaks.count == comparison.peaks.missed == 9
    assert comparison.peaks.worst_mm == pytest.approx(0.4, abs=0.01)


@pytest.mark.parametrize(("layer", "warned"), [(0.1, False), (0.14, False), (0.15, True), (0.3, True)])
def test_a_height_that_is_not_a_whole_number_of_layers_gives_a_warning(
    tmp_path: Path, layer: float, warned: bool
) -> None:
    path = write_gcode(tmp_path / "a.gcode", Block.of(2, scale=0.5, height_mm=7.0), layer_mm=layer)
    comparison = compare(read_gcode(path), Block.of(2, scale=0.5), pitch_mm=0.2)
    warnings = [warning for warning in comparison.warnings if "whole number of layers" in warning]
    assert bool(warnings) == warned
    if layer == 0.15:
        assert "3.45 or 3.6 mm" in warnings[0]


def test_the_key_is_left_out(coarse: AsSliced) -> None:
    keyed = compare(coarse.sliced, Block.of(2, key_mm=3.0), pitch_mm=0.1)
    assert not keyed.inside[-15:, :15].any()
    assert keyed.inside.mean() < coarse.inside.mean()
    assert keyed.rms_mm == pytest.approx(coarse.rms_mm, rel=0.02)


def test_another_texture_is_refused_and_the_correct_one_is_named(printed: AsSliced) -> None:
    with pytest.raises(InputError, match=r"two\.gcode.*another part.*mm from texture-2"):
        compare(printed.sliced, Block.of(3))


def test_a_low_block_is_compared_although_the_six_textures_do_not_fit_it(tmp_path: Path) -> None:
    """The block is so low that the six textures would leave no base, but it can still be compared with them."""
    block = Block.of(wave(0.4, 1.0, 0.3), height_mm=2.0, size_mm=(12.0, 9.0))
    path = write_gcode(tmp_path / "low.gcode", block, layer_mm=0.1)
    comparison = compare(read_gcode(path), block)
    assert comparison.rms_mm == pytest.approx(0.1 / np.sqrt(12.0), rel=0.15)
