"""Which textures the words of a command line mean. Commands that only describe load this and no more."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from tacbench_cad.spec.block import Block
from tacbench_cad.spec.textures import BlockTable, Texture, catalogue, read_texture
from tacbench_cad.util.errors import InputError, nearest


def textures_of(words: Sequence[str | int | Texture], preset: str) -> list[tuple[Texture, BlockTable | None]]:
    """The textures that some words mean, each with what its file says of its block.

    Args:
        words: Numbers or names of the six, paths of TOML files, ``all``, or textures themselves.
        preset: Which six.

    Raises:
        InputError: A word means nothing, or two textures have one name.
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
        elif word.lower().endswith(".toml") or "/" in word or Path(word).exists():
            file = read_texture(Path(word))
            chosen.append((file.texture, file.block))
        else:
            hint = nearest(word, [texture.name for texture in six])
            raise InputError("texture", word, f"{hint}; a number from 1 to 6, a TOML file and all are allowed too")
    if not chosen:
        raise InputError("texture", "", "name at least one: 1 to 6, a TOML file or all")
    names = [texture.name for texture, _ in chosen]
    for name in names:
        if names.count(name) > 1:
            raise InputError("texture", name, "is asked for twice; its files would share their names")
    return chosen


def described(words: Sequence[str], preset: str, scale: float) -> list[Block]:
    """The blocks of some textures, to look at and not to make: how their meshes are sampled does not matter.

    Raises:
        InputError: A word, the preset or the scale is not allowed.
    """
    sampling: Literal["grid"] | None = "grid" if preset == "released" else None
    return [
        Block.of(texture, preset, scale=scale, sampling=sampling, table=table)
        for texture, table in textures_of(words, preset)
    ]
