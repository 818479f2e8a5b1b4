"""build123d: texture blocks as parts.

This example makes a plate with four blocks and a hole::

    from build123d import BuildPart, GridLocations, Mode, Cylinder
    from tacbench_cad.bd import TextureBlock

    with BuildPart() as part:
        with GridLocations(40, 40, 2, 2):
            TextureBlock(4, key_mm=3)
        Cylinder(3, 30, mode=Mode.SUBTRACT)

:func:`textured` puts a texture on a face of any part::

    box = Box(40, 30, 5)
    box = textured(box, box.faces().sort_by(Axis.Z)[-1], 2, depth_mm=0.8)

The module :mod:`housing.bd` contains holder and jig as parts with joints.

Importing this module imports build123d.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, ClassVar

from build123d import (
    Align,
    BasePartObject,
    BuildPart,
    Color,
    Compound,
    Face,
    Location,
    Mode,
    Part,
    RigidJoint,
    RotationLike,
    Shape,
    Solid,
)

from tacbench_cad.geometry import brep
from tacbench_cad.geometry.part import colour_of
from tacbench_cad.geometry.texturing import texturing
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.textures import Texture
from tacbench_cad.util.errors import InputError


class TextureBlock(BasePartObject):  # type: ignore[misc]  # build123d is not typed for mypy
    """Part Object: Texture Block.

    A block with a texture as its top, within a proved distance of the formula. The attribute ``block`` is the
    specification, and the label is the name of the block. The joint ``underside`` is at the origin of the block frame:
    the lower corner of the underside, with z up.

    Args:
        texture: A texture, the number or name of one of the six textures, the name of a later one, a TOML file, or a
            :class:`~tacbench_cad.spec.block.Block`. With a block, the arguments up to ``step_tolerance_mm`` must keep
            their defaults.
        preset: ``paper`` or ``released``.
        scale: The factor for sides, height and mm per unit.
        size_mm: The sides x, y in mm; None for those of the preset.
        height_mm: The height of the highest point in mm; None for that of the preset.
        mm_per_unit: The number of mm per unit of u, v and height; None for those of the preset.
        key_mm: The leg of the chamfered corner at (x, 0) in mm; None for a block without a key.
        label: Whether texture, preset and scale are engraved in the underside.
        copy: The number of the copy in the label; None for a label without a number.
        step_tolerance_mm: The largest vertical distance from the formula, in mm; None for 0.001, or more if the
            texture's own error is larger.
        rotation: The rotation about the axes, in degrees.
        align: Align MIN, CENTER or MAX of the bounding box along x, y and z; None keeps the lower corner of the
            underside at the origin.
        mode: The combination mode.

    Raises:
        InputError: The specification is not allowed, or no solid of it can be made. The message states the reason.
    """

    _applies_to: ClassVar[list[str]] = [BuildPart._tag]

    def __init__(
        self,
        texture: Block | Texture | str | int | Path,
        preset: str = "paper",
        scale: float = 1.0,
        size_mm: tuple[float, float] | None = None,
        height_mm: float | None = None,
        mm_per_unit: tuple[float, float, float] | None = None,
        key_mm: float | None = None,
        label: bool = False,
        copy: int | None = None,
        step_tolerance_mm: float | None = None,
        rotation: RotationLike = (0, 0, 0),
        align: Align | tuple[Align, Align, Align] | None = (Align.CENTER, Align.CENTER, Align.MIN),
        mode: Mode = Mode.ADD,
    ) -> None:
        options: dict[str, Any] = {
            "scale": scale,
            "size_mm": size_mm,
            "height_mm": height_mm,
            "mm_per_unit": mm_per_unit,
            "key_mm": key_mm,
            "label": label,
            "copy": copy,
            "step_tolerance_mm": step_tolerance_mm,
        }
        if not isinstance(texture, Block):
            self.block = Block.of(texture, preset, **options)
        elif (preset, scale, *list(options.values())[1:]) == (
            "paper",
            1.0,
            None,
            None,
            None,
            None,
            False,
            None,
            None,
        ):
            self.block = texture
        else:
            raise InputError("texture", texture.name, "is a block and allows no further options; change the block")
        solid = Solid(brep.solid_block(self.block)[0], label=self.block.name)
        # The bounding box is known. The base class would compute it by the kernel, which takes a second for a texture
        # with many waves.
        if align is not None:
            each = (align,) * 3 if isinstance(align, Align) else align
            fractions = {Align.NONE: 0.0, Align.MIN: 0.0, Align.CENTER: 0.5, Align.MAX: 1.0}
            sides = (*self.block.size_mm, self.block.height_mm)
            solid.move(Location(tuple(-fractions[point] * side for point, side in zip(each, sides, strict=True))))
        frame = solid.location
        super().__init__(part=solid, rotation=rotation, align=None, mode=mode)
        self.color = Color(colour_of("block"))
        RigidJoint("underside", self, self.rotation * frame)


def textured(
    part: Shape | None,
    face: Face | Iterable[Face],
    texture: Texture | str | int | Path,
    *,
    mode: Mode = Mode.REPLACE,
    **settings: Any,
) -> Part:
    """Part Operation: textured.

    Put a texture on one or more planar or cylindrical faces of a part.

    Args:
        part: The part, with exactly one solid; None for the part of the builder. It is not changed.
        face: A face of the part, or several faces that get the texture one after another.
        texture: A texture, the number or name of one of the six, the name of a later one, or a TOML file.
        mode: How the result is combined with the part of a builder. ``Mode.PRIVATE`` leaves the builder as it is.
        **settings: The other settings of :class:`~tacbench_cad.geometry.texturing.Texturing`: ``depth_mm``,
            ``margin_mm``, ``fade_mm``, ``up``, ``sunk``, ``base_mm``, ``mm_per_unit`` and ``tolerance_mm``.

    Raises:
        InputError: The face is neither planar nor cylindrical, a setting is not allowed for it, or there is no part.
    """
    from tacbench_cad.geometry.textured.solid import textured_solid

    context: BuildPart | None = BuildPart._get_context("textured", log=False)
    whole = part if part is not None or context is None else context.part
    if whole is None:
        raise InputError("part", None, "is missing; give a part, or use a builder that has one")
    faces = [face] if isinstance(face, Face) else list(face)
    if not faces or not all(isinstance(chosen, Face) for chosen in faces):
        raise InputError("face", None, "must be a face of the part; select at least one")
    own = texturing(texture, **settings)
    shape = whole.wrapped
    for chosen in faces:
        shape = textured_solid(shape, chosen.wrapped, own).solid
    solid = Solid(shape)
    if context is not None:
        context._add_to_context(solid, clean=False, mode=mode)
    return Part(Compound([solid]).wrapped)


def texture_face(block: Block) -> Face:
    """Return only the textured surface, as one build123d face in the block frame.

    Do not rely on the attribute ``area`` of the face. :func:`tacbench_cad.geometry.brep.texture_face` explains the
    reason, and how to measure the area.

    Args:
        block: The block. The corner of its key is cut off.

    Raises:
        InputError: No solid of this block can be made. The message states the reason.
    """
    return Face(brep.texture_face(block))
