"""The six textures of the paper, the families they belong to, and texture files written by users."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from tacbench_cad.spec.images import read_heights
from tacbench_cad.spec.later import EQUATIONS, later_name, later_surface
from tacbench_cad.spec.operations import added, scaled, turned, windowed
from tacbench_cad.spec.sampled import height_map, smoothed
from tacbench_cad.spec.spline import SplineSurface
from tacbench_cad.spec.surface import Surface
from tacbench_cad.spec.wavefit import fit_waves
from tacbench_cad.spec.waves import Wave, WaveSum
from tacbench_cad.util.convert import Bounds, Length, Word, from_plain
from tacbench_cad.util.door import read_document
from tacbench_cad.util.errors import InputError, located, nearest, one_of

Law = Literal["triangle", "square", "sawtooth"]
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
#: The words for all six textures and for all later ones.
GROUPS = ("all", "later")


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
                for name, bounds in _BOUNDS.items():
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
    """Make the waves of the paper's second equation, a Fourier series over odd multiples i, or of a sawtooth.

    Args:
        law: The amplitudes: ``triangle`` for ``8/pi^2 (-1)^((i-1)/2) / i^2``, ``square`` for ``4/(pi i)``, both over
            odd i; ``sawtooth`` for ``2/pi (-1)^(i+1) / i`` over all i.
        N: The highest multiple, or the number of terms.
        terms: The meaning of ``N``: the ``highest`` multiple (as in the authors' files) or the ``count`` of terms.
        axes: The axes along which the series runs.

    Raises:
        InputError: ``N`` is not a positive whole number, or it is even for a triangle or a square.
    """
    if isinstance(N, bool) or not isinstance(N, int) or N < 1:
        raise InputError("N", N, "must be a whole number of at least 1")
    one_of("terms", terms, ("highest", "count"))
    one_of("law", law, ("triangle", "square", "sawtooth"))
    one_of("axes", axes, ("x", "y", "xy"))
    odd_only = law != "sawtooth"
    if odd_only and terms == "highest" and N % 2 == 0:
        raise InputError("N", N, f'must be odd where terms = "highest"; {N - 1} and {N + 1} are')
    highest = N if terms == "highest" or not odd_only else 2 * N - 1
    if highest > MAX_TERMS:
        raise InputError("N", N, f"the highest multiple may be {MAX_TERMS} at most")
    if law == "triangle":
        weights = [8.0 / math.pi**2 * (-1.0) ** ((i - 1) // 2) / i**2 for i in range(1, highest + 1)]
    elif law == "square":
        weights = [4.0 / (math.pi * i) for i in range(1, highest + 1)]
    else:
        weights = [2.0 / math.pi * (-1.0) ** (i + 1) / i for i in range(1, highest + 1)]
    if odd_only:
        weights = [weight if i % 2 == 0 else 0.0 for i, weight in enumerate(weights)]
    return harmonics(weights, axes)


def harmonics(weights: Sequence[float], axes: Axes = "xy") -> WaveSum:
    """Make a Fourier series with any weights, ``sum of weights[i - 1] sin(i u)``, and the same in v.

    >>> print(harmonics([1.0, 0.0, 0.25], axes="x"))
    sin u + 0.25 sin(3u)

    Args:
        weights: The amplitudes of the multiples 1, 2, 3 and so on.
        axes: The axes along which the series runs.

    Raises:
        InputError: There are too many weights, or one is not a finite number.
    """
    one_of("axes", axes, ("x", "y", "xy"))
    if not 1 <= len(weights) <= MAX_TERMS:
        raise InputError("weights", len(weights), f"must be 1 to {MAX_TERMS} numbers")
    used = [(float(i), weight) for i, weight in enumerate(weights, start=1) if weight != 0.0]
    along_x = [Wave(amplitude=weight, f=i, g=0.0) for i, weight in used if "x" in axes]
    along_y = [Wave(amplitude=weight, f=0.0, g=i) for i, weight in used if "y" in axes]
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


@cache
def later_texture(name: str) -> Texture | None:
    """Return one of the authors' later textures by its name or number (``dunes``, ``z13``); None for another word."""
    known = later_name(name)
    if known is None or known != name:
        return None if known is None else later_texture(known)
    return Texture(name=known, surface=later_surface(known), equation=EQUATIONS[known])


def texture(name: Texture | str | int | Path, preset: str = "paper", folder: Path = Path()) -> Texture:
    """Return one texture by its number, its name or its file. All functions that take one texture use this one.

    Args:
        name: ``4``, ``"4"`` or ``"texture-4"``; ``"dunes"`` or ``"z13"``; a TOML file, whose block settings the texture
            then has; or a texture, which is returned as it is.
        preset: ``paper`` or ``released``.
        folder: The folder of relative paths.

    Raises:
        InputError: There is no such texture, the file cannot be read, or the word means several textures.
    """
    if isinstance(name, Texture):
        return name
    if isinstance(name, Path):
        return read_texture(folder / name).texture
    word = str(name).strip()
    if path := texture_path(word, folder):
        return read_texture(path).texture
    six = {key: texture for texture in catalogue(preset) for key in (str(texture.number), texture.name)}
    known = six.get(word.lower()) or later_texture(word.lower())
    if known is not None:
        return known
    if word.lower() in GROUPS:
        allowed = "means several textures; name one: 1 to 6, a name such as dunes, or a TOML file"
        raise InputError("texture", word, allowed)
    hint = file_hint(word, folder) or nearest(word.lower(), [*(six[str(i)].name for i in range(1, 7)), *EQUATIONS])
    raise InputError("texture", word, f"{hint}; a number from 1 to 6 and a TOML file are also allowed")


def is_texture_name(word: str) -> bool:
    """Return whether a word is the number or the name of a texture, or ``all`` or ``later``; files do not matter."""
    word = word.lower()
    six = {key for texture in catalogue() for key in (str(texture.number), texture.name)}
    return word in six or word in GROUPS or later_name(word) is not None


def texture_path(word: str, folder: Path = Path()) -> Path | None:
    """Return the path of the texture file that a word means; None for the name or number of a texture, and others.

    A file whose name does not end in ``.toml`` is only meant if no texture has this name.
    """
    if is_texture_name(word):
        return None
    is_file = word.lower().endswith(".toml") or "/" in word or (folder / word).is_file()
    return folder / word if is_file else None


@dataclass(frozen=True, kw_only=True)
class TextureFile:
    """The content of a texture file.

    Args:
        texture: The texture, with the block settings.
    """

    texture: Texture

    @property
    def block(self) -> BlockTable:
        """The block settings."""
        return self.texture.block


def read_texture(path: Path | str, within: tuple[Path, ...] = ()) -> TextureFile:
    """Read a texture and its block settings from a TOML file.

    Args:
        path: The file. ``docs/textures.md`` lists the keys.
        within: The files that name this file, the outermost first.

    Raises:
        InputError: The file cannot be read, or a key or a value is not allowed.
    """
    path = Path(path)
    within = (*within, path.resolve())
    return texture_of_document(read_document(path, "texture", "toml"), f"{path}: ", path.parent, within)


def texture_of_document(
    document: Mapping[str, Any], where: str = "", folder: Path = Path(), within: tuple[Path, ...] = ()
) -> TextureFile:
    """Make a texture and its block settings from the tables of a texture file.

    Args:
        document: The tables, as a TOML parser returns them.
        where: The beginning of every error message: the name of the file.
        folder: The folder of the other files that the tables name.
        within: The file of the tables, and the files that name it.

    Raises:
        InputError: A key or a value is not allowed.
    """
    tables = from_plain(_Document, document, where)
    family = tables.texture
    with located(where):
        if not isinstance(family, _PlaneWaves) and tables.wave:
            raise InputError("[[wave]]", None, f'only allowed with family = "plane-waves", not "{family.family}"')
        texture, table = family.made(tables, _Files(folder, within))
        require_own_unit("[block] mm_per_unit", table.mm_per_unit, texture.surface)
        return TextureFile(texture=replace(texture, block=table))


@dataclass(frozen=True)
class _Files:
    """Where a texture file is.

    Args:
        folder: The folder of the other files that it names.
        within: The file itself, and the files that name it.
    """

    folder: Path
    within: tuple[Path, ...]


_Amplitude = Annotated[float, _BOUNDS["amplitude"]]
_Frequency = Annotated[float, _BOUNDS["f"]]
_Phase = Annotated[float, _BOUNDS["phase"]]


_Wavelength = Annotated[float, Bounds(1e-4, 1e6)]


@dataclass(frozen=True, kw_only=True)
class _WaveTable:
    """A wave: ``f`` and ``g``, or an angle with a wavelength in units or in mm on the block."""

    amplitude: _Amplitude
    f: _Frequency | None = None
    g: _Frequency | None = None
    angle_deg: Annotated[float, Bounds(-360.0, 360.0)] | None = None
    wavelength: _Wavelength | None = None
    wavelength_mm: _Wavelength | None = None
    phase: _Phase = 0.0

    def __post_init__(self) -> None:
        names = ("f", "g", "angle_deg", "wavelength", "wavelength_mm")
        given = tuple(name for name in names if getattr(self, name) is not None)
        if given == ("f",) or given == ("g",):
            raise InputError("g" if given == ("f",) else "f", None, "is missing; must be a finite number")
        if given not in (("f", "g"), ("angle_deg", "wavelength"), ("angle_deg", "wavelength_mm")):
            allowed = "give f and g, or angle_deg with wavelength (in units) or with wavelength_mm (on the block)"
            raise InputError("", None, allowed)

    def wave(self, mm_per_unit: tuple[float, float, float]) -> Wave:
        """Return the wave in units."""
        if self.f is not None and self.g is not None:
            return Wave(amplitude=self.amplitude, f=self.f, g=self.g, phase=self.phase)
        length = self.wavelength or self.wavelength_mm or 1.0
        angle = math.radians(self.angle_deg or 0.0)
        per_u, per_v = mm_per_unit[:2] if self.wavelength is None else (1.0, 1.0)
        f, g = (2.0 * math.pi / length * part for part in (per_u * math.cos(angle), per_v * math.sin(angle)))
        return Wave(amplitude=self.amplitude, f=f, g=g, phase=self.phase)


@dataclass(frozen=True, kw_only=True)
class _Equation1:
    name: str
    family: Literal["equation1"]
    A1: _Amplitude = 1.0
    A2: _Amplitude = 1.0
    f1: _Frequency
    f2: _Frequency
    phase: _Phase = 0.0

    def made(self, document: _Document, _: _Files) -> tuple[Texture, BlockTable]:
        surface = equation1(self.A1, self.A2, self.f1, self.f2, self.phase)
        return Texture(name=self.name, surface=surface), document.block


@dataclass(frozen=True, kw_only=True)
class _Series:
    name: str
    family: Literal["series"]
    law: Law | None = None
    N: int | None = None
    weights: Annotated[tuple[_Amplitude, ...], Length(1, MAX_TERMS)] | None = None
    terms: Terms = "highest"
    axes: Axes = "xy"

    def __post_init__(self) -> None:
        if self.weights is not None and (self.law is not None or self.N is not None):
            raise InputError("weights", None, "replaces law and N; give either weights, or law and N")
        for name in ("law", "N"):
            if self.weights is None and getattr(self, name) is None:
                raise InputError(name, None, "is missing; a series needs law and N, or weights")

    def made(self, document: _Document, _: _Files) -> tuple[Texture, BlockTable]:
        if self.weights is not None:
            return Texture(name=self.name, surface=harmonics(self.weights, self.axes)), document.block
        assert self.law is not None and self.N is not None
        text = f"{self.law} series along {self.axes}, {self.terms} = {self.N}"
        surface = series(self.law, self.N, self.terms, self.axes)
        return Texture(name=self.name, surface=surface, equation=text), document.block


@dataclass(frozen=True, kw_only=True)
class _PlaneWaves:
    name: str
    family: Literal["plane-waves"]

    def made(self, document: _Document, _: _Files) -> tuple[Texture, BlockTable]:
        if not document.wave:
            raise InputError("[[wave]]", None, "at least one such table is needed")
        units = document.block.mm_per_unit or (1.0, 1.0, 1.0)
        surface, block = WaveSum(tuple(wave.wave(units) for wave in document.wave)), document.block
        if any(wave.wavelength_mm is not None for wave in document.wave):
            surface, block = surface.mapped(units[:2], units[2], unit="mm"), table_in_mm(block, units)
        return Texture(name=self.name, surface=surface), block


@dataclass(frozen=True, kw_only=True)
class _Image:
    """A height map in a file."""

    name: str
    family: Literal["image"]
    file: str
    mm_per_pixel: Annotated[float, Bounds(1e-6, 1e3)] | tuple[float, float] | None = None
    height_mm: float | tuple[float, float] | None = None
    smooth_mm: Annotated[float, Bounds(0.0, 100.0)] = 0.0
    repeats: bool = False
    fit: Literal["spline", "waves"] = "spline"
    waves: int | None = None

    def __post_init__(self) -> None:
        if (self.fit == "waves") != (self.waves is not None):
            raise InputError("waves", self.waves, 'the number of waves belongs to fit = "waves"')

    def made(self, document: _Document, files: _Files) -> tuple[Texture, BlockTable]:
        texture = image_texture(
            self.name,
            files.folder / self.file,
            mm_per_pixel=self.mm_per_pixel,
            height_mm=self.height_mm,
            smooth_mm=self.smooth_mm,
            repeats=self.repeats,
            waves=self.waves,
        )
        return texture, document.block


@dataclass(frozen=True, kw_only=True)
class _Combined:
    """A sum of other textures."""

    name: str
    family: Literal["sum"]
    of: Annotated[tuple[Word, ...], Length(1, 10)]
    weights: Annotated[tuple[_Amplitude, ...], Length(1, 10)] | None = None
    turn_deg: Annotated[float, Bounds(-360.0, 360.0)] = 0.0
    fade: Annotated[float, Bounds(1e-3, 1e4)] | None = None

    def made(self, document: _Document, files: _Files) -> tuple[Texture, BlockTable]:
        weights = self.weights or (1.0,) * len(self.of)
        if len(weights) != len(self.of):
            raise InputError("weights", len(weights), f"needs one number for each of the {len(self.of)} textures")
        parts, own = [self._part(word, files) for word in self.of], document.block
        units = {part.block.mm_per_unit for part in parts if part.block.mm_per_unit is not None}
        if any(part.surface.unit == "mm" for part in parts):
            mixed = any(part.surface.unit != "mm" for part in parts)
            parts = [part.in_mm(own.mm_per_unit or part.block.mm_per_unit) for part in parts]
            if mixed and own.mm_per_unit is not None:
                own = table_in_mm(own, own.mm_per_unit)
        elif own.mm_per_unit is None and len(units) > 1:
            allowed = "is missing; the files in [texture] of have different ones, so say which this sum has"
            raise InputError("[block] mm_per_unit", None, allowed)
        table = parts[0].block
        for part in parts[1:]:
            table = _merged(table, part.block)
        table = _merged(table, own)
        surface = added([scaled(part.surface, weight) for part, weight in zip(parts, weights, strict=True)])
        if self.turn_deg:
            surface = turned(surface, self.turn_deg)
        named = [f"{weight:g} {part.name}" for part, weight in zip(parts, weights, strict=True)]
        text = " + ".join(named) + (f", turned by {self.turn_deg:g} degrees" if self.turn_deg else "")
        if self.fade is not None:
            ends = isinstance(surface, SplineSurface) and not (surface.u.repeats or surface.v.repeats)
            if table.domain is None and not ends:
                raise InputError("[block] domain", None, "is missing; fade needs [[u low, u high], [v low, v high]]")
            surface = windowed(surface, self.fade, table.domain)
            text += f", fading out over {self.fade:g}"
        return Texture(name=self.name, surface=surface, equation=text), table

    def _part(self, word: str, files: _Files) -> Texture:
        path = texture_path(word, files.folder)
        if path is None:
            return texture(word, folder=files.folder)
        if path.resolve() in files.within:
            allowed = "is this file itself, or a file that names this one, so the sum would never end; leave it out"
            raise InputError("[texture] of", word, allowed)
        return read_texture(path, files.within).texture


def _merged(table: BlockTable, own: BlockTable) -> BlockTable:
    """Return a table with the settings of a second table where it has some."""
    values = {item.name: getattr(own, item.name) for item in fields(own) if getattr(own, item.name) is not None}
    if own.size_mm is not None and own.domain is None and table.domain is not None:
        (u, v), per_unit = table.domain, own.mm_per_unit or table.mm_per_unit or (1.0, 1.0, 1.0)
        width, depth = (side / unit for side, unit in zip(own.size_mm, per_unit, strict=False))
        values["domain"] = ((u[0], u[0] + width), (v[0], v[0] + depth))
    return replace(table, **values)


def image_texture(
    name: str,
    path: Path,
    *,
    mm_per_pixel: float | tuple[float, float] | None = None,
    height_mm: float | tuple[float, float] | None = None,
    smooth_mm: float = 0.0,
    repeats: bool = False,
    waves: int | None = None,
) -> Texture:
    """Make a texture from a height map in a file: a picture, an array, a table, or the file of an instrument.

    Args:
        name: The name of the texture.
        path: The file; :func:`tacbench_cad.spec.images.read_heights` lists the formats.
        mm_per_pixel: The distance of neighbouring columns, or of columns and rows, in mm; None if the file says it.
        height_mm: The heights of the lowest and the highest value, or their difference; None if the values of the file
            are heights in mm.
        smooth_mm: The standard deviation of a Gaussian filter, in mm. It smooths the steps of a picture with 8 bits.
        repeats: Whether the height map repeats beyond its ends.
        waves: The number of waves that are fitted; None for a spline through all samples.

    Raises:
        InputError: The file cannot be read, or a number is missing or not allowed.
        MissingToolError: A package that reads the file is not installed.
    """
    file = read_heights(path)
    steps = mm_per_pixel if mm_per_pixel is not None else file.mm_per_pixel
    if steps is None:
        raise InputError("mm_per_pixel", None, f"is missing; {path.name} does not say how far apart its samples are")
    if height_mm is None and not file.in_mm:
        raise InputError(
            "height_mm", None, "is missing; give the height in mm of the brightest pixel above the darkest"
        )
    heights = file.values
    with located(f"{path.name}: "):
        if smooth_mm:
            heights = smoothed(heights, smooth_mm, steps, repeats or waves is not None)
        if waves is not None:
            fit = fit_waves(heights, waves=waves, mm_per_pixel=steps, height_mm=height_mm)
            return Texture(name=name, surface=fit.surface, equation=f"{path.name} as {fit}")
        surface = height_map(heights, mm_per_pixel=steps, height_mm=height_mm, repeats=repeats)
    rows, columns = np.shape(heights)
    text = f"{path.name}, {columns} x {rows} samples"
    return Texture(name=name, surface=surface, equation=text)


@dataclass(frozen=True, kw_only=True)
class _Document:
    """The document of a texture file."""

    texture: _Equation1 | _Series | _PlaneWaves | _Image | _Combined
    block: BlockTable = field(default_factory=BlockTable)
    wave: Annotated[tuple[_WaveTable, ...], Length(high=MAX_WAVES)] = ()
