"""The drawing of a holder."""

from __future__ import annotations

import numpy as np

from housing.drawings.shared import BELOW_MM, accepted_mm, block_boxes
from housing.holder import Holder
from tacbench_cad.render.drawing.blocks import BLOCK_ACCEPTED_MM
from tacbench_cad.render.drawing.cuts import Cuts
from tacbench_cad.render.drawing.sheet import Callout, Circle, Dimension, Drawing, Point, Side, View, length, sides

#: The smallest radius of the detail, and how far the detail extends beyond the rim, in mm.
_DETAIL_MM, _BEYOND_MM = 3.0, 1.5
#: The sides of the plan that show the pitch of the pockets along x and y.
_OPPOSITE: tuple[Side, Side] = ("bottom", "right")


def holder_drawing(holder: Holder) -> Drawing:
    """Draw a holder: the plan, a section through the first pocket, and a detail of a block in its pocket.

    Raises:
        MissingToolError: The CAD kernel is not installed.
    """
    cuts = Cuts(holder.part().mesh[0])
    top, floor, first = holder.size_mm[2], holder.layout.floor_mm, holder.pockets[0]
    section_y = holder.push_outs[0].at_mm[1] if holder.push_outs else (first.low[1] + first.high[1]) / 2.0
    radius = max(_DETAIL_MM, _BEYOND_MM + max(holder.rim_height_mm, *holder.clearance_mm))
    circle = Circle((first.low[0], top), radius)
    row = [pocket for pocket in holder.pockets if pocket.low[1] < section_y < pocket.high[1]]
    holes = [bore.at_mm[0] for bore in holder.push_outs if abs(bore.at_mm[1] - section_y) < bore.diameter_mm / 2.0]
    section = cuts.front(section_y)
    section["other"] = block_boxes(holder, section_y)
    front = [
        Dimension("plate height", (0.0, 0.0), (0.0, top), "left"),
        Dimension("floor", (first.low[0], 0.0), (first.low[0], floor), "left"),
        Dimension("pocket depth", (row[-1].high[0], floor), (row[-1].high[0], top), "right", BLOCK_ACCEPTED_MM),
    ]
    axes = [np.array([(x, -1.5), (x, floor + 1.5)]) for x in holes]
    return Drawing(
        report=str(holder),
        facts=("plate", "pocket", "clearance", "orientations", "thinnest wall"),
        plan=_plan(holder, cuts, section_y),
        front=View({**section, "axis": axes}, front, circle=circle),
        side=View(section, *_detail(holder, circle), within=circle),
        notes=[
            "Thin chain line: the block, up to its highest point. Rim: the height from the holder's top to that point.",
            "Print as drawn, with the pockets up, without supports.",
        ],
    )


def _plan(holder: Holder, cuts: Cuts, section_y: float) -> View:
    (x, y, top), floor, bores, first = holder.size_mm, holder.layout.floor_mm, holder.push_outs, holder.pockets[0]
    seen = [*cuts.level(top - BELOW_MM)]
    edges = ((0.0, y / 2.0), (x / 2.0, 0.0))
    pocket = sides("pocket", first.low, first.high, ("top", "left"), *accepted_mm(holder.clearance_mm))
    dimensions = [
        *sides("plate", (0.0, 0.0), (x, y), ("top", "left")),
        *pocket,
        Dimension("pocket from edge x", edges[0], pocket[0].start, "top"),
        Dimension("pocket from edge y", edges[1], pocket[1].start, "left"),
    ]
    for axis, side in enumerate(_OPPOSITE):
        row = [plan for plan in holder.pockets if plan.low[1 - axis] == first.low[1 - axis]]
        if len(row) > 1:
            beside = sides("pocket", row[1].low, row[1].high, _OPPOSITE)
            dimensions.append(Dimension(f"pocket pitch {'xy'[axis]}", pocket[axis].start, beside[axis].start, side))
    a, b, c, d = (bore.at_mm for bore in holder.screws)
    rows: list[tuple[int, Side, Point, Point]] = [(0, "top", c, d), (1, "left", a, c)]
    # The other row and the other column get dimensions only if they differ.
    rows += [(0, "bottom", a, b)] if (a[0], b[0]) != (c[0], d[0]) else []
    rows += [(1, "right", b, d)] if (a[1], c[1]) != (b[1], d[1]) else []
    for axis, side, start, end in rows:
        dimensions.append(Dimension(f"screw from edge {'xy'[axis]}", edges[axis], start, side))
        dimensions.append(Dimension(f"screw to screw {'xy'[axis]}", start, end, side))
    last = holder.screws[-1]
    callouts = [Callout(f"{len(holder.screws)} x ⌀{length(last.diameter_mm)} through", last.at_mm, last.diameter_mm)]
    if bores:
        seen += [loop for loop in cuts.level(floor / 2.0) if np.ptp(loop[:, 0]) < holder.pocket_size_mm[0]]
        at, last = bores[0].at_mm, bores[-1]
        dimensions += [
            Dimension("push-out from pocket x", (first.low[0], at[1]), at, "bottom"),
            Dimension("push-out from pocket y", (at[0], first.low[1]), at, "right"),
        ]
        number = f"{len(bores)} x " if len(bores) > 1 else ""
        callouts.append(Callout(f"{number}⌀{length(last.diameter_mm)} push-out", last.at_mm, last.diameter_mm))
    if holder.pocket_key_mm:
        outline = holder.pocket_outline()
        corner = holder.block_placements()[-1].to_holder([(outline[1] + outline[2]) / 2.0])[0]
        callouts.append(Callout(f"corner filled,\nleg {length(holder.pocket_key_mm)}", (corner[0], corner[1])))
    return View({"seen": seen}, dimensions, callouts, cuts=(section_y, None))


def _detail(holder: Holder, circle: Circle) -> tuple[list[Dimension], list[Callout], list[tuple[Point, str]]]:
    """Return the dimensions of clearance and rim, no callouts, and the labels of the parts."""
    (wall, top), r = circle.centre, circle.radius
    block, rim = wall + holder.clearance_mm[0], top + holder.rim_height_mm
    # The height of this dimension is between floor and rim, and inside the circle.
    z = top - min(r, holder.pocket_size_mm[2]) / 2.0
    dimensions = [
        Dimension("clearance", (wall, z), (block, z), "bottom", form="clearance {}"),
        Dimension("rim", (wall, top), (block, rim), "right", form="rim {}"),
    ]
    labels = [((wall - r * 0.45, top - r * 0.4), "holder"), ((block + r * 0.42, top - r * 0.4), "block")]
    return [dimension for dimension in dimensions if dimension.value_mm > 1e-6], [], labels
