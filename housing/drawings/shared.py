"""What the drawings of the fixtures have in common."""

from __future__ import annotations

from housing.holder import Holder
from housing.shapes import Rectangle
from tacbench_cad.render.drawing.blocks import BLOCK_ACCEPTS_MM
from tacbench_cad.render.drawing.sheet import Dimension, End, Point, Side
from tacbench_cad.util.text import decimal, mm
from tacbench_cad.util.types import Floats

#: A cut this far below a face shows what opens into it, in mm.
BELOW_MM = 0.01
#: What a caliper tells apart, in mm: no accepted deviation is smaller.
CALIPER_MM = 0.02
#: Paper mm that the radius of a detail takes at most.
_DETAIL_MM = 31.0
_DETAIL_SCALES = (10.0, 5.0, 4.0, 3.0, 2.5, 2.0, 1.5, 1.0, 0.5, 0.2, 0.1)


def accepts_mm(clearance_mm: float) -> float:
    """Deviation that is accepted of what fits with a clearance per side, in mm.

    Two thirds of the clearance, at most that of a block: where both parts are off by all of it towards each other,
    at least a third of the clearance is left.
    """
    return round(max(min(BLOCK_ACCEPTS_MM, clearance_mm * 2.0 / 3.0), CALIPER_MM), 2)


def detail_scale(radius_mm: float) -> float:
    """Scale of a detail of a radius."""
    return next((one for one in _DETAIL_SCALES if one * radius_mm <= _DETAIL_MM), _DETAIL_SCALES[-1])


def rectangle(low: Point, high: Point) -> Floats:
    """A rectangle's outline."""
    return Rectangle(low=low, high=high).corners


def block_boxes(holder: Holder, y_mm: float) -> tuple[Floats, ...]:
    """The boxes of the blocks that a section at a y passes, seen from the front: the highest point is their top."""
    floor, top = holder.layout.floor_mm, holder.layout.floor_mm + holder.block.height_mm
    (cx, cy), found = holder.clearance_mm, []
    for pocket in holder.pockets:
        if pocket.low[1] < y_mm < pocket.high[1]:
            plan = pocket.grown(-cx, -cy)
            found.append(rectangle((plan.low[0], floor), (plan.high[0], top)))
    return tuple(found)


def along(
    name: str,
    value_mm: float,
    start: Point,
    end: Point,
    sides: tuple[Side, Side],
    *,
    ends: tuple[End, End] = ("edge", "edge"),
    form: str = "{}",
    accept_mm: float | None = None,
) -> Dimension:
    """A length along x or y of the sheet, whichever the two points are apart along.

    Args:
        name: What it is.
        value_mm: The length.
        start: One end.
        end: The other end.
        sides: Where its line lies: along x, along y.
        ends: What the ends lie on.
        form: Text with ``{}`` for the number.
        accept_mm: Deviation of a print that is accepted; None for the general one.
    """
    across = abs(end[0] - start[0]) >= abs(end[1] - start[1])
    return Dimension(
        name=name,
        value_mm=value_mm,
        start=start,
        end=end,
        side=sides[0 if across else 1],
        ends=ends,
        form=form,
        accept_mm=accept_mm,
    )


def made_for(holder: Holder) -> str:
    """What a holder is for, for the title strip."""
    block = holder.block
    key = "no key" if block.key_mm is None else f"key {block.key_mm:g}"
    return f"{mm(*block.size_mm, block.height_mm)}, {key}; {block.preset}, scale {decimal(block.scale)}"


def fit_of(holder: Holder) -> str:
    """Its fit, for the title strip."""
    x, y = holder.clearance_mm
    clearance = f"{x:.4g}" if abs(x - y) < 1e-9 else f"{x:.4g} (x), {y:.4g} (y)"
    name = "" if holder.is_released or not isinstance(holder.fit, str) else f"{holder.fit}, "
    return f"{name}{clearance} mm clearance per side"
