"""What a dimension drawing says: views with their outlines, the lengths that are drawn on them, and the words beside.

Nothing is drawn here and no mesh is read: a drawing is plain data, so that its numbers can be tested and listed.
Views are in mm of the part, a to the right and b up on the paper.
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
#: Paper mm that the radius of a detail takes at most, and the scales that are tried.
_DETAIL_MM = 31.0
_DETAIL_SCALES = (10.0, 5.0, 4.0, 3.0, 2.5, 2.0, 1.5, 1.0, 0.5, 0.2, 0.1)


def length(value_mm: float) -> str:
    """A length as it stands in a drawing: to 0.01 mm, without zeros at the end."""
    return f"{round(value_mm, 2) + 0.0:g}"


@dataclass(frozen=True)
class Dimension:
    """A length between two points of a view, measured across or up.

    Args:
        name: What is measured, for lists.
        start: One end, in mm of the view.
        end: The other end.
        side: On which side of the view its line lies: ``top`` and ``bottom`` measure across, the others up.
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
        """What is written on the drawing."""
        return self.form.format(self.number)


def sides(name: str, low: Point, high: Point, at: tuple[Side, Side], *accept_mm: float) -> list[Dimension]:
    """The lengths ``name x`` and ``name y`` of a rectangle, between the middles of its sides.

    Args:
        name: The rectangle.
        low: Its lower corner.
        high: Its upper corner.
        at: Where the lines lie that measure across and up.
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
    """Words with a line to a place, or with an arrow to a circle.

    Args:
        text: The words; lines are separated by newlines.
        at: The place, or the centre of the circle.
        diameter_mm: The circle's diameter; None for no circle.
    """

    text: str
    at: Point
    diameter_mm: float | None = None


@dataclass(frozen=True)
class Circle:
    """What a detail shows.

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
class View:
    """One view of a part.

    Args:
        outlines: Closed outlines by how they are drawn, each (n, 2) in mm, or (2, 2) for a line that is open: ``seen``
            and ``hidden`` edges, ``fine`` engravings, ``cut`` faces (counter-clockwise, holes in them clockwise),
            the thin outlines of an ``other`` part, the ``axis`` of a hole, the ``cross`` on a marked point.
        dimensions: Lengths.
        callouts: Words with lines, in a column to the right.
        labels: Words on the view itself, each with its middle.
        cuts: In the plan, where sections are taken: y of A–A, x of B–B; None for no section.
        circle: Round what a detail of this view shows.
        within: Outside of this circle nothing is shown: the view is a detail.
        shade: A picture to lay below, (h, w, 3), and its extent left, right, bottom, top in mm.
    """

    outlines: Mapping[str, Outlines]
    dimensions: Sequence[Dimension]
    callouts: Sequence[Callout] = ()
    labels: Sequence[tuple[Point, str]] = ()
    cuts: tuple[float | None, float | None] = (None, None)
    circle: Circle | None = None
    within: Circle | None = None
    shade: tuple[Bytes, tuple[float, ...]] | None = None

    @property
    def box(self) -> Floats:
        """Lower left and upper right corner of what is shown, in mm, shape (2, 2)."""
        if self.within is not None:
            return np.add(self.within.centre, [[-self.within.radius], [self.within.radius]])
        points = np.concatenate([loop for line, loops in self.outlines.items() if line != "axis" for loop in loops])
        return np.array([points.min(axis=0), points.max(axis=0)])


@dataclass(frozen=True, kw_only=True, eq=False)
class Drawing:
    """A part's drawing in third-angle projection: the plan, a section seen from the front below it, one view beside it.

    Args:
        report: The part's dimension report, ``str(part)``.
        facts: What the title strip shows of it, five names at most.
        plan: The part from above.
        front: The section seen from the front, as wide as the plan.
        side: A section seen from the right, its z to the left, as high as the plan; or a detail.
        notes: What else must be known, a paragraph each.
    """

    report: str
    facts: Sequence[str]
    plan: View
    front: View
    side: View
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
        """The lengths that say whether a print is good, which have an accepted deviation of their own."""
        return tuple(dimension for dimension in self.dimensions if dimension.accept_mm is not None)

    def __str__(self) -> str:
        """Every length with the accepted deviation."""
        return report(self.title, {dimension.name: f"{dimension.number} mm" for dimension in self.dimensions})
