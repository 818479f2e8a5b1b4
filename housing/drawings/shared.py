"""Functions that all drawings of fixtures use."""

from __future__ import annotations

from housing.holder import Holder
from housing.shapes import Rectangle
from tacbench_cad.render.drawing.blocks import BLOCK_ACCEPTED_MM
from tacbench_cad.util.types import Floats

#: The distance of a cut below a face, in mm. Such a cut shows all openings of the face.
BELOW_MM = 0.01
#: The resolution of a caliper, in mm. No accepted deviation is smaller.
CALIPER_MM = 0.02


def accepted_mm(clearance_mm: tuple[float, float]) -> tuple[float, float]:
    """Return the accepted deviations along x and y of parts that fit with a clearance per side, in mm.

    The accepted deviation is two thirds of the clearance, but not more than that of a block. So if both parts deviate
    towards each other by the full accepted amount, at least a third of the clearance remains.
    """
    x, y = (round(max(min(BLOCK_ACCEPTED_MM, side * 2.0 / 3.0), CALIPER_MM), 2) for side in clearance_mm)
    return x, y


def block_boxes(holder: Holder, y_mm: float) -> list[Floats]:
    """Return the boxes of the blocks in a section at a given y, seen from the front, up to their highest point."""
    floor, (cx, cy) = holder.layout.floor_mm, holder.clearance_mm
    plans = [pocket.grown(-cx, -cy) for pocket in holder.pockets if pocket.low[1] < y_mm < pocket.high[1]]
    return [
        Rectangle(low=(plan.low[0], floor), high=(plan.high[0], floor + holder.block.height_mm)).corners
        for plan in plans
    ]
