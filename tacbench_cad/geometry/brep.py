"""Open CASCADE solids of blocks, made directly from the formula. No points are fitted, and no faces are sewn together.

The top is divided into spline patches (:mod:`.splines.patches`). The parameters of each patch are x and y in mm. Each
patch is a separate face, and the side walls are divided in the same way. On such faces, the kernel's volume, bounding
box, Boolean operations and mesher are correct and fast. On one large face, they are wrong or slow.

Importing this module does not load the kernel. The functions that make shapes load it.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

from tacbench_cad.geometry.mesh import Certificate
from tacbench_cad.geometry.splines.exact import SplinePatches, spline_patches, spline_refusal
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.sampling import SampleGrid
from tacbench_cad.spec.spline import SplineSurface
from tacbench_cad.util.errors import InputError

if TYPE_CHECKING:
    from OCP.TopoDS import TopoDS_Face, TopoDS_Solid

    from tacbench_cad.geometry.splines.patches import Patches


def solid_refusal(block: Block) -> str | None:
    """Return the reason why a block has no solid, or None if it has one."""
    if isinstance(block.surface, SplineSurface) and (reason := spline_refusal(block.surface)):
        return f"{block.name} has no solid: {reason}"
    if not block.grid_aliases:
        return None
    assert isinstance(block.sampling, SampleGrid)
    return (
        f"{block.name} has no solid: its sample grid of {block.sampling.nx} x {block.sampling.ny} is too coarse for "
        "the formula's finest wave and gives another shape, and a solid of the formula within 1 micrometre would need "
        "millions of poles"
    )


def solid_block(block: Block) -> tuple[TopoDS_Solid, Certificate]:
    """Make a solid of a block. Its top is proved to lie within the block's ``step_tolerance_mm`` of the formula.

    The solid is in the block frame. The zero of its formula is at
    :attr:`~tacbench_cad.spec.block.Block.solid_datum_mm`. The solids of the last few blocks are cached. Every call
    returns new topology, so that callers can move and mesh the solid without an effect on each other.

    Args:
        block: The block.

    Returns:
        The solid and the proved bounds for its top.

    Raises:
        InputError: The block has no solid (:func:`solid_refusal`), or the tolerance is not allowed or needs too many
            poles.
    """
    from OCP.BRepBuilderAPI import BRepBuilderAPI_Copy
    from OCP.TopoDS import TopoDS

    _require_solid(block)
    kept, certificate = _solid(block)
    # The topology is copied, because the kernel stores meshes in faces and uses them for later bounding boxes.
    return TopoDS.Solid_s(BRepBuilderAPI_Copy(kept, False, False).Shape()), certificate


def texture_face(block: Block) -> TopoDS_Face:
    """Make only the textured surface, as one face with parameters x and y in mm.

    Use the face to project, thicken or split. Do not use it to measure an area with the kernel's default: the kernel
    uses at most 61 points along each axis of a face, and for texture 4 of preset paper the area is 9 % too large. To
    measure an area, call ``BRepGProp.SurfaceProperties_s(face, properties, 1e-3)``, or use the top faces of
    :func:`solid_block`. The bounding box is correct.

    Args:
        block: The block. Its key is cut off. Its label has no effect.

    Raises:
        InputError: Same as for :func:`solid_block`.
    """
    from tacbench_cad.geometry.splines.block_solid import face_of

    _require_solid(block)
    return face_of(block, _patches(block))


def _require_solid(block: Block) -> None:
    refusal = solid_refusal(block)
    if refusal is not None:
        raise InputError("formats", "step", refusal)


@lru_cache(maxsize=8)
def _solid(block: Block) -> tuple[TopoDS_Solid, Certificate]:
    from tacbench_cad.geometry.splines.block_solid import solid_of

    relief = _patches(block)
    return solid_of(block, relief), relief.certificate


def _patches(block: Block) -> Patches | SplinePatches:
    from tacbench_cad.geometry.splines.patches import patches

    if block.surface.plane_waves is None:
        return spline_patches(block, block.step_tolerance_mm)
    return patches(block, block.step_tolerance_mm)
