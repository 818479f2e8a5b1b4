"""The blocks that a person names: by texture, by the engraved label, by the name of a file, or by a print set."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Literal

from tacbench_cad.making.choice import described
from tacbench_cad.making.manifest import read_rows
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.outlines import outline_of_word
from tacbench_cad.spec.presets import PRESETS, VALUES, with_table
from tacbench_cad.spec.sampling import SampleGrid, Tolerance
from tacbench_cad.spec.storage import block_from
from tacbench_cad.spec.texture_files import find_texture, is_texture_name
from tacbench_cad.spec.textures import BlockTable
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.files import MANIFEST_NAME

#: The words of an engraved label: texture, preset, scale and copy.
_LABEL = re.compile(
    r"(?P<texture>[\w.-]+)\s+(?P<preset>[A-Za-z]+)\s+X(?P<scale>\d+(?:\.\d+)?)(?:\s+(?P<copy>\d{1,3}))?",
    re.IGNORECASE,
)
_NUMBER = r"-?\d+(?:\.\d+)?"


def blocks_named(
    word: str | None, preset: str = "paper", scale: float = 1.0, key_mm: float | None = None
) -> list[Block]:
    """Return the blocks that a word means.

    Args:
        word: A texture (1 to 6, a name, or a TOML file), the words of a label (``T4 PAPER X1 03``), the name of a block
            (``texture-4_paper_x1_key3``), or the folder of a print set with a manifest. None for the six textures. A
            texture comes before a folder with the same name; ``./4`` is the folder.
        preset: The preset, if the word does not contain it.
        scale: The scale, if the word does not contain it.
        key_mm: The leg of the key, if the word does not contain it; None for no key.

    Returns:
        At least one block. Blocks that differ only in label and copy are in the list once.

    Raises:
        InputError: The word means no block.
    """
    if word is None:
        return [replace(block, key_mm=key_mm) for block in described(("all",), preset, scale)]
    folder = Path(word)
    if folder.is_dir() and not is_texture_name(word):
        return _of_print_set(folder)
    label = _LABEL.fullmatch(word.strip())
    if label is not None and label["preset"].lower() in PRESETS:
        texture = re.sub(r"^[tT](?=\d)", "", label["texture"]).lower()
        blocks = described((texture,), label["preset"].lower(), float(label["scale"]))
        return [replace(block, key_mm=key_mm, copy=_number(label["copy"]), label=True) for block in blocks]
    named = block_of_name(word)
    if named is not None:
        return [named]
    return [replace(block, key_mm=key_mm) for block in described((word,), preset, scale)]


def _number(text: str | None) -> int | None:
    return None if text is None else int(text)


def _of_print_set(folder: Path) -> list[Block]:
    blocks = list(dict.fromkeys(_blocks(folder)))
    if not blocks:
        allowed = f"has no {MANIFEST_NAME} with blocks; name a print set, a texture, or the name of a block"
        raise InputError("block", str(folder), allowed)
    return blocks


def _blocks(folder: Path) -> Iterator[Block]:
    for row in read_rows(folder):
        if row.get("kind") == "block":
            block = block_from(row.get("block"), f"{folder / MANIFEST_NAME}: ")
            yield replace(block, label=False, copy=None)


def block_of_name(name: str) -> Block | None:
    """Return the block with a given ``name``, or None if it is not the name of a block with a built-in texture."""
    words = name.split("_")
    if len(words) < 3 or words[1] not in PRESETS or not (scale := re.fullmatch(rf"x({_NUMBER})", words[2])):
        return None
    if not is_texture_name(words[0]):
        return None
    rest = words[3:]
    size, unit, origin = _numbers(rest, "", 3), _numbers(rest, "mm", 3), _numbers(rest, "from", 2)
    outline = next((shape for word in rest if (shape := outline_of_word(word)) is not None), None)
    height = _numbers(rest, "h", 1)
    key, grid, tolerance = _numbers(rest, "key", 1), _numbers(rest, "grid", 2), _numbers(rest, "tol", 1)
    copy = _numbers(rest, "copy", 1)
    try:
        sampling: SampleGrid | Tolerance | Literal["grid"] | None = "grid" if words[1] == "released" else None
        if grid:
            sampling = SampleGrid(nx=int(grid[0]), ny=int(grid[1]))
        elif tolerance:
            sampling = Tolerance(mm=tolerance[0])
        own = find_texture(words[0], words[1])
        _, own_unit, own_origin, _ = with_table(VALUES[words[1]], own.block, own.surface)
        block = Block.of(
            own,
            words[1],
            scale=float(scale.group(1)),
            sampling=sampling,
            size_mm=(size[0], size[1]) if size else VALUES[words[1]].size_mm if outline is None else None,
            height_mm=size[2] if size else height[0] if height else None,
            mm_per_unit=(unit[0], unit[1], unit[2]) if unit else own_unit,
            key_mm=key[0] if key else None,
            label="label" in rest,
            copy=int(copy[0]) if copy else None,
            outline=outline,
            table=BlockTable(),
        )
        return replace(block, origin_uv=(origin[0], origin[1]) if origin else own_origin)
    except InputError:
        return None


def _numbers(words: list[str], prefix: str, count: int) -> list[float] | None:
    """Find the word that consists of a prefix and ``count`` numbers joined by ``x``; return the numbers."""
    pattern = re.compile(prefix + "x".join([f"({_NUMBER})"] * count))
    for word in words:
        if numbers := pattern.fullmatch(word):
            return [float(number) for number in numbers.groups()]
    return None
