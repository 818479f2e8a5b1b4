"""A part with a texture on one of its faces, as one valid solid.

The body between the texture and the face is added to the part or cut from it. Its textured side consists of spline
patches, so the distance of the solid from the formula is that of the patches.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from OCP.BRepAlgoAPI import BRepAlgoAPI_Common, BRepAlgoAPI_Cut, BRepAlgoAPI_Fuse
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeFace, BRepBuilderAPI_MakePolygon, BRepBuilderAPI_Transform
from OCP.BRepCheck import BRepCheck_Analyzer
from OCP.BRepPrimAPI import BRepPrimAPI_MakePrism, BRepPrimAPI_MakeRevol
from OCP.gp import gp_Ax1, gp_Dir, gp_Pnt, gp_Trsf, gp_Vec
from OCP.TopoDS import TopoDS_Face, TopoDS_Shape, TopoDS_Solid

from tacbench_cad.geometry import kernel
from tacbench_cad.geometry.textured.amount import added_volume_mm3
from tacbench_cad.geometry.textured.area import Area
from tacbench_cad.geometry.textured.frame import frame_of
from tacbench_cad.geometry.textured.height import FLOOR_MM, Height, height_over, require_radius, require_room
from tacbench_cad.geometry.textured.patches import PatchGrid, patches_of
from tacbench_cad.geometry.textured.region import areas_of
from tacbench_cad.geometry.texturing import Texturing
from tacbench_cad.util.errors import CheckFailedError, InputError

#: The depth by which the body of a texture reaches into the part, or a sunk texture's body out of it, in mm.
OVERLAP_MM = 0.05
#: The fraction of the texture's volume by which the kernel's volume may differ from the integral of the formula.
VOLUME_FRACTION = 2e-3
#: The accuracy for the kernel's adaptive volume. The result is usually far better than this.
_ACCURACY = 1e-2


@dataclass(frozen=True, kw_only=True, eq=False)
class TexturedSolid:
    """A solid with a texture on one of its faces.

    Args:
        solid: The solid of the kernel, in the coordinates of the part.
        volume_mm3: The volume of the part before, plus the integral of the formula.
        added_mm3: The integral of the formula; negative for a sunk texture.
        patches: The patches of each textured area.
    """

    solid: TopoDS_Solid
    volume_mm3: float
    added_mm3: float
    patches: tuple[PatchGrid, ...]

    @property
    def heights(self) -> tuple[Height, ...]:
        """The heights above the textured areas."""
        return tuple(patches.height for patches in self.patches)

    @property
    def error_mm(self) -> float:
        """The bound of the distance between the textured faces and the formula."""
        return max(patches.error_mm + patches.height.own_error_mm for patches in self.patches)

    @property
    def is_proved(self) -> bool:
        """Whether this bound is proved. With a fade along an outline that is not a rectangle, it is measured."""
        return all(patches.is_proved and patches.height.surface.evidence == "proved" for patches in self.patches)


def textured_solid(shape: TopoDS_Shape, face: TopoDS_Face, texturing: Texturing) -> TexturedSolid:
    """Put a texture on one face of a solid.

    Args:
        shape: The solid, or a shape that contains exactly one solid.
        face: The face of the solid.
        texturing: The settings.

    Raises:
        InputError: The face is neither planar nor cylindrical, or is not a face of the solid, or a setting is not
            allowed for it.
        CheckFailedError: The result is not one valid solid with the expected volume.
    """
    solid, own = _owner(shape, face)
    result, made, added = solid, [], 0.0
    for area in areas_of(own, frame_of(own, texturing.up), texturing.margin_mm):
        height = height_over(area, texturing)
        require_radius(height)
        reach = texturing.base_mm + height.depth_mm
        space = _space(area, -reach - FLOOR_MM, 0.0) if texturing.sunk else _space(area, 1e-3, reach)
        common = BRepAlgoAPI_Common(space, solid).Shape()
        require_room(height, abs(kernel.volume_mm3(common)), abs(kernel.volume_mm3(space)))
        patches = patches_of(height)
        other = OVERLAP_MM if texturing.sunk else -OVERLAP_MM
        body = patches.solid_from(other)
        if not area.is_rectangle:
            low, high = height.range_mm
            body = BRepAlgoAPI_Common(body, _space(area, min(low, other) - 1.0, max(high, other) + 1.0)).Shape()
        join = BRepAlgoAPI_Cut if texturing.sunk else BRepAlgoAPI_Fuse
        result = join(result, body).Shape()
        added += added_volume_mm3(height)
        made.append(patches)
    solids = list(kernel.each(result, "SOLID"))
    if len(solids) != 1 or not BRepCheck_Analyzer(solids[0]).IsValid():
        raise CheckFailedError("the solid with the texture is not valid; choose another margin_mm or direction")
    # The adaptive method is right for spline faces. Walls below a free curve need the default method.
    for method in (_ACCURACY, None):
        measured = kernel.volume_mm3(solids[0], method) - kernel.volume_mm3(solid, method)
        if abs(measured - added) <= VOLUME_FRACTION * abs(added):
            break
    else:
        raise CheckFailedError(
            f"the texture has a volume of {measured:.6g} mm^3 instead of {added:.6g} mm^3; choose another "
            "margin_mm or direction"
        )
    return TexturedSolid(
        solid=solids[0], volume_mm3=kernel.volume_mm3(solid) + added, added_mm3=added, patches=tuple(made)
    )


def _owner(shape: TopoDS_Shape, face: TopoDS_Face) -> tuple[TopoDS_Solid, TopoDS_Face]:
    """Return the solid of a shape that has a face, and the face with its orientation in this solid."""
    solids = list(kernel.each(shape, "SOLID"))
    if len(solids) != 1:
        raise InputError("part", None, f"must be one solid, but it has {len(solids)} solids")
    for own in kernel.each(solids[0], "FACE"):
        if own.IsSame(face):
            return solids[0], own
    raise InputError("face", None, "is not a face of the part; choose one of the part's own faces")


def _space(area: Area, low_mm: float, high_mm: float) -> TopoDS_Shape:
    """Return the space above an area between two heights along the normal, as a solid."""
    if area.face is None:
        return _ring(area, low_mm, high_mm)
    move, normal = gp_Trsf(), area.frame.axes[2]
    move.SetTranslation(gp_Vec(*(normal * low_mm).tolist()))
    start = BRepBuilderAPI_Transform(area.face, move, True).Shape()
    return BRepPrimAPI_MakePrism(start, gp_Vec(*(normal * (high_mm - low_mm)).tolist())).Shape()


def _ring(area: Area, low_mm: float, high_mm: float) -> TopoDS_Shape:
    """Return the space above a rectangle or a band of a cylinder between two heights."""
    frame, polygon = area.frame, BRepBuilderAPI_MakePolygon()
    assert frame.radius_mm is not None
    for t, h in ((0.0, low_mm), (area.size_mm[1], low_mm), (area.size_mm[1], high_mm), (0.0, high_mm)):
        polygon.Add(gp_Pnt(*frame.point(np.array(0.0), np.array(t), h).tolist()))
    polygon.Close()
    profile = BRepBuilderAPI_MakeFace(polygon.Wire(), True).Face()
    axis = gp_Ax1(gp_Pnt(*frame.origin.tolist()), gp_Dir(*(frame.side * frame.axes[2]).tolist()))
    angle = 2.0 * math.pi if area.is_closed else area.size_mm[0] / frame.radius_mm
    return BRepPrimAPI_MakeRevol(profile, axis, angle).Shape()
