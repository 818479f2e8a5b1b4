"""The few solids that the fixtures are cut from, in build123d, and what their volumes are in closed form.

build123d is imported inside of the functions: numbers and reports do without it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tacbench_cad.util.errors import CheckFailedError
from tacbench_cad.util.types import Floats

if TYPE_CHECKING:
    from build123d import Shape, Solid


@dataclass(frozen=True, kw_only=True)
class Rectangle:
    """An axis-parallel rectangle in the plane, in mm.

    Args:
        low: Its lower corner.
        high: Its upper corner.
    """

    low: tuple[float, float]
    high: tuple[float, float]

    @property
    def size_mm(self) -> tuple[float, float]:
        """Sides along x and y; zero where the rectangle is empty."""
        return (max(self.high[0] - self.low[0], 0.0), max(self.high[1] - self.low[1], 0.0))

    @property
    def area_mm2(self) -> float:
        """Area in mm^2."""
        x, y = self.size_mm
        return x * y

    @property
    def corners(self) -> Floats:
        """The four corners counter-clockwise, shape (4, 2)."""
        (x0, y0), (x1, y1) = self.low, self.high
        return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])

    def grown(self, x_mm: float, y_mm: float) -> Rectangle:
        """The rectangle with its sides moved outwards."""
        (x0, y0), (x1, y1) = self.low, self.high
        return Rectangle(low=(x0 - x_mm, y0 - y_mm), high=(x1 + x_mm, y1 + y_mm))

    def distance_mm(self, point: tuple[float, float]) -> float:
        """Distance from a point to the rectangle; 0 inside."""
        x = max(self.low[0] - point[0], 0.0, point[0] - self.high[0])
        y = max(self.low[1] - point[1], 0.0, point[1] - self.high[1])
        return math.hypot(x, y)

    def apart_mm(self, other: Rectangle) -> float | None:
        """Distance to another rectangle; None where they overlap."""
        x = max(self.low[0] - other.high[0], other.low[0] - self.high[0])
        y = max(self.low[1] - other.high[1], other.low[1] - self.high[1])
        if x < 0.0 and y < 0.0:
            return None
        return math.hypot(max(x, 0.0), max(y, 0.0))

    def common(self, other: Rectangle) -> Rectangle:
        """What two rectangles share; its area is zero where they share nothing."""
        low = (max(self.low[0], other.low[0]), max(self.low[1], other.low[1]))
        return Rectangle(low=low, high=(min(self.high[0], other.high[0]), min(self.high[1], other.high[1])))


@dataclass(frozen=True, kw_only=True)
class Bore:
    """A vertical through hole, with a cone at its upper end where it has a lead-in.

    Args:
        at_mm: Where its axis stands, x and y.
        diameter_mm: Its diameter.
        lead_in_mm: Diameter of the cone at the upper face, at 45 degrees; None without one.
    """

    at_mm: tuple[float, float]
    diameter_mm: float
    lead_in_mm: float | None = None

    @property
    def cone_mm(self) -> float:
        """Depth of the cone."""
        return 0.0 if self.lead_in_mm is None else (self.lead_in_mm - self.diameter_mm) / 2.0

    @property
    def widest_mm(self) -> float:
        """Diameter at the upper face."""
        return self.diameter_mm if self.lead_in_mm is None else self.lead_in_mm

    def volume_mm3(self, depth_mm: float) -> float:
        """Volume that it takes out of a plate of a thickness."""
        r, wide, cone = self.diameter_mm / 2.0, self.widest_mm / 2.0, self.cone_mm
        return math.pi * (r * r * (depth_mm - cone) + cone / 3.0 * (wide * wide + wide * r + r * r))

    def chord_slack_mm3(self, depth_mm: float, deflection_mm: float) -> float:
        """How much less a mesh takes out, its chords missing the circle by a distance at most.

        A segment of sagitta s over a chord c has an area of 2/3 c s for short chords and below 3/4 c s for chords of
        up to a quarter of the circle; all chords together are shorter than the circumference.
        """
        return 0.75 * math.pi * self.widest_mm * deflection_mm * depth_mm

    def solid(self, z_mm: tuple[float, float]) -> Shape:
        """The tool that cuts it through a plate between two heights."""
        from build123d import Align, Cone, Cylinder, Pos

        bottom, top = z_mm
        align = (Align.CENTER, Align.CENTER, Align.MIN)
        # The tool passes the plate's faces, so that no face of it lies in one of them.
        below = Cylinder(self.diameter_mm / 2.0, top - bottom + 2.0, align=align)
        tool = Pos(*self.at_mm, bottom - 1.0) * below
        if self.lead_in_mm is None:
            return tool
        reach = 0.5
        wide = self.lead_in_mm / 2.0 + reach
        cone = Cone(self.diameter_mm / 2.0, wide, self.cone_mm + reach, align=align)
        return tool + Pos(*self.at_mm, top - self.cone_mm) * cone


def box(plan: Rectangle, z_mm: tuple[float, float]) -> Shape:
    """A box over a rectangle, between two heights."""
    from build123d import Align, Box, Pos

    x, y = plan.size_mm
    return Pos(*plan.low, z_mm[0]) * Box(x, y, z_mm[1] - z_mm[0], align=(Align.MIN, Align.MIN, Align.MIN))


def prism(outer: Floats, holes: Sequence[Floats], z_mm: tuple[float, float]) -> Shape:
    """An upright prism over an outline with holes, between two heights."""
    from build123d import Face, Solid, Vector, Wire

    def wire(points: Floats) -> Wire:
        return Wire.make_polygon([(float(x), float(y), z_mm[0]) for x, y in points], close=True)

    face = Face(wire(outer), [wire(one) for one in holes])
    return Solid.extrude(face, Vector(0.0, 0.0, z_mm[1] - z_mm[0]))


def one_solid(shape: Shape, what: str) -> Solid:
    """The only solid of a shape.

    Raises:
        CheckFailedError: The kernel made none, or more than one, or an invalid one.
    """
    solids = shape.solids()
    if len(solids) != 1 or not solids[0].is_valid:
        raise CheckFailedError(f"the CAD kernel made {len(solids)} solids of the {what}, one valid solid is needed")
    return solids[0]
