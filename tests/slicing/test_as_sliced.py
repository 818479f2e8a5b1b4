"""The comparison of the printed top with the formula, for prints with known errors."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from helpers.gcode_writer import write_gcode

from tacbench_cad.slicing.compare import AsSliced, compare
from tacbench_cad.slicing.gcode import Sliced, read_gcode
from tacbench_cad.slicing.surface import Frame, points_of, staircase
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.textures import Texture
from tacbench_cad.spec.waves import Wave, WaveSum
from tacbench_cad.util.errors import InputError

TWO = Block.of(2)


@pytest.fixture(scope="module")
def printed(tmp_path_factory: pytest.TempPathFactory) -> AsSliced:
    """Texture 2 in layers of 0.2 mm, sliced in the simplest way."""
    path = write_gcode(tmp_path_factory.mktemp("gcode") / "two.gcode", TWO)
    return compare(read_gcode(path), TWO)


@pytest.fixture(scope="module")
def coarse(printed: AsSliced) -> AsSliced:
    """The same at fewer points."""
    return compare(printed.sliced, TWO, pitch_mm=0.1)


def with_heights(found: AsSliced, heights: np.ndarray, block: Block = TWO) -> AsSliced:
    """Return the same comparison for other printed heights or another block."""
    x, y = points_of(block)
    formula = block.datum_mm + block.surface.grid(x, y)
    return AsSliced(
        sliced=found.sliced,
        block=block,
        frame=found.frame,
        x_mm=x,
        y_mm=y,
        printed_mm=heights,
        formula_mm=formula,
        ideal_mm=staircase(found.sliced, formula),
    )


def test_a_plain_slicer_comes_near_the_ideal_staircase(printed: AsSliced) -> None:
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
    ("dialect", "relative", "quarters"), [("cura", False, 1), ("bambu", True, 2), ("prusa", False, 3)]
)
def test_dialects_and_turns_give_the_same(
    coarse: AsSliced, tmp_path: Path, dialect: str, relative: bool, quarters: int
) -> None:
    path = write_gcode(
        tmp_path / "a.gcode", TWO, dialect=dialect, relative=relative, quarters=quarters, corner_mm=(7.0, 12.3)
    )
    found = compare(read_gcode(path), TWO, pitch_mm=0.1)
    assert found.frame.quarters == quarters
    assert found.rms_mm == pytest.approx(coarse.rms_mm, rel=2e-3)
    assert sum(found.sliced.left_out.values()) == sum(coarse.sliced.left_out.values())
    assumed = [one for one in found.warnings if "filament" in one]
    assert len(assumed) == (dialect == "cura") and len(found.warnings) == len(assumed)


def test_a_given_frame_and_what_misplacement_changes(printed: AsSliced) -> None:
    rms = []
    for dx, dy in ((0.1, 0.0), (0.0, -0.1)):
        frame = Frame(x_mm=printed.frame.x_mm + dx, y_mm=printed.frame.y_mm + dy)
        found = compare(printed.sliced, TWO, frame, pitch_mm=0.1)
        assert found.frame is frame
        assert found.rms_mm is not None
        rms.append(found.rms_mm)
    assert printed.rms_mm is not None and min(rms) > 1.1 * printed.rms_mm
    assert max(rms) == pytest.approx(printed.misplaced_rms_mm, rel=0.1)


def test_height_error_counts_on_the_flat_part_only(printed: AsSliced) -> None:
    raised = with_heights(printed, printed.formula_mm + np.where(printed.slope < 1.0, 0.03, 0.5))
    assert raised.rms_mm == pytest.approx(0.03) and raised.mean_mm == pytest.approx(0.03)
    assert 0.9 < raised.flat_fraction < 0.95


def wave(amplitude: float, f: float, g: float = 0.0) -> Texture:
    """A texture of one wave."""
    return Texture(name="one-wave", equation="a wave", waves=WaveSum((Wave(amplitude=amplitude, f=f, g=g),)))


@pytest.mark.parametrize("shift", [0.05, -0.12])
def test_sideways_error_is_the_shift_of_a_wall(printed: AsSliced, shift: float) -> None:
    """A wave along x that is moved along x: its walls are off by just that."""
    block = Block.of(wave(1.0, 3.0))
    x, y = points_of(block)
    found = with_heights(printed, block.datum_mm + block.surface.grid(x + shift, y), block)
    assert found.sideways is not None and found.sideways.missing_fraction == 0.0
    assert found.sideways.rms_mm == pytest.approx(abs(shift), rel=0.01)


def test_heights_that_the_formula_never_has_are_counted(printed: AsSliced) -> None:
    six = Block.of(6)
    high = with_heights(printed, np.full((len(points_of(six)[0]), len(points_of(six)[1])), 20.0), six)
    assert high.sideways is not None and high.sideways.missing_fraction == 1.0


def test_a_lost_peak_and_a_filled_valley(printed: AsSliced) -> None:
    peak, valley = (np.unravel_index(k, printed.formula_mm.shape) for k in _middle_extremes(printed))
    heights = printed.printed_mm.copy()
    for (i, j), change in ((peak, -0.25), (valley, 0.3)):
        heights[i - 8 : i + 9, j - 8 : j + 9] += change
    found = with_heights(printed, heights)
    assert (found.peaks.missed, found.valleys.missed) == (1, 1)
    assert found.peaks.worst_mm == pytest.approx(0.25, abs=0.01)
    assert found.peaks.missed_mm == pytest.approx(np.array([[printed.x_mm[peak[0]], printed.y_mm[peak[1]]]]), abs=0.051)
    assert found.valleys.worst_mm > 0.2


def _middle_extremes(found: AsSliced) -> tuple[int, int]:
    """The highest and the lowest point of the middle of the block, as flat indices."""
    x, y = found.x_mm[:, None], found.y_mm[None, :]
    middle = (np.abs(x - 10.0) < 6.0) & (np.abs(y - 15.0) < 6.0)
    high = int(np.argmax(np.where(middle, found.formula_mm, -np.inf)))
    return high, int(np.argmin(np.where(middle, found.formula_mm, np.inf)))


def test_a_ridge_counts_once(printed: AsSliced) -> None:
    one = Block.of(1)
    x, y = points_of(one)
    found = with_heights(printed, one.datum_mm + one.surface.grid(x, y), one)
    assert (found.peaks.count, found.valleys.count) == (3, 3)


def test_a_gentle_texture_has_no_steep_walls(printed: AsSliced) -> None:
    block = Block.of(wave(0.3, 1.0))
    found = with_heights(printed, block.height_at(*np.meshgrid(*points_of(block), indexing="ij")), block)
    assert found.sideways is None and found.flat_fraction == 1.0 and found.rms_mm == pytest.approx(0.0)
    assert json.loads(json.dumps(found.as_dict(), allow_nan=False))["sideways"] is None


def test_missing_tops_are_lost_peaks(tmp_path: Path) -> None:
    block = Block.of(2, scale=0.5)
    path = write_gcode(tmp_path / "a.gcode", block, layer_mm=0.1, highest_mm=3.1)
    found = compare(read_gcode(path), block)
    assert found.peaks.count == found.peaks.missed == 9
    assert found.peaks.worst_mm == pytest.approx(0.4, abs=0.01)


@pytest.mark.parametrize(("layer", "warned"), [(0.1, False), (0.14, False), (0.15, True), (0.3, True)])
def test_a_height_that_is_no_whole_number_of_layers(tmp_path: Path, layer: float, warned: bool) -> None:
    path = write_gcode(tmp_path / "a.gcode", Block.of(2, scale=0.5, height_mm=7.0), layer_mm=layer)
    found = compare(read_gcode(path), Block.of(2, scale=0.5), pitch_mm=0.2)
    said = [one for one in found.warnings if "whole number of layers" in one]
    assert bool(said) == warned
    if layer == 0.15:
        assert "3.45 or 3.6 mm" in said[0]


def test_the_key_is_left_out(coarse: AsSliced) -> None:
    keyed = compare(coarse.sliced, Block.of(2, key_mm=3.0), pitch_mm=0.1)
    assert not keyed.inside[-15:, :15].any()
    assert keyed.inside.mean() < coarse.inside.mean()
    assert keyed.rms_mm == pytest.approx(coarse.rms_mm, rel=0.02)


@pytest.mark.parametrize("texture", [1, 3, 4, 5, 6])
def test_another_texture_is_refused_and_the_right_one_named(printed: AsSliced, texture: int) -> None:
    with pytest.raises(InputError, match=r"two\.gcode.*another part.*mm from texture-2"):
        compare(printed.sliced, Block.of(texture))


def test_a_frame_beside_the_print_is_refused(printed: AsSliced) -> None:
    with pytest.raises(InputError, match="prints nothing there"):
        compare(printed.sliced, TWO, Frame(x_mm=300.0, y_mm=300.0))


def test_a_texture_unlike_the_six_needs_no_base_for_them(tmp_path: Path) -> None:
    """A low block, on which the reliefs of the six would leave no base, is compared with them all the same."""
    block = Block.of(wave(0.4, 1.0, 0.3), height_mm=2.0, size_mm=(12.0, 9.0))
    path = write_gcode(tmp_path / "low.gcode", block, layer_mm=0.1)
    found = compare(read_gcode(path), block)
    assert found.rms_mm == pytest.approx(0.1 / np.sqrt(12.0), rel=0.15)


def test_json_holds_numbers_only(printed: AsSliced) -> None:
    said = json.loads(json.dumps(printed.as_dict(), allow_nan=False))
    assert said["frame"]["source"] == "outer walls" and said["height"]["misplaced_by_mm"] == 0.1
    assert said["block"] == TWO.name and isinstance(printed.sliced, Sliced)
