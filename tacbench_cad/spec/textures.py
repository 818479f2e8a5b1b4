"""A texture: a surface with a name, and the block settings that belong to it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from tacbench_cad.spec.spline import SplineSurface
from tacbench_cad.spec.surface import Surface
from tacbench_cad.spec.waves import WaveSum
from tacbench_cad.util.convert import Bounds
from tacbench_cad.util.errors import InputError

#: The allowed numbers of a wave. For larger phases, the sine of a 64-bit number has few correct digits.
WAVE_BOUNDS = {
    "amplitude": Bounds(-1e6, 1e6),
    "f": Bounds(-1e4, 1e4),
    "g": Bounds(-1e4, 1e4),
    "phase": Bounds(-1e6, 1e6),
}
#: The names that a user's texture must not have, because they are names of other parts of a print set.
RESERVED = ("holder", "jig", "coupon", "preview", "manifest", "all")


@dataclass(frozen=True, kw_only=True)
class BlockTable:
    """The block settings of a texture file. A setting that the file leaves out is None.

    Args:
        size_mm: The sides x, y, in mm.
        height_mm: The height of the highest point, in mm.
        mm_per_unit: The millimetres per unit of u, v and height; None if the texture is in mm.
        domain: The part of the plane to use, ``((u low, u high), (v low, v high))``, in the unit of the surface.
        outline: The outline in words: ``disc``, ``hexagon:30``; see :func:`tacbench_cad.spec.outlines.outline_of`.
    """

    size_mm: tuple[float, float] | None = None
    height_mm: float | None = None
    mm_per_unit: tuple[float, float, float] | None = None
    domain: tuple[tuple[float, float], tuple[float, float]] | None = None
    outline: str | None = None


@dataclass(frozen=True, kw_only=True)
class Texture:
    """A surface with a name.

    Args:
        name: The name in lower case, which file names contain: ``texture-4``, ``hex``.
        surface: The formula: a sum of waves, or a spline.
        equation: The formula as text. If it is empty, it is written from the surface.
        number: The number 1 to 6 of a texture of the paper, otherwise None.
        block: The block settings that belong to the surface, for example the size of a height map.

    Raises:
        InputError: The name is not allowed or is already used, the surface is flat, or a number is out of bounds.
    """

    name: str
    surface: Surface
    equation: str = ""
    number: int | None = None
    block: BlockTable = field(default_factory=BlockTable)

    def in_mm(self, mm_per_unit: tuple[float, float, float] | None) -> Texture:
        """Return the texture with a surface in mm.

        Args:
            mm_per_unit: The millimetres per unit of u, v and height. A texture in mm needs none.

        Raises:
            InputError: The texture has units, and no millimetres per unit are given.
        """
        if self.surface.unit == "mm":
            return self
        if mm_per_unit is None:
            allowed = f"is missing; {self.name} has units, and cannot be added to a texture in mm without it"
            raise InputError("[block] mm_per_unit", None, allowed)
        x, y, z = mm_per_unit
        return replace(
            self, surface=self.surface.mapped((x, y), z, unit="mm"), block=table_in_mm(self.block, mm_per_unit)
        )

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[a-z0-9]([a-z0-9-]{0,30}[a-z0-9])?", self.name):
            raise InputError("texture name", self.name, "use 1 to 32 of the characters a-z, 0-9 and inner hyphens")
        if self.number is None and (self.name in RESERVED or re.fullmatch(r"(texture-?)?\d+", self.name)):
            raise InputError("texture name", self.name, "is the name of a part of the print set; choose another")
        if not isinstance(self.surface, WaveSum | SplineSurface):
            raise InputError(
                f"texture {self.name} surface",
                type(self.surface).__name__,
                "must be a sum of waves (plane_waves, series, equation1, WaveSum) or a spline (sampled for a Python "
                "function, height_map for an array)",
            )
        if self.surface.is_flat:
            raise InputError("texture", self.name, "is flat; at least one wave needs an amplitude and a frequency")
        if isinstance(self.surface, WaveSum):
            for wave in self.surface.waves:
                for name, bounds in WAVE_BOUNDS.items():
                    if refusal := bounds.refusal(value := getattr(wave, name)):
                        raise InputError(f"texture {self.name} wave {name}", value, refusal)
        if not self.equation:
            object.__setattr__(self, "equation", str(self.surface))


def require_own_unit(field: str, mm_per_unit: Sequence[float] | None, surface: Surface) -> None:
    """Check that a texture in mm is not stretched.

    Args:
        field: The name of the setting, for the error message.
        mm_per_unit: The millimetres per unit that were given, or None.
        surface: The surface of the texture.

    Raises:
        InputError: The surface is in mm, and a unit would not be 1 mm.
    """
    if surface.unit == "mm" and mm_per_unit is not None and any(factor != 1.0 for factor in mm_per_unit):
        raise InputError(field, tuple(mm_per_unit), "the texture is in mm; leave this out, or use scale to enlarge it")


def table_in_mm(table: BlockTable, mm_per_unit: Sequence[float]) -> BlockTable:
    """Return the settings for a surface that was brought to mm."""
    if table.domain is None:
        return replace(table, mm_per_unit=None)
    (u0, u1), (v0, v1) = table.domain
    x, y = mm_per_unit[:2]
    return replace(table, mm_per_unit=None, domain=((u0 * x, u1 * x), (v0 * y, v1 * y)))
