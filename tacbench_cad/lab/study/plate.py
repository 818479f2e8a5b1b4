"""Reading of a plate's layout file, which ``tacbench plate`` writes and which lists the blocks of the plate."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from tacbench_cad.lab.study import names
from tacbench_cad.lab.study.spec import PrintedBlock
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.texture_files import find_texture
from tacbench_cad.util import untrusted
from tacbench_cad.util.errors import InputError, located

T = TypeVar("T")

#: The column with the texture file of a printed file that differs from the block.
FILE = "file"
#: The columns that describe the block. The other columns describe its position on the plate and are not needed.
NEEDED = ("texture", "preset", "scale", "key_mm", "copy", "printer", "filament")


def block_of_word(word: str | int, preset: str, scale: float, key_mm: float | None, folder: Path) -> Block:
    """Return the block of a texture.

    Args:
        word: The number or name of one of the six textures, or a TOML file.
        preset: ``paper`` or ``released``.
        scale: The block's scale.
        key_mm: The leg of the key, in mm; None for no key.
        folder: The folder that TOML files are relative to.

    Raises:
        InputError: A value is not allowed.
    """
    return Block.of(find_texture(word, preset, folder), preset, scale=scale, key_mm=key_mm)


def block_in_file(block: Block, path: Path) -> Block:
    """Return a block as it is in a printed file that differs from it.

    Args:
        block: The block that the print is expected to equal.
        path: The TOML file of the texture in the printed file, with its block settings.

    Raises:
        InputError: The file cannot be read, or a value is not allowed.
    """
    texture = find_texture(path, block.preset)
    return Block.of(texture, block.preset, scale=block.scale, key_mm=block.key_mm, sampling=block.sampling)


def read_layout(path: Path) -> tuple[PrintedBlock, ...]:
    """Read the blocks of a layout file, in the order of the file.

    Args:
        path: The CSV file. Texture files are relative to its folder.

    Raises:
        InputError: The file cannot be read, lacks a column, or has a value that is not allowed. The message names the
            row.
    """
    header, rows = untrusted.read_table(path, "layout")
    missing = [name for name in NEEDED if name not in header]
    if missing:
        raise InputError(f"layout {path}", None, f"has no column {missing[0]}; use a file that tacbench plate wrote")
    if not rows:
        raise InputError("layout", str(path), "has no block")
    blocks = []
    for number, row in enumerate(rows, start=2):
        with located(f"layout {path}, line {number}: "):
            word = {name: row[header.index(name)].strip() for name in NEEDED}
            scale = _number(float, "scale", word["scale"])
            key_mm = _number(float, "key_mm", word["key_mm"]) if word["key_mm"] else None
            block = block_of_word(word["texture"], word["preset"], scale, key_mm, path.parent)
            printer, filament = names.own_name("printer", word["printer"]), names.own_name("filament", word["filament"])
            other = row[header.index(FILE)].strip() if FILE in header else ""
            file = block_in_file(block, path.parent / other) if other else None
            copy = _number(int, "copy", word["copy"])
            blocks.append(PrintedBlock(block=block, printer=printer, filament=filament, copy=copy, file=file))
    return tuple(blocks)


def _number(kind: Callable[[str], T], name: str, word: str) -> T:
    try:
        return kind(word)
    except ValueError:
        raise InputError(name, word, f"must be a {'whole ' if kind is int else ''}number") from None
