"""Open CASCADE solids of blocks, straight from the formula: no point is fitted and nothing is sewn.

The top is cut into spline patches (:mod:`.splines.patches`). On a patch the surface's parameters are x and
y in mm. Each patch is a face of its own and the side walls are split along with them, because the kernel's volume,
bounding box, Boolean operations and mesher are right and fast on such faces and wrong or slow on one large face.

Importing this module does not load the kernel; the functions that make shapes do.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

from tacbench_cad.geometry.mesh import Certificate
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.sampling import SampleGrid
from tacbench_cad.util.errors import InputError

if TYPE_CHECKING:
    from OCP.TopoDS import TopoDS_Face, TopoDS_Solid


def solid_refusal(block: Block) -> str | None:
    """Why there is no solid of a block, or None where there is one."""
    if not block.grid_aliases:
        return None
    assert isinstance(block.sampling, SampleGrid)
    return (
        f"{block.name} has none: its sample grid of {block.sampling.nx} x {block.sampling.ny} is too coarse for the "
        "formula's finest wave and draws another shape, and the formula itself within 1 micrometre would take millions "
        "of poles"
    )


def solid_block(block: Block) -> tuple[TopoDS_Solid, Certificate]:
    """The block as a solid within its ``step_tolerance_mm`` of the formula, proved.

    The solid lies in the block frame, its formula's zero at :attr:`~tacbench_cad.spec.block.Block.solid_datum_mm`. The
    last few are kept: asking again gives new topology over the same geometry, which may be moved and meshed freely.

    Args:
        block: The block.

    Returns:
        The solid and what is proved of its top.

    Raises:
        InputError: There is no solid of this block (:func:`solid_refusal`), the tolerance is not allowed, or it
            needs too many poles.
    """
    from OCP.BRepBuilderAPI import BRepBuilderAPI_Copy
    from OCP.TopoDS import TopoDS

    _require_solid(block)
    kept, certificate = _solid(block)
    # Topology of its own: the kernel keeps a mesh in the faces, and takes it into later bounding boxes.
    return TopoDS.Solid_s(BRepBuilderAPI_Copy(kept, False, False).Shape()), certificate


def texture_face(block: Block) -> TopoDS_Face:
    """The textured surface alone, as one face with parameters x and y in mm.

    A single face is what projecting, thickening and splitting want. It is not what measuring wants: the kernel's
    default area takes 61 points along each axis of a face however rich it is, which gives texture 4 of preset paper an
    area 9 % too large. Ask for ``BRepGProp.SurfaceProperties_s(face, properties, 1e-3)``, or take the top faces of
    :func:`solid_block`. The bounding box is right.

    Args:
        block: The block; its key is cut off, its label does not matter.

    Raises:
        InputError: As for :func:`solid_block`.
    """
    from tacbench_cad.geometry.splines.build import SolidBuilder
    from tacbench_cad.geometry.splines.patches import patches

    _require_solid(block)
    return SolidBuilder(block, patches(block, block.step_tolerance_mm)).face()


def _require_solid(block: Block) -> None:
    refusal = solid_refusal(block)
    if refusal is not None:
        raise InputError("formats", "step", refusal)


@lru_cache(maxsize=8)
def _solid(block: Block) -> tuple[TopoDS_Solid, Certificate]:
    from tacbench_cad.geometry.splines.build import SolidBuilder
    from tacbench_cad.geometry.splines.patches import patches

    relief = patches(block, block.step_tolerance_mm)
    return SolidBuilder(block, relief).solid(), relief.certificate
