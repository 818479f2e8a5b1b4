"""PrusaSlicer's resin slices against the formula: a printer's view of the surface, built without any code of ours.

A pixel is filled in a layer when the part covers most of it at the layer's middle. So the number of filled layers
times the layer height h is the surface's height there, give or take half a layer: a uniform error, its rms
``h / sqrt(12)``. What the file itself leaves of the formula comes on top, in squares.
"""

from __future__ import annotations

import io
import itertools
import math
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from helpers.outsiders import Run, Written, part_named

from tacbench_cad.spec.block import Block
from tacbench_cad.util.types import Floats

Image = pytest.importorskip("PIL.Image", reason="reading layer images needs pillow (extra dev)")

pytestmark = pytest.mark.real

LAYER_MM = 0.05
PIXEL_MM = 0.05
DISPLAY_MM = (48.0, 36.0)
#: rms of rounding to whole layers.
ROUNDING_MM = LAYER_MM / math.sqrt(12.0)
#: Pixels closer to the outline than this are half covered, in mm.
BORDER_MM = 0.1


@dataclass(frozen=True, eq=False)
class Slices:
    """The printed surface as a resin printer would build it.

    Attributes:
        x_mm: Pixel centres in the block frame, (n,).
        y_mm: Pixel centres in the block frame, (m,).
        height_mm: Filled layers times their height, (n, m).
        layers: Number of layers.
    """

    x_mm: Floats
    y_mm: Floats
    height_mm: Floats
    layers: int

    def deviation_mm(self, block: Block, datum_mm: float) -> Floats:
        """Height above the formula with its zero at ``datum_mm``, at each pixel away from the outline."""
        x_side, y_side = block.size_mm
        x = (self.x_mm > BORDER_MM) & (self.x_mm < x_side - BORDER_MM)
        y = (self.y_mm > BORDER_MM) & (self.y_mm < y_side - BORDER_MM)
        formula = datum_mm + block.surface.grid(self.x_mm[x], self.y_mm[y])
        return np.asarray(self.height_mm[np.ix_(x, y)] - formula)


def slices(prusa_slicer: Run, model: Path, block: Block, target: Path) -> Slices:
    """Slice a file for a resin printer with the block in the middle of its display, and stack the layers."""
    wide, deep = DISPLAY_MM
    prusa_slicer(
        [
            *("--export-sla", "--printer-technology", "SLA", "--output", target),
            *("--layer-height", str(LAYER_MM), "--initial-layer-height", str(LAYER_MM), "--gamma-correction", "0"),
            *("--display-width", f"{wide:g}", "--display-height", f"{deep:g}", "--display-orientation", "landscape"),
            *("--display-pixels-x", f"{wide / PIXEL_MM:.0f}", "--display-pixels-y", f"{deep / PIXEL_MM:.0f}"),
            *(
                "--display-mirror-x=0",
                "--display-mirror-y=0",
                "--bed-shape",
                f"0x0,{wide:g}x0,{wide:g}x{deep:g},0x{deep:g}",
            ),
            *("--supports-enable=0", "--pad-enable=0", "--support-object-elevation", "0", "--hollowing-enable=0"),
            *("--elefant-foot-compensation", "0", "--absolute-correction", "0", "--slice-closing-radius", "0"),
            *("--center", f"{wide / 2:g},{deep / 2:g}", model),
        ]
    )
    with zipfile.ZipFile(target) as archive:
        names = sorted(one for one in archive.namelist() if one.endswith(".png") and "/" not in one)
        images = [np.asarray(Image.open(io.BytesIO(archive.read(one)))) > 127 for one in names]
    filled = np.sum(images, axis=0)
    for lower, upper in itertools.pairwise(images):
        assert not (upper & ~lower).any(), "a texture has no overhang"
    x_side, y_side = block.size_mm
    rows, columns = filled.shape
    x = (np.arange(columns) + 0.5) * PIXEL_MM - (wide - x_side) / 2.0
    y = (np.arange(rows) + 0.5) * PIXEL_MM - (deep - y_side) / 2.0
    return Slices(x, y, LAYER_MM * filled[::-1].T, len(names))  # image rows run from the far side of the display


def rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


@pytest.mark.parametrize("number", range(1, 7))
def test_default_files(prusa_slicer: Run, written: Written, tmp_path: Path, number: int) -> None:
    """At 0.01 mm. On walls as steep as 14 mm a mm, 0.01 mm across the surface is 0.14 mm in height."""
    name = f"paper-{number}"
    block = Block.of(number)
    found = slices(prusa_slicer, written(name, "stl"), block, tmp_path / "part.sl1")
    assert found.layers == 140, "7 mm in layers of 0.05 mm: the last one is there"
    deviation = found.deviation_mm(block, block.datum_mm)
    gentle = number in (1, 2, 3, 5)
    assert 0.8 * ROUNDING_MM < rms(deviation) < (1.2 if gentle else 1.7) * ROUNDING_MM
    assert abs(deviation.mean()) < 0.002
    certificate = part_named(name).mesh[1].certificate
    assert certificate is not None
    # Half a layer, the file's own certified error, and the slope within half a pixel in steep places.
    slope = np.hypot(block.surface.bound(1, 0), block.surface.bound(0, 1))
    assert np.abs(deviation).max() < LAYER_MM / 2 + certificate.vertical_mm + slope * PIXEL_MM / 4


@pytest.mark.parametrize("number", [4, *(pytest.param(n, marks=pytest.mark.long) for n in (1, 2, 3, 5, 6))])
def test_fine_files_leave_only_the_layers(prusa_slicer: Run, written: Written, tmp_path: Path, number: int) -> None:
    """At 0.002 mm nothing but the rounding to layers is left, for the steepest texture too."""
    block = part_named(f"fine-{number}").block
    assert block is not None
    found = slices(prusa_slicer, written(f"fine-{number}", "stl"), block, tmp_path / "part.sl1")
    assert rms(found.deviation_mm(block, block.datum_mm)) == pytest.approx(ROUNDING_MM, rel=0.15)


@pytest.mark.parametrize(("number", "expected_mm"), [(6, 0.05), (4, 0.07)])
def test_the_paper_grid_leaves_the_formula(
    prusa_slicer: Run, written: Written, tmp_path: Path, number: int, expected_mm: float
) -> None:
    """On 189 x 201 samples the slices show the grid's own error against the formula with its top at 7 mm."""
    block = part_named(f"grid-{number}").block
    assert block is not None
    found = slices(prusa_slicer, written(f"grid-{number}", "stl"), block, tmp_path / "part.sl1")
    assert found.layers == 140
    assert rms(found.deviation_mm(block, block.formula_datum_mm)) == pytest.approx(expected_mm, rel=0.08)
    # With the grid's own datum the shift is gone, and the straight lines between samples are what remains.
    assert rms(found.deviation_mm(block, block.datum_mm)) > 3.0 * ROUNDING_MM


def test_the_released_grid_aliases(prusa_slicer: Run, written: Written, tmp_path: Path) -> None:
    """N = 101 on a 0.1 mm grid is another shape than its formula: the slices say so as well."""
    block = part_named("released-4").block
    assert block is not None
    found = slices(prusa_slicer, written("released-4", "stl"), block, tmp_path / "part.sl1")
    assert found.layers == 140
    assert rms(found.deviation_mm(block, block.datum_mm)) > 8.0 * ROUNDING_MM


def test_key_and_label_are_sliced(prusa_slicer: Run, written: Written, tmp_path: Path) -> None:
    """The key's corner stays empty, and the label's pockets are open in the first eight layers only."""
    part = part_named("keyed-4")
    block = part.block
    assert block is not None
    assert block.engraving is not None
    assert block.keep is not None
    target = tmp_path / "part.sl1"
    with pytest.raises(AssertionError, match="overhang"):
        slices(prusa_slicer, written("keyed-4", "stl"), block, target)
    with zipfile.ZipFile(target) as archive:
        names = sorted(one for one in archive.namelist() if one.endswith(".png") and "/" not in one)
        areas = [
            PIXEL_MM**2 * np.count_nonzero(np.asarray(Image.open(io.BytesIO(archive.read(one)))) > 127)
            for one in names[:12]
        ]
    assert areas[:8] == pytest.approx([block.footprint_mm2 - block.engraving.area_mm2] * 8, rel=2e-3)
    assert areas[8:] == pytest.approx([block.footprint_mm2] * 4, rel=1e-3)
