"""The label engraved in a block's underside: glyphs as strokes of our own, the same in mesh and solid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

#: Depth of the engraving, in mm.
LABEL_DEPTH_MM = 0.4
#: Width of a stroke, in mm.
STROKE_MM = 0.8
#: Least height of a glyph, in mm.
LEAST_GLYPH_MM = 3.0


@dataclass(frozen=True, eq=False)
class Engraving:
    """Flat-bottomed pockets in the underside.

    Args:
        contours: Closed outlines in the block frame, each (n, 2) in mm without a repeated end: outer ones
            counter-clockwise, islands clockwise (both seen from above).
    """

    contours: tuple[Floats, ...]

    @property
    def area_mm2(self) -> float:
        """Area of the pockets in mm^2 (islands taken off)."""
        total = 0.0
        for c in self.contours:
            n = np.roll(c, -1, axis=0)
            total += float(np.sum(c[:, 0] * n[:, 1] - n[:, 0] * c[:, 1])) / 2.0
        return total

    @property
    def volume_mm3(self) -> float:
        """Volume of the pockets in mm^3."""
        return self.area_mm2 * LABEL_DEPTH_MM


def engrave(words: tuple[str, ...], size_mm: tuple[float, float], key_mm: float) -> Engraving:
    """Set the words on the underside, mirrored so that they read from below."""
    raise NotImplementedError
