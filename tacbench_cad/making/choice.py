"""Which textures the words of a command line mean. Commands that only describe load this and no more."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

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
    found: list[tuple[Texture, BlockTable | None]] = []
    six = catalogue(preset)
    known = {name: one for one in six for name in (str(one.number), one.name)}
    for one in words:
        if isinstance(one, Texture):
            found.append((one, None))
            continue
        word = str(one)
        if word == "all":
            found += [(one, None) for one in six]
        elif word.lower() in known:
            found.append((known[word.lower()], None))
        elif word.lower().endswith(".toml") or "/" in word or Path(word).exists():
            file = read_texture(Path(word))
            found.append((file.texture, file.block))
        else:
            hint = nearest(word, [one.name for one in six])
            raise InputError("texture", word, f"{hint}; a number from 1 to 6, a TOML file and all are allowed too")
    if not found:
        raise InputError("texture", "", "name at least one: 1 to 6, a TOML file or all")
    names = [one.name for one, _ in found]
    for name in names:
        if names.count(name) > 1:
            raise InputError("texture", name, "is asked for twice; its files would share their names")
    return found


def described(words: Sequence[str], preset: str, scale: float) -> list[Block]:
    """The blocks of some textures, to look at and not to make: how their meshes are sampled does not matter.

    Raises:
        InputError: A word, the preset or the scale is not allowed.
    """
    found = textures_of(words, preset)
    if preset == "released":
        return [Block.of(one, preset, scale=scale, sampling="grid", table=table) for one, table in found]
    return [Block.of(one, preset, scale=scale, table=table) for one, table in found]
