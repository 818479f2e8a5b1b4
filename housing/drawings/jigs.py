"""The drawing of a jig, as it is used: in the holder frame, its marked face up."""

from __future__ import annotations

import numpy as np

from housing.drawings.shared import (
    BELOW_MM,
    accepts_mm,
    along,
    block_boxes,
    detail_scale,
    rectangle,
)
from housing.jig import Jig
from housing.marks import DATUM_MM, DEPTH_MM, HAIR_MM
from housing.seat import AIR_MM, LIP_MM, ROOF_MM
from tacbench_cad.render.drawing.blocks import ACCEPTS_MM
from tacbench_cad.render.drawing.cuts import Cuts
from tacbench_cad.render.drawing.sheet import Callout, Circle, CutMark, Dimension, Drawing, Point, Side, View, length
from tacbench_cad.util.text import mm
from tacbench_cad.util.types import Floats

#: Deviation that is accepted of the press grid's sides, in mm.
_GRID_ACCEPTS_MM = 0.05


def jig_drawing(jig: Jig) -> Drawing:
    """Draw a jig: the plan, a section through the first row of holes, and the markers of one block.

    Args:
        jig: The jig.

    Raises:
        MissingToolError: The CAD kernel is not there.
    """
    cuts = Cuts(jig.part().mesh[0].moved(jig.from_print))
    y = jig.bores[0].at_mm[1]
    circle = _circle(jig)
    plan = _plan(jig, cuts, y, circle)
    clearance = " x ".join(f"{one:.4g}" for one in jig.clearance_mm)
    grid = jig.grid
    return Drawing(
        name=jig.name,
        title=f"Grid-marker jig, {mm(*jig.size_mm)}",
        facts=(
            ("sits on", jig.holder.name),
            ("columns x", ", ".join(f"{x:g}" for x in grid.x_mm)),
            ("rows y", ", ".join(f"{y:g}" for y in grid.y_mm)),
            ("fit", f"{clearance} mm clearance per side on the holder"),
            ("marks", f"{len(jig.holes_mm)} holes, {len(jig.cross_hairs_mm)} cross hairs a block"),
        ),
        accepts_mm=ACCEPTS_MM,
        plan=plan,
        front=_front(jig, cuts, y),
        side=_detail(jig, plan, circle),
        detail_scale=detail_scale(circle.radius),
        notes=[
            "Drawn as it is used. Thin chain line: holder and blocks, up to their highest points. "
            f"The jig rests on the holder's rim, {length(AIR_MM)} mm above the blocks.",
            "X0 and Y0 mark the block's edges x = 0 and y = 0.",
            "Print upside down, marked face on the bed. No supports.",
        ],
    )


def _circle(jig: Jig) -> Circle:
    """Round the markers of the first block."""
    place, points = jig.holder.block_placements()[0], jig.grid.positions_mm
    (x, y), half = place.to_holder([points.mean(axis=0)])[0], np.ptp(points, axis=0) / 2.0
    radius = float(np.hypot(*half)) + jig.bores[0].widest_mm / 2.0 + 1.2
    return Circle(letter="C", centre=(float(x), float(y)), radius=radius)


def _plan(jig: Jig, cuts: Cuts, y_mm: float, circle: Circle) -> View:
    seat = jig.seat
    ceiling, top = seat.roof_mm
    bore = jig.bores[0]
    recesses = tuple(one for one in cuts.level(ceiling - BELOW_MM) if not _is_plan(one, jig))
    lips = cuts.level((seat.bottom_mm + seat.rest_mm) / 2.0)
    narrow = tuple(one for one in cuts.level(ceiling + BELOW_MM) if not _is_plan(one, jig)) if bore.lead_in_mm else ()
    upper = cuts.level(top - BELOW_MM)
    return View(
        seen=tuple(one for one in upper if _is_plan(one, jig)),
        fine=(*(one for one in upper if not _is_plan(one, jig)), *narrow),
        hidden=(*recesses, *lips),
        dimensions=(*_outer(jig), *_lips(jig), *_notch(jig), *_datum(jig)),
        cut_marks=(CutMark(letter="A", at=y_mm, across=True),),
        circles=(circle,),
    )


def _is_plan(loop: Floats, jig: Jig) -> bool:
    """Whether a loop is the jig's own outline."""
    return bool(np.ptp(loop[:, 0]) > jig.size_mm[0] - 1e-3)


def _middle(jig: Jig) -> Point:
    low, high = jig.seat.outer.low, jig.seat.outer.high
    return ((low[0] + high[0]) / 2.0, (low[1] + high[1]) / 2.0)


def _outer(jig: Jig) -> list[Dimension]:
    (x0, y0), (x1, y1), (x, y) = jig.seat.outer.low, jig.seat.outer.high, _middle(jig)
    width, depth = jig.seat.outer.size_mm
    return [
        Dimension(name="outer x", value_mm=width, start=(x0, y), end=(x1, y), side="top"),
        Dimension(name="outer y", value_mm=depth, start=(x, y0), end=(x, y1), side="left"),
    ]


def _lips(jig: Jig) -> list[Dimension]:
    (x0, y0), (x1, y1), (x, y) = jig.seat.inner.low, jig.seat.inner.high, _middle(jig)
    accept = [accepts_mm(one) for one in jig.clearance_mm]
    width, depth = jig.seat.inner.size_mm
    return [
        Dimension(name="between lips x", value_mm=width, start=(x0, y), end=(x1, y), side="top", accept_mm=accept[0]),
        Dimension(name="between lips y", value_mm=depth, start=(x, y0), end=(x, y1), side="left", accept_mm=accept[1]),
    ]


def _notch(jig: Jig) -> list[Dimension]:
    """The corner that is left out at low x, low y."""
    low, high = jig.seat.notches[0].low, jig.seat.notches[0].high
    x, y = _middle(jig)
    return [
        Dimension(
            name="screw corner x", value_mm=high[0] - low[0], start=(low[0], y), end=(high[0], low[1]), side="bottom"
        ),
        Dimension(
            name="screw corner y", value_mm=high[1] - low[1], start=(x, low[1]), end=(low[0], high[1]), side="left"
        ),
    ]


def _datum(jig: Jig) -> list[Dimension]:
    """From the lines that mark the first block's edges to its first hole."""
    place, (x, y) = jig.holder.block_placements()[0], jig.holder.block.size_mm
    end = x - 4.0
    points = place.to_holder([jig.holes_mm[0], (0.0, y - 1.0 + DATUM_MM / 2.0), (end - DATUM_MM / 2.0, 0.0)])
    hole, datum_x, datum_y = [(float(a), float(b)) for a, b in points]
    turned = place.quarter_turns % 2 == 1
    sides: tuple[Side, Side] = ("bottom", "right")
    found = []
    for i, (name, datum) in enumerate((("first hole from X0", datum_x), ("first hole from Y0", datum_y))):
        # Only one coordinate of the datum counts: the other is where its line happens to lie.
        axis = (i + turned) % 2
        found.append(
            Dimension(
                name=name,
                value_mm=float(jig.holes_mm[0][i]),
                start=datum,
                end=hole,
                side=sides[axis],
                ends=("axis", "axis"),
            )
        )
    return found


def _front(jig: Jig, cuts: Cuts, y_mm: float) -> View:
    seat, (ceiling, top) = jig.seat, jig.seat.roof_mm
    (x0, _), (x1, _) = seat.outer.low, seat.outer.high
    inner = seat.inner.high[0]
    last = max(one.high[0] for one in seat.recesses if one.low[1] < y_mm < one.high[1])
    holder = rectangle((0.0, 0.0), (jig.holder.size_mm[0], jig.holder.size_mm[2]))
    rest, bottom = seat.rest_mm, seat.bottom_mm
    dimensions = [
        Dimension(name="height", value_mm=jig.size_mm[2], start=(x0, bottom), end=(x0, top), side="left"),
        Dimension(name="lip depth", value_mm=seat.lip_depth_mm, start=(inner, bottom), end=(inner, rest), side="right"),
        Dimension(
            name="recess",
            value_mm=seat.recess_depth_mm,
            start=(last, rest),
            end=(last, ceiling),
            side="right",
            accept_mm=AIR_MM / 3.0,
        ),
        Dimension(name="roof", value_mm=ROOF_MM, start=(last, ceiling), end=(x1, top), side="right"),
        Dimension(name="lip", value_mm=LIP_MM, start=(inner, bottom), end=(x1, bottom), side="bottom"),
    ]
    axes = sorted({bore.at_mm[0] for bore in jig.bores if abs(bore.at_mm[1] - y_mm) < 1e-6})
    return View(
        caption="A–A",
        cut=cuts.from_front(y_mm),
        seen=cuts.beyond_front(y_mm),
        other=(holder, *block_boxes(jig.holder, y_mm)),
        axes=tuple(((x, ceiling - 0.8), (x, top + 1.2)) for x in axes),
        dimensions=tuple(dimensions),
    )


def _detail(jig: Jig, plan: View, circle: Circle) -> View:
    """The markers of one block."""
    place, bore = jig.holder.block_placements()[0], jig.bores[0]
    grid, (step_x, step_y) = jig.grid, jig.grid.spacing_mm
    low, right, up = (
        (float(a), float(b))
        for a, b in place.to_holder(
            [(grid.x_mm[0], grid.y_mm[0]), (grid.x_mm[-1], grid.y_mm[0]), (grid.x_mm[0], grid.y_mm[-1])]
        )
    )
    sides: tuple[Side, Side] = ("top", "left")
    spans = ((right, grid.x_mm, step_x, "columns"), (up, grid.y_mm, step_y, "rows"))
    dimensions = [
        along(
            name,
            places[-1] - places[0],
            low,
            end,
            sides,
            ends=("axis", "axis"),
            form=f"4 x {length(step)} = {{}}",
            accept_mm=_GRID_ACCEPTS_MM,
        )
        for end, places, step, name in spans
    ]
    corner = place.to_holder([jig.holes_mm[-1]])[0]
    lead_in = "" if bore.lead_in_mm is None else f",\nlead-in ⌀{length(bore.lead_in_mm)}"
    callouts = [
        Callout(
            name="holes",
            text=f"{len(jig.holes_mm)} x ⌀{length(bore.diameter_mm)}{lead_in}",
            at=(float(corner[0]), float(corner[1])),
            diameter_mm=bore.diameter_mm,
        )
    ]
    if len(jig.cross_hairs_mm):
        text = f"hairs {length(HAIR_MM)} wide,\n{length(DEPTH_MM)} deep"
        callouts.append(Callout(name="hairs", text=text, at=_on_hair(jig)))
    return View(
        caption=f"C ({length(detail_scale(circle.radius))}:1)",
        fine=plan.fine,
        dimensions=tuple(dimensions),
        callouts=tuple(callouts),
        circle=circle,
    )


def _on_hair(jig: Jig) -> Point:
    """A point on the tick beyond the last marker of the first row."""
    x, y = jig.grid.x_mm[-1], jig.grid.y_mm[0]
    reach = jig.bores[0].widest_mm / 2.0 + jig.nozzle_mm + 0.5
    a, b = jig.holder.block_placements()[0].to_holder([(x + reach, y)])[0]
    return (float(a), float(b))
