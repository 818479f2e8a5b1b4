"""Where dimension lines lie so that none meets another, and at which scale it all goes onto the sheet. In paper mm."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from tacbench_cad.render.drawing.sheet import Callout, Dimension, Drawing, Side, View

#: Width of a text in mm.
Width = Callable[[str], float]

#: The sheet, A4 across, its margin and the height of the title strip, in mm.
SHEET_MM, MARGIN_MM, STRIP_MM = (297.0, 210.0), 5.0, 24.5
#: Scales that are tried, the largest first.
SCALES = (10.0, 5.0, 4.0, 3.0, 2.5, 2.0, 1.5, 1.0, 0.75, 0.5, 0.4, 0.25, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002)
#: From the view to the first dimension line, and from line to line.
FIRST_MM, PITCH_MM = 7.2, 6.2
#: What a section's letter takes beside the view; on the sides where texts lie between view and line, they lie beyond.
LETTER_MM = 6.5
#: How far a line goes on beyond its ends where its arrows stand outside, and below which span they do.
TAIL_MM, NARROW_MM = 4.5, 7.5
#: Height of a line of text, of a callout's and a caption's.
LINE_MM, CAPTION_MM = 4.3, 7.0
#: Between the columns, and least width of the notes.
GAP_MM, NOTES_MM = 7.0, 84.0


@dataclass(frozen=True)
class Placed:
    """A dimension line where it stands, in mm on the paper.

    Args:
        dimension: What it says.
        level: How far out it stands, from 0.
        inside: Whether its arrows stand inside.
        text_at: Middle of its text along the line.
        low: Where it begins.
        high: Where it ends.
        width: Width of its text.
    """

    dimension: Dimension
    level: int
    inside: bool
    text_at: float
    low: float
    high: float
    width: float

    @property
    def text(self) -> tuple[float, float]:
        """Where its text begins and ends."""
        return self.text_at - self.width / 2.0, self.text_at + self.width / 2.0

    @property
    def covers(self) -> tuple[float, float]:
        """What it takes up on its level."""
        tail = 0.0 if self.inside else TAIL_MM
        return min(self.low - tail, self.text[0] - 0.6), max(self.high + tail, self.text[1] + 0.6)


def stacked(dimensions: Sequence[Dimension], scale: float, width: Width) -> list[Placed]:
    """Lay the lines of one side of a view in levels, the shorter ones nearer to it."""
    ordered = sorted(dimensions, key=lambda one: abs(one.end[one.axis] - one.start[one.axis]))
    best: tuple[tuple[int, int], list[Placed]] | None = None
    orders = itertools.permutations(ordered) if len(ordered) <= 5 else [tuple(ordered)]
    for order in orders:
        placed: list[Placed] = []
        for one in order:
            placed.append(_place(one, placed, scale, width))
        cost = (_crossings(placed), sum(one.level for one in placed))
        if best is None or cost < best[0]:
            best = (cost, placed)
    return best[1] if best else []


def _place(one: Dimension, others: list[Placed], scale: float, width: Width) -> Placed:
    loose: Placed | None = None
    for level in range(len(others) + 1):
        for option in _options(one, level, scale, width(one.text)):
            if any(_overlap(option.covers, other.covers) for other in others if other.level == level):
                continue
            loose = loose or option
            if not any(_crosses(option, other) for other in others):
                return option
    assert loose is not None, "a level of its own is always free"
    return loose


def _options(one: Dimension, level: int, scale: float, width: float) -> Iterator[Placed]:
    low, high = sorted((one.start[one.axis] * scale, one.end[one.axis] * scale))
    span = high - low
    inside = span >= NARROW_MM
    if width <= span - 1.0 and (inside or width <= span):
        yield Placed(one, level, inside, (low + high) / 2.0, low, high, width)
    for at in (high + 1.2 + width / 2.0, low - 1.2 - width / 2.0):
        yield Placed(one, level, False, at, low, high, width)


def _overlap(a: tuple[float, float], b: tuple[float, float]) -> bool:
    return a[0] < b[1] - 0.05 and b[0] < a[1] - 0.05


def _crosses(a: Placed, b: Placed) -> bool:
    """Whether an extension line of the outer one runs through the text of the inner one."""
    if a.level == b.level:
        return False
    outer, inner = (a, b) if a.level > b.level else (b, a)
    return any(inner.text[0] - 0.4 < end < inner.text[1] + 0.4 for end in (outer.low, outer.high))


def _crossings(placed: Sequence[Placed]) -> int:
    return sum(_crosses(a, b) for a, b in itertools.combinations(placed, 2))


@dataclass(frozen=True)
class Framed:
    """A view at a scale with its lines laid out.

    Args:
        view: The view.
        scale: Millimetres on the paper for one of the part.
        sides: The dimension lines of each side.
        room: What it takes beyond its box on each side, in mm.
        column_mm: From its box to the callouts' texts.
    """

    view: View
    scale: float
    sides: dict[Side, list[Placed]]
    room: dict[Side, float]
    column_mm: float

    @property
    def size(self) -> tuple[float, float]:
        """Sides of its box."""
        (a0, b0), (a1, b1) = self.view.box
        return (a1 - a0) * self.scale, (b1 - b0) * self.scale

    def first_mm(self, side: Side) -> float:
        """From its box to the first dimension line of a side."""
        return first_mm(self.view, side)

    def callout_heights(self) -> list[tuple[Callout, float]]:
        """Callouts with the middle of each one's text above the box's lower edge, from the top one down."""
        ordered = sorted(self.view.callouts, key=lambda one: -one.at[1])
        if not ordered:
            return []
        heights = [LINE_MM * (one.text.count("\n") + 1) + 1.6 for one in ordered]
        wanted = [self._wanted(one) for one in ordered]
        tops, limit = [], float("inf")
        for height, at in zip(heights, wanted, strict=True):
            top = min(at + height / 2.0, limit)
            tops.append(top)
            limit = top - height
        # What has been pushed down is moved up by half of it, as a whole.
        shift = sum(at - (top - h / 2.0) for at, top, h in zip(wanted, tops, heights, strict=True)) / len(tops)
        middle = [top - h / 2.0 + max(shift, 0.0) for top, h in zip(tops, heights, strict=True)]
        return list(zip(ordered, middle, strict=True))

    def _wanted(self, one: Callout) -> float:
        """Height of a callout: level with its place, or as near as its line keeps off the letters of sections."""
        (a0, b0), _ = self.view.box
        x, y = (one.at[0] - a0) * self.scale, (one.at[1] - b0) * self.scale
        end = self.size[0] + self.column_mm
        cuts = [(mark.at - b0) * self.scale for mark in self.view.cut_marks if mark.across]
        for aside in (0.0, 7.0, -7.0, 11.0, -11.0, 16.0):

            def clear(cut: float, aside: float = aside) -> bool:
                shares = [(self.size[0] + out - x) / (end - x) for out in (0.5, LETTER_MM)]
                passes = [y + aside * share - cut for share in shares]
                along = abs(y - cut) < 1.5 and abs(aside) < 5.0
                return not along and (min(passes) > 4.2 or max(passes) < -5.2)

            if all(clear(cut) for cut in cuts):
                return y + aside
        return y + 7.0


def first_mm(view: View, side: Side) -> float:
    """From a view to the first dimension line of a side."""
    letters = any(mark.across == (side == "right") for mark in view.cut_marks) and side in ("right", "bottom")
    return FIRST_MM + (3.2 if letters else 0.0)


def framed(view: View, scale: float, width: Width) -> Framed:
    """Lay out one view."""
    names: tuple[Side, ...] = ("top", "bottom", "left", "right")
    sides = {side: stacked([one for one in view.dimensions if one.side == side], scale, width) for side in names}
    room: dict[Side, float] = {}
    for side in names:
        levels = 1 + max((one.level for one in sides[side]), default=-1)
        upright = side in ("left", "right")
        marks = LETTER_MM if any(mark.across == upright for mark in view.cut_marks) else 2.0
        room[side] = max(marks, first_mm(view, side) + PITCH_MM * (levels - 1) + 4.2 if levels else 0.0)
    (a0, b0), (a1, b1) = view.box
    for low_side, high_side, axis, low, high in (("left", "right", 0, a0, a1), ("bottom", "top", 1, b0, b1)):
        for one in (one for side in names for one in sides[side] if one.dimension.axis == axis):
            room[low_side] = max(room[low_side], low * scale - one.covers[0] + 1.0)  # type: ignore[index]
            room[high_side] = max(room[high_side], one.covers[1] - high * scale + 1.0)  # type: ignore[index]
    column = room["right"] + 5.0
    if view.callouts:
        room["right"] = column + max(width(line) for one in view.callouts for line in one.text.split("\n")) + 3.0
    room["bottom"] += CAPTION_MM if view.caption else 0.0
    return Framed(view, scale, sides, room, column)


@dataclass(frozen=True)
class Arranged:
    """A sheet.

    Args:
        scale: Millimetres on the paper for one of the part.
        views: Each view with the paper point of its box's lower left corner, in mm.
        notes_at: The notes' upper left corner, in mm.
        notes_width: Their width, in mm.
    """

    scale: float
    views: tuple[tuple[Framed, tuple[float, float]], ...]
    notes_at: tuple[float, float]
    notes_width: float


def arrange(drawing: Drawing, width: Width) -> Arranged:
    """Find the largest scale at which everything has its place."""
    for scale in SCALES:
        found = _arranged(drawing, scale, width)
        if found is not None:
            return found
    raise ValueError("the part is too large for a sheet")  # sides are limited to 2 m


def _arranged(drawing: Drawing, scale: float, width: Width) -> Arranged | None:
    plan, front = framed(drawing.plan, scale, width), framed(drawing.front, scale, width)
    side = framed(drawing.side, drawing.detail_scale or scale, width)
    left = max(plan.room["left"], front.room["left"])
    right = max(plan.room["right"], front.room["right"])
    across = max(plan.size[0], front.size[0])
    beside = side.room["left"] + side.size[0] + side.room["right"]
    column = max(beside, NOTES_MM)
    sheet_w, sheet_h = SHEET_MM[0] - 2.0 * MARGIN_MM - 4.0, SHEET_MM[1] - 2.0 * MARGIN_MM - STRIP_MM - 3.0
    if left + across + right + GAP_MM + column > sheet_w:
        return None
    top = max(plan.room["top"], side.room["top"])
    upper = max(plan.size[1] + plan.room["bottom"], side.size[1] + side.room["bottom"])
    down = top + plan.size[1] + plan.room["bottom"] + front.room["top"] + front.size[1] + front.room["bottom"]
    notes_mm = 42.0
    if down > sheet_h or top + upper + notes_mm > sheet_h:
        return None
    spare_x = sheet_w - (left + across + right + GAP_MM + column)
    spare_y = sheet_h - down
    x = MARGIN_MM + 2.0 + spare_x / 3.0 + left
    y = SHEET_MM[1] - MARGIN_MM - 1.5 - spare_y / 3.0 - top - plan.size[1]
    (pa, _), _ = drawing.plan.box
    (fa, _), _ = drawing.front.box
    low_a = min(pa, fa)
    low_plan = (x + (pa - low_a) * scale, y)
    gap = plan.room["bottom"] + front.room["top"] + spare_y / 3.0
    low_front = (x + (fa - low_a) * scale, y - gap - front.size[1])
    column_x = x + across + right + GAP_MM + spare_x / 3.0
    side_x = column_x + side.room["left"] + max(column - beside, 0.0) / 2.0
    (_, pb), _ = drawing.plan.box
    (_, sb), _ = drawing.side.box
    side_y = y + plan.size[1] - side.size[1] if drawing.detail_scale else y + (sb - pb) * scale
    notes_y = min(side_y - side.room["bottom"] - 4.0, low_front[1] + front.size[1] + 14.0)
    return Arranged(
        scale, ((plan, low_plan), (front, low_front), (side, (side_x, side_y))), (column_x, notes_y), column
    )
