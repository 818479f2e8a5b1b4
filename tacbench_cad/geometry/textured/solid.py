"""A part with a texture on one of its faces, as one valid solid."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from OCP.BRep import BRep_Builder
from OCP.BRepCheck import BRepCheck_Analyzer
from OCP.TopoDS import TopoDS_Compound, TopoDS_Face, TopoDS_Shape, TopoDS_Shell, TopoDS_Solid

from tacbench_cad.geometry import kernel
from tacbench_cad.geometry.textured.amount import added_volume_mm3
from tacbench_cad.geometry.textured.field import Avoid, ExactField, Fade, Height, PatchGrid, SampledField
from tacbench_cad.geometry.textured.frame import frame_of
from tacbench_cad.geometry.textured.height import FLOOR_MM, height_over, require_fade
from tacbench_cad.geometry.textured.region import Region, distances, divide, inside, thickened
from tacbench_cad.geometry.textured.shell import TextureFaces
from tacbench_cad.geometry.texturing import Texturing
from tacbench_cad.spec.waves import WaveSum
from tacbench_cad.util.errors import CheckFailedError, InputError

#: The fraction of the texture's volume by which the kernel's volume may differ from the integral of the formula.
VOLUME_FRACTION = 2e-3
#: The accuracy for the kernel's adaptive volume. The result is usually far better than this.
_ACCURACY = 1e-2


@dataclass(frozen=True, kw_only=True, eq=False)
class TexturedSolid:
    """A solid with a texture on one of its faces.

    Args:
        solid: The solid of the kernel, in the coordinates of the part.
        texturing: The settings.
        volume_mm3: The volume of the part before, plus the integral of the formula.
        added_mm3: The integral of the formula; negative for a sunk texture.
        error_mm: The bound of the distance between the textured faces and the formula.
        is_proved: Whether this bound is proved. With a fade along an outline that is not a rectangle, it is measured.
        mm_per_unit: The millimetres per unit of u and v. Around a cylinder, u is changed so that the texture closes.
        periods: The number of periods around a closed cylinder; None for other faces.
        regions: The textured regions, with their patches and heights.
    """

    solid: TopoDS_Solid
    texturing: Texturing
    volume_mm3: float
    added_mm3: float
    error_mm: float
    is_proved: bool
    mm_per_unit: tuple[float, float]
    periods: int | None
    regions: tuple[tuple[Region, PatchGrid, Height], ...]


def textured_solid(shape: TopoDS_Shape, face: TopoDS_Face, texturing: Texturing) -> TexturedSolid:
    """Put a texture on one face of a solid.

    The face is divided into a margin and the region inside of it. The region is replaced by walls and by spline patches
    of the formula. All other faces stay the same, so no Boolean operation changes the part.

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
    frame = frame_of(own, texturing.up)
    rims, regions = divide(own, frame, texturing.margin_mm)
    faces, described, added = list(rims), [], []
    for region in regions:
        fade = _fade(region, texturing.fade_mm)
        height, mm_per_unit, periods = height_over(region.size_mm, region.is_closed, texturing, fade)
        _require_room(solid, region, texturing, height.depth_mm)
        exact = not height.fade.length_mm or height.fade.sides is not None
        field = (ExactField if exact and isinstance(height.surface, WaveSum) else SampledField)(
            height, region.frame, region.is_closed
        )
        patches = field.patches(texturing.tolerance_mm, _avoid(region))
        new = list(TextureFaces(region, patches, texturing.sunk).faces())
        faces.extend(new)
        added.append((region, new, added_volume_mm3(region, height)))
        described.append((region, patches, height))
    result = _rebuilt(solid, own, faces)
    _require_valid(result, added)
    return TexturedSolid(
        solid=result,
        texturing=texturing,
        volume_mm3=kernel.volume_mm3(solid) + (more := sum(volume for _, _, volume in added)),
        added_mm3=more,
        error_mm=max(patches.error_mm + height.own_error_mm for _, patches, height in described),
        is_proved=all(patches.is_proved and height.surface.evidence == "proved" for _, patches, height in described),
        mm_per_unit=mm_per_unit,
        periods=periods,
        regions=tuple(described),
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


def _fade(region: Region, length_mm: float) -> Fade:
    if not length_mm:
        return Fade(length_mm=0.0)
    require_fade(length_mm, region.size_mm, region.is_closed)
    if region.is_rectangle:
        return Fade(length_mm=length_mm, sides=(not region.is_closed, True))
    return Fade(length_mm=length_mm, distances=partial(distances, region, length_mm), inside=partial(inside, region))


def _avoid(region: Region) -> Avoid:
    """Return the places that lines between patches must keep away from."""
    points, outline = [], [edge.samples for loop in region.loops for edge in loop]
    for samples in outline:
        points.append(samples[[0, -1]])
        if len(samples) > 2:
            steps = np.diff(samples, axis=0)
            turning = np.any(steps[:-1] * steps[1:] <= 0.0, axis=1)
            points.append(samples[1:-1][turning])
    return Avoid(corners=np.concatenate(points), outline=outline)


def _require_room(solid: TopoDS_Solid, region: Region, texturing: Texturing, depth_mm: float) -> None:
    """Check that a raised texture does not touch other faces of the part, or that a sunk texture lies in material."""
    from OCP.BRepAlgoAPI import BRepAlgoAPI_Common

    reach = texturing.base_mm + depth_mm
    radius = region.frame.radius_mm
    inwards = reach + FLOOR_MM if texturing.sunk else -reach
    if radius is not None and region.frame.side * inwards >= radius:
        raise InputError("depth_mm", depth_mm, f"is too much for a cylinder of radius {radius:.4g} mm")
    low, high = (-reach - FLOOR_MM, 0.0) if texturing.sunk else (1e-3, reach)
    space = thickened(region, low, high)
    common, whole = abs(kernel.volume_mm3(BRepAlgoAPI_Common(space, solid).Shape())), abs(kernel.volume_mm3(space))
    if texturing.sunk and common < (1.0 - 1e-4) * whole:
        raise InputError(
            "depth_mm",
            depth_mm,
            f"leaves less than {FLOOR_MM:g} mm of material below the texture; choose a smaller depth",
        )
    if not texturing.sunk and common > 1e-6 * whole:
        raise InputError(
            "depth_mm", depth_mm, "makes the texture touch another face of the part; choose a larger margin"
        )


def _rebuilt(solid: TopoDS_Solid, face: TopoDS_Face, new: list[TopoDS_Face]) -> TopoDS_Solid:
    """Return the solid with other faces instead of one of its faces."""
    builder, result = BRep_Builder(), TopoDS_Solid()
    builder.MakeSolid(result)
    for shell in kernel.each(solid, "SHELL"):
        own = TopoDS_Shell()
        builder.MakeShell(own)
        for old in kernel.each(shell, "FACE"):
            for kept in new if old.IsSame(face) else [old]:
                builder.Add(own, kept)
        own.Closed(True)
        builder.Add(result, own)
    return result


def _require_valid(solid: TopoDS_Solid, added: list[tuple[Region, list[TopoDS_Face], float]]) -> None:
    """Check the topology of the solid, and the volume between each region and its texture."""
    if not BRepCheck_Analyzer(solid).IsValid():
        raise CheckFailedError("the solid with the texture is not valid; choose another margin_mm or direction")
    builder = BRep_Builder()
    for region, faces, volume_mm3 in added:
        between = TopoDS_Compound()
        builder.MakeCompound(between)
        for face in (*faces, region.face.Reversed()):
            builder.Add(between, face)
        if abs(kernel.volume_mm3(between, _ACCURACY) - volume_mm3) <= VOLUME_FRACTION * abs(volume_mm3):
            continue
        measured = kernel.volume_mm3(between)
        if abs(measured - volume_mm3) > VOLUME_FRACTION * abs(volume_mm3):
            raise CheckFailedError(
                f"the texture has a volume of {measured:.6g} mm^3 instead of {volume_mm3:.6g} mm^3; choose another "
                "margin_mm or direction"
            )
