"""CadQuery: texture blocks as solids and in method chains.

This example makes two blocks side by side::

    import cadquery as cq
    from tacbench_cad.spec.block import Block
    from tacbench_cad.cq import texture_block

    two = cq.Workplane().rarray(40, 1, 2, 1).eachpoint(texture_block(Block.of(4)))

After ``tacbench_cad.cq.register()`` you can also write
``cq.Workplane().rarray(40, 1, 2, 1).textureBlock(Block.of(4))``.

Importing this module imports CadQuery.
"""

from __future__ import annotations

from collections.abc import Callable

import cadquery as cq

from tacbench_cad.geometry import brep
from tacbench_cad.geometry.part import rgb_of
from tacbench_cad.spec.block import Block


def solid(block: Block) -> cq.Solid:
    """Return a block as a CadQuery solid in the block frame, in mm.

    The lower corner of the underside is at the origin, and z points up.

    Raises:
        InputError: No solid of this block can be made. The message states the reason.
    """
    result = cq.Solid(brep.solid_block(block)[0])
    result.label = block.name
    return result


def assembly(block: Block) -> cq.Assembly:
    """Return a block in the block frame as an assembly, because only assemblies have colours in CadQuery.

    Raises:
        InputError: No solid of this block can be made. The message states the reason.
    """
    return cq.Assembly(solid(block), name=block.name, color=cq.Color(*rgb_of("block")))


def texture_block(
    block: Block,
) -> Callable[[cq.Location | cq.Workplane], cq.Solid | cq.Workplane]:
    """Return a function for ``Workplane.eachpoint`` and ``Workplane.invoke`` that adds the block at every point.

    The lower corner of the block's underside is at the point, and the block's axes are those of the workplane. With
    ``eachpoint``, use ``useLocalCoordinates=True`` if the workplane is not the global one, and choose ``combine``.
    ``invoke`` puts the blocks on the stack without combining them.

    Raises:
        InputError: No solid of this block can be made. The message states the reason.
    """
    solid_of_block = solid(block)

    def place(at: cq.Location | cq.Workplane) -> cq.Solid | cq.Workplane:
        if isinstance(at, cq.Workplane):
            return at.eachpoint(solid_of_block.moved, useLocalCoordinates=True, combine=False, clean=False)
        return solid_of_block.moved(at)

    return place


def texture_face(block: Block) -> cq.Face:
    """Return only the textured surface, as one CadQuery face in the block frame.

    Do not rely on the method ``Area()`` of the face. :func:`tacbench_cad.geometry.brep.texture_face` explains the
    reason, and how to measure the area.

    Args:
        block: The block. The corner of its key is cut off.

    Raises:
        InputError: No solid of this block can be made. The message states the reason.
    """
    return cq.Face(brep.texture_face(block))


def register() -> None:
    """Add ``Workplane.textureBlock(block, combine=True, clean=True)`` to CadQuery.

    The method adds the block at every point of the stack, aligned with the axes of the workplane, and combines it like
    ``Workplane.box``.
    """

    def texture_block_method(
        self: cq.Workplane,
        block: Block,
        combine: bool | str = True,
        clean: bool = True,
    ) -> cq.Workplane:
        """Add a texture block at every point of the stack. Its lower corner is at the point."""
        return self.eachpoint(solid(block).moved, True, combine, clean)

    cq.Workplane.textureBlock = texture_block_method
