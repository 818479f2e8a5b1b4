"""The six textures of the paper, the families they belong to, and texture files written by users."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from tacbench_cad.spec.spline import SplineSurface
from tacbench_cad.spec.surface import Surface
from tacbench_cad.spec.waves import Wave, WaveSum
from tacbench_cad.util.convert import Bounds, Length, from_plain
from tacbench_cad.util.door import read_document
from tacbench_cad.util.errors import InputError, located, one_of

Law = Literal["triangle", "square"]
Terms = Literal["highest", "count"]
Axes = Literal["x", "y", "xy"]

#: The largest allowed odd multiple of a series.
MAX_TERMS = 5_001
#: The largest number of waves in a texture file.
MAX_WAVES = 1_000
#: The allowed numbers of a wave. For larger phases, the sine of a 64-bit number has few correct digits.
_BOUNDS = {"amplitude": Bounds(-1e6, 1e6), "f": Bounds(-1e4, 1e4), "g": Bounds(-1e4, 1e4), "phase": Bounds(-1e6, 1e6)}
#: The names that a user's texture must not have, because they are names of other parts of a print set.
RESERVED = ("holder", "jig", "coupon", "preview", "manifest", "all")


@dataclass(frozen=True, kw_only=True)
class BlockTable:
    """The block settings of a texture file. A setting that the file leaves out is None.

    Args:
        size_mm: The sides x, y, in mm.
        height_mm: The height of the highest point, in mm.
        mm_per_unit: The millimetres per unit of u, v and height.
        domain: The part of the plane to use, ``((u low, u high), (v low, v high))``.
    """

    size_mm: tuple[float, float] | None = None
    height_mm: float | None = None
    mm_per_unit: tuple[float, float, float] | None = None
    domain: tuple[tuple[float, float], tuple[float, float]] | None = None


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

    def __new__(cls, **values: Any) -> Texture:
        """Refuse the former name of ``surface``."""
        if "waves" in values:
            raise InputError("texture waves", None, "is now called surface: Texture(name=..., surface=...)")
        return super().__new__(cls)

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
                for name, bounds in _BOUNDS.items():
                    if refusal := bounds.refusal(value := getattr(wave, name)):
                        raise InputError(f"texture {self.name} wave {name}", value, refusal)
        if not self.equation:
            object.__setattr__(self, "equation", str(self.surface))


def equation1(A1: float, A2: float, f1: float, f2: float, phase: float = 0.0) -> WaveSum:  # noqa: N803 (the paper's)
    """Make the waves of the paper's first equation, ``A1 sin(f1 u) + A2 sin(f2 v + phase)``.

    Args:
        A1: The amplitude along u, in units of height.
        A2: The amplitude along v, in units of height.
        f1: The frequency along u, in radians per unit of u.
        f2: The frequency along v, in radians per unit of v.
        phase: The phase of the wave along v, in radians.
    """
    return WaveSum(
        (Wave(amplitude=A1, f=f1, g=0.0, phase=0.0), Wave(amplitude=A2, f=0.0, g=f2, phase=phase)),
    )


def series(law: Law, N: int, terms: Terms = "highest", axes: Axes = "xy") -> WaveSum:  # noqa: N803
    """Make the waves of the paper's second equation, a Fourier series over odd multiples i.

    Args:
        law: The amplitudes: ``triangle`` for ``8/pi^2 (-1)^((i-1)/2) / i^2``, ``square`` for ``4/(pi i)``.
        N: The highest odd multiple, or the number of terms.
        terms: The meaning of ``N``: the ``highest`` multiple (as in the authors' files) or the ``count`` of terms.
        axes: The axes along which the series runs.

    Raises:
        InputError: ``N`` is not a positive whole number, or it is the highest multiple and even.
    """
    if isinstance(N, bool) or not isinstance(N, int) or N < 1:
        raise InputError("N", N, "must be a whole number of at least 1")
    one_of("terms", terms, ("highest", "count"))
    one_of("law", law, ("triangle", "square"))
    one_of("axes", axes, ("x", "y", "xy"))
    if terms == "highest" and N % 2 == 0:
        raise InputError("N", N, f'must be odd where terms = "highest"; {N - 1} and {N + 1} are')
    highest = N if terms == "highest" else 2 * N - 1
    if highest > MAX_TERMS:
        raise InputError("N", N, f"the highest multiple may be {MAX_TERMS} at most")
    odd = range(1, highest + 1, 2)
    if law == "triangle":
        weights = [(i, 8.0 / math.pi**2 * (-1.0) ** ((i - 1) // 2) / i**2) for i in odd]
    else:
        weights = [(i, 4.0 / (math.pi * i)) for i in odd]
    along_x = [Wave(amplitude=w, f=float(i), g=0.0) for i, w in weights if "x" in axes]
    along_y = [Wave(amplitude=w, f=0.0, g=float(i)) for i, w in weights if "y" in axes]
    return WaveSum(tuple(along_x + along_y))


def plane_waves(*waves: tuple[float, float, float] | tuple[float, float, float, float]) -> WaveSum:
    """Make a sum of any waves, each given as ``(amplitude, f, g)`` or ``(amplitude, f, g, phase)``.

    >>> print(plane_waves((0.6, 2.0, 1.0), (0.6, 2.0, -1.0)))
    0.6 sin(2u + v) + 0.6 sin(2u - v)

    Raises:
        InputError: A wave has too few or too many numbers, or a number that is not finite.
    """
    table = []
    for one in waves:
        if len(one) not in (3, 4):
            raise InputError("wave", one, "must be (amplitude, f, g) or (amplitude, f, g, phase)")
        amplitude, f, g, phase = (*one, 0.0)[:4]
        table.append(Wave(amplitude=amplitude, f=f, g=g, phase=phase))
    return WaveSum(tuple(table))


def _series_texture(number: int, law: Law, highest: int, axes: Axes) -> Texture:
    weight = "8/pi^2 (-1)^((i-1)/2)/i^2" if law == "triangle" else "4/(pi i)"
    shape = "(sin iu + sin iv)" if axes == "xy" else "sin iu"
    text = f"sum of {weight} {shape}, odd i = 1..{highest}"
    return Texture(name=f"texture-{number}", number=number, equation=text, surface=series(law, highest, axes=axes))


def catalogue(preset: str = "paper") -> tuple[Texture, ...]:
    """Return the paper's six textures. For ``released``, textures 4 and 6 have N = 101, as in the authors' files."""
    square = 101 if preset == "released" else 25
    return (
        Texture(name="texture-1", number=1, equation="sin u", surface=equation1(1.0, 0.0, 1.0, 1.0, math.pi / 2)),
        Texture(
            name="texture-2",
            number=2,
            equation="sin u + sin(v + pi/2)",
            surface=equation1(1.0, 1.0, 1.0, 1.0, math.pi / 2),
        ),
        _series_texture(3, "triangle", 25, "xy"),
        _series_texture(4, "square", square, "xy"),
        _series_texture(5, "triangle", 25, "x"),
        _series_texture(6, "square", square, "x"),
    )


def file_hint(word: str, folder: Path = Path()) -> str:
    """Return ``did you mean the file "hex.toml"?`` for the word ``hex`` if the folder has this file, else nothing."""
    name = f"{word}.toml"
    return f'did you mean the file "{name}"?' if (folder / name).is_file() else ""


def texture(name: str | int, preset: str = "paper") -> Texture:
    """Return one of the six textures by its number or name.

    Args:
        name: ``4``, ``"4"`` or ``"texture-4"``.
        preset: ``paper`` or ``released``.

    Raises:
        InputError: There is no such texture.
    """
    word = str(name).strip().lower()
    for texture in catalogue(preset):
        if word in (str(texture.number), texture.name):
            return texture
    allowed = "allowed: 1 to 6, texture-1 to texture-6, a TOML file or all"
    raise InputError("texture", str(name), file_hint(str(name)) or allowed)


@dataclass(frozen=True, kw_only=True)
class TextureFile:
    """The content of a texture file.

    Args:
        texture: The texture.
        block: The block settings.
    """

    texture: Texture
    block: BlockTable = field(default_factory=BlockTable)


def read_texture(path: Path) -> TextureFile:
    """Read a texture and its block settings from a TOML file.

    Args:
        path: The file. ``docs/textures.md`` lists the keys.

    Raises:
        InputError: The file cannot be read, or a key or a value is not allowed.
    """
    return texture_of_document(read_document(path, "texture", "toml"), f"{path}: ")


def texture_of_document(document: Mapping[str, Any], where: str = "") -> TextureFile:
    """Make a texture and its block settings from the tables of a texture file.

    Args:
        document: The tables, as a TOML parser returns them.
        where: The beginning of every error message: the name of the file.

    Raises:
        InputError: A key or a value is not allowed.
    """
    tables = from_plain(_Document, document, where)
    family = tables.texture
    with located(where):
        if not isinstance(family, _PlaneWaves) and tables.wave:
            raise InputError("[[wave]]", None, f'only allowed with family = "plane-waves", not "{family.family}"')
        waves = family.waves(tables.wave)
        texture = Texture(name=family.name, equation=family.equation(waves), surface=waves)
    return TextureFile(texture=texture, block=tables.block)


_Amplitude = Annotated[float, _BOUNDS["amplitude"]]
_Frequency = Annotated[float, _BOUNDS["f"]]
_Phase = Annotated[float, _BOUNDS["phase"]]


@dataclass(frozen=True, kw_only=True)
class _WaveTable:
    amplitude: _Amplitude
    f: _Frequency
    g: _Frequency
    phase: _Phase = 0.0


@dataclass(frozen=True, kw_only=True)
class _Equation1:
    name: str
    family: Literal["equation1"]
    A1: _Amplitude = 1.0
    A2: _Amplitude = 1.0
    f1: _Frequency
    f2: _Frequency
    phase: _Phase = 0.0

    def waves(self, _: tuple[_WaveTable, ...]) -> WaveSum:
        return equation1(self.A1, self.A2, self.f1, self.f2, self.phase)

    def equation(self, waves: WaveSum) -> str:
        return str(waves)


@dataclass(frozen=True, kw_only=True)
class _Series:
    name: str
    family: Literal["series"]
    law: Law
    N: int
    terms: Terms = "highest"
    axes: Axes = "xy"

    def waves(self, _: tuple[_WaveTable, ...]) -> WaveSum:
        return series(self.law, self.N, self.terms, self.axes)

    def equation(self, _: WaveSum) -> str:
        return f"{self.law} series along {self.axes}, {self.terms} = {self.N}"


@dataclass(frozen=True, kw_only=True)
class _PlaneWaves:
    name: str
    family: Literal["plane-waves"]

    def waves(self, tables: tuple[_WaveTable, ...]) -> WaveSum:
        if not tables:
            raise InputError("[[wave]]", None, "at least one such table is needed")
        return plane_waves(*((wave.amplitude, wave.f, wave.g, wave.phase) for wave in tables))

    def equation(self, waves: WaveSum) -> str:
        return str(waves)


@dataclass(frozen=True, kw_only=True)
class _Document:
    """The document of a texture file."""

    texture: _Equation1 | _Series | _PlaneWaves
    block: BlockTable = field(default_factory=BlockTable)
    wave: Annotated[tuple[_WaveTable, ...], Length(high=MAX_WAVES)] = ()
