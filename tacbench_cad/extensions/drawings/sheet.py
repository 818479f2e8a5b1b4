"""The content of a dimension drawing: its views with their outlines, the lengths on them, and the notes.

This module draws nothing and reads no mesh. A drawing is plain data, so that its numbers can be tested and listed. The
points of a view are in mm of the part: the first coordinate runs to the right on the paper, the second one up.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from tacbench_cad.util.text import report, report_rows
from tacbench_cad.util.types import Bytes, Floats

Point = tuple[float, float]
Outlines = Sequence[Floats]
Side = Literal["top", "bottom", "left", "right"]
#: Accepted deviation of any length of a print that has no accepted deviation of its own, in mm.
ACCEPTED_MM = 0.3
#: Largest radius of a detail on the paper in mm, and the scales that are tried.
_DETAIL_MM = 31.0
_DETAIL_SCALES = (10.0, 5.0, 4.0, 3.0, 2.5, 2.0, 1.5, 1.0, 0.5, 0.2, 0.1)


def length(value_mm: float) -> str:
    """A length as drawings show it: rounded to 0.01 mm, without zeros at the end."""
    return f"{round(value_mm, 2) + 0.0:g}"


@dataclass(frozen=True)
class Dimension:
    """A length between two points of a view, measured across or up.

    Args:
        name: The name of the length, for lists.
        start: One end, in mm of the view.
        end: The other end.
        side: The side of the view where its line lies. Lines at ``top`` and ``bottom`` measure across, others up.
        accept_mm: Accepted deviation of a print; None for 0.3 mm.
        form: Text with ``{}`` for the number.
    """

    name: str
    start: Point
    end: Point
    side: Side
    accept_mm: float | None = None
    form: str = "{}"

    @property
    def axis(self) -> int:
        """0 where it measures across, 1 where it measures up."""
        return 0 if self.side in ("top", "bottom") else 1

    @property
    def value_mm(self) -> float:
        """The length."""
        return abs(self.end[self.axis] - self.start[self.axis])

    @property
    def number(self) -> str:
        """The length and the accepted deviation: ``23.3 ±0.1``."""
        return length(self.value_mm) + ("" if self.accept_mm is None else f" ±{length(self.accept_mm)}")

    @cached_property
    def text(self) -> str:
        """The text on the drawing."""
        return self.form.format(self.number)


def sides(name: str, low: Point, high: Point, at: tuple[Side, Side], *accept_mm: float) -> list[Dimension]:
    """The lengths ``name x`` and ``name y`` of a rectangle, between the middles of its sides.

    Args:
        name: The rectangle.
        low: Its lower corner.
        high: Its upper corner.
        at: The sides where the two lines lie: first the line that measures across, then the line that measures up.
        accept_mm: Accepted deviations along both axes; none for 0.3 mm.
    """
    a, b = (low[0] + high[0]) / 2.0, (low[1] + high[1]) / 2.0
    accept_x, accept_y = accept_mm or (None, None)
    return [
        Dimension(f"{name} x", (low[0], b), (high[0], b), at[0], accept_x),
        Dimension(f"{name} y", (a, low[1]), (a, high[1]), at[1], accept_y),
    ]


@dataclass(frozen=True)
class Callout:
    """A text with a line to a place, or with an arrow to a circle.

    Args:
        text: The text; its lines are separated by newlines.
        at: The place, or the centre of the circle.
        diameter_mm: The circle's diameter; None for no circle.
    """

    text: str
    at: Point
    diameter_mm: float | None = None


@dataclass(frozen=True)
class DrawnCircle:
    """The region that a detail shows.

    Args:
        centre: Its centre in mm.
        radius: Its radius in mm.
    """

    centre: Point
    radius: float

    @property
    def scale(self) -> float:
        """The largest scale at which the detail fits beside the plan."""
        fitting = (scale for scale in _DETAIL_SCALES if scale * self.radius <= _DETAIL_MM)
        return next(fitting, _DETAIL_SCALES[-1])


@dataclass(frozen=True, eq=False)
class DrawingView:
    """One view of a part.

    Args:
        outlines: Outlines by the kind of line. Each is closed and has shape (n, 2), in mm; an open line has shape
            (2, 2). The kinds are ``seen`` and ``hidden`` edges, ``fine`` engravings, ``cut`` faces
            (counter-clockwise; holes in them are clockwise), the thin outlines of an ``other`` part, the ``axis`` of
            a hole, and the ``cross`` on a marked point.
        dimensions: The lengths.
        callouts: Texts with lines, in a column to the right of the view.
        labels: Texts on the view itself, each with the point in its middle.
        cuts: In the plan, the places of the sections: y of A–A and x of B–B; None for no section.
        circle: The region of this view that a detail shows.
        within: The region that is shown, if the view is a detail.
        shade: A picture below the lines, (h, w, 3), and the ends of its rectangle in mm: left, right, bottom, top.
    """

    outlines: Mapping[str, Outlines]
    dimensions: Sequence[Dimension]
    callouts: Sequence[Callout] = ()
    labels: Sequence[tuple[Point, str]] = ()
    cuts: tuple[float | None, float | None] = (None, None)
    circle: DrawnCircle | None = None
    within: DrawnCircle | None = None
    shade: tuple[Bytes, tuple[float, ...]] | None = None

    @property
    def box(self) -> Floats:
        """Lower left and upper right corner of the view, in mm, shape (2, 2)."""
        if self.within is not None:
            return np.add(self.within.centre, [[-self.within.radius], [self.within.radius]])
        points = np.concatenate([loop for line, loops in self.outlines.items() if line != "axis" for loop in loops])
        return np.array([points.min(axis=0), points.max(axis=0)])


@dataclass(frozen=True, kw_only=True, eq=False)
class Drawing:
    """A part's drawing in third-angle projection: the plan, a section from the front below it, and a view beside it.

    Args:
        report: The part's dimension report, ``str(part)``.
        facts: Names of the report's rows that the title strip shows, five at most.
        plan: The part from above.
        front: The section seen from the front, as wide as the plan.
        side: A section seen from the right, with z to the left, as high as the plan; or a detail.
        notes: Further remarks, one paragraph each.
    """

    report: str
    facts: Sequence[str]
    plan: DrawingView
    front: DrawingView
    side: DrawingView
    notes: Sequence[str] = ()

    @property
    def title(self) -> str:
        """The part in one line."""
        return self.report.splitlines()[0]

    @property
    def name(self) -> str:
        """Stem of the part's file names."""
        return self.rows["name"]

    @property
    def rows(self) -> dict[str, str]:
        """The values of the report by their names."""
        return report_rows(self.report)

    @property
    def dimensions(self) -> tuple[Dimension, ...]:
        """Every length of every view."""
        return (*self.plan.dimensions, *self.front.dimensions, *self.side.dimensions)

    @property
    def to_measure(self) -> tuple[Dimension, ...]:
        """The lengths with an accepted deviation of their own. They decide whether a print is good."""
        return tuple(dimension for dimension in self.dimensions if dimension.accept_mm is not None)

    def __str__(self) -> str:
        """Every length with the accepted deviation."""
        return report(self.title, {dimension.name: f"{dimension.number} mm" for dimension in self.dimensions})
