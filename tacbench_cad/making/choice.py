"""The choice of textures by the words of a command line. Commands that make no parts load only this module."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from tacbench_cad.spec.block import Block
from tacbench_cad.spec.later import EQUATIONS
from tacbench_cad.spec.textures import BlockTable, Texture, catalogue, file_hint, later_texture, read_texture
from tacbench_cad.spec.textures import texture as find_texture
from tacbench_cad.util.errors import InputError, nearest


def textures_of(words: Sequence[str | int | Texture], preset: str) -> list[tuple[Texture, BlockTable | None]]:
    """Return the textures for some words, each with the block settings of its file.

    Args:
        words: Numbers or names of the six textures, names of the authors' later textures, paths of TOML files, ``all``
            for the six, ``later`` for the later ones, or texture objects.
        preset: The preset of the six textures.

    Raises:
        InputError: A word is unknown, or two textures have the same name.
    """
    chosen: list[tuple[Texture, BlockTable | None]] = []
    six = catalogue(preset)
    known = {name: texture for texture in six for name in (str(texture.number), texture.name)}
    for word in words:
        if isinstance(word, Texture):
            chosen.append((word, None))
            continue
        word = str(word)
        if word == "all":
            chosen += [(texture, None) for texture in six]
        elif word.lower() in known:
            chosen.append((known[word.lower()], None))
        elif word.lower() == "later":
            chosen += [(find_texture(name, preset), None) for name in EQUATIONS]
        elif later := later_texture(word.lower()):
            chosen.append((later, None))
        elif word.lower().endswith(".toml") or "/" in word or Path(word).exists():
            file = read_texture(Path(word))
            chosen.append((file.texture, file.block))
        else:
            hint = file_hint(word) or nearest(word, [*(texture.name for texture in six), *EQUATIONS])
            raise InputError("texture", word, f"{hint}; a number from 1 to 6, a TOML file and all are also allowed")
    if not chosen:
        raise InputError("texture", "", "give at least one texture: 1 to 6, a TOML file or all")
    names = [texture.name for texture, _ in chosen]
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
    return [
        Block.of(texture, preset, scale=scale, sampling=sampling, table=table)
        for texture, table in textures_of(words, preset)
    ]
