"""The drawing of a jig in its place of use: in the holder frame, with the marked face up."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from housing.drawings.shared import BELOW_MM, accepted_mm, block_boxes
from housing.jig import Jig
from housing.marks import DATUM_MM, DEPTH_MM, HAIR_MM
from housing.seat import AIR_MM
from housing.shapes import Rectangle
from tacbench_cad.render.drawing.cuts import Cuts
from tacbench_cad.render.drawing.sheet import Callout, Circle, Dimension, Drawing, Point, Side, View, length, sides
from tacbench_cad.util.types import Floats

#: The accepted deviation of the sides of the press grid, in mm.
_GRID_ACCEPTED_MM = 0.05


def jig_drawing(jig: Jig) -> Drawing:
    """Draw a jig: the plan, a section through the first row of holes, and the markers of one block.

    Raises:
        MissingToolError: The CAD kernel is not installed.
    """
    cuts = Cuts(jig.part().mesh[0].transformed(jig.from_print))
    seat, grid, section_y = jig.seat, jig.grid, jig.bores[0].at_mm[1]
    ceiling, top = seat.roof_mm
    upper, lower, narrow = (cuts.level(z) for z in (top - BELOW_MM, ceiling - BELOW_MM, ceiling + BELOW_MM))
    markers = [loop for loop in (*upper, *narrow) if not _is_outline(loop, jig)]
    lips = cuts.level((seat.bottom_mm + seat.rest_mm) / 2.0)
    x, y = np.mean(_in_holder(jig, grid.positions_mm), axis=0)
    radius = float(np.hypot(*np.ptp(grid.positions_mm, axis=0))) / 2.0 + jig.bores[0].widest_mm / 2.0 + 1.2
    circle = Circle((float(x), float(y)), radius)
    (x0, y0), (x1, y1) = seat.notches[0].low, seat.notches[0].high
    dimensions = [
        *sides("outer", seat.outer.low, seat.outer.high, ("top", "left")),
        *sides("between lips", seat.inner.low, seat.inner.high, ("top", "left"), *accepted_mm(jig.clearance_mm)),
        Dimension("screw corner x", (x0, y1), (x1, y0), "bottom"),
        Dimension("screw corner y", (x1, y0), (x0, y1), "left"),
        *_datum(jig),
    ]
    outlines = {
        "seen": [loop for loop in upper if _is_outline(loop, jig)],
        "fine": markers,
        "hidden": [*(loop for loop in lower if not _is_outline(loop, jig)), *lips],
    }
    return Drawing(
        report=str(jig),
        facts=("size", "columns x", "rows y", "clearance", "cross hairs"),
        plan=View(outlines, dimensions, cuts=(section_y, None), circle=circle),
        front=_front(jig, cuts, section_y),
        side=View({"fine": markers}, *_detail(jig), within=circle),
        notes=[
            "Drawn in its place of use. Thin chain line: holder and blocks, up to their highest points. "
            f"The jig rests on the holder's rim, {length(AIR_MM)} mm above the blocks.",
            "X0 and Y0 mark the block's edges x = 0 and y = 0.",
            "Print upside down, with the marked face on the bed, without supports.",
        ],
    )


def _is_outline(loop: Floats, jig: Jig) -> bool:
    """Return whether a loop is the outline of the jig."""
    return bool(np.ptp(loop[:, 0]) > jig.size_mm[0] - 1e-3)


def _in_holder(jig: Jig, points_mm: ArrayLike) -> list[Point]:
    """Convert points from the frame of the first block to the holder frame."""
    return [(float(x), float(y)) for x, y in jig.holder.block_placements()[0].to_holder(points_mm)]


def _datum(jig: Jig) -> list[Dimension]:
    """Return the dimensions from the first block's datum lines to its first hole."""
    x, y = jig.holder.block.size_mm
    # Only one coordinate of each datum line is used. The other is the middle of the line.
    lines = ((0.0, y - 1.0 + DATUM_MM / 2.0), (x - 4.0 - DATUM_MM / 2.0, 0.0))
    line_x, line_y, hole = _in_holder(jig, np.array([*lines, jig.holes_mm[0]]))
    at: tuple[Side, Side] = ("right", "bottom") if jig.holder.turns % 2 else ("bottom", "right")
    return [Dimension("first hole from X0", line_x, hole, at[0]), Dimension("first hole from Y0", line_y, hole, at[1])]


def _front(jig: Jig, cuts: Cuts, section_y: float) -> View:
    seat, (ceiling, top), holder = jig.seat, jig.seat.roof_mm, jig.holder
    inner, outer, rest, bottom = seat.inner.high[0], seat.outer.high[0], seat.rest_mm, seat.bottom_mm
    last = max(recess.high[0] for recess in seat.recesses if recess.low[1] < section_y < recess.high[1])
    holes = {bore.at_mm[0] for bore in jig.bores if abs(bore.at_mm[1] - section_y) < 1e-6}
    plate = Rectangle(low=(0.0, 0.0), high=holder.size_mm[::2]).corners
    outlines = cuts.front(section_y)
    outlines["other"] = [plate, *block_boxes(holder, section_y)]
    outlines["axis"] = [np.array([(x, ceiling - 0.8), (x, top + 1.2)]) for x in sorted(holes)]
    dimensions = [
        Dimension("height", (seat.outer.low[0], bottom), (seat.outer.low[0], top), "left"),
        Dimension("lip depth", (inner, bottom), (inner, rest), "right"),
        Dimension("recess", (last, rest), (last, ceiling), "right", AIR_MM / 3.0),
        Dimension("roof", (last, ceiling), (outer, top), "right"),
        Dimension("lip", (inner, bottom), (outer, bottom), "bottom"),
    ]
    return View(outlines, dimensions)


def _detail(jig: Jig) -> tuple[list[Dimension], list[Callout]]:
    """Return the dimensions and callouts of the markers of one block."""
    bore, grid, spans = jig.bores[0], jig.grid, ("columns", "rows")
    (x0, x1), (y0, y1) = ((places[0], places[-1]) for places in (grid.x_mm, grid.y_mm))
    # This point is on the tick beyond the last marker of the first row.
    tick = (x1 + bore.widest_mm / 2.0 + jig.nozzle_mm + 0.5, y0)
    low, right, up, hair, hole = _in_holder(jig, np.array([(x0, y0), (x1, y0), (x0, y1), tick, jig.holes_mm[-1]]))
    dimensions = []
    for name, end, pitch in zip(spans, (right, up), grid.spacing_mm, strict=True):
        side: Side = "top" if abs(end[0] - low[0]) > abs(end[1] - low[1]) else "left"
        dimensions.append(Dimension(name, low, end, side, _GRID_ACCEPTED_MM, f"4 x {length(pitch)} = {{}}"))
    lead_in = "" if bore.lead_in_mm is None else f",\nlead-in ⌀{length(bore.lead_in_mm)}"
    callouts = [Callout(f"{len(jig.holes_mm)} x ⌀{length(bore.diameter_mm)}{lead_in}", hole, bore.diameter_mm)]
    if len(jig.cross_hairs_mm):
        callouts.append(Callout(f"hairs {length(HAIR_MM)} wide,\n{length(DEPTH_MM)} deep", hair))
    return dimensions, callouts
