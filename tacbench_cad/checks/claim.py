"""What a file of ours says that it is: its part's name stands in the STL header, the 3MF metadata, the STEP header."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import Literal

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
        header = _STEP_NAME.search(stream.read(2048).decode("ascii", "replace"))
    return header.group(1) if header else None


def claimed_block(name: str, texture: Texture | None = None) -> Block | None:
    """The block that a name of ours stands for (its ``name``), or None where it is no block's.

    Args:
        name: The name.
        texture: Comes in place of the name's texture; needed where that is not one of the six.
    """
    words = name.split("_")
    if len(words) < 3 or words[1] not in PRESETS or not (scale := re.fullmatch(rf"x({_NUMBER})", words[2])):
        return None
    rest = words[3:]
    size, unit, origin = _numbers(rest, "", 3), _numbers(rest, "mm", 3), _numbers(rest, "from", 2)
    key, grid, tolerance = _numbers(rest, "key", 1), _numbers(rest, "grid", 2), _numbers(rest, "tol", 1)
    try:
        sampling: SampleGrid | Tolerance | Literal["grid"] | None = "grid" if words[1] == "released" else None
        if grid:
            sampling = SampleGrid(nx=int(grid[0]), ny=int(grid[1]))
        elif tolerance:
            sampling = Tolerance(mm=tolerance[0])
        block = Block.of(
            texture or find_texture(words[0], words[1]),
            words[1],
            scale=float(scale.group(1)),
            sampling=sampling,
            size_mm=(size[0], size[1]) if size else None,
            height_mm=size[2] if size else None,
            mm_per_unit=(unit[0], unit[1], unit[2]) if unit else None,
            key_mm=key[0] if key else None,
        )
        return dataclasses.replace(block, origin_uv=(origin[0], origin[1])) if origin else block
    except InputError:
        return None


def _numbers(words: list[str], prefix: str, count: int) -> list[float] | None:
    """The numbers of the word made of a prefix and so many numbers joined by x."""
    pattern = re.compile(prefix + "x".join([f"({_NUMBER})"] * count))
    for word in words:
        if numbers := pattern.fullmatch(word):
            return [float(number) for number in numbers.groups()]
    return None
