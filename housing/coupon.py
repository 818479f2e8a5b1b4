"""The fit coupon: five pockets and a stub, with which you find the fit of a printer before you print 36 blocks.

The stub is beside the plate. A tab, which the user snaps off, connects the two. So the coupon is one closed solid in
one file, and plate and stub are printed in the same state of the printer. The tab is above the part of the stub that
goes into a pocket, so that its burr does not influence the fit.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import shapely

from housing.engraving import engraved
from housing.fits import (
    FITS,
    MIN_FLOOR_MM,
    NOZZLE_MM,
    min_bearing_wall_mm,
    require_nozzle,
    require_walls,
)
from housing.fixture import Fixture
from housing.lettering import COUNTER_MM, HEIGHT_MM, width_mm, word
from housing.marks import DEPTH_MM, merged
from housing.shapes import Rectangle, box, cut, fused, one_solid
from tacbench_cad.spec.block import Block

if TYPE_CHECKING:
    from OCP.TopoDS import TopoDS_Solid

#: The clearances of the five pockets, in mm per side. They include the named fits.
CLEARANCES_MM = (0.05, 0.10, 0.15, 0.20, 0.30)
#: The size x, y, z of the stub, in mm. The sides differ, and the stub is high enough to be gripped.
STUB_MM = (12.0, 9.0, 10.0)
#: The depth of the pockets, in mm.
DEPTH_OF_POCKET_MM = 5.0
#: The thickness of the floor below the pockets, in mm.
FLOOR_MM = 1.6
#: The thickness of the walls around the pockets, in mm.
WALL_MM = 2.4
#: The distance of a numeral from the edge of the plate and from its pocket, in mm.
NUMERAL_EDGE_MM = 1.0
#: The gap between plate and stub, which the tab bridges, in mm.
GAP_MM = 2.0
#: The width and the thickness of the tab, in mm.
TAB_MM = (2.0, 0.8)


@dataclass(frozen=True, kw_only=True)
class Coupon(Fixture):
    """A fit coupon. It is the same for every block, because the fit depends on the printer and not on the block.

    Args:
        nozzle_mm: The width of the printer's nozzle. It sets the smallest allowed wall and has no other effect.

    Raises:
        InputError: A wall is too thin for the nozzle.
    """

    kind = "coupon"
    options = ("nozzle_mm",)
    by_default = False
    for_each_outline = False
    reported = ("clearances_per_side_mm", "stub_mm", "pocket_depth_mm", "plate_mm", "tab_mm", "print_orientation")

    nozzle_mm: float = NOZZLE_MM

    @classmethod
    def requested(cls, block: Block, options: Mapping[str, Any]) -> Coupon:
        """Return the coupon, which does not depend on the block."""
        return cls(nozzle_mm=options.get("nozzle_mm", NOZZLE_MM))

    def __post_init__(self) -> None:
        require_nozzle(self.nozzle_mm)
        walls = dict(self.walls_mm)
        fine = {name: walls.pop(name) for name in ("tab", "wall inside a numeral", "wall beside a numeral")}
        require_walls("nozzle", self.nozzle_mm, fine, self.nozzle_mm)
        require_walls("floor", FLOOR_MM, {"floor": walls.pop("floor")}, MIN_FLOOR_MM)
        require_walls("nozzle", self.nozzle_mm, walls, min_bearing_wall_mm(self.nozzle_mm))

    @property
    def pockets(self) -> tuple[Rectangle, ...]:
        """The five pockets seen from above, from the tightest to the loosest."""
        y = 2.0 * NUMERAL_EDGE_MM + HEIGHT_MM
        plans, x = [], WALL_MM
        for clearance in CLEARANCES_MM:
            high = (x + STUB_MM[0] + 2.0 * clearance, y + STUB_MM[1] + 2.0 * clearance)
            plans.append(Rectangle(low=(x, y), high=high))
            x = high[0] + WALL_MM
        return tuple(plans)

    @property
    def plate_mm(self) -> tuple[float, float, float]:
        """The sides and the height of the plate, in mm."""
        last = self.pockets[-1]
        return (last.high[0] + WALL_MM, last.high[1] + WALL_MM, FLOOR_MM + DEPTH_OF_POCKET_MM)

    @property
    def stub(self) -> Rectangle:
        """The stub seen from above. It is beside the middle of the plate."""
        x, y, _ = self.plate_mm
        low = ((x - STUB_MM[0]) / 2.0, y + GAP_MM)
        return Rectangle(low=low, high=(low[0] + STUB_MM[0], low[1] + STUB_MM[1]))

    @property
    def tab(self) -> Rectangle:
        """The tab seen from above, between plate and stub."""
        x, y, _ = self.plate_mm
        return Rectangle(low=((x - TAB_MM[0]) / 2.0, y), high=((x + TAB_MM[0]) / 2.0, y + GAP_MM))

    @property
    def tab_height_mm(self) -> tuple[float, float]:
        """The heights of the lower and the upper face of the tab. The upper face is level with the plate."""
        top = self.plate_mm[2]
        return (top - TAB_MM[1], top)

    @cached_property
    def grooves(self) -> tuple[shapely.Polygon, ...]:
        """The numerals, which state the clearance per side in hundredths of a mm."""
        strokes = []
        for plan, clearance in zip(self.pockets, CLEARANCES_MM, strict=True):
            letters = f"{round(clearance * 100):02d}"
            middle = (plan.low[0] + plan.high[0]) / 2.0
            strokes += word(letters, (middle - width_mm(letters) / 2.0, NUMERAL_EDGE_MM))
        return merged(strokes)

    @property
    def size_mm(self) -> tuple[float, float, float]:
        """The size of the bounding box, in mm."""
        return (self.plate_mm[0], self.stub.high[1], max(self.plate_mm[2], STUB_MM[2]))

    @property
    def walls_mm(self) -> Mapping[str, float]:
        """The name and the thickness of each wall, in mm."""
        return {
            "floor": FLOOR_MM,
            "wall round the pockets": WALL_MM,
            "tab": min(TAB_MM),
            "wall inside a numeral": COUNTER_MM,
            "wall beside a numeral": NUMERAL_EDGE_MM,
        }

    @property
    def name(self) -> str:
        """The stem of the file names: ``coupon``."""
        return "coupon"

    @property
    def title(self) -> str:
        """A description in one line."""
        clearances = ", ".join(f"{clearance:.2f}" for clearance in CLEARANCES_MM)
        return f"Fit coupon: pockets with {clearances} mm clearance per side, and a stub to try in them"

    @property
    def volume_mm3(self) -> float:
        """The volume of plate, tab and stub without pockets and numerals, in mm^3."""
        x, y, z = self.plate_mm
        pockets = sum(plan.area_mm2 for plan in self.pockets) * DEPTH_OF_POCKET_MM
        numerals = float(sum(groove.area for groove in self.grooves)) * DEPTH_MM
        stub = self.stub.area_mm2 * STUB_MM[2]
        return x * y * z - pockets - numerals + stub + self.tab.area_mm2 * TAB_MM[1]

    @cached_property
    def solid_in_use(self) -> TopoDS_Solid:
        """The Open CASCADE solid, in the orientation of the file."""
        x, y, z = self.plate_mm
        plate = box(Rectangle(low=(0.0, 0.0), high=(x, y)), (0.0, z))
        tools = [box(plan, (FLOOR_MM, z + 1.0)) for plan in self.pockets]
        bodies = [box(self.tab, self.tab_height_mm), box(self.stub, (0.0, STUB_MM[2]))]
        return engraved(one_solid(fused(cut(plate, tools), bodies), "coupon"), z, self.grooves, DEPTH_MM)

    def spec(self) -> dict[str, Any]:
        """Return all values that define the coupon, as plain JSON values."""
        return {
            "clearances_per_side_mm": list(CLEARANCES_MM),
            "named_fits_mm": dict(FITS),
            "stub_mm": STUB_MM,
            "pocket_depth_mm": DEPTH_OF_POCKET_MM,
            "plate_mm": self.plate_mm,
            "tab_mm": (*TAB_MM, GAP_MM),
            "walls_mm": dict(self.walls_mm),
            "nozzle_mm": self.nozzle_mm,
            "print_orientation": "as in the file, with the pockets up; without supports: the tab bridges 2 mm",
            "notes": [
                "snap off the stub and try it in each pocket, with its lower end down and its long side along the row",
                "the numerals are the clearance per side in hundredths of a mm; use the clearance that fits as --fit",
                "plate and stub are one solid, so that they come from the same print",
            ],
        }
