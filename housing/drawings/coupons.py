"""The drawing of the fit coupon."""

from __future__ import annotations

import numpy as np

from housing.coupon import CLEARANCES_MM, FLOOR_MM, GAP_MM, STUB_MM, TAB_MM, Coupon
from housing.drawings.shared import BELOW_MM
from housing.fits import FITS
from housing.lettering import HEIGHT_MM
from tacbench_cad.render.drawing.cuts import Cuts
from tacbench_cad.render.drawing.sheet import Callout, Dimension, Drawing, View, length

#: The accepted deviation of the stub, in mm. The fit compensates smaller deviations.
_ACCEPTED_MM = 0.2


def coupon_drawing(coupon: Coupon) -> Drawing:
    """Draw a coupon: the plan, a section through the pockets, and a section through stub and tab.

    Raises:
        MissingToolError: The CAD kernel is not installed.
    """
    cuts = Cuts(coupon.part().mesh[0])
    (x, y, top), stub, tab, pockets = coupon.plate_mm, coupon.stub, coupon.tab, coupon.pockets
    first, last = pockets[0], pockets[-1]
    section_x, section_y = tab.low[0] + 0.5, (first.low[1] + first.high[1]) / 2.0
    upper = cuts.level(top - BELOW_MM)
    numerals = [loop for loop in upper if np.ptp(loop[:, 1]) < 2.0 * HEIGHT_MM]
    others = [loop for loop in upper if np.ptp(loop[:, 1]) >= 2.0 * HEIGHT_MM]
    middle = (tab.high[0], (tab.low[1] + tab.high[1]) / 2.0)
    dimensions = [
        Dimension("plate x", (0.0, 0.0), (x, 0.0), "bottom"),
        Dimension("plate y", (0.0, 0.0), (0.0, y), "left"),
        Dimension("stub x", (stub.low[0], stub.high[1]), stub.high, "top", _ACCEPTED_MM),
        Dimension("stub y", stub.low, (stub.low[0], stub.high[1]), "left", _ACCEPTED_MM),
        Dimension("first pocket y", first.low, (first.low[0], first.high[1]), "left"),
        Dimension("last pocket y", (last.high[0], last.low[1]), last.high, "right"),
    ]
    for pocket, clearance in zip(pockets, CLEARANCES_MM, strict=True):
        name, end = f"pocket {round(100 * clearance):02d} x", (pocket.high[0], pocket.low[1])
        dimensions.append(Dimension(name, pocket.low, end, "bottom"))
    plan = View(
        {"seen": others, "fine": numerals},
        dimensions,
        [Callout(f"tab {length(TAB_MM[0])} x {length(GAP_MM)} x {length(TAB_MM[1])}", middle)],
        cuts=(section_y, section_x),
    )
    front = [
        Dimension("plate height", (0.0, 0.0), (0.0, top), "left"),
        Dimension("pocket depth", (last.high[0], FLOOR_MM), (last.high[0], top), "right"),
        Dimension("floor", (x, 0.0), (last.high[0], FLOOR_MM), "right"),
    ]
    side = [
        Dimension("stub height", (-STUB_MM[2], stub.high[1]), (0.0, stub.high[1]), "top"),
        Dimension("tab", (-top, y), (-coupon.tab_height_mm[0], y), "bottom"),
        Dimension("gap", (0.0, y), (0.0, stub.low[1]), "right"),
    ]
    return Drawing(
        report=str(coupon),
        facts=("size", "stub", "tab", "numerals", "thinnest wall"),
        plan=plan,
        front=View(cuts.front(section_y), front),
        side=View(cuts.right(section_x), side),
        notes=[
            "Fits: " + ", ".join(f"{name} {length(clearance)}" for name, clearance in FITS.items()) + " mm per side.",
            "Pockets, x by y: " + ", ".join(" x ".join(map(length, pocket.size_mm)) for pocket in pockets) + ".",
            "Snap off the stub and try it in each pocket, with its lower end down and its long side along the row.",
            f"Print as drawn, without supports. The tab bridges {length(GAP_MM)} mm.",
        ],
    )
