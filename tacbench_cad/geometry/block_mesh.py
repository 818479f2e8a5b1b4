"""The mesh of a block: its textured top, with the key cut off, closed by walls and an underside."""

from __future__ import annotations

import numpy as np

from tacbench_cad.geometry.mesh import Certificate, Mesh
from tacbench_cad.geometry.meshing.clip import sheet
from tacbench_cad.geometry.meshing.closing import close
from tacbench_cad.geometry.meshing.top import Top, textured_top
from tacbench_cad.spec.block import Block


def mesh_block(block: Block) -> tuple[Mesh, Certificate]:
    """A closed mesh of a block and what is proved of its top.

    Args:
        block: The block; its ``sampling`` says how the top follows the formula.

    Returns:
        The mesh, whose highest vertex is at exactly the float32 of the block's height, and the certificate.

    Raises:
        InputError: The mesh would pass :data:`~tacbench_cad.geometry.mesh.MAX_TRIANGLES` or the tolerance is too
            fine for single precision.
    """
    top = textured_top(block)
    return mesh_of_top(block, top), top.certificate


def mesh_of_top(block: Block, top: Top) -> Mesh:
    """The closed mesh below a top of the block."""
    return close(sheet(top, block.key_mm, float(np.float32(block.height_mm))), block.engraving)
