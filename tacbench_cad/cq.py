"""CadQuery: texture blocks in a chain.

Two blocks side by side::

    import cadquery as cq
    from tacbench_cad.spec.block import Block
    from tacbench_cad.cq import texture_block

    two = cq.Workplane().rarray(40, 1, 2, 1).eachpoint(texture_block(Block.of(4)))

or, after ``tacbench_cad.cq.register()``, ``cq.Workplane().rarray(40, 1, 2, 1).textureBlock(Block.of(4))``.

Importing this module imports CadQuery.
"""

from __future__ import annotations

from collections.abc import Callable

import cadquery as cq

from tacbench_cad.geometry import brep
from tacbench_cad.geometry.part import rgb_of
from tacbench_cad.spec.block import Block


def solid(block: Block) -> cq.Solid:
    """The block as a CadQuery solid in the block frame: lower corner of the underside at the origin, z up, mm.

    Args:
        block: The block.

    Raises:
        InputError: There is no solid of this block; the message says why.
    """
    made = cq.Solid(brep.solid_block(block)[0])
    made.label = block.name
    return made


def assembly(block: Block) -> cq.Assembly:
    """The block with its name and colour, to be added to an assembly: CadQuery keeps colours there alone.

    Args:
        block: The block, in the block frame.

    Raises:
        InputError: There is no solid of this block; the message says why.
    """
    return cq.Assembly(solid(block), name=block.name, color=cq.Color(*rgb_of("block")))


def texture_block(
    block: Block,
) -> Callable[[cq.Location | cq.Workplane], cq.Solid | cq.Workplane]:
    """What ``Workplane.eachpoint`` and ``Workplane.invoke`` take: the block at every point of the stack.

    Each point is where the lower corner of a block's underside lies; the block's x, y and z are those of the
    workplane. With ``eachpoint`` say ``useLocalCoordinates=True`` where the workplane is not the global one, and
    ``combine`` as you like; ``invoke`` puts the blocks on the stack without combining them.

    Args:
        block: The block.

    Raises:
        InputError: There is no solid of this block; the message says why.
    """
    made = solid(block)

    def place(at: cq.Location | cq.Workplane) -> cq.Solid | cq.Workplane:
        if isinstance(at, cq.Workplane):
            return at.eachpoint(made.moved, useLocalCoordinates=True, combine=False, clean=False)
        return made.moved(at)

    return place


def texture_face(block: Block) -> cq.Face:
    """The textured surface alone, as one CadQuery face in the block frame.

    Do not rely on its ``Area()``: :func:`tacbench_cad.geometry.brep.texture_face` says why, and how to measure it.

    Args:
        block: The block; its key is cut off.

    Raises:
        InputError: There is no solid of this block; the message says why.
    """
    return cq.Face(brep.texture_face(block))


def register() -> None:
    """Add ``Workplane.textureBlock(block, combine=True, clean=True)`` to CadQuery.

    It puts the block at every point of the stack, in the workplane's own axes, and combines as ``Workplane.box`` does.
    """

    def texture_block_method(
        self: cq.Workplane,
        block: Block,
        combine: bool | str = True,
        clean: bool = True,
    ) -> cq.Workplane:
        """A texture block at every point of the stack; its lower corner lies at the point."""
        return self.eachpoint(solid(block).moved, True, combine, clean)

    cq.Workplane.textureBlock = texture_block_method
