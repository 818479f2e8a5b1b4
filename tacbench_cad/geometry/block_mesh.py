"""The mesh of a block: its textured top, with the key cut off, closed by walls and an underside."""

from __future__ import annotations

import numpy as np

from tacbench_cad.geometry.mesh import Certificate, Mesh
from tacbench_cad.geometry.meshing.adaptive import NetTop
from tacbench_cad.geometry.meshing.clip import sheet
from tacbench_cad.geometry.meshing.closing import close
from tacbench_cad.geometry.meshing.outlined import outlined_mesh
from tacbench_cad.geometry.meshing.top import Top, textured_top
from tacbench_cad.spec.block import Block


def mesh_block(block: Block) -> tuple[Mesh, Certificate]:
    """Make a closed mesh of a block, and prove how far its top lies from the formula.

    Args:
        block: The block. Its ``sampling`` decides how the top follows the formula.

    Returns:
        The mesh and the proved bounds. The z of the highest vertex is exactly the block's height, rounded to float32.

    Raises:
        InputError: The mesh would have more triangles than :data:`~tacbench_cad.geometry.mesh.MAX_TRIANGLES`, or the
            tolerance is too fine for single precision.
    """
    if block.outline is not None:
        outlined = outlined_mesh(block)
        return outlined.mesh, outlined.certificate.plus(block.surface.error, block.surface.evidence)
    top = textured_top(block)
    return mesh_of_top(block, top), top.certificate.plus(block.surface.error, block.surface.evidence)


def mesh_of_top(block: Block, top: Top | NetTop) -> Mesh:
    """Close a top of a rectangular block with walls and an underside."""
    if isinstance(top, NetTop):
        return close(top.sheet, block.engraving)
    return close(sheet(top, block.key_mm, float(np.float32(block.height_mm))), block.engraving)
