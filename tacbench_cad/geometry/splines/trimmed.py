"""The part of a block's solid or surface inside of an outline that is not a rectangle."""

from __future__ import annotations

from OCP.BRepAlgoAPI import BRepAlgoAPI_Common
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeEdge, BRepBuilderAPI_MakeFace, BRepBuilderAPI_MakePolygon
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeWire as MakeWire
from OCP.BRepPrimAPI import BRepPrimAPI_MakePrism
from OCP.gp import gp_Ax2, gp_Circ, gp_Dir, gp_Pnt, gp_Vec
from OCP.TopoDS import TopoDS, TopoDS_Shape, TopoDS_Wire

from tacbench_cad.geometry import kernel
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.outlines import Circle, Loop, Outline
from tacbench_cad.util.errors import CheckFailedError

#: The distance by which the prism extends beyond the block below and above, in mm.
_BEYOND_MM = 1.0


def prism(outline: Outline, z_mm: tuple[float, float]) -> TopoDS_Shape:
    """Return an upright prism over an outline, with cylinders over its circles, between two heights."""
    outer, *holes = (_wire(loop, z_mm[0]) for loop in outline.loops)
    face = BRepBuilderAPI_MakeFace(outer, True)
    for hole in holes:
        face.Add(TopoDS.Wire_s(hole.Reversed()))
    return BRepPrimAPI_MakePrism(face.Face(), gp_Vec(0.0, 0.0, z_mm[1] - z_mm[0])).Shape()


def inside_of(shape: TopoDS_Shape, outline: Outline, block: Block, kind: str) -> TopoDS_Shape:
    """Return the part of a block's solid or surface inside of an outline.

    Args:
        shape: The solid or surface of the rectangle around the outline.
        outline: The outline.
        block: The block.
        kind: The kind of the result: ``SOLID`` or ``FACE``.

    Raises:
        CheckFailedError: The kernel does not return exactly one shape of this kind.
    """
    most = block.solid_datum_mm + block.surface.amplitude_sum
    tool = prism(outline, (-_BEYOND_MM, most + _BEYOND_MM))
    parts = list(kernel.each(BRepAlgoAPI_Common(shape, tool).Shape(), kind))
    if len(parts) != 1:
        raise CheckFailedError(f"the CAD kernel cut {block.name} into {len(parts)} parts instead of one")
    return parts[0]


def _wire(loop: Loop, z: float) -> TopoDS_Wire:
    if isinstance(loop, Circle):
        circle = gp_Circ(gp_Ax2(gp_Pnt(*loop.centre, z), gp_Dir(0.0, 0.0, 1.0)), loop.radius)
        return MakeWire(BRepBuilderAPI_MakeEdge(circle).Edge()).Wire()
    polygon = BRepBuilderAPI_MakePolygon()
    for x, y in loop.points:
        polygon.Add(gp_Pnt(x, y, z))
    polygon.Close()
    return polygon.Wire()
