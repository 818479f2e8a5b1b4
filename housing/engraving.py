"""Engraving of grooves into the flat upper face of a solid, without a boolean operation.

A boolean cut of about 240 small prisms (a jig for six blocks) takes the kernel 5 to 10 s. A groove only adds a hole to
the face, and walls and a floor below it. Therefore this module builds the shell directly from faces that share edges.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import shapely

from housing.shapes import prism
from tacbench_cad.geometry.kernel import box_mm, distinct, volume_mm3
from tacbench_cad.util.errors import CheckFailedError

if TYPE_CHECKING:
    from OCP.TopoDS import TopoDS_Face, TopoDS_Solid, TopoDS_Wire


#: The largest relative difference between the volumes by the kernel and in closed form; it allows for rounding.
VOLUME_FRACTION = 1e-9


def engraved(solid: TopoDS_Solid, z_mm: float, grooves: Sequence[shapely.Polygon], depth_mm: float) -> TopoDS_Solid:
    """Engrave grooves into the upper face of a solid at a given height.

    Args:
        solid: The solid. It must have exactly one such face.
        z_mm: The height of the face.
        grooves: The grooves. The holes of a polygon are islands that are not engraved. The grooves must be inside the
            face and must not touch each other.
        depth_mm: The depth of the grooves.

    Raises:
        CheckFailedError: There is no such face or more than one, or the result is invalid or has a wrong volume.
    """
    from OCP.BRep import BRep_Builder
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeSolid
    from OCP.BRepCheck import BRepCheck_Analyzer
    from OCP.BRepLib import BRepLib
    from OCP.ShapeFix import ShapeFix_Shell
    from OCP.TopoDS import TopoDS_Shell

    upper: list[TopoDS_Face] = []
    others: list[TopoDS_Face] = []
    for face in distinct(solid, "FACE"):
        (upper if _is_upper(face, z_mm) else others).append(face)
    if len(upper) != 1:
        raise CheckFailedError(f"{len(upper)} faces are at the height of the engraving; there must be one")
    builder, shell = BRep_Builder(), TopoDS_Shell()
    builder.MakeShell(shell)
    for face in others:
        builder.Add(shell, face)
    outer, holes = _wires(upper[0])
    islands: list[tuple[shapely.Polygon, TopoDS_Wire]] = []
    for groove in grooves:
        loops = [shapely.get_coordinates(ring)[:-1] for ring in (groove.exterior, *groove.interiors)]
        for face in distinct(prism(loops[0], loops[1:], (z_mm - depth_mm, z_mm)), "FACE"):
            if _is_upper(face, z_mm):
                # The outlines of a groove are also the holes, or the outer outlines, of the faces around and in it.
                around, inside = _wires(face)
                holes.append(_reversed(around))
                islands += [(_island_of(wire, groove), _reversed(wire)) for wire in inside]
            else:
                builder.Add(shell, face)
    for outline, inner in _level_faces(outer, islands, holes):
        builder.Add(shell, _level_face(z_mm, [outline, *inner]))
    shell.Closed(True)
    # The normals of the groove's faces point out of the prisms, not out of the solid. ShapeFix orients all faces by
    # their shared edges.
    repair = ShapeFix_Shell(shell)
    repair.FixFaceOrientation(shell)
    closed = BRepBuilderAPI_MakeSolid(repair.Shell()).Solid()
    BRepLib.OrientClosedSolid_s(closed)
    expected = volume_mm3(solid) - sum(groove.area for groove in grooves) * depth_mm
    volume = volume_mm3(closed)
    if abs(volume - expected) > VOLUME_FRACTION * expected:
        raise CheckFailedError(f"the engraved fixture has {volume:.6g} mm^3 instead of {expected:.6g} mm^3")
    if not BRepCheck_Analyzer(closed).IsValid():
        raise CheckFailedError("the CAD kernel made an invalid solid of the engraved fixture")
    return closed


def _is_upper(face: TopoDS_Face, z_mm: float) -> bool:
    low, high = box_mm(face)
    return bool(abs(low[2] - z_mm) < 1e-6 and abs(high[2] - z_mm) < 1e-6)


def _wires(face: TopoDS_Face) -> tuple[TopoDS_Wire, list[TopoDS_Wire]]:
    """Return the outer wire of a face and its inner wires."""
    from OCP.BRepTools import BRepTools

    outer = BRepTools.OuterWire_s(face)
    return outer, [wire for wire in distinct(face, "WIRE") if not wire.IsSame(outer)]


def _reversed(wire: TopoDS_Wire) -> TopoDS_Wire:
    from OCP.TopoDS import TopoDS

    return TopoDS.Wire_s(wire.Reversed())


def _first_point(wire: TopoDS_Wire) -> shapely.Point:
    from OCP.BRep import BRep_Tool

    point = BRep_Tool.Pnt_s(distinct(wire, "VERTEX")[0])
    return shapely.Point(point.X(), point.Y())


def _island_of(wire: TopoDS_Wire, groove: shapely.Polygon) -> shapely.Polygon:
    """Return the island that a wire was made from."""
    return shapely.Polygon(min(groove.interiors, key=_first_point(wire).distance))


def _level_faces(
    outline: TopoDS_Wire, islands: list[tuple[shapely.Polygon, TopoDS_Wire]], holes: list[TopoDS_Wire]
) -> list[tuple[TopoDS_Wire, list[TopoDS_Wire]]]:
    """Return the outer face and the islands with their holes. A hole belongs to the smallest island around it."""
    faces: list[tuple[TopoDS_Wire, list[TopoDS_Wire]]] = [(outline, []), *((wire, []) for _, wire in islands)]
    for hole in holes:
        point = _first_point(hole)
        # The groove around an island is outside the island, and so is the outer wire of that groove.
        around = [i for i, (island, _) in enumerate(islands) if island.contains(point)]
        place = 1 + min(around, key=lambda i: float(islands[i][0].area)) if around else 0
        faces[place][1].append(hole)
    return faces


def _level_face(z_mm: float, wires: list[TopoDS_Wire]) -> TopoDS_Face:
    """Make a horizontal face from an outer wire (counter-clockwise) and inner wires (clockwise), with their edges."""
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeFace
    from OCP.gp import gp_Dir, gp_Pln, gp_Pnt

    face = BRepBuilderAPI_MakeFace(gp_Pln(gp_Pnt(0.0, 0.0, z_mm), gp_Dir(0.0, 0.0, 1.0)), wires[0], True)
    for wire in wires[1:]:
        face.Add(wire)
    return face.Face()
