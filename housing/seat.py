"""The jig without its markers, in the holder frame.

It has lips around the edge of the holder, arms that rest on the holder's rim, and recesses over the blocks.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import shapely

from housing.holder import Holder
from housing.marks import DEPTH_MM
from housing.shapes import Rectangle
from tacbench_cad.util.types import Floats

#: The gap between a block's highest point and the jig, in mm. So the jig rests only on the holder's rim.
AIR_MM = 0.3
#: How much wider than the pocket the recess over a block is, on each side, in mm.
RECESS_MM = 0.5
#: The thickness of the jig above the recess, in mm.
ROOF_MM = 2.0
#: The thickness of the lips around the holder's edge, in mm.
LIP_MM = 2.4
#: How far the lips extend below the holder's rim if the holder is high enough, in mm.
LIP_DEPTH_MM = 3.0
#: The radius of the free space for the head and the washer of a screw, in mm.
SCREW_HEAD_MM = 4.5


@dataclass(frozen=True, kw_only=True)
class Seat:
    """The jig without its markers.

    Args:
        holder: The holder that the jig rests on.
        clearance_mm: The clearance per side between lips and holder along x and y.
    """

    holder: Holder
    clearance_mm: tuple[float, float]

    @property
    def rest_mm(self) -> float:
        """The height z of the holder's rim, on which the jig rests, in mm."""
        return self.holder.size_mm[2]

    @property
    def recess_depth_mm(self) -> float:
        """The height of the recesses above the rim, in mm."""
        return self.holder.rim_height_mm + AIR_MM

    @property
    def roof_mm(self) -> tuple[float, float]:
        """The heights z of the jig's lower and upper face over the blocks, in mm."""
        ceiling = self.rest_mm + self.recess_depth_mm
        return (ceiling, ceiling + ROOF_MM)

    @property
    def lip_depth_mm(self) -> float:
        """How far the lips extend below the rim, in mm. They end at least 1 mm above the bed."""
        return min(LIP_DEPTH_MM, self.rest_mm - 1.0)

    @property
    def bottom_mm(self) -> float:
        """The height z of the lower ends of the lips, in mm."""
        return self.rest_mm - self.lip_depth_mm

    @property
    def inner(self) -> Rectangle:
        """The rectangle of the inner faces of the lips."""
        x, y, _ = self.holder.size_mm
        return Rectangle(low=(0.0, 0.0), high=(x, y)).grown(*self.clearance_mm)

    @property
    def outer(self) -> Rectangle:
        """The rectangle of the outer faces of the lips."""
        return self.inner.grown(LIP_MM, LIP_MM)

    @property
    def notches(self) -> tuple[Rectangle, ...]:
        """The corners that are left out for the heads of the screws, in the order of the holder's screws."""
        (x0, y0), (x1, y1) = self.outer.low, self.outer.high
        a, b, c, d = (bore.at_mm for bore in self.holder.screws)
        r = SCREW_HEAD_MM
        return (
            Rectangle(low=(x0, y0), high=(a[0] + r, a[1] + r)),
            Rectangle(low=(b[0] - r, y0), high=(x1, b[1] + r)),
            Rectangle(low=(x0, c[1] - r), high=(c[0] + r, y1)),
            Rectangle(low=(d[0] - r, d[1] - r), high=(x1, y1)),
        )

    @property
    def recesses(self) -> tuple[Rectangle, ...]:
        """The recesses over the pockets."""
        return tuple(pocket.grown(RECESS_MM, RECESS_MM) for pocket in self.holder.pockets)

    @property
    def has_outlined_recesses(self) -> bool:
        """Whether the recesses have the outline of the block. Otherwise they are rectangles.

        They are also rectangles if the rectangle around the outline touches the corner for a screw.
        """
        touches = any(n.polygon.intersection(r.polygon).area > 0.0 for n in self.notches for r in self.recesses)
        return self.holder.block.outline is not None and not touches

    @property
    def lip_lengths_mm(self) -> tuple[float, ...]:
        """The lengths of the lips between the notches, at low y, high y, low x and high x, in mm."""
        a, b, c, d = self.notches
        return (b.low[0] - a.high[0], d.low[0] - c.high[0], c.low[1] - a.high[1], d.low[1] - b.high[1])

    def outline(self) -> Floats:
        """Return the outline, counter-clockwise, shape (12, 2), in mm."""
        (x0, y0), (x1, y1) = self.outer.low, self.outer.high
        a, b, c, d = self.notches
        low_y = [(a.high[0], y0), (b.low[0], y0), (b.low[0], b.high[1])]
        high_x = [(x1, b.high[1]), (x1, d.low[1]), d.low]
        high_y = [(d.low[0], y1), (c.high[0], y1), (c.high[0], c.low[1])]
        low_x = [(x0, c.low[1]), (x0, a.high[1]), a.high]
        return np.array([*low_y, *high_x, *high_y, *low_x])

    @property
    def walls_mm(self) -> Mapping[str, float]:
        """The name and the thickness of each wall, in mm."""
        (x0, y0), (x1, y1) = self.outer.low, self.outer.high
        arms = [min(r.low[0] - x0, r.low[1] - y0, x1 - r.high[0], y1 - r.high[1]) for r in self.recesses]
        pairs = [(notch.polygon, recess.polygon) for notch in self.notches for recess in self.recesses]
        pinches = [notch.distance(recess) for notch, recess in pairs if notch.intersection(recess).area == 0.0]
        walls = {
            "lip": LIP_MM,
            "roof": ROOF_MM,
            "roof below the marks": ROOF_MM - DEPTH_MM,
            "wall from recess to outer face": min(arms),
        }
        if pinches:
            walls["wall from recess to screw corner"] = min(pinches)
        if self.holder.slots > 1:
            walls["foot between recesses"] = self.holder.web_mm - 2.0 * RECESS_MM
        return walls

    @property
    def volume_mm3(self) -> float:
        """The volume of arms, lips and roof, in mm^3."""

        def covered(plan: Rectangle) -> float:
            return float(plan.polygon.difference(shapely.union_all([n.polygon for n in self.notches])).area)

        height = self.roof_mm[1] - self.bottom_mm
        hollow = covered(self.inner) * self.lip_depth_mm
        recesses = sum(map(covered, self.recesses))
        if self.has_outlined_recesses:
            recesses = self.holder.slots * self.holder.pocket_loop.moved_outwards(RECESS_MM).area_mm2
        return covered(self.outer) * height - hollow - recesses * self.recess_depth_mm
