"""The blocks of textures for a description. Commands that make no parts load only this module."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from tacbench_cad.spec.block import Block
from tacbench_cad.spec.texture_files import find_textures


def described(words: Sequence[str], preset: str, scale: float) -> list[Block]:
    """Return the blocks of some textures for a description. The sampling of their meshes does not matter.

    Raises:
        InputError: A word, the preset or the scale is not allowed.
    """
    sampling: Literal["grid"] | None = "grid" if preset == "released" else None
    return [Block.of(texture, preset, scale=scale, sampling=sampling) for texture in find_textures(words, preset)]
