"""The drawing of a holder."""

from __future__ import annotations

import numpy as np

from housing.drawings.shared import (
    BELOW_MM,
    accepts_mm,
    block_boxes,
    detail_scale,
    fit_of,
    made_for,
)
from housing.holder import Holder
from housing.shapes import Rectangle
from tacbench_cad.render.drawing.blocks import ACCEPTS_MM, BLOCK_ACCEPTS_MM
from tacbench_cad.render.drawing.cuts import Cuts
from tacbench_cad.render.drawing.sheet import Callout, Circle, CutMark, Dimension, Drawing, Point, Side, View, length
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import mm

#: Least radius of the detail, in mm, and what it shows beyond the rim.
_DETAIL_MM, _BEYOND_MM = 3.0, 1.5


def holder_drawing(holder: Holder) -> Drawing:
    """Draw a holder: the plan, a section through its first pocket, and how a block stands in it.

    Args:
        holder: The holder.

    Raises:
        MissingToolError: The CAD kernel is not there.
    """
    cuts = Cuts(holder.part().mesh[0])
    y = holder.push_outs[0].at_mm[1] if holder.push_outs else sum(_first(holder, 1)) / 2.0
    circle = _circle(holder)
    front = _front(holder, cuts, y, circle)
    return Drawing(
        name=holder.name,
        title=f"{_what(holder)}, {mm(*holder.size_mm)}",
        facts=(
            ("for blocks", made_for(holder)),
            ("fit", fit_of(holder)),
            ("slots", str(holder.slots)),
            ("a block goes in", " or ".join(f"{one}°" for one in holder.admits_deg)),
        ),
        accepts_mm=ACCEPTS_MM,
        plan=_plan(holder, cuts, y),
        front=front,
        side=_detail(holder, front, circle),
        detail_scale=detail_scale(circle.radius),
        notes=[
            "Thin chain line: the block, up to its highest point. The rim is how far the holder's top lies below it.",
            "Print as drawn, pockets upward. No supports.",
        ],
    )


def _what(holder: Holder) -> str:
    if holder.is_released:
        return "The authors' holder"
    return "Holder" if holder.slots == 1 else f"Tray for {holder.slots} blocks"


def _first(holder: Holder, axis: int) -> tuple[float, float]:
    """Ends of the first pocket along an axis."""
    pocket = holder.pockets[0]
    return pocket.low[axis], pocket.high[axis]


def _circle(holder: Holder) -> Circle:
    radius = max(_DETAIL_MM, holder.rim_height_mm + _BEYOND_MM, max(holder.clearance_mm) + _BEYOND_MM)
    return Circle(letter="C", centre=(_first(holder, 0)[0], holder.size_mm[2]), radius=radius)


def _plan(holder: Holder, cuts: Cuts, y_mm: float) -> View:
    top, floor = holder.size_mm[2], holder.layout.floor_mm
    bores = holder.push_outs
    bottom = (
        tuple(one for one in cuts.level(floor / 2.0) if np.ptp(one[:, 0]) < holder.pocket_size_mm[0]) if bores else ()
    )
    callouts = [_screws(holder)]
    if bores:
        number = f"{len(bores)} x " if len(bores) > 1 else ""
        last = bores[-1]
        callouts.append(
            Callout(
                name="push-out hole",
                text=f"{number}⌀{length(last.diameter_mm)} push-out",
                at=last.at_mm,
                diameter_mm=last.diameter_mm,
            )
        )
    if holder.pocket_key_mm:
        callouts.append(_key(holder))
    return View(
        seen=(*cuts.level(top - BELOW_MM), *bottom),
        dimensions=(*_plate(holder), *_pockets(holder), *_screw_dimensions(holder), *_push_out_dimensions(holder)),
        callouts=tuple(callouts),
        cut_marks=(CutMark(letter="A", at=y_mm, across=True),),
    )


def _screws(holder: Holder) -> Callout:
    last = holder.screws[-1]
    text = f"{len(holder.screws)} x ⌀{length(last.diameter_mm)} through"
    return Callout(name="screw holes", text=text, at=last.at_mm, diameter_mm=last.diameter_mm)


def _key(holder: Holder) -> Callout:
    """The filled corner of the last pocket."""
    place, outline = holder.block_placements()[-1], holder.pocket_outline()
    x, y = place.to_holder([(outline[1] + outline[2]) / 2.0])[0]
    text = f"corner filled,\nleg {length(holder.pocket_key_mm)}"
    return Callout(name="filled corner", text=text, at=(float(x), float(y)))


def _plate(holder: Holder) -> list[Dimension]:
    x, y, _ = holder.size_mm
    return [
        Dimension(name="plate x", value_mm=x, start=(0.0, y), end=(x, y), side="top"),
        Dimension(name="plate y", value_mm=y, start=(0.0, 0.0), end=(0.0, y), side="left"),
    ]


def _at(axis: int, value: float, other: float) -> Point:
    return (value, other) if axis == 0 else (other, value)


def _pockets(holder: Holder) -> list[Dimension]:
    found: list[Dimension] = []
    first = holder.pockets[0]
    middle = ((first.low[1] + first.high[1]) / 2.0, (first.low[0] + first.high[0]) / 2.0)
    sides: tuple[tuple[Side, Side], tuple[Side, Side]] = (("top", "bottom"), ("left", "right"))
    for axis, (side, opposite) in enumerate(sides):
        letter, (low, high) = "xy"[axis], _first(holder, axis)
        start, end = _at(axis, low, middle[axis]), _at(axis, high, middle[axis])
        accept = accepts_mm(holder.clearance_mm[axis])
        size = holder.pocket_size_mm[axis]
        found.append(
            Dimension(name=f"pocket {letter}", value_mm=size, start=start, end=end, side=side, accept_mm=accept)
        )
        edge = _at(axis, 0.0, middle[axis])
        found.append(Dimension(name=f"pocket from edge {letter}", value_mm=low, start=edge, end=start, side=side))
        others = [one for one in holder.pockets if one.low[1 - axis] == first.low[1 - axis]]
        if len(others) > 1:
            found.append(_pitch(holder, others, axis, opposite))
    return found


def _pitch(holder: Holder, row: list[Rectangle], axis: int, side: Side) -> Dimension:
    """From the first pocket's low edge to the next one's."""
    a, b = row[0], row[1]
    middle = (a.low[1 - axis] + a.high[1 - axis]) / 2.0
    return Dimension(
        name=f"pocket pitch {'xy'[axis]}",
        value_mm=holder.pocket_size_mm[axis] + holder.web_mm,
        start=_at(axis, a.low[axis], middle),
        end=_at(axis, b.low[axis], middle),
        side=side,
    )


def _screw_dimensions(holder: Holder) -> list[Dimension]:
    """From the plate's edges to the first hole of a row, and from hole to hole; a row equal to the other only once."""
    points = [bore.at_mm for bore in holder.screws]
    rows: list[tuple[int, Side, Point, Point]] = [
        (0, "top", points[2], points[3]),
        (0, "bottom", points[0], points[1]),
        (1, "left", points[0], points[2]),
        (1, "right", points[1], points[3]),
    ]
    found: list[Dimension] = []
    shown: set[tuple[int, float, float]] = set()
    for axis, side, a, b in rows:
        if (axis, a[axis], b[axis]) in shown:
            continue
        shown.add((axis, a[axis], b[axis]))
        letter = "xy"[axis]
        inset = Dimension(
            name=f"screw from edge {letter}",
            value_mm=a[axis],
            start=_at(axis, 0.0, holder.size_mm[1 - axis] / 2.0),
            end=a,
            side=side,
            ends=("edge", "axis"),
        )
        apart = Dimension(
            name=f"screw to screw {letter}",
            value_mm=b[axis] - a[axis],
            start=a,
            end=b,
            side=side,
            ends=("axis", "axis"),
        )
        found += [inset, apart]
    return found


def _push_out_dimensions(holder: Holder) -> list[Dimension]:
    if not holder.push_outs:
        return []
    (x, y), first = holder.push_outs[0].at_mm, holder.pockets[0]
    return [
        Dimension(
            name="push-out from pocket x",
            value_mm=x - first.low[0],
            start=(first.low[0], y),
            end=(x, y),
            side="bottom",
            ends=("edge", "axis"),
        ),
        Dimension(
            name="push-out from pocket y",
            value_mm=y - first.low[1],
            start=(x, first.low[1]),
            end=(x, y),
            side="right",
            ends=("edge", "axis"),
        ),
    ]


def _front(holder: Holder, cuts: Cuts, y_mm: float, circle: Circle) -> View:
    top, floor, depth = holder.size_mm[2], holder.layout.floor_mm, holder.pocket_size_mm[2]
    blocks = block_boxes(holder, y_mm)
    if not blocks:
        raise InputError("section", y_mm, "passes no pocket")
    low, high = float(blocks[0][0, 0]), max(one.high[0] for one in holder.pockets if one.low[1] < y_mm < one.high[1])
    wall = low - holder.clearance_mm[0]
    dimensions = [
        Dimension(name="plate height", value_mm=top, start=(0.0, 0.0), end=(0.0, top), side="left"),
        Dimension(name="floor", value_mm=floor, start=(wall, 0.0), end=(wall, floor), side="left"),
        Dimension(
            name="pocket depth",
            value_mm=depth,
            start=(high, floor),
            end=(high, top),
            side="right",
            accept_mm=BLOCK_ACCEPTS_MM,
        ),
    ]
    axes = [
        (bore.at_mm[0], 0.0, floor) for bore in holder.push_outs if abs(bore.at_mm[1] - y_mm) < bore.diameter_mm / 2.0
    ]
    return View(
        caption="A–A",
        cut=cuts.from_front(y_mm),
        seen=cuts.beyond_front(y_mm),
        other=blocks,
        axes=tuple(((a, low_z - 1.5), (a, high_z + 1.5)) for a, low_z, high_z in axes),
        dimensions=tuple(dimensions),
        circles=(circle,),
    )


def _detail(holder: Holder, front: View, circle: Circle) -> View:
    """How a block stands in its pocket: clearance and rim."""
    wall, top = circle.centre
    clearance, rim = holder.clearance_mm[0], holder.rim_height_mm
    block = wall + clearance
    # Between floor and rim, and inside of the circle.
    z = top - min(circle.radius, holder.pocket_size_mm[2]) / 2.0
    dimensions = []
    if clearance > 1e-6:
        dimensions.append(
            Dimension(
                name="clearance",
                value_mm=clearance,
                start=(wall, z),
                end=(block, z),
                side="bottom",
                ends=("edge", "other"),
                form="clearance {}",
            )
        )
    if rim > 1e-6:
        dimensions.append(
            Dimension(
                name="rim",
                value_mm=rim,
                start=(wall, top),
                end=(block, top + rim),
                side="right",
                ends=("edge", "other"),
                form="rim {}",
            )
        )
    return View(
        caption=f"C ({length(detail_scale(circle.radius))}:1)",
        cut=front.cut,
        seen=front.seen,
        other=front.other,
        dimensions=tuple(dimensions),
        labels=(
            ((wall - circle.radius * 0.45, top - circle.radius * 0.4), "holder"),
            ((block + circle.radius * 0.42, top - circle.radius * 0.4), "block"),
        ),
        circle=circle,
    )
