"""The Open CASCADE solids that the fixtures consist of, and their volumes in closed form.

The kernel is imported inside the functions, because numbers and reports do not need it. build123d could make the same
solids, but importing it takes several times as long as importing the kernel.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely

from tacbench_cad.geometry.kernel import distinct
from tacbench_cad.util.errors import CheckFailedError
from tacbench_cad.util.types import Floats

if TYPE_CHECKING:
    from OCP.gp import gp_Ax2
    from OCP.TopoDS import TopoDS_Shape, TopoDS_Solid


@dataclass(frozen=True, kw_only=True)
class Rectangle:
    """An axis-parallel rectangle in the plane, in mm.

    Args:
        low: The lower corner.
        high: The upper corner.
    """

    low: tuple[float, float]
    high: tuple[float, float]

    @property
    def size_mm(self) -> tuple[float, float]:
        """The sides along x and y; zero if the rectangle is empty."""
        return (max(self.high[0] - self.low[0], 0.0), max(self.high[1] - self.low[1], 0.0))

    @property
    def area_mm2(self) -> float:
        """The area in mm^2."""
        x, y = self.size_mm
        return x * y

    @property
    def corners(self) -> Floats:
        """The four corners, counter-clockwise, shape (4, 2)."""
        (x0, y0), (x1, y1) = self.low, self.high
        return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])

    def grown(self, x_mm: float, y_mm: float) -> Rectangle:
        """Return the rectangle with its sides moved outwards by a distance along x and along y."""
        (x0, y0), (x1, y1) = self.low, self.high
        return Rectangle(low=(x0 - x_mm, y0 - y_mm), high=(x1 + x_mm, y1 + y_mm))

    @property
    def polygon(self) -> shapely.Polygon:
        """The rectangle as a polygon of shapely."""
        return shapely.box(*self.low, *self.high)


@dataclass(frozen=True, kw_only=True)
class Bore:
    """A vertical through hole. Its lead-in is a cone at the upper end.

    Args:
        at_mm: The position x, y of the axis.
        diameter_mm: The diameter of the hole.
        lead_in_mm: The diameter of the cone at the upper face, at 45 degrees; None for a hole without a lead-in.
    """

    at_mm: tuple[float, float]
    diameter_mm: float
    lead_in_mm: float | None = None

    @property
    def cone_mm(self) -> float:
        """The depth of the cone, in mm."""
        return 0.0 if self.lead_in_mm is None else (self.lead_in_mm - self.diameter_mm) / 2.0

    @property
    def widest_mm(self) -> float:
        """The diameter at the upper face, in mm."""
        return self.diameter_mm if self.lead_in_mm is None else self.lead_in_mm

    def volume_mm3(self, depth_mm: float) -> float:
        """Return the volume of the hole in a plate of a given thickness, in mm^3."""
        r, wide, cone = self.diameter_mm / 2.0, self.widest_mm / 2.0, self.cone_mm
        return math.pi * (r * r * (depth_mm - cone) + cone / 3.0 * (wide * wide + wide * r + r * r))

    def chord_slack_mm3(self, depth_mm: float, deflection_mm: float) -> float:
        """Return an upper bound of the volume by which the hole of a mesh is smaller than the exact hole, in mm^3.

        The chords of the mesh are at most ``deflection_mm`` away from the circle. A circular segment of sagitta s over
        a chord c has an area of 2/3 c s for short chords, and less than 3/4 c s for chords of up to a quarter of the
        circle. All chords together are shorter than the circumference.
        """
        return 0.75 * math.pi * self.widest_mm * deflection_mm * depth_mm

    def solid(self, z_mm: tuple[float, float]) -> TopoDS_Shape:
        """Return the tool that cuts the hole through a plate between two heights."""
        from OCP.BRepPrimAPI import BRepPrimAPI_MakeCone

        bottom, top = z_mm
        radius = self.diameter_mm / 2.0
        # The tool extends beyond the faces of the plate, so that no face of the tool coincides with them.
        below = cylinder(self.at_mm, radius, (bottom - 1.0, top + 1.0))
        if self.lead_in_mm is None:
            return below
        reach = 0.5
        start, height = top - self.cone_mm, self.cone_mm + reach
        wide = self.lead_in_mm / 2.0 + reach
        return fused(below, [BRepPrimAPI_MakeCone(_upwards(self.at_mm, start), radius, wide, height).Solid()])


def box(plan: Rectangle, z_mm: tuple[float, float]) -> TopoDS_Shape:
    """Return a box over a rectangle, between two heights."""
    from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox
    from OCP.gp import gp_Pnt

    return BRepPrimAPI_MakeBox(gp_Pnt(*plan.low, z_mm[0]), gp_Pnt(*plan.high, z_mm[1])).Solid()


def cylinder(at_mm: tuple[float, float], radius_mm: float, z_mm: tuple[float, float]) -> TopoDS_Shape:
    """Return an upright cylinder between two heights."""
    from OCP.BRepPrimAPI import BRepPrimAPI_MakeCylinder

    return BRepPrimAPI_MakeCylinder(_upwards(at_mm, z_mm[0]), radius_mm, z_mm[1] - z_mm[0]).Solid()


def _upwards(at_mm: tuple[float, float], z_mm: float) -> gp_Ax2:
    """Return the axes at a point, with the main direction upwards."""
    from OCP.gp import gp_Ax2, gp_Dir, gp_Pnt

    return gp_Ax2(gp_Pnt(*at_mm, z_mm), gp_Dir(0.0, 0.0, 1.0))


def prism(outer: Floats, holes: Sequence[Floats], z_mm: tuple[float, float]) -> TopoDS_Shape:
    """Return an upright prism over an outline with holes, between two heights."""
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeFace, BRepBuilderAPI_MakePolygon
    from OCP.BRepPrimAPI import BRepPrimAPI_MakePrism
    from OCP.gp import gp_Dir, gp_Pln, gp_Pnt, gp_Vec
    from OCP.ShapeFix import ShapeFix_Face
    from OCP.TopoDS import TopoDS_Wire

    def wire(points: Floats) -> TopoDS_Wire:
        polygon = BRepBuilderAPI_MakePolygon()
        for x, y in points.tolist():
            polygon.Add(gp_Pnt(x, y, z_mm[0]))
        polygon.Close()
        return polygon.Wire()

    plane = gp_Pln(gp_Pnt(0.0, 0.0, z_mm[0]), gp_Dir(0.0, 0.0, 1.0))
    face = BRepBuilderAPI_MakeFace(plane, wire(outer), True)
    for hole in holes:
        face.Add(wire(hole))
    repair = ShapeFix_Face(face.Face())
    repair.FixOrientation()
    return BRepPrimAPI_MakePrism(repair.Face(), gp_Vec(0.0, 0.0, z_mm[1] - z_mm[0])).Shape()


def cut(body: TopoDS_Shape, tools: Sequence[TopoDS_Shape]) -> TopoDS_Shape:
    """Subtract tools from a body."""
    from OCP.BRepAlgoAPI import BRepAlgoAPI_Cut

    return _combined(BRepAlgoAPI_Cut(), body, tools)


def fused(body: TopoDS_Shape, others: Sequence[TopoDS_Shape]) -> TopoDS_Shape:
    """Join other bodies to a body, and merge faces that lie in the same surface."""
    from OCP.BRepAlgoAPI import BRepAlgoAPI_Fuse
    from OCP.ShapeUpgrade import ShapeUpgrade_UnifySameDomain

    unify = ShapeUpgrade_UnifySameDomain(_combined(BRepAlgoAPI_Fuse(), body, others), True, True, True)
    unify.AllowInternalEdges(False)
    unify.Build()
    return unify.Shape()


def _combined(operation: Any, body: TopoDS_Shape, others: Sequence[TopoDS_Shape]) -> TopoDS_Shape:
    from OCP.TopTools import TopTools_ListOfShape

    arguments, tools = TopTools_ListOfShape(), TopTools_ListOfShape()
    arguments.Append(body)
    for other in others:
        tools.Append(other)
    operation.SetArguments(arguments)
    operation.SetTools(tools)
    operation.SetRunParallel(True)
    operation.Build()
    return operation.Shape()


def one_solid(shape: TopoDS_Shape, what: str) -> TopoDS_Solid:
    """Return the only solid of a shape.

    Raises:
        CheckFailedError: The kernel made no solid, more than one, or an invalid one.
    """
    from OCP.BRepCheck import BRepCheck_Analyzer

    solids = distinct(shape, "SOLID")
    if len(solids) != 1 or not BRepCheck_Analyzer(solids[0]).IsValid():
        raise CheckFailedError(f"the CAD kernel made {len(solids)} solids of the {what} instead of one valid solid")
    return solids[0]
