"""The faces of a texture on a region: trimmed spline patches, and walls down to the face of the part."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from OCP.BRep import BRep_Builder, BRep_Tool
from OCP.BRepAdaptor import BRepAdaptor_Curve
from OCP.Geom import Geom_BSplineCurve, Geom_BSplineSurface, Geom_CylindricalSurface, Geom_SurfaceOfLinearExtrusion
from OCP.Geom2d import Geom2d_BSplineCurve, Geom2d_Curve, Geom2d_Line
from OCP.GeomAbs import GeomAbs_CurveType
from OCP.gp import gp_Ax3, gp_Dir, gp_Dir2d, gp_Pnt2d, gp_Vec2d
from OCP.TColgp import TColgp_Array1OfPnt2d
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS, TopoDS_Edge, TopoDS_Face, TopoDS_Vertex, TopoDS_Wire

from tacbench_cad.geometry.splines import kernelsplines
from tacbench_cad.geometry.splines.topology import TOLERANCE_MM, Topology, plane, turned
from tacbench_cad.geometry.textured.field import PatchGrid
from tacbench_cad.geometry.textured.region import OutlineEdge, Region, vertices_of
from tacbench_cad.geometry.textured.trim import Arrangement, Cell, Piece
from tacbench_cad.spec.spline import greville
from tacbench_cad.util.errors import CheckFailedError
from tacbench_cad.util.types import Floats

#: The intended distance between an edge and its curve on a patch, in mm.
EDGE_MM = 2e-7
#: The largest distance between the end of an edge and its corner, in mm.
MAX_GAP_MM = 1e-3
#: The degree of the curves of edges.
_DEGREE = 5
#: The largest number of poles of the curve of an edge.
_MAX_EDGE_POLES = 2000
#: The points on each span of the curve of an edge at which its error is measured. With only a few, the largest error
#: could lie between them, and the kernel would find the edge outside of its tolerance.
_TESTS_PER_SPAN = 12


class TextureFaces:
    """Builds the faces. Each vertex and each edge is made once.

    Args:
        region: The region.
        patches: Its patches.
        sunk: Whether the texture lies below the face.
    """

    def __init__(self, region: Region, patches: PatchGrid, sunk: bool) -> None:
        self._region, self._patches, self._sunk = region, patches, sunk
        self._arrangement = Arrangement(region, patches.s, patches.t)
        self._top, self._builder = Topology(), BRep_Builder()
        self._surfaces: dict[Cell, Geom_BSplineSurface] = {}
        self._vertices: dict[int, TopoDS_Vertex] = {}
        self._edges: dict[tuple[int | str, ...], TopoDS_Edge] = {}
        self._lines: dict[tuple[str, int, int], Geom_BSplineCurve] = {}
        self._posts: dict[tuple[int, int], TopoDS_Edge] = {}

    def faces(self) -> Iterator[TopoDS_Face]:
        """Yield the patches of the texture and the walls."""
        for (number, k), pieces in self._arrangement.outline.items():
            for cell, piece in pieces:
                self._outline_edge(self._region.loops[number][k], cell, piece)
        for cell, loops in self._arrangement.faces():
            yield self._top.face(self._surface(cell), [self._wire(cell, loop) for loop in loops], self._is_whole(loops))
        for number, loop in enumerate(self._region.loops):
            for k in range(len(loop)):
                yield self._wall(number, k)

    def _is_whole(self, loops: list[list[Piece]]) -> bool:
        return len(loops) == 1 and len(loops[0]) == 4 and all(isinstance(p.key[0], str) for p in loops[0])

    def _surface(self, cell: Cell) -> Geom_BSplineSurface:
        if cell not in self._surfaces:
            s, t = self._patches.s, self._patches.t
            self._surfaces[cell] = kernelsplines.surface(
                self._patches.poles(*cell), (s.knots_of(cell[0]), t.knots_of(cell[1])), (s.degree, t.degree)
            )
        return self._surfaces[cell]

    def _vertex(self, node: int) -> TopoDS_Vertex:
        if node not in self._vertices:
            s, t = self._arrangement.nodes[node]
            i, j = (
                min(max(int(np.searchsorted(axis.lines, at)) - 1, 0), axis.patches - 1)
                for axis, at in ((self._patches.s, s), (self._patches.t, t))
            )
            point = self._patches.points(i, j, np.array([s]), np.array([t]))[0]
            self._vertices[node] = self._top.vertex(tuple(point.tolist()))
        return self._vertices[node]

    def _wire(self, cell: Cell, loop: list[Piece]) -> TopoDS_Wire:
        edges = []
        for piece in loop:
            edge = self._edge(cell, piece)
            edges.append(edge if piece.forward else turned(edge))
        return self._top.wire(edges)

    def _edge(self, cell: Cell, piece: Piece) -> TopoDS_Edge:
        """Return the edge of a piece along increasing parameters, with its curve on a patch."""
        if not isinstance(piece.key[0], str):
            return self._edges[piece.key]
        axis, line, along, _ = piece.key
        assert isinstance(axis, str) and isinstance(line, int) and isinstance(along, int)
        if piece.key not in self._edges:
            first, last = (piece.start, piece.end) if piece.forward else (piece.end, piece.start)
            curve = self._line(axis, line, along)
            self._edges[piece.key] = self._top.edge(
                curve, piece.low, piece.high, self._vertex(first), self._vertex(last)
            )
        edge = self._edges[piece.key]
        at = float(piece.points[0, 0 if axis == "s" else 1])
        trace = Geom2d_Line(gp_Pnt2d(at, 0.0), gp_Dir2d(0.0, 1.0)) if axis == "s" else None
        trace = trace or Geom2d_Line(gp_Pnt2d(0.0, at), gp_Dir2d(1.0, 0.0))
        self._top.lay(edge, trace, self._surface(cell))
        return edge

    def _line(self, axis: str, line: int, along: int) -> Geom_BSplineCurve:
        """Return the curve of a line between patches. Its parameter is the coordinate along it."""
        key = (axis, line, along)
        if key not in self._lines:
            own, other = (self._patches.s, self._patches.t) if axis == "s" else (self._patches.t, self._patches.s)
            last = line == own.patches
            cell = (line - last, along) if axis == "s" else (along, line - last)
            poles = self._patches.poles(*cell)
            row = -1 if last else 0
            border = poles[row] if axis == "s" else poles[:, row]
            self._lines[key] = kernelsplines.curve(border, other.knots_of(along), other.degree)
        return self._lines[key]

    def _outline_edge(self, outline: OutlineEdge, cell: Cell, piece: Piece) -> None:
        """Make the edge of a piece of the outline: a spline through points of the patch, with the same parameter."""
        shift = np.array([piece.shift, 0.0])

        def at(parameters: Floats) -> Floats:
            s, t = (outline.at(parameters) + shift).T
            return self._patches.points(*cell, s, t)

        poles, knots, error = _fitted(at, piece.low, piece.high)
        first, last = (piece.start, piece.end) if piece.forward else (piece.end, piece.start)
        ends = self._vertex(first), self._vertex(last)
        curve = kernelsplines.curve(poles, _multiplicities(knots), _DEGREE)
        edge = self._top.edge(curve, piece.low, piece.high, *ends)
        trace = outline.curve
        if shift[0]:
            trace = trace.Translated(gp_Vec2d(*shift))
        self._top.lay(edge, trace, self._surface(cell))
        self._loosen(edge, error)
        for vertex, parameter in zip(ends, (piece.low, piece.high), strict=True):
            point, end = BRep_Tool.Pnt_s(vertex), curve.Value(parameter)
            if (gap := point.Distance(end)) > MAX_GAP_MM:
                raise CheckFailedError("an edge of the texture does not end at its corner; choose another margin_mm")
            if gap > 0.5 * TOLERANCE_MM:
                self._builder.UpdateVertex(vertex, 2.0 * gap)
        self._edges[piece.key] = edge

    def _loosen(self, edge: TopoDS_Edge, error: float) -> None:
        if error > 0.5 * TOLERANCE_MM:
            self._builder.UpdateEdge(edge, 2.0 * error)
            for vertex in vertices_of(edge):
                self._builder.UpdateVertex(vertex, 2.0 * error)

    def _loosen_to(self, origin: Floats, normal: Floats, edges: Sequence[TopoDS_Edge]) -> None:
        """Set the tolerance of edges to their distance from the plane of a wall.

        A wall along the axis of a cylinder is a plane through the axis. The edge of the texture leaves this plane by
        less than the error of the texture.
        """
        for edge in edges:
            adaptor = BRepAdaptor_Curve(edge)
            at = np.linspace(adaptor.FirstParameter(), adaptor.LastParameter(), 65)
            points = [adaptor.Value(parameter) for parameter in at.tolist()]
            off = (np.array([(point.X(), point.Y(), point.Z()) for point in points]) - origin) @ normal
            self._loosen(edge, float(np.abs(off).max()))

    def _wall(self, number: int, k: int) -> TopoDS_Face:
        """Return the wall between an edge of the outline and the edges of the texture above or below it."""
        outline = self._region.loops[number][k]
        pieces = [piece for _, piece in self._arrangement.outline[number, k]]
        uppers = [self._edges[piece.key] if piece.forward else turned(self._edges[piece.key]) for piece in pieces]
        start, end = vertices_of(outline.foot)
        posts = self._post(number, k, start, pieces[0].start), self._post(number, k + 1, end, pieces[-1].end)
        surface, natural = self._wall_surface(outline, pieces, posts)
        edges = [outline.foot, posts[1], *(turned(edge) for edge in reversed(uppers)), turned(posts[0])]
        if natural:
            return self._top.face(surface, [self._top.wire(edges)])
        wire = self._top.wire([turned(edge) for edge in reversed(edges)])
        return TopoDS.Face_s(self._top.face(surface, [wire]).Reversed())

    def _post(self, number: int, k: int, foot: TopoDS_Vertex, node: int) -> TopoDS_Edge:
        """Return the edge from the outline's vertex on the face to the vertex of the texture."""
        key = (number, k % len(self._region.loops[number]))
        if key not in self._posts:
            top = self._vertex(node)
            a, b = (BRep_Tool.Pnt_s(vertex) for vertex in (foot, top))
            self._posts[key] = self._top.segment((a.X(), a.Y(), a.Z()), (b.X(), b.Y(), b.Z()), foot, top)
        return self._posts[key]

    def _wall_surface(
        self, outline: OutlineEdge, pieces: Sequence[Piece], posts: tuple[TopoDS_Edge, TopoDS_Edge]
    ) -> tuple[object, bool]:
        """Return the surface of a wall, with curves on it, and whether its normal points out of the material."""
        frame = self._region.frame
        if outline.kind == "line":
            points = outline.samples
            middle = points.mean(axis=0)
            ends = frame.point(points[:, 0], points[:, 1], 0.0)
            near = middle + np.outer([-1e-3, 1e-3], points[1] - points[0])
            way = np.diff(frame.point(near[:, 0], near[:, 1], 0.0), axis=0)[0]
            normal = np.cross(way, frame.normal(float(middle[0]))) * (-1.0 if self._sunk else 1.0)
            self._loosen_to(ends[0], normal / np.linalg.norm(normal), [*posts, *(self._edges[p.key] for p in pieces)])
            return plane(tuple(ends[0].tolist()), tuple(normal.tolist()), tuple(way.tolist())), True
        adaptor = BRepAdaptor_Curve(outline.foot)
        up = frame.axes[2]
        sign = 1.0
        if adaptor.GetType() == GeomAbs_CurveType.GeomAbs_Circle:
            place = adaptor.Circle().Position()
            axis = np.array([place.Direction().X(), place.Direction().Y(), place.Direction().Z()])
            sign = 1.0 if float(axis @ up) > 0.0 else -1.0
            own = gp_Ax3(place.Location(), place.Direction(), place.XDirection())
            surface = Geom_CylindricalSurface(own, adaptor.Circle().Radius())
        else:
            curve = adaptor.Curve().Curve().Transformed(adaptor.Trsf())
            surface = Geom_SurfaceOfLinearExtrusion(curve, gp_Dir(*up.tolist()))
        self._lay(outline.foot, Geom2d_Line(gp_Pnt2d(0.0, 0.0), gp_Dir2d(1.0, 0.0)), surface)
        travel = (outline.first, outline.last) if outline.forward else (outline.last, outline.first)
        for post, at in zip(posts, travel, strict=True):
            # The post begins on the face and runs along the normal, or against it below the face.
            way = sign * (-1.0 if self._sunk else 1.0)
            self._lay(post, Geom2d_Line(gp_Pnt2d(at, 0.0), gp_Dir2d(0.0, way)), surface)
        for piece in pieces:
            edge = self._edges[piece.key]
            own_curve = BRep_Tool.Curve_s(edge, 0.0, 1.0)
            self._lay(edge, self._unrolled(own_curve, sign), surface)
        return surface, (outline.forward == (sign > 0.0)) != self._sunk

    def _unrolled(self, curve: Geom_BSplineCurve, sign: float) -> Geom2d_Curve:
        """Return the curve of an edge of the texture on a wall: the parameter of the outline, and the height."""
        frame = self._region.frame
        knots = np.array([curve.Knot(k) for k in range(1, curve.NbKnots() + 1)])
        times = [curve.Multiplicity(k) for k in range(1, curve.NbKnots() + 1)]
        flat = np.repeat(knots, times)
        places = greville(flat, _DEGREE)
        poles = [curve.Pole(k) for k in range(1, curve.NbPoles() + 1)]
        points = np.array([(pole.X(), pole.Y(), pole.Z()) for pole in poles])
        heights = sign * ((points - frame.origin) @ frame.axes[2])
        array = TColgp_Array1OfPnt2d(1, len(places))
        for k, (u, v) in enumerate(zip(places.tolist(), heights.tolist(), strict=True), start=1):
            array.SetValue(k, gp_Pnt2d(u, v))
        return Geom2d_BSplineCurve(array, kernelsplines.reals(knots), kernelsplines.integers(times), _DEGREE, False)

    def _lay(self, edge: TopoDS_Edge, trace: Geom2d_Curve, surface: object) -> None:
        tolerance = max(BRep_Tool.Tolerance_s(edge), TOLERANCE_MM)
        self._builder.UpdateEdge(edge, trace, surface, TopLoc_Location(), tolerance)


def _fitted(at: object, low: float, high: float) -> tuple[Floats, Floats, float]:
    """Interpolate a curve by a spline. Return its poles, its knots and the largest distance at points between."""
    from scipy.interpolate import BSpline, make_interp_spline

    spans = 2
    while True:
        breaks = np.linspace(low, high, spans + 1)
        knots = np.concatenate([[low] * _DEGREE, breaks, [high] * _DEGREE])
        places = greville(knots, _DEGREE)
        places[0], places[-1] = low, high
        points = at(places)  # type: ignore[operator]
        poles = make_interp_spline(places, points, k=_DEGREE, t=knots).c
        poles[0], poles[-1] = points[0], points[-1]
        tests = np.linspace(low, high, _TESTS_PER_SPAN * spans + 1)
        off = BSpline(knots, poles, _DEGREE)(tests) - at(tests)  # type: ignore[operator]
        error = float(np.linalg.norm(off, axis=1).max())
        if error <= EDGE_MM or len(poles) > _MAX_EDGE_POLES:
            return poles, knots, error
        spans = int(spans * min(3.0, max(1.3, (error / EDGE_MM) ** 0.2))) + 1


def _multiplicities(knots: Floats) -> tuple[Floats, list[int]]:
    inner = knots[_DEGREE:-_DEGREE]
    return inner, [_DEGREE + 1, *([1] * (len(inner) - 2)), _DEGREE + 1]
