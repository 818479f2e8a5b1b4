"""The areas of a face of a CAD solid inside of its margin."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import shapely
from OCP.BRep import BRep_Tool
from OCP.BRepAdaptor import BRepAdaptor_Curve, BRepAdaptor_Surface
from OCP.BRepAlgoAPI import BRepAlgoAPI_Cut
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeEdge, BRepBuilderAPI_MakeFace, BRepBuilderAPI_MakeWire
from OCP.BRepOffsetAPI import BRepOffsetAPI_MakeOffset
from OCP.BRepTools import BRepTools, BRepTools_WireExplorer
from OCP.GCPnts import GCPnts_QuasiUniformDeflection
from OCP.Geom import Geom_TrimmedCurve
from OCP.GeomAbs import GeomAbs_CurveType, GeomAbs_JoinType, GeomAbs_Shape
from OCP.GeomConvert import GeomConvert_ApproxCurve
from OCP.TopAbs import TopAbs_Orientation
from OCP.TopoDS import TopoDS_Edge, TopoDS_Face, TopoDS_Wire
from OCP.TopTools import TopTools_ListOfShape

from tacbench_cad.geometry import kernel
from tacbench_cad.geometry.textured.area import SAME_MM, Area
from tacbench_cad.geometry.textured.frame import Frame
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats

#: The largest distance between the offset of a free curve and its approximation, in mm.
_CURVE_MM = 1e-6
#: The largest distance between an outline and its chords, in mm.
_CHORD_MM = 1e-4


def areas_of(face: TopoDS_Face, frame: Frame, margin_mm: float) -> list[Area]:
    """Return the areas of a face inside of its margin.

    Args:
        face: The face, with its orientation in the solid.
        frame: Its local coordinates.
        margin_mm: The distance between the areas and the edges of the face.

    Raises:
        InputError: The margin leaves nothing of the face, or a cylinder has edges that are neither circles around its
            axis nor lines along it.
    """
    areas = (
        _bands(face, frame, margin_mm) if frame.radius_mm else [_area(part, frame) for part in _inset(face, margin_mm)]
    )
    if not areas:
        raise InputError("margin_mm", margin_mm, "leaves nothing of the face; choose a smaller margin")
    return areas


def _inset(face: TopoDS_Face, margin_mm: float) -> list[TopoDS_Face]:
    """Return a planar face without its margin, as one or more faces."""
    plane, outer = BRepAdaptor_Surface(face).Plane(), BRepTools.OuterWire_s(face)
    inside = [BRepBuilderAPI_MakeFace(plane, wire, True).Face() for wire in _offset(outer, -margin_mm)]
    for wire in kernel.each(face, "WIRE"):
        for grown in [] if wire.IsSame(outer) else _offset(wire, margin_mm)[:1]:
            tool = BRepBuilderAPI_MakeFace(plane, grown, True).Face()
            inside = [part for old in inside for part in kernel.each(BRepAlgoAPI_Cut(old, tool).Shape(), "FACE")]
    return inside


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
        adaptor = BRepAdaptor_Curve(edge)
        curve = adaptor.Curve().Curve().Transformed(adaptor.Trsf())
        first, last = adaptor.FirstParameter(), adaptor.LastParameter()
        if adaptor.GetType() == GeomAbs_CurveType.GeomAbs_OffsetCurve:
            trimmed = Geom_TrimmedCurve(curve, first, last)
            curve = GeomConvert_ApproxCurve(trimmed, _CURVE_MM, GeomAbs_Shape.GeomAbs_C2, 500, 9).Curve()
            first, last = curve.FirstParameter(), curve.LastParameter()
        closed = curve.Value(first).Distance(curve.Value(last)) < SAME_MM
        for low, high in itertools.pairwise([first, (first + last) / 2.0, last] if closed else [first, last]):
            edges.Append(BRepBuilderAPI_MakeEdge(curve, low, high).Edge())
    maker = BRepBuilderAPI_MakeWire()
    maker.Add(edges)
    return maker.Wire()


def _area(face: TopoDS_Face, frame: Frame) -> Area:
    """Describe a planar face. The lower corner of its box becomes the origin."""
    to_local = np.eye(4)
    to_local[:3, :3], to_local[:3, 3] = frame.axes, -frame.axes @ frame.origin
    low, high = kernel.box_mm(face.Moved(kernel.location(to_local)))
    own, outer = frame.moved(*low[:2].tolist()), BRepTools.OuterWire_s(face)
    holes = [own.local(_chords(wire)) for wire in kernel.each(face, "WIRE") if not wire.IsSame(outer)]
    polygon = shapely.Polygon(own.local(_chords(outer)), holes)
    s, t = (high - low)[:2].tolist()
    return Area(own, polygon, (s, t), face=face)


def _chords(wire: TopoDS_Wire) -> Floats:
    """Return points along a wire whose chords are near to its edges, shape (n, 3)."""
    explorer, runs = BRepTools_WireExplorer(wire), []
    while explorer.More():
        edge = explorer.Current()
        run = _points(edge)
        runs.append(run[:-1] if edge.Orientation() == TopAbs_Orientation.TopAbs_FORWARD else run[:0:-1])
        explorer.Next()
    return np.concatenate(runs)


def _points(edge: TopoDS_Edge) -> Floats:
    """Return points along an edge in the direction of its curve, shape (n, 3)."""
    places = GCPnts_QuasiUniformDeflection(BRepAdaptor_Curve(edge), _CHORD_MM)
    points: list[Any] = [places.Value(k) for k in range(1, places.NbPoints() + 1)]
    return np.array([(point.X(), point.Y(), point.Z()) for point in points])


def _bands(face: TopoDS_Face, frame: Frame, margin_mm: float) -> list[Area]:
    """Return the part of a cylindrical face inside of its margin, which is a rectangle or a closed band."""
    assert frame.radius_mm is not None and frame.around_mm is not None
    runs = [frame.local(_points(edge)) for edge in kernel.distinct(face, "EDGE") if not BRep_Tool.Degenerated_s(edge)]
    s, t = np.concatenate(runs).T
    low, high = float(t.min()), float(t.max())
    for along, across in (run.T for run in runs):
        is_line = np.ptp(np.unwrap(along, period=frame.around_mm)) < SAME_MM * frame.radius_mm
        if not is_line and np.minimum(across - low, high - across).max() > 1e-5:
            raise InputError(
                "face",
                None,
                "is a cylinder with a hole or a slanted rim; put the texture on the cylinder before you cut the hole "
                "or the rim",
            )
    surface = BRepAdaptor_Surface(face)
    closed = surface.LastUParameter() - surface.FirstUParameter() > 2.0 * math.pi - 1e-7
    around, start, inset = frame.around_mm, 0.0, 0.0
    if not closed:  # it begins behind the largest gap between the points of its edges
        places = np.sort(s)
        gaps = np.diff(places, append=places[0] + around)
        start = float(places[(int(np.argmax(gaps)) + 1) % len(places)])
        around, inset = around - float(gaps.max()), margin_mm
    size = (around - 2.0 * inset, high - low - 2.0 * margin_mm)
    own = frame.moved(start + inset, low + margin_mm)
    return [Area.rectangle(own, size, closed)] if min(size) > SAME_MM else []
