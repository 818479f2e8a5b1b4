"""build123d: texture blocks as parts.

A plate with four blocks and a hole::

    from build123d import BuildPart, GridLocations, Mode, Cylinder
    from tacbench_cad.bd import TextureBlock

    with BuildPart() as part:
        with GridLocations(40, 40, 2, 2):
            TextureBlock(4, key_mm=3)
        Cylinder(3, 30, mode=Mode.SUBTRACT)

Holder and jig as parts with joints are in :mod:`housing.bd`.

Importing this module imports build123d.
"""

from __future__ import annotations

from typing import Any, ClassVar

from build123d import (
    Align,
    BasePartObject,
    BuildPart,
    Color,
    Face,
    Location,
    Mode,
    RigidJoint,
    RotationLike,
    Solid,
)

from tacbench_cad.geometry import brep
from tacbench_cad.geometry.part import colour_of
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.sampling import STEP_TOLERANCE_MM
from tacbench_cad.spec.textures import Texture
from tacbench_cad.util.errors import InputError


class TextureBlock(BasePartObject):  # type: ignore[misc]  # build123d is not typed for mypy
    """Part Object: Texture Block.

    A block whose top is a texture, within a proved distance of its formula. ``.block`` is its specification, its
    label is the block's name. The joint ``underside`` is the block frame: the lower corner of the underside, z up.

    Args:
        texture: A texture, the number or name of one of the six, or a :class:`~tacbench_cad.spec.block.Block`; with
            a block the arguments up to ``step_tolerance_mm`` keep their defaults.
        preset: ``paper`` or ``released``.
        scale: Multiplies sides, height and mm per unit.
        size_mm: Sides x, y in mm instead of the preset's.
        height_mm: Height of the highest point in mm instead of the preset's.
        mm_per_unit: Millimetres per unit of u, v and height instead of the preset's.
        key_mm: Leg of the chamfered corner at (x, 0) in mm, or None.
        label: Engrave texture, preset and scale in the underside.
        copy: Copy number in the label, or None.
        step_tolerance_mm: Greatest vertical distance from the formula, in mm.
        rotation: Angles to rotate about the axes, in degrees.
        align: Align MIN, CENTER or MAX of the block's box along x, y and z; None leaves the lower corner of the
            underside at the origin.
        mode: Combination mode.

    Raises:
        InputError: The specification is not allowed, or there is no solid of it; the message says why.
    """

    _applies_to: ClassVar[list[str]] = [BuildPart._tag]

    def __init__(
        self,
        texture: Block | Texture | str | int,
        preset: str = "paper",
        scale: float = 1.0,
        size_mm: tuple[float, float] | None = None,
        height_mm: float | None = None,
        mm_per_unit: tuple[float, float, float] | None = None,
        key_mm: float | None = None,
        label: bool = False,
        copy: int | None = None,
        step_tolerance_mm: float = STEP_TOLERANCE_MM,
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
            STEP_TOLERANCE_MM,
        ):
            self.block = texture
        else:
            raise InputError("texture", texture.name, "is a whole block already; change the block instead")
        made = Solid(brep.solid_block(self.block)[0], label=self.block.name)
        # The box is known: asking the kernel for it, as the base class would, takes a second for a rich texture.
        if align is not None:
            each = (align,) * 3 if isinstance(align, Align) else align
            shares = {Align.NONE: 0.0, Align.MIN: 0.0, Align.CENTER: 0.5, Align.MAX: 1.0}
            sides = (*self.block.size_mm, self.block.height_mm)
            made.move(Location(tuple(-shares[one] * side for one, side in zip(each, sides, strict=True))))
        frame = made.location
        super().__init__(part=made, rotation=rotation, align=None, mode=mode)
        self.color = Color(colour_of("block"))
        RigidJoint("underside", self, self.rotation * frame)


def texture_face(block: Block) -> Face:
    """The textured surface alone, as one build123d face in the block frame.

    Do not rely on its ``.area``: :func:`tacbench_cad.geometry.brep.texture_face` says why, and how to measure it.

    Args:
        block: The block; its key is cut off.

    Raises:
        InputError: There is no solid of this block; the message says why.
    """
    return Face(brep.texture_face(block))
