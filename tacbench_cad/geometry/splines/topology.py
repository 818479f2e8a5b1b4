"""Construction of vertices, edges, wires and faces. Neighbours share their edges, so no faces are sewn together."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from OCP.BRep import BRep_Builder
from OCP.Geom import Geom_Curve, Geom_Line, Geom_Plane, Geom_Surface
from OCP.Geom2d import Geom2d_Curve
from OCP.gp import gp_Ax3, gp_Dir, gp_Pnt, gp_Vec
from OCP.TopAbs import TopAbs_Orientation
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS, TopoDS_Edge, TopoDS_Face, TopoDS_Shell, TopoDS_Solid, TopoDS_Vertex, TopoDS_Wire

#: The tolerance of vertices, edges and faces in mm. It is the usual minimum of the kernel.
TOLERANCE_MM = 1e-7

Point = tuple[float, float, float]
#: The orientations of a sub-shape in its shape.
FORWARD, REVERSED = TopAbs_Orientation.TopAbs_FORWARD, TopAbs_Orientation.TopAbs_REVERSED


class Topology:
    """Builds shapes from sub-shapes. Two shapes share a sub-shape if the caller uses it for both."""

    def __init__(self) -> None:
        self._builder = BRep_Builder()
        self._nowhere = TopLoc_Location()

    def vertex(self, point: Point) -> TopoDS_Vertex:
        """Make a vertex at a point in mm."""
        result = TopoDS_Vertex()
        self._builder.MakeVertex(result, gp_Pnt(*point), TOLERANCE_MM)
        return result

    def edge(
        self, curve: Geom_Curve, first: float, last: float, start: TopoDS_Vertex, end: TopoDS_Vertex
    ) -> TopoDS_Edge:
        """Make an edge along a curve between two of its parameters."""
        result = TopoDS_Edge()
        self._builder.MakeEdge(result, curve, TOLERANCE_MM)
        self._builder.Add(result, start.Oriented(FORWARD))
        self._builder.Add(result, end.Oriented(REVERSED))
        self._builder.Range(result, first, last)
        return result

    def segment(self, a: Point, b: Point, start: TopoDS_Vertex, end: TopoDS_Vertex) -> TopoDS_Edge:
        """Make a straight edge from a to b."""
        way = gp_Vec(gp_Pnt(*a), gp_Pnt(*b))
        return self.edge(Geom_Line(gp_Pnt(*a), gp_Dir(way)), 0.0, way.Magnitude(), start, end)

    def lay(self, edge: TopoDS_Edge, trace: Geom2d_Curve, surface: Geom_Surface) -> None:
        """Set the curve of an edge in the parameters of a surface. Edge and curve must have the same parameter."""
        self._builder.UpdateEdge(edge, trace, surface, self._nowhere, TOLERANCE_MM)

    def wire(self, edges: Iterable[TopoDS_Edge]) -> TopoDS_Wire:
        """Make a closed wire from edges with the right orientations."""
        result = TopoDS_Wire()
        self._builder.MakeWire(result)
        for edge in edges:
            self._builder.Add(result, edge)
        result.Closed(True)
        return result

    def face(self, surface: Geom_Surface, wires: Sequence[TopoDS_Wire], whole: bool = False) -> TopoDS_Face:
        """Make a face within wires.

        Args:
            surface: The surface. Its normal points out of the solid.
            wires: The wires, counter-clockwise around the area of the face, seen against the normal.
            whole: Whether the face covers the whole surface.
        """
        result = TopoDS_Face()
        self._builder.MakeFace(result, surface, TOLERANCE_MM)
        for wire in wires:
            self._builder.Add(result, wire)
        self._builder.NaturalRestriction(result, whole)
        return result

    def solid(self, faces: Iterable[TopoDS_Face]) -> TopoDS_Solid:
        """Make a solid from faces that form a closed shell."""
        shell = TopoDS_Shell()
        self._builder.MakeShell(shell)
        for face in faces:
            self._builder.Add(shell, face)
        shell.Closed(True)
        result = TopoDS_Solid()
        self._builder.MakeSolid(result)
        self._builder.Add(result, shell)
        return result


def turned(edge: TopoDS_Edge) -> TopoDS_Edge:
    """Return the edge with the opposite orientation."""
    return TopoDS.Edge_s(edge.Reversed())


def plane(origin: Point, normal: Point, along: Point) -> Geom_Plane:
    """Make a plane from a point, its normal and the direction of its first parameter."""
    return Geom_Plane(gp_Ax3(gp_Pnt(*origin), gp_Dir(*normal), gp_Dir(*along)))
