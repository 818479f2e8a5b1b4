"""Where dimension lines lie so that none meets another, and at which scale it all goes onto the sheet. In paper mm."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from tacbench_cad.render.drawing.sheet import Callout, Dimension, Drawing, Side, View
from tacbench_cad.util.plotting import text_width_mm
from tacbench_cad.util.types import Floats

#: The sheet, A4 across, its margin and the height of the title strip, in mm.
SHEET_MM, MARGIN_MM, STRIP_MM = (297.0, 210.0), 5.0, 24.5
#: Scales that are tried, the largest first.
SCALES = (10.0, 5.0, 4.0, 3.0, 2.5, 2.0, 1.5, 1.0, 0.75, 0.5, 0.4, 0.25, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002)
SIDES: tuple[Side, ...] = ("left", "right", "bottom", "top")
#: Size of dimensions, callouts and labels, in points, and height of a line of them.
TEXT_PT, LINE_MM = 9.0, 4.3
#: How far a line goes on beyond its ends where its arrows stand outside, and below which span they do.
TAIL_MM, NARROW_MM = 4.5, 7.5
#: From the view to the first dimension line, from line to line, and from the last line to its text's far edge.
_FIRST_MM, _PITCH_MM, _TEXT_MM = 7.2, 6.2, 4.2
#: Length of a section's mark with its letter, and of a caption with what keeps it from the view.
_LETTER_MM, _CAPTION_MM = 6.5, 7.0
#: Between the columns; least width and height of the notes.
_GAP_MM, _NOTES_MM = 7.0, (84.0, 38.0)


@dataclass(frozen=True)
class Placed:
    """A dimension line with its place, in mm on the paper from the view's lower left corner.

    Args:
        dimension: The dimension.
        level: How far out it lies, from 0.
        low: Where it begins.
        high: Where it ends.
        text_at: Middle of its text along the line.
        inside: Whether its arrows lie between its ends.
    """

    dimension: Dimension
    level: int
    low: float
    high: float
    text_at: float
    inside: bool

    @cached_property
    def text(self) -> tuple[float, float]:
        """Where its text begins and ends."""
        half = text_width_mm(self.dimension.text, TEXT_PT) / 2.0 + 0.5
        return self.text_at - half, self.text_at + half

    @cached_property
    def line(self) -> tuple[float, float]:
        """Where what is drawn begins and ends: below a text beside it, the line goes on."""
        low, high = (self.low, self.high) if self.inside else (self.low - TAIL_MM, self.high + TAIL_MM)
        return min(low, self.text[0]), max(high, self.text[1])

    def overlaps(self, other: Placed) -> bool:
        """Whether two lines of one level meet."""
        return self.level == other.level and self.line[0] < other.line[1] and other.line[0] < self.line[1]

    def crosses(self, other: Placed) -> bool:
        """Whether an extension line of the outer one runs through the text of the inner one."""
        inner, outer = sorted((self, other), key=lambda line: line.level)
        return inner.level < outer.level and any(inner.text[0] < x < inner.text[1] for x in (outer.low, outer.high))


def _places(dimension: Dimension, level: int, origin: float, scale: float) -> Iterator[Placed]:
    """The places of a dimension on a level: its text between its ends if there is room, or beside them."""
    ends = dimension.start[dimension.axis], dimension.end[dimension.axis]
    low, high = ((end - origin) * scale for end in sorted(ends))
    width = text_width_mm(dimension.text, TEXT_PT)
    if width <= high - low - 1.0:
        yield Placed(dimension, level, low, high, (low + high) / 2.0, high - low >= NARROW_MM)
    for text_at in (high + 1.2 + width / 2.0, low - 1.2 - width / 2.0):
        yield Placed(dimension, level, low, high, text_at, False)


def _stacked(dimensions: Sequence[Dimension], origin: float, scale: float) -> list[Placed]:
    """Lay lines in levels, one after the other."""
    stack: list[Placed] = []
    for dimension in dimensions:
        levels = range(len(stack) + 1)
        places = (place for level in levels for place in _places(dimension, level, origin, scale))
        free = (place for place in places if not any(place.overlaps(other) for other in stack))
        nearest = next(free)
        clear = (
            place for place in itertools.chain((nearest,), free) if not any(place.crosses(other) for other in stack)
        )
        stack.append(next(clear, nearest))
    return stack


def _cost(stack: Sequence[Placed]) -> tuple[int, int]:
    return sum(a.crosses(b) for a, b in itertools.combinations(stack, 2)), sum(place.level for place in stack)


class Frame:
    """A view at a scale with its lines laid out.

    Args:
        view: The view.
        scale: Millimetres on the paper for one of the part.
    """

    def __init__(self, view: View, scale: float) -> None:
        self.view, self.scale = view, scale
        #: The paper point of the box's lower left corner, in mm.
        self.at = (0.0, 0.0)
        self.low = view.box[0]
        self.width, self.height = (float(side) * scale for side in view.box[1] - view.box[0])
        self.sides = {side: self._stack(side) for side in SIDES}
        #: What the view takes up beyond its box on each side, in mm.
        self.room = {side: self._depth(side) for side in SIDES}
        for place in (place for stack in self.sides.values() for place in stack):
            (low, high), size = ((SIDES[:2], self.width), (SIDES[2:], self.height))[place.dimension.axis]
            self.room[low] = max(self.room[low], 1.0 - place.line[0])
            self.room[high] = max(self.room[high], 1.0 + place.line[1] - size)
        #: From the box to the callouts' texts.
        self.column_mm = self.room["right"] + 5.0
        if view.callouts:
            lines = [line for callout in view.callouts for line in callout.text.split("\n")]
            self.room["right"] = self.column_mm + 3.0 + max(text_width_mm(line, TEXT_PT) for line in lines)

    def paper(self, points: Any) -> Floats:
        """Paper mm of points of the view."""
        place: Floats = (np.asarray(points, dtype=np.float64) - self.low) * self.scale + self.at
        return place

    def _stack(self, side: Side) -> list[Placed]:
        """The lines of a side, the shorter ones nearer to the view, in the order in which the fewest cross."""
        dimensions = [dimension for dimension in self.view.dimensions if dimension.side == side]
        dimensions.sort(key=lambda dimension: dimension.value_mm)
        orders = itertools.permutations(dimensions) if len(dimensions) <= 5 else [dimensions]
        origin = float(self.low[0 if side in ("top", "bottom") else 1])
        return min((_stacked(list(order), origin, self.scale) for order in orders), key=_cost)

    def _has_letter(self, side: Side) -> bool:
        return self.view.cuts[side in ("top", "bottom")] is not None

    def offset_mm(self, side: Side, level: int) -> float:
        """From the box to a dimension line; where its text would lie on a section's letter, beyond the letter."""
        letter = side in ("right", "bottom") and self._has_letter(side)
        return _FIRST_MM + (3.2 if letter else 0.0) + _PITCH_MM * level

    def _depth(self, side: Side) -> float:
        last = max((place.level for place in self.sides[side]), default=None)
        lines = 0.0 if last is None else self.offset_mm(side, last) + _TEXT_MM
        return max(lines, _LETTER_MM if self._has_letter(side) else 2.0)

    def callouts(self) -> Iterator[tuple[Callout, float]]:
        """Callouts with the heights of their texts: as high as the places, clear of each other and of A–A's letter."""
        cut = -1e9 if self.view.cuts[0] is None else (self.view.cuts[0] - self.low[1]) * self.scale
        limit = float("inf")
        for callout in sorted(self.view.callouts, key=lambda callout: -callout.at[1]):
            half = (LINE_MM * (callout.text.count("\n") + 1) + 1.6) / 2.0
            y = min((callout.at[1] - self.low[1]) * self.scale, limit - half)
            if abs(y - cut) < _LETTER_MM:
                y = cut + _LETTER_MM if cut + _LETTER_MM <= limit - half else cut - _LETTER_MM
            yield callout, y
            limit = y - half


class Sheet(NamedTuple):
    """Where everything lies on the paper, in mm.

    Args:
        frames: Each view.
        notes_at: The notes' upper left corner.
        notes_width: Their width.
    """

    frames: Sequence[Frame]
    notes_at: tuple[float, float]
    notes_width: float


def arrange(drawing: Drawing) -> Sheet:
    """Find the largest scale at which everything has its place; the smallest takes 2 m, more than any part has."""
    return next(sheet for scale in SCALES if (sheet := _arranged(drawing, scale)) is not None)


def _arranged(drawing: Drawing, scale: float) -> Sheet | None:
    plan, front = Frame(drawing.plan, scale), Frame(drawing.front, scale)
    side = Frame(drawing.side, drawing.side.within.scale if drawing.side.within else scale)
    left, right = (max(plan.room[end], front.room[end]) for end in SIDES[:2])
    beside = side.room["left"] + side.width + side.room["right"]
    column = max(beside, _NOTES_MM[0])
    top = max(plan.room["top"], side.room["top"])
    gap = plan.room["bottom"] + front.room["top"]
    height = SHEET_MM[1] - 2.0 * MARGIN_MM - STRIP_MM - 3.0
    spare_x = SHEET_MM[0] - 2.0 * MARGIN_MM - 4.0 - (left + plan.width + right + _GAP_MM + column)
    spare_y = height - (top + plan.height + gap + front.height + front.room["bottom"] + _CAPTION_MM)
    below = side.room["bottom"] + _CAPTION_MM + 4.0
    if min(spare_x, spare_y, height - (top + side.height + below + _NOTES_MM[1])) < 0.0:
        return None
    x = MARGIN_MM + 2.0 + spare_x / 3.0 + left
    upper = SHEET_MM[1] - MARGIN_MM - 1.5 - spare_y / 3.0 - top
    front_y = upper - plan.height - gap - spare_y / 3.0 - front.height
    column_x = x + plan.width + right + _GAP_MM + spare_x / 3.0
    plan.at, front.at = (x, upper - plan.height), (x, front_y)
    side.at = (column_x + side.room["left"] + (column - beside) / 2.0, upper - side.height)
    notes_y = min(side.at[1] - below, front_y + front.height + 14.0)
    return Sheet((plan, front, side), (column_x, notes_y), column)
