"""What the drawings of the fixtures have in common."""

from __future__ import annotations

from housing.holder import Holder
from housing.shapes import Rectangle
from tacbench_cad.render.drawing.blocks import BLOCK_ACCEPTED_MM
from tacbench_cad.util.types import Floats

#: A cut this far below a face shows what opens into it, in mm.
BELOW_MM = 0.01
#: What a caliper tells apart, in mm: no accepted deviation is smaller.
CALIPER_MM = 0.02


def accepted_mm(clearance_mm: tuple[float, float]) -> tuple[float, float]:
    """Accepted deviations of what fits with a clearance per side along x and y, in mm.

    Two thirds of the clearance, at most that of a block: where both parts are off by all of it towards each other,
    at least a third of the clearance is left.
    """
    x, y = (round(max(min(BLOCK_ACCEPTED_MM, side * 2.0 / 3.0), CALIPER_MM), 2) for side in clearance_mm)
    return x, y


def block_boxes(holder: Holder, y_mm: float) -> list[Floats]:
    """The boxes of the blocks that a section at a y passes, seen from the front: the highest point is their top."""
    floor, (cx, cy) = holder.layout.floor_mm, holder.clearance_mm
    plans = [pocket.grown(-cx, -cy) for pocket in holder.pockets if pocket.low[1] < y_mm < pocket.high[1]]
    return [
        Rectangle(low=(plan.low[0], floor), high=(plan.high[0], floor + holder.block.height_mm)).corners
        for plan in plans
    ]
