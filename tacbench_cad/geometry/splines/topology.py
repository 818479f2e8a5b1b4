"""Vertices, edges, wires and faces put together by hand, so that neighbours share them and nothing is sewn."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from OCP.BRep import BRep_Builder
from OCP.Geom import Geom_Curve, Geom_Line, Geom_Plane, Geom_Surface
from OCP.Geom2d import Geom2d_Curve
from OCP.gp import gp_Ax3, gp_Dir, gp_Pnt, gp_Vec
from OCP.TopAbs import TopAbs_Orientation
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS, TopoDS_Edge, TopoDS_Face, TopoDS_Shell, TopoDS_Solid, TopoDS_Vertex, TopoDS_Wire

#: Tolerance of vertices, edges and faces in mm: the kernel's usual least one.
TOLERANCE_MM = 1e-7

Point = tuple[float, float, float]
#: Orientations of a sub-shape in its shape.
FORWARD, REVERSED = TopAbs_Orientation.TopAbs_FORWARD, TopAbs_Orientation.TopAbs_REVERSED


class Topology:
    """Builds shapes whose parts are shared as the caller shares them."""

    def __init__(self) -> None:
        self._builder = BRep_Builder()
        self._nowhere = TopLoc_Location()

    def vertex(self, point: Point) -> TopoDS_Vertex:
        """A vertex at a point in mm."""
        result = TopoDS_Vertex()
        self._builder.MakeVertex(result, gp_Pnt(*point), TOLERANCE_MM)
        return result

    def edge(
        self, curve: Geom_Curve, first: float, last: float, start: TopoDS_Vertex, end: TopoDS_Vertex
    ) -> TopoDS_Edge:
        """An edge along a curve between two of its parameters."""
        result = TopoDS_Edge()
        self._builder.MakeEdge(result, curve, TOLERANCE_MM)
        self._builder.Add(result, start.Oriented(FORWARD))
        self._builder.Add(result, end.Oriented(REVERSED))
        self._builder.Range(result, first, last)
        return result

    def segment(self, a: Point, b: Point, start: TopoDS_Vertex, end: TopoDS_Vertex) -> TopoDS_Edge:
        """A straight edge from a to b."""
        way = gp_Vec(gp_Pnt(*a), gp_Pnt(*b))
        return self.edge(Geom_Line(gp_Pnt(*a), gp_Dir(way)), 0.0, way.Magnitude(), start, end)

    def lay(self, edge: TopoDS_Edge, trace: Geom2d_Curve, surface: Geom_Surface) -> None:
        """State that on a surface the edge runs along a curve of its parameters, with the same parameter."""
        self._builder.UpdateEdge(edge, trace, surface, self._nowhere, TOLERANCE_MM)

    def wire(self, edges: Iterable[TopoDS_Edge]) -> TopoDS_Wire:
        """A closed wire of edges that are oriented already."""
        result = TopoDS_Wire()
        self._builder.MakeWire(result)
        for edge in edges:
            self._builder.Add(result, edge)
        result.Closed(True)
        return result

    def face(self, surface: Geom_Surface, wires: Sequence[TopoDS_Wire], whole: bool = False) -> TopoDS_Face:
        """A face within wires.

        Args:
            surface: The surface; its normal points out of the solid.
            wires: Counter-clockwise around what belongs to the face, seen against the normal.
            whole: Whether the face covers the whole surface.
        """
        result = TopoDS_Face()
        self._builder.MakeFace(result, surface, TOLERANCE_MM)
        for wire in wires:
            self._builder.Add(result, wire)
        self._builder.NaturalRestriction(result, whole)
        return result

    def solid(self, faces: Iterable[TopoDS_Face]) -> TopoDS_Solid:
        """A solid bounded by faces that close."""
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
    """The same edge, run the other way."""
    return TopoDS.Edge_s(edge.Reversed())


def plane(origin: Point, normal: Point, along: Point) -> Geom_Plane:
    """A plane by a point, its normal and the direction of its first parameter."""
    return Geom_Plane(gp_Ax3(gp_Pnt(*origin), gp_Dir(*normal), gp_Dir(*along)))
