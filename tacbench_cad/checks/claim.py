"""What a file of ours says that it is: its part's name stands in the STL header, the 3MF metadata, the STEP header."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

from tacbench_cad.formats.stl import stl_header
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.presets import PRESETS
from tacbench_cad.spec.sampling import SampleGrid, Tolerance
from tacbench_cad.spec.textures import Texture
from tacbench_cad.spec.textures import texture as find_texture
from tacbench_cad.util.door import open_input
from tacbench_cad.util.errors import InputError

_NUMBER = r"\d+(?:\.\d+)?"
_STEP_NAME = re.compile(r"FILE_NAME\(\s*'([^']*)'.*?'tacbench-cad ", re.DOTALL)


def claimed_name(path: Path, metadata: dict[str, str] | None = None) -> str | None:
    """The part's name that a file of ours bears, or None for a file made elsewhere.

    Args:
        path: The file.
        metadata: What a 3MF's reader found.
    """
    suffix = path.suffix.lower()
    if metadata is not None:
        ours = metadata.get("Application", "").startswith("tacbench-cad ")
        return metadata.get("name") if ours else None
    if suffix == ".stl":
        first, _, name = stl_header(path).partition(" ")
        return name if first == "tacbench-cad" and name else None
    with open_input(path, kind="step") as stream:
        found = _STEP_NAME.search(stream.read(2048).decode("ascii", "replace"))
    return found.group(1) if found else None


def claimed_block(name: str, texture: Texture | None = None) -> Block | None:
    """The block that a name of ours stands for (its ``name``), or None where it is no block's.

    Args:
        name: The name.
        texture: Comes in place of the name's texture; needed where that is not one of the six.
    """
    words = name.split("_")
    if len(words) < 3 or words[1] not in PRESETS or not (scale := re.fullmatch(rf"x({_NUMBER})", words[2])):
        return None
    try:
        surface = texture or find_texture(words[0], words[1])
        sampling = _sampling(words[3:])
        block = Block.of(
            surface,
            words[1],
            scale=float(scale.group(1)),
            sampling=sampling if sampling is not None else ("grid" if words[1] == "released" else None),
            size_mm=_sizes(words[3:]),
            height_mm=_height(words[3:]),
            mm_per_unit=_mm_per_unit(words[3:]),
            key_mm=_key(words[3:]),
        )
        origin = _numbers(words[3:], "from", 2)
        return dataclasses.replace(block, origin_uv=(origin[0], origin[1])) if origin else block
    except InputError:
        return None


def _numbers(words: list[str], prefix: str, count: int) -> list[float] | None:
    """The numbers of the word made of a prefix and so many numbers joined by x."""
    pattern = re.compile(prefix + "x".join([f"({_NUMBER})"] * count))
    for word in words:
        if found := pattern.fullmatch(word):
            return [float(one) for one in found.groups()]
    return None


def _sizes(words: list[str]) -> tuple[float, float] | None:
    found = _numbers(words, "", 3)
    return (found[0], found[1]) if found else None


def _height(words: list[str]) -> float | None:
    found = _numbers(words, "", 3)
    return found[2] if found else None


def _mm_per_unit(words: list[str]) -> tuple[float, float, float] | None:
    found = _numbers(words, "mm", 3)
    return (found[0], found[1], found[2]) if found else None


def _key(words: list[str]) -> float | None:
    found = _numbers(words, "key", 1)
    return found[0] if found else None


def _sampling(words: list[str]) -> SampleGrid | Tolerance | None:
    if grid := _numbers(words, "grid", 2):
        return SampleGrid(nx=int(grid[0]), ny=int(grid[1]))
    tolerance = _numbers(words, "tol", 1)
    return Tolerance(mm=tolerance[0]) if tolerance else None
