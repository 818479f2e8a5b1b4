"""PrusaSlicer's slices for resin printers, compared with the formula without any code of this project.

A pixel is filled in a layer if the part covers most of it at the middle of the layer. The number of filled layers
multiplied by the layer height h is therefore the height of the surface, with an error of up to half a layer. This error
is uniform and has the rms value ``h / sqrt(12)``. The squared error of the file is added to its square.
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
from helpers.cases import mostly_long
from helpers.outsiders import Run, Written, part_named

from tacbench_cad.spec.block import Block
from tacbench_cad.util.types import Floats

Image = pytest.importorskip("PIL.Image", reason="reading layer images needs pillow (extra dev)")

pytestmark = pytest.mark.real

LAYER_MM = 0.05
PIXEL_MM = 0.05
DISPLAY_MM = (48.0, 36.0)
#: The rms error of rounding to whole layers.
ROUNDING_MM = LAYER_MM / math.sqrt(12.0)
#: The distance from the outline below which pixels are half covered, in mm.
BORDER_MM = 0.1


@dataclass(frozen=True, eq=False)
class Slices:
    """The surface that a resin printer would print.

    Attributes:
        x_mm: The centres of the pixels in the block frame, shape (n,).
        y_mm: The centres of the pixels in the block frame, shape (m,).
        height_mm: The number of filled layers multiplied by the layer height, shape (n, m).
        layers: The number of layers.
    """

    x_mm: Floats
    y_mm: Floats
    height_mm: Floats
    layers: int

    def deviation_mm(self, block: Block, datum_mm: float) -> Floats:
        """Return the height above the formula (with its zero at ``datum_mm``) at each pixel away from the outline."""
        x_side, y_side = block.size_mm
        x = (self.x_mm > BORDER_MM) & (self.x_mm < x_side - BORDER_MM)
        y = (self.y_mm > BORDER_MM) & (self.y_mm < y_side - BORDER_MM)
        formula = datum_mm + block.surface.grid(self.x_mm[x], self.y_mm[y])
        return np.asarray(self.height_mm[np.ix_(x, y)] - formula)


def slices(prusa_slicer: Run, model: Path, block: Block, target: Path) -> Slices:
    """Slice a file for a resin printer with the block in the middle of its display, and stack the layers."""
    width, depth = DISPLAY_MM
    prusa_slicer(
        [
            *("--export-sla", "--printer-technology", "SLA", "--output", target),
            *("--layer-height", str(LAYER_MM), "--initial-layer-height", str(LAYER_MM), "--gamma-correction", "0"),
            *("--display-width", f"{width:g}", "--display-height", f"{depth:g}", "--display-orientation", "landscape"),
            *("--display-pixels-x", f"{width / PIXEL_MM:.0f}", "--display-pixels-y", f"{depth / PIXEL_MM:.0f}"),
            *(
                "--display-mirror-x=0",
                "--display-mirror-y=0",
                "--bed-shape",
                f"0x0,{width:g}x0,{width:g}x{depth:g},0x{depth:g}",
            ),
            *("--supports-enable=0", "--pad-enable=0", "--support-object-elevation", "0", "--hollowing-enable=0"),
            *("--elefant-foot-compensation", "0", "--absolute-correction", "0", "--slice-closing-radius", "0"),
            *("--center", f"{width / 2:g},{depth / 2:g}", model),
        ]
    )
    with zipfile.ZipFile(target) as archive:
        names = sorted(name for name in archive.namelist() if name.endswith(".png") and "/" not in name)
        images = [np.asarray(Image.open(io.BytesIO(archive.read(name)))) > 127 for name in names]
    filled = np.sum(images, axis=0)
    for lower, upper in itertools.pairwise(images):
        assert not (upper & ~lower).any(), "a texture must have no overhang"
    x_side, y_side = block.size_mm
    rows, columns = filled.shape
    x = (np.arange(columns) + 0.5) * PIXEL_MM - (width - x_side) / 2.0
    y = (np.arange(rows) + 0.5) * PIXEL_MM - (depth - y_side) / 2.0
    # The first row of an image is at the far side of the display.
    return Slices(x, y, LAYER_MM * filled[::-1].T, len(names))


def rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


@pytest.mark.parametrize("number", mostly_long(range(1, 7), 2))
def test_default_files(prusa_slicer: Run, written: Written, tmp_path: Path, number: int) -> None:
    """The tolerance is 0.01 mm. On walls with a slope of 14, a distance of 0.01 mm is 0.14 mm in height."""
    name = f"paper-{number}"
    block = Block.of(number)
    sliced = slices(prusa_slicer, written(name, "stl"), block, tmp_path / "part.sl1")
    assert sliced.layers == 140, "7 mm in layers of 0.05 mm must include the last layer"
    deviation = sliced.deviation_mm(block, block.datum_mm)
    gentle = number in (1, 2, 3, 5)
    assert 0.8 * ROUNDING_MM < rms(deviation) < (1.2 if gentle else 1.7) * ROUNDING_MM
    assert abs(deviation.mean()) < 0.002
    certificate = part_named(name).mesh[1].certificate
    assert certificate is not None
    # The error is half a layer, the certified error of the file, and the slope within half a pixel on steep walls.
    slope = np.hypot(block.surface.bound(1, 0), block.surface.bound(0, 1))
    assert np.abs(deviation).max() < LAYER_MM / 2 + certificate.vertical_mm + slope * PIXEL_MM / 4


def test_key_and_label_are_sliced(prusa_slicer: Run, written: Written, tmp_path: Path) -> None:
    """The corner of the key stays empty, and the pockets of the label are open only in the first eight layers."""
    part = part_named("keyed-4")
    block = part.block
    assert block is not None
    assert block.engraving is not None
    assert block.region is not None
    target = tmp_path / "part.sl1"
    with pytest.raises(AssertionError, match="overhang"):
        slices(prusa_slicer, written("keyed-4", "stl"), block, target)
    with zipfile.ZipFile(target) as archive:
        names = sorted(name for name in archive.namelist() if name.endswith(".png") and "/" not in name)
        areas = [
            PIXEL_MM**2 * np.count_nonzero(np.asarray(Image.open(io.BytesIO(archive.read(name)))) > 127)
            for name in names[:12]
        ]
    assert areas[:8] == pytest.approx([block.footprint_mm2 - block.engraving.area_mm2] * 8, rel=2e-3)
    assert areas[8:] == pytest.approx([block.footprint_mm2] * 4, rel=1e-3)
