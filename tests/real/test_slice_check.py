"""The comparison of G-code with the formula, for real slicers: PrusaSlicer and CuraEngine."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.outsiders import Run, Written, part_named, program
from helpers.slicing import by_cura, by_prusa, cura_search_path

from tacbench_cad.extensions.slicing.comparison import AsSliced, compare
from tacbench_cad.extensions.slicing.gcode import read_gcode
from tacbench_cad.spec.block import Block

pytestmark = pytest.mark.real

#: The height error of texture 2, and the error of the ideal staircase, for each layer height, in mm.
EXPECTED = {0.1: (0.027, 0.029), 0.15: (0.039, 0.0435), 0.2: (0.052, 0.0575)}
HEIGHTS = [pytest.param(height, marks=() if height == 0.2 else pytest.mark.long) for height in EXPECTED]


@pytest.fixture
def cura_engine(monkeypatch: pytest.MonkeyPatch) -> Run:
    run = program("CuraEngine", "cura-engine")
    folders = cura_search_path()
    if folders is None:
        pytest.skip("CuraEngine's definitions are not installed: apt-get install cura")
    monkeypatch.setenv("CURA_ENGINE_SEARCH_PATH", folders)
    return run


def checked(path: Path, texture: int = 2) -> AsSliced:
    return compare(read_gcode(path), Block.of(texture), pitch_mm=0.1)


def require_like_expected(comparison: AsSliced, layer_mm: float) -> None:
    rms, ideal = EXPECTED[layer_mm]
    assert comparison.sliced.layer_mm == pytest.approx(layer_mm)
    assert comparison.rms_mm == pytest.approx(rms, abs=0.004)
    assert comparison.ideal_rms_mm == pytest.approx(ideal, abs=0.001)
    assert comparison.misplaced_rms_mm is not None and comparison.misplaced_rms_mm > 0.055
    assert comparison.sideways is not None and comparison.sideways.missing_fraction < 0.01
    assert (comparison.peaks.count, comparison.peaks.missed) == (9, 0)
    assert (comparison.valleys.count, comparison.valleys.missed) == (9, 0)
    assert comparison.sliced.unknown == ()
    warned = any("whole number of layers" in warning for warning in comparison.warnings)
    assert warned == (layer_mm == 0.15)


@pytest.mark.parametrize("layer_mm", HEIGHTS)
def test_prusaslicer(prusa_slicer: Run, written: Written, tmp_path: Path, layer_mm: float) -> None:
    comparison = checked(by_prusa(prusa_slicer, written("paper-2", "stl"), tmp_path / "a.gcode", layer_mm))
    assert comparison.sliced.dialect == "PrusaSlicer" and not comparison.sliced.filament_assumed
    assert set(comparison.sliced.left_out) == {"Skirt/Brim"}
    assert float(comparison.sliced.beads.width_mm.max()) < 1.0
    require_like_expected(comparison, layer_mm)


def test_prusaslicer_relative_turned_and_on_supports(prusa_slicer: Run, written: Written, tmp_path: Path) -> None:
    """The G-code has M83, G92 at each layer, classic walls, a raft, a rotation by 90 degrees and another position."""
    options = ("--use-relative-e-distances", "--layer-gcode", "G92 E0", "--perimeter-generator", "classic")
    place = ("--rotate", "90", "--center", "60,70", "--raft-layers", "2")
    comparison = checked(by_prusa(prusa_slicer, written("paper-2", "stl"), tmp_path / "a.gcode", 0.2, *options, *place))
    assert comparison.frame.quarters == 1
    assert (comparison.frame.x_mm, comparison.frame.y_mm) == pytest.approx((60.0 - 15.0, 70.0 - 11.65), abs=0.02)
    assert comparison.sliced.floor_mm > 0.3
    assert any(name.startswith("Support material") for name in comparison.sliced.left_out)
    require_like_expected(comparison, 0.2)


@pytest.mark.parametrize("layer_mm", HEIGHTS)
def test_curaengine(cura_engine: Run, written: Written, tmp_path: Path, layer_mm: float) -> None:
    comparison = checked(by_cura(cura_engine, written("paper-2", "stl"), tmp_path / "a.gcode", layer_mm))
    assert comparison.sliced.dialect == "Cura" and comparison.sliced.filament_assumed
    assert comparison.sliced.left_out.keys() == {"before the first feature", "SKIRT"}
    require_like_expected(comparison, layer_mm)


@pytest.mark.parametrize("name", ["disc-2", "ring-2"])
def test_prusaslicer_slices_other_outlines(prusa_slicer: Run, written: Written, tmp_path: Path, name: str) -> None:
    block = part_named(name).block
    assert block is not None
    path = by_prusa(prusa_slicer, written(name, "stl"), tmp_path / "a.gcode", 0.2, "--center", "60,70")
    comparison = compare(read_gcode(path), block, pitch_mm=0.1)
    assert (comparison.frame.x_mm, comparison.frame.y_mm) == pytest.approx(
        (60.0 - block.size_mm[0] / 2.0, 70.0 - block.size_mm[1] / 2.0), abs=0.02
    )
    rms, ideal = EXPECTED[0.2]
    assert comparison.rms_mm == pytest.approx(rms, abs=0.006)
    assert comparison.ideal_rms_mm == pytest.approx(ideal, abs=0.002)
    assert comparison.misplaced_rms_mm is not None and comparison.misplaced_rms_mm > 0.055
    assert comparison.peaks.missed == comparison.valleys.missed == 0 < comparison.peaks.count
    inside = np.argwhere(comparison.inside)
    x, y = comparison.x_mm[inside[:, 0]], comparison.y_mm[inside[:, 1]]
    assert block.outline is not None and block.outline.distance(x, y).max() < 0.0
