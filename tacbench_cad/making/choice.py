"""The choice of textures by the words of a command line. Commands that make no parts load only this module."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from tacbench_cad.spec.block import Block
from tacbench_cad.spec.later import EQUATIONS
from tacbench_cad.spec.textures import Texture, catalogue
from tacbench_cad.spec.textures import texture as find_texture
from tacbench_cad.util.errors import InputError


def textures_of(words: Sequence[str | int | Path | Texture], preset: str) -> list[Texture]:
    """Return the textures for some words.

    Args:
        words: Numbers or names of the six textures, names of the authors' later textures, paths of TOML files, ``all``
            for the six, ``later`` for the later ones, or texture objects.
        preset: The preset of the six textures.

    Raises:
        InputError: A word is unknown, or two textures have the same name.
    """
    chosen: list[Texture] = []
    for word in words:
        group = word.lower() if isinstance(word, str) else ""
        if group == "all":
            chosen += catalogue(preset)
        elif group == "later":
            chosen += [find_texture(name, preset) for name in EQUATIONS]
        else:
            chosen.append(find_texture(word, preset))
    if not chosen:
        raise InputError("texture", "", "give at least one texture: 1 to 6, a TOML file or all")
    names = [texture.name for texture in chosen]
    for name in names:
        if names.count(name) > 1:
            raise InputError("texture", name, "is given twice, so two files would have the same name; remove one")
    return chosen


def described(words: Sequence[str], preset: str, scale: float) -> list[Block]:
    """Return the blocks of some textures for a description. The sampling of their meshes does not matter.

    Raises:
        InputError: A word, the preset or the scale is not allowed.
    """
    sampling: Literal["grid"] | None = "grid" if preset == "released" else None
    return [Block.of(texture, preset, scale=scale, sampling=sampling) for texture in textures_of(words, preset)]
