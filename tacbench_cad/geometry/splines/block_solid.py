"""The solid and the textured surface of a block from its spline patches, cut along the outline and the label."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely
from OCP.BRepAlgoAPI import BRepAlgoAPI_Common, BRepAlgoAPI_Cut
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeEdge, BRepBuilderAPI_MakeFace, BRepBuilderAPI_MakePolygon
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeWire as MakeWire
from OCP.BRepPrimAPI import BRepPrimAPI_MakePrism
from OCP.Geom import Geom_BSplineSurface
from OCP.Geom2d import Geom2d_Line
from OCP.gp import gp_Ax2, gp_Circ, gp_Dir, gp_Dir2d, gp_Pnt, gp_Pnt2d, gp_Vec
from OCP.TopoDS import TopoDS, TopoDS_Face, TopoDS_Shape, TopoDS_Solid, TopoDS_Wire

from tacbench_cad.geometry import kernel
from tacbench_cad.geometry.solids import compound
from tacbench_cad.geometry.splines import kernelsplines
from tacbench_cad.geometry.splines.exact import SplinePatches
from tacbench_cad.geometry.splines.patch_solid import solid_between
from tacbench_cad.geometry.splines.patches import Patches
from tacbench_cad.geometry.splines.topology import Topology, turned
from tacbench_cad.geometry.textured.frame import Frame
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.label import LABEL_DEPTH_MM, Engraving
from tacbench_cad.spec.outlines import Circle, Corners, Loop, LoopRegion, Polygons, area_mm2, key_wedge
from tacbench_cad.util.errors import CheckFailedError
from tacbench_cad.util.types import Floats

#: The distance by which the tools of the cuts extend beyond the block, in mm.
_BEYOND_MM = 1.0


def solid_of(block: Block, relief: Patches | SplinePatches) -> TopoDS_Solid:
    """Return the solid of a block.

    Raises:
        CheckFailedError: The kernel does not cut it into exactly one solid.
    """
    poles = {
        (i, j): _grid(relief.x.abscissae_mm(i), relief.y.abscissae_mm(j), relief.heights_mm(i, j))
        for i in range(relief.x.patches)
        for j in range(relief.y.patches)
    }
    frame = Frame(np.zeros(3), np.eye(3))
    solid: TopoDS_Shape = solid_between(poles, (relief.x, relief.y), frame, 0.0, is_above=True)
    solid = _inside(solid, block)
    if block.engraving is not None:
        solid = BRepAlgoAPI_Cut(solid, compound([(tool, np.eye(4)) for tool in _pockets(block.engraving)])).Shape()
    return TopoDS.Solid_s(_only(solid, block, "SOLID"))


def face_of(block: Block, relief: Patches | SplinePatches) -> TopoDS_Face:
    """Return one face for the whole surface. Its parameters are x and y in mm.

    Raises:
        CheckFailedError: The kernel does not cut it into exactly one face.
    """
    (knots_x, keep_x), (knots_y, keep_y) = relief.x.joined(), relief.y.joined()
    at_x, at_y = (
        np.concatenate([axis.abscissae_mm(i) for i in range(axis.patches)])[keep]
        for axis, keep in ((relief.x, keep_x), (relief.y, keep_y))
    )
    rows = [np.hstack([relief.heights_mm(i, j) for j in range(relief.y.patches)]) for i in range(relief.x.patches)]
    poles = _grid(at_x, at_y, np.vstack(rows)[np.ix_(keep_x, keep_y)])
    surface = kernelsplines.surface(poles, (knots_x, knots_y), (relief.x.degree, relief.y.degree))
    return TopoDS.Face_s(_only(_inside(_whole(surface, relief.x.lines, relief.y.lines), block), block, "FACE"))


def _whole(surface: Geom_BSplineSurface, x: Floats, y: Floats) -> TopoDS_Face:
    """Return the face of a whole surface, whose sides are divided at lines, so that the kernel's area is accurate."""
    top, (x0, x1), (y0, y1) = Topology(), x[[0, -1]].tolist(), y[[0, -1]].tolist()
    along_x, along_y = x.tolist(), y.tolist()
    corners = [*((at, y0) for at in along_x[:-1]), *((x1, at) for at in along_y[:-1])]
    corners += [*((at, y1) for at in along_x[:0:-1]), *((x0, at) for at in along_y[:0:-1])]
    points = [surface.Value(*corner) for corner in corners]
    vertices = [top.vertex((point.X(), point.Y(), point.Z())) for point in points]
    edges = []
    for k, (a, start) in enumerate(zip(corners, vertices, strict=True)):
        b, end = corners[(k + 1) % len(corners)], vertices[(k + 1) % len(corners)]
        axis = 0 if a[1] == b[1] else 1
        backwards = b[axis] < a[axis]
        (low, high), ends = sorted([a[axis], b[axis]]), (end, start) if backwards else (start, end)
        edge = top.edge(surface.UIso(a[0]) if axis else surface.VIso(a[1]), low, high, *ends)
        trace = (gp_Pnt2d(a[0], 0.0), gp_Dir2d(0.0, 1.0)) if axis else (gp_Pnt2d(0.0, a[1]), gp_Dir2d(1.0, 0.0))
        top.lay(edge, Geom2d_Line(*trace), surface)
        edges.append(turned(edge) if backwards else edge)
    return top.face(surface, [top.wire(edges)], whole=True)


def _inside(shape: TopoDS_Shape, block: Block) -> TopoDS_Shape:
    """Return the part of the solid or surface of a rectangle inside of the outline of a block."""
    ends = (-_BEYOND_MM, block.solid_datum_mm + block.surface.amplitude_sum + _BEYOND_MM)
    if block.outline is not None:
        return BRepAlgoAPI_Common(shape, _prism(block.outline, ends)).Shape()
    if (key := block.key_mm) is None:
        return shape
    wedge = key_wedge(block.size_mm[0], key, _BEYOND_MM)
    return BRepAlgoAPI_Cut(shape, _prism(Polygons((wedge,)), ends)).Shape()


def _only(shape: TopoDS_Shape, block: Block, kind: str) -> TopoDS_Shape:
    parts = list(kernel.each(shape, kind))
    if len(parts) != 1:
        raise CheckFailedError(f"the CAD kernel cut {block.name} into {len(parts)} parts instead of one")
    return parts[0]


def _pockets(engraving: Engraving) -> Sequence[TopoDS_Shape]:
    """Return the spaces of the pockets of a label."""
    sides: dict[bool, list[shapely.Polygon]] = {True: [], False: []}
    for contour in engraving.contours:
        sides[area_mm2(contour) > 0.0].append(shapely.Polygon(contour))
    glyphs = shapely.difference(shapely.union_all(sides[True]), shapely.union_all(sides[False]))
    return [
        _prism(
            Polygons(
                (
                    Corners.of(np.array(part.exterior.coords)[:-1]),
                    *(Corners.of(np.array(hole.coords)[:0:-1]) for hole in part.interiors),
                )
            ),
            (-_BEYOND_MM, LABEL_DEPTH_MM),
        )
        for part in shapely.get_parts(shapely.orient_polygons(glyphs))
    ]


def _prism(outline: LoopRegion, z_mm: tuple[float, float]) -> TopoDS_Shape:
    """Return an upright prism over an outline, with cylinders over its circles, between two heights."""
    outer, *holes = (_wire(loop, z_mm[0]) for loop in outline.loops)
    face = BRepBuilderAPI_MakeFace(outer, True)
    for hole in holes:
        face.Add(TopoDS.Wire_s(hole.Reversed()))
    return BRepPrimAPI_MakePrism(face.Face(), gp_Vec(0.0, 0.0, z_mm[1] - z_mm[0])).Shape()


def _wire(loop: Loop, z: float) -> TopoDS_Wire:
    if isinstance(loop, Circle):
        circle = gp_Circ(gp_Ax2(gp_Pnt(*loop.centre, z), gp_Dir(0.0, 0.0, 1.0)), loop.radius)
        return MakeWire(BRepBuilderAPI_MakeEdge(circle).Edge()).Wire()
    polygon = BRepBuilderAPI_MakePolygon()
    for x, y in loop.points:
        polygon.Add(gp_Pnt(x, y, z))
    polygon.Close()
    return polygon.Wire()


def _grid(x: Floats, y: Floats, z: Floats) -> Floats:
    """Return the poles of a surface from positions x, shape (n,), and y, shape (m,), and heights z, shape (n, m)."""
    return np.stack(np.broadcast_arrays(x[:, None], y[None, :], z), axis=-1)
