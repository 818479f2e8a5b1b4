"""The layout of a drawing, in mm of the paper: dimension lines that do not meet, and a scale at which all fits."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from tacbench_cad.extensions.drawings.sheet import Callout, Dimension, Drawing, DrawingView, Side
from tacbench_cad.util.plotting import text_width_mm
from tacbench_cad.util.types import Floats

#: Size of the sheet (A4, landscape), its margin, and the height of the title strip, in mm.
SHEET_MM, MARGIN_MM, STRIP_MM = (297.0, 210.0), 5.0, 24.5
#: Scales that are tried, the largest first.
SCALES = (10.0, 5.0, 4.0, 3.0, 2.5, 2.0, 1.5, 1.0, 0.75, 0.5, 0.4, 0.25, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002)
SIDES: tuple[Side, ...] = ("left", "right", "bottom", "top")
#: Size of dimensions, callouts and labels, in points, and height of a line of them.
TEXT_PT, LINE_MM = 9.0, 4.3
#: Length of a line beyond its ends if its arrows are outside, and the span below which they are.
TAIL_MM, NARROW_MM = 4.5, 7.5
#: Distances from the view to the first dimension line, from line to line, and from the last line past its text.
_FIRST_MM, _PITCH_MM, _TEXT_MM = 7.2, 6.2, 4.2
#: Length of a section's mark with its letter, and height of a caption with its distance from the view.
_LETTER_MM, _CAPTION_MM = 6.5, 7.0
#: Gap between the columns; smallest width and height of the notes.
_GAP_MM, _NOTES_MM = 7.0, (84.0, 38.0)


@dataclass(frozen=True)
class Placed:
    """A dimension line with its place, in mm on the paper from the view's lower left corner.

    Args:
        dimension: The dimension.
        level: How far out it lies, from 0.
        low: The line's lower end.
        high: The line's upper end.
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
        """The ends of its text along the line."""
        half = text_width_mm(self.dimension.text, TEXT_PT) / 2.0 + 0.5
        return self.text_at - half, self.text_at + half

    @cached_property
    def line(self) -> tuple[float, float]:
        """The ends of the drawn line. Where the text is beside the arrows, the line continues below the text."""
        low, high = (self.low, self.high) if self.inside else (self.low - TAIL_MM, self.high + TAIL_MM)
        return min(low, self.text[0]), max(high, self.text[1])

    def overlaps(self, other: Placed) -> bool:
        """Whether both lines are in the same level and overlap."""
        return self.level == other.level and self.line[0] < other.line[1] and other.line[0] < self.line[1]

    def crosses(self, other: Placed) -> bool:
        """Whether an extension line of the outer line runs through the text of the inner line."""
        inner, outer = sorted((self, other), key=lambda line: line.level)
        return inner.level < outer.level and any(inner.text[0] < x < inner.text[1] for x in (outer.low, outer.high))


def _places(dimension: Dimension, level: int, origin: float, scale: float) -> Iterator[Placed]:
    """Possible places of a dimension on a level: its text between its ends if there is room, or beside them."""
    ends = dimension.start[dimension.axis], dimension.end[dimension.axis]
    low, high = ((end - origin) * scale for end in sorted(ends))
    width = text_width_mm(dimension.text, TEXT_PT)
    if width <= high - low - 1.0:
        yield Placed(dimension, level, low, high, (low + high) / 2.0, high - low >= NARROW_MM)
    for text_at in (high + 1.2 + width / 2.0, low - 1.2 - width / 2.0):
        yield Placed(dimension, level, low, high, text_at, False)


def _stacked(dimensions: Sequence[Dimension], origin: float, scale: float) -> list[Placed]:
    """Place the lines in levels, one line after the other."""
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


class DrawingFrame:
    """A view at a scale, with places for its dimension lines.

    Args:
        view: The view.
        scale: Millimetres on the paper for each millimetre of the part.
    """

    def __init__(self, view: DrawingView, scale: float) -> None:
        self.view, self.scale = view, scale
        #: Place of the box's lower left corner on the paper, in mm.
        self.at = (0.0, 0.0)
        self.low = view.box[0]
        self.width, self.height = (float(side) * scale for side in view.box[1] - view.box[0])
        self.sides = {side: self._stack(side) for side in SIDES}
        #: Space that the view needs beyond its box on each side, in mm.
        self.room = {side: self._depth(side) for side in SIDES}
        for place in (place for stack in self.sides.values() for place in stack):
            (low, high), size = ((SIDES[:2], self.width), (SIDES[2:], self.height))[place.dimension.axis]
            self.room[low] = max(self.room[low], 1.0 - place.line[0])
            self.room[high] = max(self.room[high], 1.0 + place.line[1] - size)
        #: Distance from the box to the callouts' texts, in mm.
        self.column_mm = self.room["right"] + 5.0
        if view.callouts:
            lines = [line for callout in view.callouts for line in callout.text.split("\n")]
            self.room["right"] = self.column_mm + 3.0 + max(text_width_mm(line, TEXT_PT) for line in lines)

    def paper(self, points: Any) -> Floats:
        """Places of points of the view on the paper, in mm."""
        place: Floats = (np.asarray(points, dtype=np.float64) - self.low) * self.scale + self.at
        return place

    def _stack(self, side: Side) -> list[Placed]:
        """The lines of a side in the order with the fewest crossings; shorter lines are nearer to the view."""
        dimensions = [dimension for dimension in self.view.dimensions if dimension.side == side]
        dimensions.sort(key=lambda dimension: dimension.value_mm)
        orders = itertools.permutations(dimensions) if len(dimensions) <= 5 else [dimensions]
        origin = float(self.low[0 if side in ("top", "bottom") else 1])
        return min((_stacked(list(order), origin, self.scale) for order in orders), key=_cost)

    def _has_letter(self, side: Side) -> bool:
        return self.view.cuts[side in ("top", "bottom")] is not None

    def offset_mm(self, side: Side, level: int) -> float:
        """Distance of a dimension line from the box. Lines beside a section's letter lie beyond the letter."""
        letter = side in ("right", "bottom") and self._has_letter(side)
        return _FIRST_MM + (3.2 if letter else 0.0) + _PITCH_MM * level

    def _depth(self, side: Side) -> float:
        last = max((place.level for place in self.sides[side]), default=None)
        lines = 0.0 if last is None else self.offset_mm(side, last) + _TEXT_MM
        return max(lines, _LETTER_MM if self._has_letter(side) else 2.0)

    def callouts(self) -> Iterator[tuple[Callout, float]]:
        """Callouts and the heights of their texts: level with the places, clear of each other and of A–A's letter."""
        cut = -1e9 if self.view.cuts[0] is None else (self.view.cuts[0] - self.low[1]) * self.scale
        limit = float("inf")
        for callout in sorted(self.view.callouts, key=lambda callout: -callout.at[1]):
            half = (LINE_MM * (callout.text.count("\n") + 1) + 1.6) / 2.0
            y = min((callout.at[1] - self.low[1]) * self.scale, limit - half)
            if abs(y - cut) < _LETTER_MM:
                y = cut + _LETTER_MM if cut + _LETTER_MM <= limit - half else cut - _LETTER_MM
            yield callout, y
            limit = y - half


class DrawingSheet(NamedTuple):
    """The places of all parts of a drawing on the paper, in mm.

    Args:
        frames: Each view.
        notes_at: Upper left corner of the notes.
        notes_width: Width of the notes.
    """

    frames: Sequence[DrawingFrame]
    notes_at: tuple[float, float]
    notes_width: float


def arrange(drawing: Drawing) -> DrawingSheet:
    """Find the largest scale at which everything fits. The smallest scale fits 2 m, more than any part needs."""
    return next(sheet for scale in SCALES if (sheet := _arranged(drawing, scale)) is not None)


def _arranged(drawing: Drawing, scale: float) -> DrawingSheet | None:
    plan, front = DrawingFrame(drawing.plan, scale), DrawingFrame(drawing.front, scale)
    side = DrawingFrame(drawing.side, drawing.side.within.scale if drawing.side.within else scale)
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
    return DrawingSheet((plan, front, side), (column_x, notes_y), column)
