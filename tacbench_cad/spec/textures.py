"""A texture: a surface with a name, and the block settings that belong to it."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

# the readers and families make textures, so their modules are loaded when they are used
from numpy.typing import ArrayLike

from tacbench_cad import spec
from tacbench_cad.spec.surface import Surface, Unit
from tacbench_cad.util.convert import Unchecked
from tacbench_cad.util.errors import InputError, require_between
from tacbench_cad.util.types import Floats

#: The largest numbers of a wave. For larger phases, the sine of a 64-bit number has few correct digits.
WAVE_LIMITS = {"amplitude": 1e6, "f": 1e4, "g": 1e4, "phase": 1e6}
#: The names that a user's texture must not have, because they are names of other parts of a print set.
RESERVED = ("holder", "jig", "coupon", "preview", "manifest", "all")

#: What a surface must have.
_MEMBERS = {name for name in vars(Surface) if not name.startswith("_")} | {"__call__"}


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
    surface: Annotated[Surface, Unchecked()]
    equation: str = ""
    number: int | None = None
    block: BlockTable = field(default_factory=BlockTable)

    @staticmethod
    def of(word: Texture | str | int | Path, preset: str = "paper") -> Texture:
        """Return a texture by its number, its name or its file: ``4``, ``"dunes"``, ``"hex.toml"``.

        Raises:
            InputError: There is no such texture, or the file cannot be read.
        """
        return spec.find_texture(word, preset)

    @staticmethod
    def catalogue(preset: str = "paper") -> tuple[Texture, ...]:
        """Return the paper's six textures; see :func:`tacbench_cad.spec.families.catalogue`."""
        return spec.catalogue(preset)

    @staticmethod
    def read(path: Path | str) -> Texture:
        """Read a texture and its block settings from a TOML file.

        Raises:
            InputError: The file cannot be read, or a key or a value is not allowed.
        """
        return spec.read_texture(path)

    @staticmethod
    def from_image(name: str, path: Path | str, **options: Any) -> Texture:
        """Make a texture from a height map in a file; see :func:`tacbench_cad.spec.images.image_texture`."""
        return spec.image_texture(name, Path(path), **options)

    @classmethod
    def from_heights(
        cls,
        heights: ArrayLike,
        *,
        name: str = "height-map",
        mm_per_pixel: float | tuple[float, float] = 1.0,
        height_mm: float | tuple[float, float] | None = None,
        repeats: bool = False,
        waves: int | None = None,
    ) -> Self:
        """Make a texture from the heights on an even grid; see :func:`tacbench_cad.spec.interpolation.height_map`.

        Args:
            heights: The heights, shape (rows, columns), as in an image: the first row is at the largest y.
            name: The name.
            mm_per_pixel: The distance of neighbouring columns, or of neighbouring columns and rows, in mm.
            height_mm: The heights to which the lowest and the highest value are scaled, or their difference; None if
                the values are in mm.
            repeats: Whether the surface repeats beyond its ends.
            waves: The number of waves that are fitted, which repeat without a seam; None for a spline through all
                heights.
        """
        if waves is not None:
            fit = spec.fit_waves(heights, waves=waves, mm_per_pixel=mm_per_pixel, height_mm=height_mm)
            return cls(name=name, surface=fit.surface, equation=str(fit))
        surface = spec.height_map(heights, mm_per_pixel=mm_per_pixel, height_mm=height_mm, repeats=repeats)
        return cls(name=name, surface=surface)

    @classmethod
    def from_function(
        cls,
        function: Callable[[Floats, Floats], ArrayLike],
        *,
        u: tuple[float, float],
        v: tuple[float, float],
        name: str = "function",
        error: float = 1e-4,
        creases: tuple[Sequence[float], Sequence[float]] = ((), ()),
        repeats: tuple[bool, bool] = (False, False),
        unit: Unit = "units",
    ) -> Self:
        """Make a texture from a Python function; see :func:`tacbench_cad.spec.interpolation.sampled`."""
        surface = spec.sampled(function, u=u, v=v, error=error, creases=creases, repeats=repeats, unit=unit)
        return cls(name=name, surface=surface)

    @classmethod
    def plane_waves(cls, *waves: tuple[float, ...], name: str = "waves", equation: str = "") -> Self:
        """Make a texture from any waves, each given as ``(amplitude, f, g)`` or ``(amplitude, f, g, phase)``.

        >>> Texture.plane_waves((0.6, 2.0, 1.0), (0.6, 2.0, -1.0)).equation
        '0.6 sin(2u + v) + 0.6 sin(2u - v)'
        """
        return cls(name=name, surface=spec.plane_waves(*waves), equation=equation)

    @classmethod
    def equation1(
        cls,
        A1: float,  # noqa: N803 (the paper's)
        A2: float,  # noqa: N803
        f1: float,
        f2: float,
        phase: float = 0.0,
        *,
        name: str = "equation1",
    ) -> Self:
        """Make the paper's first equation, ``A1 sin(f1 u) + A2 sin(f2 v + phase)``."""
        return cls(name=name, surface=spec.equation1(A1, A2, f1, f2, phase))

    @classmethod
    def series(
        cls,
        law: Literal["triangle", "square", "sawtooth"],
        N: int,  # noqa: N803 (the paper's)
        terms: Literal["highest", "count"] = "highest",
        axes: Literal["x", "y", "xy"] = "xy",
        *,
        name: str = "series",
    ) -> Self:
        """Make a series of the paper's second equation; see :func:`tacbench_cad.spec.families.series`."""
        return cls(name=name, surface=spec.series(law, N, terms, axes))

    @classmethod
    def harmonics(
        cls, weights: Sequence[float], axes: Literal["x", "y", "xy"] = "xy", *, name: str = "harmonics"
    ) -> Self:
        """Make a Fourier series with any weights; see :func:`tacbench_cad.spec.families.harmonics`."""
        return cls(name=name, surface=spec.harmonics(weights, axes))

    @classmethod
    def ridges(cls, *, pitch_mm: float, height_mm: float, name: str = "ridges") -> Self:
        """Make parallel round ridges along y, one pitch apart, with a height from valley to ridge."""
        return cls(name=name, surface=spec.ridges(pitch_mm, height_mm))

    @classmethod
    def dots(cls, *, pitch_mm: float, height_mm: float, name: str = "dots") -> Self:
        """Make round bumps on a square grid."""
        return cls(name=name, surface=spec.dots(pitch_mm, height_mm))

    @classmethod
    def checks(cls, *, pitch_mm: float, height_mm: float, name: str = "checks") -> Self:
        """Make bumps and pits like the fields of a chessboard. Two bumps along x are one pitch apart."""
        return cls(name=name, surface=spec.checks(pitch_mm, height_mm))

    @classmethod
    def hex_bumps(cls, *, pitch_mm: float, height_mm: float, name: str = "hex-bumps") -> Self:
        """Make bumps that each have six neighbours at the distance of the pitch."""
        return cls(name=name, surface=spec.hex_bumps(pitch_mm, height_mm))

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
        if missing := _MEMBERS - set(dir(self.surface)):
            raise InputError(
                f"texture {self.name} surface",
                type(self.surface).__name__,
                f"must be a WaveSum, a SplineSurface or another Surface; it has no {min(missing)}",
            )
        if self.surface.is_flat:
            raise InputError("texture", self.name, "is flat; at least one wave needs an amplitude and a frequency")
        for wave in self.surface.plane_waves or ():
            for name, limit in WAVE_LIMITS.items():
                require_between(f"texture {self.name} wave {name}", getattr(wave, name), -limit, limit)
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
