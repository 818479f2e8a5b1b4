"""The region of a face that gets the texture: the face without a margin, divided from the rest of the face."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepAdaptor import BRepAdaptor_Curve, BRepAdaptor_Surface
from OCP.BRepAlgoAPI import BRepAlgoAPI_Cut, BRepAlgoAPI_Splitter
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeEdge, BRepBuilderAPI_MakeFace, BRepBuilderAPI_MakeWire
from OCP.BRepOffsetAPI import BRepOffsetAPI_MakeOffset
from OCP.BRepTools import BRepTools, BRepTools_WireExplorer
from OCP.Geom2d import Geom2d_Curve, Geom2d_Line
from OCP.GeomAbs import GeomAbs_CurveType, GeomAbs_JoinType
from OCP.GeomAPI import GeomAPI
from OCP.GeomConvert import GeomConvert_ApproxCurve
from OCP.gp import gp_Ax2, gp_Ax3, gp_Circ, gp_Dir, gp_Dir2d, gp_Pln, gp_Pnt, gp_Pnt2d
from OCP.TopAbs import TopAbs_Orientation
from OCP.TopoDS import TopoDS_Edge, TopoDS_Face, TopoDS_Shape, TopoDS_Vertex, TopoDS_Wire
from OCP.TopTools import TopTools_ListOfShape

from tacbench_cad.geometry import kernel
from tacbench_cad.geometry.textured.frame import Frame
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.types import Bools, Floats

if TYPE_CHECKING:
    from OCP.Geom import Geom_Curve

#: The number of points along an edge of the outline at which its position is tested.
SAMPLES = 721
#: The largest distance between the offset of a free curve and its approximation, in mm.
CURVE_MM = 1e-6
#: The sine of the smallest angle of a convex corner.
_CORNER = 1e-2
#: Coordinates of an outline that differ by less than this are equal, in mm.
SAME_MM = 1e-6


@dataclass(frozen=True, eq=False)
class OutlineEdge:
    """An edge of the outline of the region. The region is on the left, seen against the normal.

    Args:
        foot: The edge on the face, with the direction along the outline.
        curve: The same curve in the local coordinates (s, t).
        first: The smallest parameter of the curve.
        last: The largest parameter of the curve.
        forward: Whether the outline runs along increasing parameters.
        at: The curve as a function of an array of parameters, with values of shape (n, 2).
        kind: ``line``, ``circle`` or ``free``.
    """

    foot: TopoDS_Edge
    curve: Geom2d_Curve
    first: float
    last: float
    forward: bool
    at: Callable[[Floats], Floats]
    kind: str

    @cached_property
    def samples(self) -> Floats:
        """Points along the outline, shape (n, 2)."""
        count = 2 if self.kind == "line" else SAMPLES
        points = self.at(np.linspace(self.first, self.last, count))
        return points if self.forward else points[::-1]


@dataclass(frozen=True, eq=False)
class Region:
    """A connected region of a face.

    Args:
        frame: The local coordinates. The lowest s and t of the region are 0; on a closed cylinder s = 0 is at ``up``.
        loops: The outline: one or more closed loops of edges.
        face: The region as a face, with its orientation in the solid.
        size_mm: The extents along s and t.
        is_closed: Whether the region goes all the way around a cylinder.
    """

    frame: Frame
    loops: tuple[tuple[OutlineEdge, ...], ...]
    face: TopoDS_Face
    size_mm: tuple[float, float]
    is_closed: bool

    @property
    def is_rectangle(self) -> bool:
        """Whether the region is a rectangle along s and t, or a band around a cylinder."""
        if self.is_closed:
            return True
        if len(self.loops) != 1 or any(edge.kind != "line" for edge in self.loops[0]):
            return False
        corners = np.array([edge.samples for edge in self.loops[0]])
        return bool(np.all(np.abs(np.diff(corners, axis=1)).min(axis=2) < SAME_MM)) and len(corners) == 4


def divide(face: TopoDS_Face, frame: Frame, margin_mm: float) -> tuple[list[TopoDS_Face], list[Region]]:
    """Divide a face into its margin and the regions inside of the margin.

    Args:
        face: The face, with its orientation in the solid.
        frame: Its local coordinates.
        margin_mm: The distance between the regions and the edges of the face.

    Returns:
        The faces of the margin, and the regions.

    Raises:
        InputError: The margin leaves nothing of the face, or a cylinder has edges that are neither circles around its
            axis nor lines along it.
    """
    flat = frame.radius_mm is None
    outlines = _inset(face, margin_mm) if flat else _band(face, frame, margin_mm)
    pieces = _split(face, outlines)
    old = kernel.distinct(face, "EDGE")
    rims, regions = [], []
    for piece in pieces:
        is_rim = any(edge.IsSame(other) for edge in kernel.distinct(piece, "EDGE") for other in old)
        if is_rim or not (flat or _is_inside(piece, frame, outlines)):
            rims.append(piece)
        else:
            regions.append(_region(piece, frame))
    if not regions:
        raise CheckFailedError("the kernel cannot divide the face along its margin; choose another margin_mm")
    return rims, regions


def _is_inside(piece: TopoDS_Face, frame: Frame, outlines: list[TopoDS_Edge]) -> bool:
    """Return whether a piece of a cylinder is bounded by the whole outline along t."""
    ends = np.array([frame.local(_at(edge, 0.5))[1] for edge in outlines])
    own = np.array([frame.local(_at(edge, 0.5))[1] for edge in kernel.distinct(piece, "EDGE")])
    return bool(abs(own.min() - ends.min()) < SAME_MM and abs(own.max() - ends.max()) < SAME_MM)


def _inset(face: TopoDS_Face, margin_mm: float) -> list[TopoDS_Edge]:
    """Return the edges of the outlines of a planar face without its margin."""
    plane = BRepAdaptor_Surface(face).Plane()
    outer = BRepTools.OuterWire_s(face)
    inside = [_face_in(plane, wire) for wire in _offset(outer, -margin_mm)]
    for wire in kernel.each(face, "WIRE"):
        if wire.IsSame(outer):
            continue
        for grown in _offset(wire, margin_mm)[:1]:
            tool = _face_in(plane, grown)
            inside = [part for old in inside for part in kernel.each(BRepAlgoAPI_Cut(old, tool).Shape(), "FACE")]
    if not inside:
        raise InputError("margin_mm", margin_mm, "leaves nothing of the face; choose a smaller margin")
    return [edge for part in inside for edge in kernel.distinct(part, "EDGE")]


def _face_in(plane: gp_Pln, wire: TopoDS_Wire) -> TopoDS_Face:
    return BRepBuilderAPI_MakeFace(plane, wire, True).Face()


def _offset(wire: TopoDS_Wire, distance_mm: float) -> list[TopoDS_Wire]:
    """Offset a wire outwards. The edges of the result are lines, circles and B-splines without a location.

    The kernel's offset applies the location of an edge twice, so the edges are made again before.
    """
    maker = BRepOffsetAPI_MakeOffset(_plain(wire), GeomAbs_JoinType.GeomAbs_Arc, False)
    maker.Perform(distance_mm)
    shape = maker.Shape()
    return [] if shape is None or shape.IsNull() else [_plain(result) for result in kernel.each(shape, "WIRE")]


def _plain(wire: TopoDS_Wire) -> TopoDS_Wire:
    """Make the edges of a wire again. Closed edges are divided in two, and offset curves become B-splines."""
    edges = TopTools_ListOfShape()
    for edge in kernel.each(wire, "EDGE"):
        curve, first, last = _curve(edge)
        adaptor = BRepAdaptor_Curve(edge)
        if adaptor.GetType() == GeomAbs_CurveType.GeomAbs_OffsetCurve:
            from OCP.Geom import Geom_TrimmedCurve
            from OCP.GeomAbs import GeomAbs_Shape

            trimmed = Geom_TrimmedCurve(curve, first, last)
            curve = GeomConvert_ApproxCurve(trimmed, CURVE_MM, GeomAbs_Shape.GeomAbs_C2, 500, 9).Curve()
            first, last = curve.FirstParameter(), curve.LastParameter()
        ends = [curve.Value(first), curve.Value(last)]
        cuts = [first, (first + last) / 2.0, last] if ends[0].Distance(ends[1]) < SAME_MM else [first, last]
        for low, high in itertools.pairwise(cuts):
            edges.Append(BRepBuilderAPI_MakeEdge(curve, low, high).Edge())
    maker = BRepBuilderAPI_MakeWire()
    maker.Add(edges)
    return maker.Wire()


def _curve(edge: TopoDS_Edge) -> tuple[Geom_Curve, float, float]:
    """Return the curve of an edge in the coordinates of the part, with its first and last parameter."""
    adaptor = BRepAdaptor_Curve(edge)
    curve = adaptor.Curve().Curve().Transformed(adaptor.Trsf())
    return curve, adaptor.FirstParameter(), adaptor.LastParameter()


def _at(edge: TopoDS_Edge, fraction: float) -> Floats:
    """Return the point of an edge at a fraction of its parameters, in the coordinates of the part."""
    adaptor = BRepAdaptor_Curve(edge)
    first, last = adaptor.FirstParameter(), adaptor.LastParameter()
    point = adaptor.Value(first + fraction * (last - first))
    return np.array([point.X(), point.Y(), point.Z()])


def _band(face: TopoDS_Face, frame: Frame, margin_mm: float) -> list[TopoDS_Edge]:
    """Return the edges of the outline of a cylindrical face without its margin."""
    for edge in kernel.distinct(face, "EDGE"):
        if BRep_Tool.Degenerated_s(edge):
            continue
        points = (np.stack([_at(edge, k / 8.0) for k in range(9)]) - frame.origin) @ frame.axes.T
        angles = np.unwrap(np.arctan2(points[:, 1], points[:, 0]))
        if np.ptp(points[:, 2]) > 1e-5 and np.ptp(angles) > 1e-6:
            raise InputError(
                "face",
                None,
                "is a cylinder with a hole or a slanted rim; put the texture on the cylinder before you cut the hole "
                "or the rim",
            )
    surface = BRepAdaptor_Surface(face)
    ends = (surface.FirstUParameter(), surface.LastUParameter(), surface.FirstVParameter(), surface.LastVParameter())
    full = ends[1] - ends[0] > 2.0 * math.pi - 1e-7
    assert frame.radius_mm is not None
    u0, u1, v0, v1 = ends
    inset = margin_mm / frame.radius_mm
    if v1 - v0 <= 2.0 * margin_mm + SAME_MM or not (full or u1 - u0 > 2.0 * inset + SAME_MM):
        raise InputError("margin_mm", margin_mm, "leaves nothing of the face; choose a smaller margin")
    v0, v1 = v0 + margin_mm, v1 - margin_mm
    if len(kernel.distinct(face, "WIRE")) > 1 and not full:
        raise InputError(
            "face", None, "is a cylinder with a hole; put the texture on the cylinder before you cut the hole"
        )
    cylinder = surface.Cylinder()
    place = cylinder.Position()

    def circle(v: float, low: float, high: float) -> TopoDS_Edge:
        centre = place.Location().XYZ() + place.Direction().XYZ() * v
        return BRepBuilderAPI_MakeEdge(_circle(gp_Pnt(centre), place, cylinder.Radius()), low, high).Edge()

    if full:
        middle = (u0 + u1) / 2.0
        return [circle(v, *ends) for v in (v0, v1) for ends in ((u0, middle), (middle, u1))]
    u0, u1 = u0 + inset, u1 - inset
    corners = {(u, v): surface.Value(u, v) for u in (u0, u1) for v in (v0, v1)}
    sides = [BRepBuilderAPI_MakeEdge(corners[u, v0], corners[u, v1]).Edge() for u in (u0, u1)]
    return [circle(v0, u0, u1), circle(v1, u0, u1), *sides]


def _circle(centre: gp_Pnt, place: gp_Ax3, radius: float) -> gp_Circ:
    """Return a circle around an axis whose parameter is the angle of the cylinder with this axis."""
    normal = place.XDirection().Crossed(place.YDirection())
    return gp_Circ(gp_Ax2(centre, normal, place.XDirection()), radius)


def _split(face: TopoDS_Face, edges: list[TopoDS_Edge]) -> list[TopoDS_Face]:
    arguments, tools = TopTools_ListOfShape(), TopTools_ListOfShape()
    arguments.Append(face)
    for edge in edges:
        tools.Append(edge)
    splitter = BRepAlgoAPI_Splitter()
    splitter.SetArguments(arguments)
    splitter.SetTools(tools)
    splitter.Build()
    return list(kernel.each(splitter.Shape(), "FACE"))


def _region(piece: TopoDS_Face, frame: Frame) -> Region:
    """Describe a piece of the face. The origin of the frame is moved to its lower corner."""
    wires = [_edges_in_order(wire, piece) for wire in kernel.each(piece, "WIRE")]
    wires = [loop for wire in wires for loop in _without_seams(wire, piece)]
    points = np.concatenate([_extents(edge, frame) for wire in wires for edge in wire])
    closed = False
    if frame.radius_mm is None:
        frame = frame.moved(*points.min(axis=0).tolist())
    else:
        closed = len(wires) == 2
        start = 0.0 if closed else _start(points[:, 0], 2.0 * math.pi * frame.radius_mm)
        frame = frame.moved(start, float(points[:, 1].min()))
    loops = tuple(_loop(wire, frame) for wire in wires)
    size = np.concatenate([edge.samples for loop in loops for edge in loop]).max(axis=0)
    s_size = float(frame.around_mm or 0.0) if closed else float(size[0])
    if frame.radius_mm is None:
        ends = np.concatenate([_extents(edge, frame) for wire in wires for edge in wire]).max(axis=0)
        s_size, size = float(ends[0]), ends
    return Region(frame, loops, piece, (s_size, float(size[1])), closed)


def _start(angles_mm: Floats, around_mm: float) -> float:
    """Return the coordinate at which a part of a cylinder begins: the end of the largest gap between its points."""
    points = np.sort(angles_mm)
    gaps = np.diff(points, append=points[0] + around_mm)
    return float(points[(int(np.argmax(gaps)) + 1) % len(points)])


def _edges_in_order(wire: TopoDS_Wire, face: TopoDS_Face) -> list[TopoDS_Edge]:
    explorer, edges = BRepTools_WireExplorer(wire, face), []
    while explorer.More():
        edges.append(explorer.Current())
        explorer.Next()
    if len(edges) != len(list(kernel.each(wire, "EDGE"))):
        raise CheckFailedError("the kernel gives an outline whose edges are not connected; choose another margin_mm")
    return edges


def _without_seams(edges: list[TopoDS_Edge], face: TopoDS_Face) -> Iterator[list[TopoDS_Edge]]:
    """Yield the closed loops that remain if the seam of a cylinder is left out of a wire."""
    seams = [BRep_Tool.IsClosed_s(edge, face) for edge in edges]
    if not any(seams):
        yield edges
        return
    first = seams.index(True)
    loop: list[TopoDS_Edge] = []
    for k in range(first, first + len(edges)):
        if not seams[k % len(edges)]:
            loop.append(edges[k % len(edges)])
        elif loop:
            yield loop
            loop = []
    if loop:
        yield loop


def _extents(edge: TopoDS_Edge, frame: Frame) -> Floats:
    """Return the local coordinates of points of an edge. On a plane, these include the extremes of circles."""
    adaptor = BRepAdaptor_Curve(edge)
    first, last = adaptor.FirstParameter(), adaptor.LastParameter()
    at = np.linspace(first, last, SAMPLES if frame.radius_mm is None else 33)
    if adaptor.GetType() == GeomAbs_CurveType.GeomAbs_Circle and frame.radius_mm is None:
        place = adaptor.Circle().Position()
        basis = np.array([_xyz(place.XDirection()), _xyz(place.YDirection())]) @ frame.axes[:2].T
        angles = np.arctan2(basis[1], basis[0])
        extremes = (angles[:, None] + math.pi * np.arange(-4, 8)).ravel()
        at = np.append(at, extremes[(extremes >= first) & (extremes <= last)])
    points = [adaptor.Value(parameter) for parameter in at.tolist()]
    return frame.local(np.array([_xyz(point) for point in points]))


def _xyz(point: Any) -> Floats:
    return np.array([point.X(), point.Y(), point.Z()])


def _loop(edges: list[TopoDS_Edge], frame: Frame) -> tuple[OutlineEdge, ...]:
    return tuple(_flat_edge(edge, frame) if frame.radius_mm is None else _round_edge(edge, frame) for edge in edges)


def _flat_edge(edge: TopoDS_Edge, frame: Frame) -> OutlineEdge:
    curve, first, last = _curve(edge)
    origin, normal, along = gp_Pnt(*frame.origin), gp_Dir(*frame.axes[2]), gp_Dir(*frame.axes[0])
    flat = GeomAPI.To2d_s(curve, gp_Pln(gp_Ax3(origin, normal, along)))
    forward = edge.Orientation() == TopAbs_Orientation.TopAbs_FORWARD
    kind = BRepAdaptor_Curve(edge).GetType()
    if kind == GeomAbs_CurveType.GeomAbs_Line:
        return OutlineEdge(edge, flat, first, last, forward, _line(flat), "line")
    if kind == GeomAbs_CurveType.GeomAbs_Circle:
        return OutlineEdge(edge, flat, first, last, forward, _arc(flat), "circle")
    return OutlineEdge(edge, flat, first, last, forward, _free(flat), "free")


def _round_edge(edge: TopoDS_Edge, frame: Frame) -> OutlineEdge:
    """Describe an edge of a cylinder as a line in the local coordinates. Its parameter is its length."""
    around = frame.around_mm
    assert around is not None
    points = frame.local(np.stack([_at(edge, fraction) for fraction in (0.0, 0.25, 0.5, 0.75, 1.0)]))
    if edge.Orientation() == TopAbs_Orientation.TopAbs_REVERSED:
        points = points[::-1]
    points = np.stack([np.unwrap(points[:, 0], period=around), points[:, 1]], axis=1)
    points[np.abs(points) < SAME_MM] = 0.0
    if points[:, 0].max() > around + SAME_MM:
        points[:, 0] -= around
    a, b = points[0], points[-1]
    length = float(np.linalg.norm(b - a))
    flat = Geom2d_Line(gp_Pnt2d(*a), gp_Dir2d(*(b - a)))
    return OutlineEdge(edge, flat, 0.0, length, True, _line(flat), "line")


def _line(line: Geom2d_Line) -> Callable[[Floats], Floats]:
    place, way = line.Location(), line.Direction()
    start, step = np.array([place.X(), place.Y()]), np.array([way.X(), way.Y()])
    return lambda at: start + np.multiply.outer(at, step)


def _arc(circle: Any) -> Callable[[Floats], Floats]:
    round_ = circle.Circ2d()
    centre, x, y = round_.Location(), round_.XAxis().Direction(), round_.YAxis().Direction()
    axes = round_.Radius() * np.array([[x.X(), x.Y()], [y.X(), y.Y()]])
    middle = np.array([centre.X(), centre.Y()])
    return lambda at: middle + np.stack([np.cos(at), np.sin(at)], axis=-1) @ axes


def _free(curve: Geom2d_Curve) -> Callable[[Floats], Floats]:
    def at(parameters: Floats) -> Floats:
        points = [curve.Value(parameter) for parameter in np.ravel(parameters).tolist()]
        return np.array([(point.X(), point.Y()) for point in points]).reshape(*np.shape(parameters), 2)

    return at


def distances(region: Region, far_mm: float, points: Floats) -> list[Floats]:
    """Return the distances of points, shape (n, 2), from each part of the outline between two convex corners.

    The distances are right up to ``far_mm``. They are smooth near the outline.
    """
    result = []
    for loop in region.loops:
        chains: list[list[OutlineEdge]] = [[]]
        for before, edge in zip((loop[-1], *loop), loop, strict=False):
            (ax, ay), (bx, by) = np.diff(before.samples[-2:], axis=0)[0], np.diff(edge.samples[:2], axis=0)[0]
            if ax * by - ay * bx > _CORNER * math.hypot(ax, ay) * math.hypot(bx, by):
                chains.append([])
            chains[-1].append(edge)
        if len(chains) > 1:
            chains[-1].extend(chains.pop(0))
        for chain in chains:
            own = [distance(edge, points, far_mm) for edge in chain]
            result.append(np.min(own, axis=0))
    return result


def inside(region: Region, s: Floats, t: Floats) -> Bools:
    """Return which points of a grid are inside of a region, shape (n, m). The coordinates ascend."""
    result = np.zeros((len(s), len(t)), dtype=np.bool_)
    for loop in region.loops:
        for edge in loop:
            points = edge.samples
            for (s0, t0), (s1, t1) in zip(points[:-1].tolist(), points[1:].tolist(), strict=True):
                first, last = np.searchsorted(t, (min(t0, t1), max(t0, t1))).tolist()
                if last > first:
                    crossing = s0 + (t[first:last] - t0) / (t1 - t0) * (s1 - s0)
                    result[:, first:last] ^= s[:, None] > crossing
    return result


def distance(edge: OutlineEdge, points: Floats, far_mm: float) -> Floats:
    """Return the distances of points, shape (n, 2), from an edge of the outline. They are right up to ``far_mm``."""
    samples = edge.samples
    low, high = samples.min(axis=0) - far_mm, samples.max(axis=0) + far_mm
    if edge.kind != "line":  # the samples of a curve miss its extremes by a little
        low, high = low - 1e-3 * far_mm - np.ptp(samples) / SAMPLES, high + 1e-3 * far_mm + np.ptp(samples) / SAMPLES
    near = np.all((points >= low) & (points <= high), axis=1)
    result = np.full(len(points), np.inf)
    result[near] = _distance(edge, points[near], far_mm)
    return result


def _distance(edge: OutlineEdge, points: Floats, far_mm: float) -> Floats:
    """Return the distances of points near an edge of the outline."""
    from scipy.spatial import cKDTree

    if edge.kind == "line":
        return _from_segments(points, edge.samples[0], edge.samples[-1])
    if edge.kind == "circle":
        a, b, c = edge.at(np.array([edge.first, edge.first + math.pi, (edge.first + edge.last) / 2.0]))
        centre = (a + b) / 2.0
        away = points - centre
        middle, half = c - centre, (edge.last - edge.first) / 2.0
        angle = np.abs(np.arctan2(middle[0] * away[:, 1] - middle[1] * away[:, 0], away @ middle))
        ends = edge.at(np.array([edge.first, edge.last]))
        from_ends = np.minimum(*(np.hypot(*(points - end).T) for end in ends))
        from_circle = np.abs(np.hypot(*away.T) - np.hypot(*middle))
        return np.asarray(np.where(angle <= half, from_circle, from_ends))
    samples = edge.at(np.linspace(edge.first, edge.last, 2001))
    _, near = cKDTree(samples).query(points, distance_upper_bound=1.01 * far_mm)
    known = near < len(samples)
    result = np.full(len(points), np.inf)
    for first in (np.maximum(near - 1, 0), np.minimum(near, len(samples) - 2)):
        k = first[known]
        result[known] = np.minimum(result[known], _from_segments(points[known], samples[k], samples[k + 1]))
    return result


def _from_segments(points: Floats, a: Floats, b: Floats) -> Floats:
    """Return the distances of points from segments from a to b."""
    (x, y), (ax, ay), (bx, by) = points.T, np.transpose(a), np.transpose(b)
    way_x, way_y, x, y = bx - ax, by - ay, x - ax, y - ay
    fraction = np.clip((x * way_x + y * way_y) / (way_x**2 + way_y**2), 0.0, 1.0)
    return np.asarray(np.hypot(x - fraction * way_x, y - fraction * way_y))


def vertices_of(edge: TopoDS_Edge) -> tuple[TopoDS_Vertex, TopoDS_Vertex]:
    """Return the start and the end of an edge along its direction."""
    from OCP.TopExp import TopExp

    return TopExp.FirstVertex_s(edge, True), TopExp.LastVertex_s(edge, True)


def thickened(region: Region, low_mm: float, high_mm: float) -> TopoDS_Shape:
    """Return the space above a region between two heights along its normal, as a solid."""
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakePolygon, BRepBuilderAPI_Transform
    from OCP.BRepPrimAPI import BRepPrimAPI_MakePrism, BRepPrimAPI_MakeRevol
    from OCP.gp import gp_Ax1, gp_Trsf, gp_Vec

    frame = region.frame
    if frame.radius_mm is None:
        move = gp_Trsf()
        move.SetTranslation(gp_Vec(*(frame.axes[2] * low_mm).tolist()))
        start = BRepBuilderAPI_Transform(region.face, move, True).Shape()
        return BRepPrimAPI_MakePrism(start, gp_Vec(*(frame.axes[2] * (high_mm - low_mm)).tolist())).Shape()
    length = region.size_mm[1]
    polygon = BRepBuilderAPI_MakePolygon()
    for t, h in ((0.0, low_mm), (length, low_mm), (length, high_mm), (0.0, high_mm)):
        polygon.Add(gp_Pnt(*frame.point(np.array(0.0), np.array(t), h).tolist()))
    polygon.Close()
    profile = BRepBuilderAPI_MakeFace(polygon.Wire(), True).Face()
    axis = gp_Ax1(gp_Pnt(*frame.origin.tolist()), gp_Dir(*(frame.side * frame.axes[2]).tolist()))
    if region.is_closed:
        return BRepPrimAPI_MakeRevol(profile, axis).Shape()
    return BRepPrimAPI_MakeRevol(profile, axis, region.size_mm[0] / frame.radius_mm).Shape()
