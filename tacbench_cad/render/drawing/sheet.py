"""What a dimension drawing says: views with their outlines, the lengths that are drawn on them, and the words beside.

Nothing is drawn here and no mesh is read: a drawing is plain data, so that its numbers can be tested and listed.
Views are in mm of the part, a to the right and b up on the paper.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from tacbench_cad.util.text import report
from tacbench_cad.util.types import Bytes, Floats

Point = tuple[float, float]
Side = Literal["top", "bottom", "left", "right"]
#: What an end of a length lies on: an outline of the part, the axis of something symmetrical in it, a drawn cross, or
#: the thin outline of a part that belongs to it.
End = Literal["edge", "axis", "cross", "other"]


def length(value_mm: float) -> str:
    """A length as it stands in a drawing: to 0.01 mm, without zeros at the end."""
    return f"{round(value_mm, 2) + 0.0:g}"


@dataclass(frozen=True, kw_only=True)
class Dimension:
    """A length between two points of a view.

    Args:
        name: What it is, for lists.
        value_mm: The length, from the part's specification.
        start: One end, in mm of the view.
        end: The other end.
        side: On which side of the view its line lies: ``top`` and ``bottom`` measure across, the others up.
        ends: What both ends lie on.
        accept_mm: Deviation of a print that is accepted; None for the general one of the sheet.
        form: Text with ``{}`` for the number.
    """

    name: str
    value_mm: float
    start: Point
    end: Point
    side: Side
    ends: tuple[End, End] = ("edge", "edge")
    accept_mm: float | None = None
    form: str = "{}"

    @property
    def axis(self) -> int:
        """0 where it measures across, 1 where it measures up."""
        return 0 if self.side in ("top", "bottom") else 1

    @property
    def number(self) -> str:
        """The length, and what is accepted of a print: ``23.3 ±0.1``."""
        return length(self.value_mm) + self._within

    @property
    def text(self) -> str:
        """What is written on the drawing."""
        return self.form.format(length(self.value_mm)) + self._within

    @property
    def _within(self) -> str:
        return "" if self.accept_mm is None else f" ±{length(self.accept_mm)}"


@dataclass(frozen=True, kw_only=True)
class Callout:
    """Words with a line to a place: a hole's diameter, a label.

    Args:
        name: What it is, for lists.
        text: The words; lines are separated by newlines.
        at: The place, or the centre of the circle.
        diameter_mm: The circle's diameter; None for no circle.
    """

    name: str
    text: str
    at: Point
    diameter_mm: float | None = None


@dataclass(frozen=True, kw_only=True)
class CutMark:
    """Where a section is taken, shown in the plan.

    Args:
        letter: Its letter.
        at: x of a section seen from the right, y of one seen from the front, in mm.
        across: Whether it runs across the plan (seen from the front) or up.
    """

    letter: str
    at: float
    across: bool


@dataclass(frozen=True, kw_only=True)
class Circle:
    """A circle of a view: what a detail shows.

    Args:
        letter: Its letter.
        centre: Its centre in mm.
        radius: Its radius in mm.
    """

    letter: str
    centre: Point
    radius: float


@dataclass(frozen=True, kw_only=True, eq=False)
class View:
    """One view of a part.

    Args:
        caption: What stands below it; empty for nothing.
        seen: Closed outlines that are seen, each (n, 2) in mm.
        fine: Closed outlines of engravings, drawn with a finer line.
        hidden: Closed outlines of what lies below.
        cut: Closed outlines of what is cut, to be hatched: outer ones counter-clockwise, inner ones clockwise.
        other: Closed outlines of parts that belong to it, thin.
        crosses: Points that are marked.
        axes: Axes of holes, pairs of ends.
        dimensions: Lengths.
        callouts: Words with lines, in a column to the right.
        labels: Words on the view itself, each with its middle.
        cut_marks: Where sections are taken.
        circle: Outside of it nothing is shown (a detail).
        circles: Circles round what details show.
        shade: A picture to lay below, (h, w, 3), and its extent left, right, bottom, top in mm.
    """

    caption: str = ""
    seen: tuple[Floats, ...] = ()
    fine: tuple[Floats, ...] = ()
    hidden: tuple[Floats, ...] = ()
    cut: tuple[Floats, ...] = ()
    other: tuple[Floats, ...] = ()
    crosses: tuple[Point, ...] = ()
    axes: tuple[tuple[Point, Point], ...] = ()
    dimensions: tuple[Dimension, ...] = ()
    callouts: tuple[Callout, ...] = ()
    labels: tuple[tuple[Point, str], ...] = ()
    cut_marks: tuple[CutMark, ...] = ()
    circle: Circle | None = None
    circles: tuple[Circle, ...] = ()
    shade: tuple[Bytes, tuple[float, float, float, float]] | None = None

    @property
    def outlines(self) -> tuple[Floats, ...]:
        """All outlines of the part itself."""
        return (*self.seen, *self.fine, *self.hidden, *self.cut)

    @property
    def box(self) -> tuple[Point, Point]:
        """Lower left and upper right corner of what is shown, in mm."""
        if self.circle is not None:
            (a, b), r = self.circle.centre, self.circle.radius
            return (a - r, b - r), (a + r, b + r)
        points = np.concatenate([*self.outlines, *self.other])
        low, high = points.min(axis=0), points.max(axis=0)
        return (float(low[0]), float(low[1])), (float(high[0]), float(high[1]))


@dataclass(frozen=True, kw_only=True, eq=False)
class Drawing:
    """A part's drawing in third-angle projection: the plan, a section seen from the front below it, one view beside it.

    Args:
        name: Stem of the part's file names.
        title: One line for people.
        facts: Pairs of a head and a value for the title strip.
        accepts_mm: Deviation of a print that is accepted where a length has none of its own.
        plan: The part from above.
        front: The section seen from the front.
        side: A section seen from the right, its z to the left, level with the plan; or a detail.
        detail_scale: Paper mm per mm of the detail; None where ``side`` is a section and has the sheet's scale.
        notes: What else must be known, a paragraph each.
    """

    name: str
    title: str
    facts: tuple[tuple[str, str], ...]
    accepts_mm: float
    plan: View
    front: View
    side: View
    detail_scale: float | None = None
    notes: Sequence[str] = ()

    @property
    def views(self) -> tuple[View, View, View]:
        """Plan, front and side."""
        return self.plan, self.front, self.side

    @property
    def dimensions(self) -> tuple[Dimension, ...]:
        """Every length of every view."""
        return tuple(self._dimensions())

    @property
    def to_measure(self) -> tuple[Dimension, ...]:
        """The lengths that say whether a print is good, which have an accepted deviation of their own."""
        return tuple(one for one in self._dimensions() if one.accept_mm is not None)

    def __str__(self) -> str:
        """Every length with what is accepted of a print."""
        lines = {one.name: one.number + " mm" for one in self.dimensions}
        return report(self.title, lines)

    def _dimensions(self) -> Iterator[Dimension]:
        for view in self.views:
            yield from view.dimensions
