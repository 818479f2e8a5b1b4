"""The fit coupon: five pockets and a stub, so that a lab finds its printer's fit before it prints 36 blocks.

The stub stands beside the plate, joined to it by a tab to be snapped off: one closed solid, one file, one print, and
the printer's state is the same for both. The tab meets the stub above the depth to which it goes into a pocket, so
that its burr does not touch the fit.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

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
from housing.marks import DEPTH_MM, Groove, merged
from housing.shapes import Rectangle, box, one_solid
from tacbench_cad.spec.block import Block
from tacbench_cad.util.text import mm

#: Clearances of the five pockets, in mm per side; the named fits are among them.
CLEARANCES_MM = (0.05, 0.10, 0.15, 0.20, 0.30)
#: The stub, x, y, z: a small block with sides that differ, high enough to be gripped, in mm.
STUB_MM = (12.0, 9.0, 10.0)
#: Depth of the pockets, in mm.
DEPTH_OF_POCKET_MM = 5.0
#: Thickness below the pockets, in mm.
FLOOR_MM = 1.6
#: Walls round the pockets, in mm.
WALL_MM = 2.4
#: Between a numeral and the plate's edge, and between a numeral and its pocket, in mm.
NUMERAL_EDGE_MM = 1.0
#: Gap between plate and stub, which the tab bridges, in mm.
GAP_MM = 2.0
#: The tab's width and thickness, in mm.
TAB_MM = (2.0, 0.8)


@dataclass(frozen=True, kw_only=True)
class Coupon(Fixture):
    """A fit coupon. It is the same for every block: a fit is a matter of the printer, not of the size.

    Args:
        nozzle_mm: The printer's nozzle: sets the least wall, changes nothing else.

    Raises:
        InputError: A wall is too thin for the nozzle.
    """

    kind = "coupon"
    options = ("nozzle_mm",)
    by_default = False
    for_each_outline = False

    nozzle_mm: float = NOZZLE_MM

    @classmethod
    def requested(cls, block: Block, options: Mapping[str, Any]) -> Coupon:
        """The one coupon."""
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
        """The five pockets' plans, from the tightest to the loosest."""
        y = 2.0 * NUMERAL_EDGE_MM + HEIGHT_MM
        plans, x = [], WALL_MM
        for clearance in CLEARANCES_MM:
            high = (x + STUB_MM[0] + 2.0 * clearance, y + STUB_MM[1] + 2.0 * clearance)
            plans.append(Rectangle(low=(x, y), high=high))
            x = high[0] + WALL_MM
        return tuple(plans)

    @property
    def plate_mm(self) -> tuple[float, float, float]:
        """Sides and height of the plate, in mm."""
        last = self.pockets[-1]
        return (last.high[0] + WALL_MM, last.high[1] + WALL_MM, FLOOR_MM + DEPTH_OF_POCKET_MM)

    @property
    def stub(self) -> Rectangle:
        """The stub's plan, beside the middle of the plate."""
        x, y, _ = self.plate_mm
        low = ((x - STUB_MM[0]) / 2.0, y + GAP_MM)
        return Rectangle(low=low, high=(low[0] + STUB_MM[0], low[1] + STUB_MM[1]))

    @property
    def tab(self) -> Rectangle:
        """The tab's plan, between plate and stub."""
        x, y, _ = self.plate_mm
        return Rectangle(low=((x - TAB_MM[0]) / 2.0, y), high=((x + TAB_MM[0]) / 2.0, y + GAP_MM))

    @property
    def tab_height_mm(self) -> tuple[float, float]:
        """Lower and upper face of the tab, z: its top is the plate's."""
        top = self.plate_mm[2]
        return (top - TAB_MM[1], top)

    @cached_property
    def grooves(self) -> tuple[Groove, ...]:
        """The numerals: clearance per side in hundredths of a mm."""
        strokes = []
        for plan, clearance in zip(self.pockets, CLEARANCES_MM, strict=True):
            letters = f"{round(clearance * 100):02d}"
            middle = (plan.low[0] + plan.high[0]) / 2.0
            strokes += word(letters, (middle - width_mm(letters) / 2.0, NUMERAL_EDGE_MM))
        return merged(strokes)

    @property
    def size_mm(self) -> tuple[float, float, float]:
        """Bounding box, in mm."""
        return (self.plate_mm[0], self.stub.high[1], max(self.plate_mm[2], STUB_MM[2]))

    @property
    def walls_mm(self) -> Mapping[str, float]:
        """The coupon's walls and their thickness, in mm."""
        return {
            "floor": FLOOR_MM,
            "wall round the pockets": WALL_MM,
            "tab": min(TAB_MM),
            "wall inside a numeral": COUNTER_MM,
            "wall beside a numeral": NUMERAL_EDGE_MM,
        }

    @property
    def name(self) -> str:
        """``coupon``: there is one."""
        return "coupon"

    @property
    def title(self) -> str:
        """One line for people."""
        clearances = ", ".join(f"{one:.2f}" for one in CLEARANCES_MM)
        return f"Fit coupon: pockets with {clearances} mm per side, and a stub to try in them"

    @property
    def volume_mm3(self) -> float:
        """Plate, tab and stub less pockets and numerals, in mm^3."""
        x, y, z = self.plate_mm
        pockets = sum(plan.area_mm2 for plan in self.pockets) * DEPTH_OF_POCKET_MM
        numerals = sum(one.area_mm2 for one in self.grooves) * DEPTH_MM
        stub = self.stub.area_mm2 * STUB_MM[2]
        return x * y * z - pockets - numerals + stub + self.tab.area_mm2 * TAB_MM[1]

    @cached_property
    def shape(self) -> Any:
        """The build123d solid, as it is printed."""
        x, y, z = self.plate_mm
        plate = box(Rectangle(low=(0.0, 0.0), high=(x, y)), (0.0, z))
        tools = [box(plan, (FLOOR_MM, z + 1.0)) for plan in self.pockets]
        bodies = [box(self.tab, self.tab_height_mm), box(self.stub, (0.0, STUB_MM[2]))]
        return engraved(one_solid(plate.cut(*tools).fuse(*bodies), "coupon"), z, self.grooves, DEPTH_MM)

    def spec(self) -> dict[str, Any]:
        """Everything that went into the coupon, as plain JSON values."""
        return {
            "clearances_per_side_mm": list(CLEARANCES_MM),
            "named_fits_mm": dict(FITS),
            "stub_mm": list(STUB_MM),
            "pocket_depth_mm": DEPTH_OF_POCKET_MM,
            "plate_mm": list(self.plate_mm),
            "tab_mm": [*TAB_MM, GAP_MM],
            "walls_mm": dict(self.walls_mm),
            "nozzle_mm": self.nozzle_mm,
            "print_orientation": "as it lies, pockets upward; no supports, the tab bridges 2 mm",
            "notes": [
                "snap the stub off and try it in each pocket, its lower end first, its long side along the row",
                "the numerals are hundredths of a mm per side: give the one that fits as --fit",
                "one solid with a tab, not two files: plate and stub come from the same print",
            ],
        }

    def facts(self) -> dict[str, str]:
        """The lines of the dimension report."""
        return {
            "size": mm(*self.size_mm),
            "plate": mm(*self.plate_mm),
            "stub": mm(*STUB_MM),
            "pockets": "; ".join(mm(*plan.size_mm) for plan in self.pockets) + f"; {mm(DEPTH_OF_POCKET_MM)} deep",
            "numerals": "clearance per side in hundredths of a mm",
            "tab": f"{mm(*TAB_MM)}, snap off",
            "least wall": self._thinnest,
        }
