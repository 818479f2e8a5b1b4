"""Texture files in TOML, and the textures that words mean: a number, a name, or the path of such a file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from annotated_types import Interval, Len

from tacbench_cad.spec.families import (
    BUILT_IN_NAMES,
    LATER_NAMES,
    MAX_TERMS,
    Axes,
    Law,
    Terms,
    built_in,
    built_in_name,
    catalogue,
    equation1,
    harmonics,
    series,
)
from tacbench_cad.spec.images import image_texture
from tacbench_cad.spec.operations import added
from tacbench_cad.spec.sines import Wave
from tacbench_cad.spec.textures import WAVE_LIMITS, BlockTable, Texture, require_own_unit, table_in_mm
from tacbench_cad.spec.waves import WaveSum
from tacbench_cad.util.convert import from_plain
from tacbench_cad.util.errors import InputError, located, nearest
from tacbench_cad.util.untrusted import read_document

#: The largest number of waves in a texture file.
MAX_WAVES = 1_000
#: The words for all six textures and for all later ones.
GROUPS = ("all", "later")


def find_textures(
    words: Sequence[Texture | str | int | Path],
    preset: str = "paper",
    folder: Path = Path(),
    *,
    others: Sequence[str] = (),
    within: tuple[Path, ...] = (),
) -> list[Texture]:
    """Return the textures that words mean. Everything that takes the name of a texture uses this function.

    Args:
        words: Each is one of ``4``, ``"4"`` or ``"texture-4"``; ``"dunes"`` or ``"z13"``; a TOML file, whose block
            settings the texture then has; ``"all"`` for the six textures of the paper, ``"later"`` for the authors'
            later ones; or a texture, which is returned as it is.
        preset: ``paper`` or ``released``.
        folder: The folder of relative paths.
        others: The words that the caller also accepts, which the error message offers.
        within: The texture files that are being read, if the words stand in the last of them.

    Raises:
        InputError: There is no such texture, a file cannot be read, or two textures have the same name.
    """
    chosen = [texture for word in words for texture in _meant(word, preset, folder, others, within)]
    if not chosen:
        raise InputError("texture", "", "give at least one texture: 1 to 6, a TOML file or all")
    names = [texture.name for texture in chosen]
    for name in names:
        if names.count(name) > 1:
            raise InputError("texture", name, "is given twice, so two files would have the same name; remove one")
    return chosen


def find_texture(
    word: Texture | str | int | Path, preset: str = "paper", folder: Path = Path(), *, within: tuple[Path, ...] = ()
) -> Texture:
    """Return the one texture that a word means; same arguments as for :func:`find_textures`.

    Raises:
        InputError: There is no such texture, the file cannot be read, or the word means several textures.
    """
    first, *rest = find_textures((word,), preset, folder, within=within)
    if rest:
        allowed = "means several textures; name one: 1 to 6, a name such as dunes, or a TOML file"
        raise InputError("texture", word, allowed)
    return first


def _meant(
    word: Texture | str | int | Path, preset: str, folder: Path, others: Sequence[str], within: tuple[Path, ...]
) -> Sequence[Texture]:
    if isinstance(word, Texture):
        return (word,)
    text = word if isinstance(word, Path) else str(word).strip()
    path = folder / text if isinstance(text, Path) else texture_path(text, folder)
    if path is not None:
        if path.resolve() in within:
            allowed = "is this file itself, or a file that names this one, so the sum would never end; leave it out"
            raise InputError("[texture] of", word, allowed)
        return (read_texture(path, within),)
    name = str(text).lower()
    if name == "all":
        return catalogue(preset)
    if name == "later":
        return [built_in(each) for each in LATER_NAMES]
    if (known := built_in_name(name)) is not None:
        return (built_in(known, preset),)
    raise unknown_texture(str(text), folder, others)


def unknown_texture(word: str, folder: Path = Path(), others: Sequence[str] = ()) -> InputError:
    """Return the error for a word that means no texture; same arguments as for :func:`find_textures`."""
    file = f"{word}.toml"
    hint = f'did you mean the file "{file}"?' if (folder / file).is_file() else ""
    allowed = hint or nearest(word.lower(), [*others, *BUILT_IN_NAMES])
    return InputError("texture", word, f"{allowed}; a number from 1 to 6 and a TOML file are also allowed")


def is_texture_name(word: str) -> bool:
    """Return whether a word is the number or the name of a texture, or ``all`` or ``later``; files do not matter."""
    return word.lower() in GROUPS or built_in_name(word) is not None


def texture_path(word: str, folder: Path = Path()) -> Path | None:
    """Return the path of the texture file that a word means; None for the name or number of a texture, and others.

    A file whose name does not end in ``.toml`` is only meant if no texture has this name.
    """
    if is_texture_name(word):
        return None
    is_file = word.lower().endswith(".toml") or "/" in word or (folder / word).is_file()
    return folder / word if is_file else None


def read_texture(path: Path | str, within: tuple[Path, ...] = ()) -> Texture:
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
) -> Texture:
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
        texture, table = family.made(tables, folder, within)
        require_own_unit("[block] mm_per_unit", table.mm_per_unit, texture.surface)
        return replace(texture, block=table)


_Amplitude = Annotated[float, Interval(ge=-WAVE_LIMITS["amplitude"], le=WAVE_LIMITS["amplitude"])]
_Frequency = Annotated[float, Interval(ge=-WAVE_LIMITS["f"], le=WAVE_LIMITS["f"])]
_Phase = Annotated[float, Interval(ge=-WAVE_LIMITS["phase"], le=WAVE_LIMITS["phase"])]


_Stretch = Annotated[float, Interval(ge=1e-3, le=1e3)]
_Wavelength = Annotated[float, Interval(ge=1e-4, le=1e6)]


@dataclass(frozen=True, kw_only=True)
class _WaveTable:
    """A wave: ``f`` and ``g``, or an angle with a wavelength in units or in mm on the block."""

    amplitude: _Amplitude
    f: _Frequency | None = None
    g: _Frequency | None = None
    angle_deg: Annotated[float, Interval(ge=-360.0, le=360.0)] | None = None
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

    def made(self, document: _Document, *_: object) -> tuple[Texture, BlockTable]:
        surface = equation1(self.A1, self.A2, self.f1, self.f2, self.phase)
        return Texture(name=self.name, surface=surface), document.block


@dataclass(frozen=True, kw_only=True)
class _Series:
    name: str
    family: Literal["series"]
    law: Law | None = None
    N: int | None = None
    weights: Annotated[tuple[_Amplitude, ...], Len(1, MAX_TERMS)] | None = None
    terms: Terms = "highest"
    axes: Axes = "xy"

    def __post_init__(self) -> None:
        if self.weights is not None and (self.law is not None or self.N is not None):
            raise InputError("weights", None, "replaces law and N; give either weights, or law and N")
        for name in ("law", "N"):
            if self.weights is None and getattr(self, name) is None:
                raise InputError(name, None, "is missing; a series needs law and N, or weights")

    def made(self, document: _Document, *_: object) -> tuple[Texture, BlockTable]:
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

    def made(self, document: _Document, *_: object) -> tuple[Texture, BlockTable]:
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
    mm_per_pixel: Annotated[float, Interval(ge=1e-6, le=1e3)] | tuple[float, float] | None = None
    height_mm: float | tuple[float, float] | None = None
    smooth_mm: Annotated[float, Interval(ge=0.0, le=100.0)] = 0.0
    repeats: bool = False
    fit: Literal["spline", "waves"] = "spline"
    waves: int | None = None

    def __post_init__(self) -> None:
        if (self.fit == "waves") != (self.waves is not None):
            raise InputError("waves", self.waves, 'the number of waves belongs to fit = "waves"')

    def made(self, document: _Document, folder: Path, within: tuple[Path, ...]) -> tuple[Texture, BlockTable]:
        texture = image_texture(
            self.name,
            folder / self.file,
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
    of: Annotated[tuple[str | int, ...], Len(1, 10)]
    weights: Annotated[tuple[_Amplitude, ...], Len(1, 10)] | None = None
    turn_deg: Annotated[float, Interval(ge=-360.0, le=360.0)] = 0.0
    stretch: tuple[_Stretch, _Stretch, _Stretch] = (1.0, 1.0, 1.0)
    fade: Annotated[float, Interval(ge=1e-3, le=1e4)] | None = None

    def made(self, document: _Document, folder: Path, within: tuple[Path, ...]) -> tuple[Texture, BlockTable]:
        weights = self.weights or (1.0,) * len(self.of)
        if len(weights) != len(self.of):
            raise InputError("weights", len(weights), f"needs one number for each of the {len(self.of)} textures")
        parts = [find_texture(word, folder=folder, within=within) for word in self.of]
        own = document.block
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
        surface = added([weight * part.surface for part, weight in zip(parts, weights, strict=True)])
        if self.stretch != (1.0, 1.0, 1.0):
            surface = surface.mapped(self.stretch[:2], self.stretch[2])
        if self.turn_deg:
            surface = surface.turned(self.turn_deg)
        named = [f"{weight:g} {part.name}" for part, weight in zip(parts, weights, strict=True)]
        text = " + ".join(named) + (f", turned by {self.turn_deg:g} degrees" if self.turn_deg else "")
        if self.fade is not None:
            if table.domain is None and None in surface.ends:
                raise InputError("[block] domain", None, "is missing; fade needs [[u low, u high], [v low, v high]]")
            surface = surface.windowed(self.fade, table.domain)
            text += f", fading out over {self.fade:g}"
        return Texture(name=self.name, surface=surface, equation=text), table


def _merged(table: BlockTable, own: BlockTable) -> BlockTable:
    """Return a table with the settings of a second table where it has some."""
    values = {item.name: getattr(own, item.name) for item in fields(own) if getattr(own, item.name) is not None}
    if own.size_mm is not None and own.domain is None and table.domain is not None:
        (u, v), per_unit = table.domain, own.mm_per_unit or table.mm_per_unit or (1.0, 1.0, 1.0)
        width, depth = (side / unit for side, unit in zip(own.size_mm, per_unit, strict=False))
        values["domain"] = ((u[0], u[0] + width), (v[0], v[0] + depth))
    return replace(table, **values)


@dataclass(frozen=True, kw_only=True)
class _Document:
    """The document of a texture file."""

    texture: _Equation1 | _Series | _PlaneWaves | _Image | _Combined = field(metadata={"discriminator": "family"})
    block: BlockTable = field(default_factory=BlockTable)
    wave: Annotated[tuple[_WaveTable, ...], Len(0, MAX_WAVES)] = ()
