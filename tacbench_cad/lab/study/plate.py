"""A plate's layout file, as ``tacbench plate`` writes it: which blocks were printed together, read for ``acquire``."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from tacbench_cad.lab.study import names
from tacbench_cad.lab.study.spec import PrintedBlock
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.textures import read_texture
from tacbench_cad.util import door
from tacbench_cad.util.errors import InputError, located

T = TypeVar("T")

#: What a row says of its block; other columns say where it lay and are not needed here.
NEEDED = ("texture", "preset", "scale", "key_mm", "copy", "printer", "filament")


def block_of_word(word: str, preset: str, scale: float, key_mm: float | None, folder: Path) -> Block:
    """The block of a texture: the number or name of one of the six, or a TOML file.

    Args:
        word: The texture.
        preset: ``paper`` or ``released``.
        scale: The block's scale.
        key_mm: Leg of its key, or None.
        folder: Where TOML files are found from.

    Raises:
        InputError: A value is not allowed.
    """
    if word.endswith(".toml"):
        file = read_texture(folder / word)
        return Block.of(file.texture, preset, scale=scale, key_mm=key_mm, table=file.block)
    return Block.of(word, preset, scale=scale, key_mm=key_mm)


def read_layout(path: Path) -> tuple[PrintedBlock, ...]:
    """The blocks of a layout file, in its order.

    Args:
        path: The CSV file; texture files in it are found from its folder.

    Raises:
        InputError: The file cannot be read, lacks a column, or a value in it is not allowed; the message names the
            row.
    """
    header, rows = door.read_table(path, "layout")
    missing = [name for name in NEEDED if name not in header]
    if missing:
        raise InputError(f"layout {path}", None, f"has no column {missing[0]}; tacbench plate writes such files")
    if not rows:
        raise InputError("layout", str(path), "has no block")
    blocks = []
    for number, row in enumerate(rows, start=2):
        with located(f"layout {path}, line {number}: "):
            word = {name: row[header.index(name)].strip() for name in NEEDED}
            scale = _number(float, "scale", word["scale"])
            key_mm = _number(float, "key_mm", word["key_mm"]) if word["key_mm"] else None
            blocks.append(
                PrintedBlock(
                    block=block_of_word(word["texture"], word["preset"], scale, key_mm, path.parent),
                    printer=names.own_name("printer", word["printer"]),
                    filament=names.own_name("filament", word["filament"]),
                    copy=_number(int, "copy", word["copy"]),
                )
            )
    return tuple(blocks)


def _number(kind: Callable[[str], T], name: str, word: str) -> T:
    try:
        return kind(word)
    except ValueError:
        raise InputError(name, word, f"must be a {'whole ' if kind is int else ''}number") from None
