"""Grooves sunk into a flat upper face of a solid, without a boolean operation.

A boolean cut of some 240 small prisms (a jig for six blocks) costs the kernel 5 to 10 s. A groove only puts a hole
into the face and adds walls and a floor below it, so the shell is put together directly from faces that share edges.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from housing.marks import Groove
from housing.shapes import prism
from tacbench_cad.spec.outlines import area_mm2, is_inside
from tacbench_cad.util.errors import CheckFailedError
from tacbench_cad.util.types import Floats

if TYPE_CHECKING:
    from build123d import Face, Solid, Wire
    from OCP.TopoDS import TopoDS_Face


#: Fraction of the volume by which kernel and closed form may differ: rounding.
VOLUME_FRACTION = 1e-9


def engraved(solid: Solid, z_mm: float, grooves: Sequence[Groove], depth_mm: float) -> Solid:
    """Sink grooves into the one upward face at a height.

    Args:
        solid: The solid.
        z_mm: Height of the face.
        grooves: Engravings that lie inside of the face and apart from each other.
        depth_mm: Their depth.

    Raises:
        CheckFailedError: There is no such face, or more than one, or the result is not valid or has a wrong volume.
    """
    from build123d import Solid
    from OCP.BRep import BRep_Builder
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeSolid
    from OCP.BRepLib import BRepLib
    from OCP.ShapeFix import ShapeFix_Shell
    from OCP.TopoDS import TopoDS_Shell

    upper: list[Face] = []
    others: list[Face] = []
    for face in solid.faces():
        (upper if _is_upper(face, z_mm) else others).append(face)
    if len(upper) != 1:
        raise CheckFailedError(f"{len(upper)} faces lie at the height to be engraved, one is needed")
    builder, shell = BRep_Builder(), TopoDS_Shell()
    builder.MakeShell(shell)
    for face in others:
        builder.Add(shell, face.wrapped)
    holes = list(upper[0].inner_wires())
    islands: list[tuple[Floats, Wire]] = []
    for groove in grooves:
        for face in prism(groove.outer, groove.islands, (z_mm - depth_mm, z_mm)).faces():
            if _is_upper(face, z_mm):
                # What bounds a groove bounds the level faces from their other side.
                holes.append(_reversed(face.outer_wire()))
                islands += [(_loop_of(wire, groove), _reversed(wire)) for wire in face.inner_wires()]
            else:
                builder.Add(shell, face.wrapped)
    for outline, inner in _level_faces(upper[0].outer_wire(), islands, holes):
        builder.Add(shell, _level_face(z_mm, [outline, *inner]))
    shell.Closed(True)
    # The grooves' faces look out of the prisms, not out of the solid: orient them by the edges that they share.
    repair = ShapeFix_Shell(shell)
    repair.FixFaceOrientation(shell)
    closed = BRepBuilderAPI_MakeSolid(repair.Shell()).Solid()
    BRepLib.OrientClosedSolid_s(closed)
    result = Solid(closed)
    expected = solid.volume - sum(one.area_mm2 for one in grooves) * depth_mm
    if abs(result.volume - expected) > VOLUME_FRACTION * expected:
        raise CheckFailedError(f"the engraved fixture has {result.volume:.6g} mm^3, {expected:.6g} mm^3 were expected")
    if not result.is_valid:
        raise CheckFailedError("the CAD kernel made no valid solid of the engraved fixture")
    return result


def _is_upper(face: Face, z_mm: float) -> bool:
    box = face.bounding_box()
    return bool(abs(box.min.Z - z_mm) < 1e-6 and abs(box.max.Z - z_mm) < 1e-6)


def _reversed(wire: Wire) -> Wire:
    from build123d import Wire
    from OCP.TopoDS import TopoDS

    return Wire(TopoDS.Wire_s(wire.wrapped.Reversed()))


def _a_point(wire: Wire) -> Floats:
    vertex = wire.vertices()[0]
    return np.array([vertex.X, vertex.Y])


def _loop_of(wire: Wire, groove: Groove) -> Floats:
    """The island's outline that a wire was made from."""
    point = _a_point(wire)
    return min(groove.islands, key=lambda loop: float(np.linalg.norm(loop - point, axis=1).min()))


def _level_faces(outline: Wire, islands: list[tuple[Floats, Wire]], holes: list[Wire]) -> list[tuple[Wire, list[Wire]]]:
    """The outer face and the islands, each with the holes in it: a hole belongs to the smallest island round it."""
    faces: list[tuple[Wire, list[Wire]]] = [(outline, []), *((wire, []) for _, wire in islands)]
    sizes = [abs(area_mm2(loop)) for loop, _ in islands]
    for hole in holes:
        point = _a_point(hole)
        # An island's own groove lies round it, so the outer wire of that groove is not inside.
        around = [i for i, (loop, _) in enumerate(islands) if is_inside(point, [loop])]
        place = 1 + min(around, key=lambda i: sizes[i]) if around else 0
        faces[place][1].append(hole)
    return faces


def _level_face(z_mm: float, wires: list[Wire]) -> TopoDS_Face:
    """A level face from an outer wire, counter-clockwise, and inner ones, clockwise; their edges are kept."""
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeFace
    from OCP.gp import gp_Dir, gp_Pln, gp_Pnt

    face = BRepBuilderAPI_MakeFace(gp_Pln(gp_Pnt(0.0, 0.0, z_mm), gp_Dir(0.0, 0.0, 1.0)), wires[0].wrapped, True)
    for wire in wires[1:]:
        face.Add(wire.wrapped)
    return face.Face()
