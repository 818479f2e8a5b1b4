"""CadQuery: texture blocks as solids and in method chains.

This example makes two blocks side by side::

    import cadquery as cq
    from tacbench_cad.spec.block import Block
    from tacbench_cad.cq import texture_block

    two = cq.Workplane().rarray(40, 1, 2, 1).eachpoint(texture_block(Block.of(4)))

After ``tacbench_cad.cq.register()`` you can also write
``cq.Workplane().rarray(40, 1, 2, 1).textureBlock(Block.of(4))``.

:func:`textured` puts a texture on a face of any part::

    plate = cq.Workplane().box(40, 30, 5)
    plate = textured(plate, plate.faces(">Z"), 2, depth_mm=0.8)

After ``register()`` you can also write ``plate.faces(">Z").texture(2, depth_mm=0.8)``.

Importing this module imports CadQuery.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cadquery as cq

from tacbench_cad.geometry import brep
from tacbench_cad.geometry.part import rgb_of
from tacbench_cad.geometry.texturing import Texturing, texturing
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.textures import Texture
from tacbench_cad.util.errors import InputError


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


def textured(
    part: cq.Workplane | cq.Shape,
    face: cq.Workplane | cq.Face | str,
    texture: Texture | str | int | Path,
    **settings: Any,
) -> cq.Workplane:
    """Put a texture on a planar or cylindrical face of a part.

    Args:
        part: The part, with exactly one solid. It is not changed.
        face: A face of the part, a workplane with the face, or a selector, for example ``">Z"``.
        texture: A texture, the number or name of one of the six, the name of a later one, or a TOML file.
        **settings: The other settings of :class:`~tacbench_cad.geometry.texturing.Texturing`: ``depth_mm``,
            ``margin_mm``, ``fade_mm``, ``up``, ``sunk``, ``base_mm``, ``mm_per_unit`` and ``tolerance_mm``.

    Returns:
        A new workplane with the solid. To write it to a file, use :func:`tacbench_cad.textured`.

    Raises:
        InputError: The face is neither planar nor cylindrical, or a setting is not allowed for it.
    """
    shape = part.findSolid() if isinstance(part, cq.Workplane) else part
    if isinstance(face, str):
        from tacbench_cad.geometry.textured.textured_faces import faces_by

        faces = [cq.Face(found) for found in faces_by(shape.wrapped, face)]
    else:
        faces = face.vals() if isinstance(face, cq.Workplane) else [face]
    return cq.Workplane(_textured(shape, faces, texturing(texture, **settings)))


def _textured(shape: cq.Shape, faces: Sequence[Any], settings: Texturing) -> cq.Solid:
    """Put a texture on some faces of a shape, one after another. The other faces stay the same faces."""
    from tacbench_cad.geometry.textured.solid import textured_solid

    if not faces or not all(isinstance(face, cq.Face) for face in faces):
        raise InputError("face", None, "must be a face of the part; select at least one")
    wrapped = shape.wrapped
    for face in faces:
        wrapped = textured_solid(wrapped, face.wrapped, settings).solid
    return cq.Solid(wrapped)


def register() -> None:
    """Add the methods ``textureBlock`` and ``texture`` to CadQuery's ``Workplane``.

    ``textureBlock(block, combine=True, clean=True)`` adds the block at every point of the stack, aligned with the axes
    of the workplane, and combines it like ``Workplane.box``. ``texture(texture, ...)`` puts a texture on the selected
    faces of the solid in the chain. Its settings are the same as those of :func:`textured`.
    """

    def texture_block_method(
        self: cq.Workplane,
        block: Block,
        combine: bool | str = True,
        clean: bool = True,
    ) -> cq.Workplane:
        """Add a texture block at every point of the stack. Its lower corner is at the point."""
        return self.eachpoint(solid(block).moved, True, combine, clean)

    def texture_method(self: cq.Workplane, texture: Texture | str | int | Path, **settings: Any) -> cq.Workplane:
        """Put a texture on the selected faces."""
        return self.newObject([_textured(self.findSolid(), self.vals(), texturing(texture, **settings))])

    cq.Workplane.textureBlock = texture_block_method
    cq.Workplane.texture = texture_method
