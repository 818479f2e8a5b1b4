"""The drawing of the fit coupon."""

from __future__ import annotations

import numpy as np

from housing.coupon import CLEARANCES_MM, DEPTH_OF_POCKET_MM, FLOOR_MM, GAP_MM, STUB_MM, TAB_MM, Coupon
from housing.drawings.shared import BELOW_MM
from housing.fits import FITS
from housing.lettering import HEIGHT_MM
from housing.marks import DEPTH_MM
from tacbench_cad.render.drawing.blocks import ACCEPTS_MM
from tacbench_cad.render.drawing.cuts import Cuts
from tacbench_cad.render.drawing.sheet import Callout, CutMark, Dimension, Drawing, View, length
from tacbench_cad.util.types import Floats

#: Deviation that is accepted of stub and pockets: what is left is for the fit to find, in mm.
_ACCEPTS_MM = 0.2


def coupon_drawing(coupon: Coupon) -> Drawing:
    """Draw a coupon: the plan, a section through its pockets, and one through stub and tab.

    Args:
        coupon: The coupon.

    Raises:
        MissingToolError: The CAD kernel is not there.
    """
    cuts = Cuts(coupon.part().mesh[0])
    pocket, tab = coupon.pockets[0], coupon.tab
    at = (tab.low[0] + 0.5, (pocket.low[1] + pocket.high[1]) / 2.0)
    named = ", ".join(f"{name} {length(one)}" for name, one in FITS.items())
    return Drawing(
        name=coupon.name,
        title="Fit coupon",
        facts=(
            ("pockets", ", ".join(f"{one:.2f}" for one in CLEARANCES_MM) + " mm clearance per side"),
            ("named fits", named),
            ("numerals", f"clearance per side in 0.01 mm, {length(DEPTH_MM)} deep"),
        ),
        accepts_mm=ACCEPTS_MM,
        plan=_plan(coupon, cuts, at),
        front=_front(coupon, cuts, at[1]),
        side=_side(coupon, cuts, at[0]),
        notes=[
            "Pockets, x by y: " + ", ".join(" x ".join(map(length, plan.size_mm)) for plan in coupon.pockets) + ".",
            "Snap the stub off at its tab and try it in each pocket, lower end first, its long side along the row.",
            "Print as drawn. No supports: the tab bridges " + length(GAP_MM) + " mm.",
        ],
    )


def _plan(coupon: Coupon, cuts: Cuts, at: tuple[float, float]) -> View:
    (x, y, top), stub, tab = coupon.plate_mm, coupon.stub, coupon.tab
    first, last = coupon.pockets[0], coupon.pockets[-1]
    dimensions = [
        Dimension(name="plate x", value_mm=x, start=(0.0, y), end=(x, y), side="bottom"),
        Dimension(name="plate y", value_mm=y, start=(0.0, 0.0), end=(0.0, y), side="left"),
        Dimension(
            name="stub x",
            value_mm=STUB_MM[0],
            start=(stub.low[0], stub.high[1]),
            end=stub.high,
            side="top",
            accept_mm=_ACCEPTS_MM,
        ),
        Dimension(
            name="stub y",
            value_mm=STUB_MM[1],
            start=stub.low,
            end=(stub.low[0], stub.high[1]),
            side="left",
            accept_mm=_ACCEPTS_MM,
        ),
        Dimension(
            name="first pocket y",
            value_mm=first.size_mm[1],
            start=first.low,
            end=(first.low[0], first.high[1]),
            side="left",
        ),
        Dimension(
            name="last pocket y",
            value_mm=last.size_mm[1],
            start=(last.high[0], last.low[1]),
            end=last.high,
            side="right",
        ),
    ]
    dimensions += [
        Dimension(
            name=f"pocket {round(100 * one):02d} x",
            value_mm=plan.size_mm[0],
            start=plan.low,
            end=(plan.high[0], plan.low[1]),
            side="bottom",
        )
        for plan, one in zip(coupon.pockets, CLEARANCES_MM, strict=True)
    ]
    tip = (tab.high[0], (tab.low[1] + tab.high[1]) / 2.0)
    text = f"tab {length(TAB_MM[0])} x {length(GAP_MM)} x {length(TAB_MM[1])}"
    upper = cuts.level(top - BELOW_MM)
    return View(
        seen=tuple(one for one in upper if not _is_numeral(one)),
        fine=tuple(one for one in upper if _is_numeral(one)),
        dimensions=tuple(dimensions),
        callouts=(Callout(name="tab", text=text, at=tip),),
        cut_marks=(CutMark(letter="A", at=at[1], across=True), CutMark(letter="B", at=at[0], across=False)),
    )


def _is_numeral(loop: Floats) -> bool:
    """Whether a loop is a part of a numeral."""
    return bool(np.ptp(loop[:, 1]) < 2.0 * HEIGHT_MM)


def _front(coupon: Coupon, cuts: Cuts, y_mm: float) -> View:
    (x, _, top), pocket = coupon.plate_mm, coupon.pockets[-1]
    return View(
        caption="A–A",
        cut=cuts.from_front(y_mm),
        seen=cuts.beyond_front(y_mm),
        dimensions=(
            Dimension(name="plate height", value_mm=top, start=(0.0, 0.0), end=(0.0, top), side="left"),
            Dimension(
                name="pocket depth",
                value_mm=DEPTH_OF_POCKET_MM,
                start=(pocket.high[0], FLOOR_MM),
                end=(pocket.high[0], top),
                side="right",
            ),
            Dimension(name="floor", value_mm=FLOOR_MM, start=(x, 0.0), end=(pocket.high[0], FLOOR_MM), side="right"),
        ),
    )


def _side(coupon: Coupon, cuts: Cuts, x_mm: float) -> View:
    (_, y, top), stub, (low, _) = coupon.plate_mm, coupon.stub, coupon.tab_height_mm
    height = STUB_MM[2]
    return View(
        caption="B–B",
        cut=cuts.from_right(x_mm),
        seen=cuts.beyond_right(x_mm),
        dimensions=(
            Dimension(
                name="stub height", value_mm=height, start=(-height, stub.high[1]), end=(0.0, stub.high[1]), side="top"
            ),
            Dimension(name="tab", value_mm=TAB_MM[1], start=(-top, y), end=(-low, y), side="bottom"),
            Dimension(name="gap", value_mm=GAP_MM, start=(0.0, y), end=(0.0, stub.low[1]), side="right"),
        ),
    )
