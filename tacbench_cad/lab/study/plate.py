"""Reading of a plate's layout file, which ``tacbench plate`` writes and which lists the blocks of the plate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from tacbench_cad.lab.study import names
from tacbench_cad.lab.study.spec import PrintedBlock
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.printermodel import read_printer_model
from tacbench_cad.spec.texture_files import find_texture
from tacbench_cad.util import door
from tacbench_cad.util.errors import InputError, located

T = TypeVar("T")

#: The column with the printer model of corrected files, which older layouts lack.
COMPENSATE = "compensate"
#: The columns that describe the block. The other columns describe its position on the plate and are not needed.
NEEDED = ("texture", "preset", "scale", "key_mm", "copy", "printer", "filament")


def block_of_word(word: str, preset: str, scale: float, key_mm: float | None, folder: Path) -> Block:
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


def read_layout(path: Path) -> tuple[PrintedBlock, ...]:
    """Read the blocks of a layout file, in the order of the file.

    Args:
        path: The CSV file. Texture files are relative to its folder.

    Raises:
        InputError: The file cannot be read, lacks a column, or has a value that is not allowed. The message names the
            row.
    """
    header, rows = door.read_table(path, "layout")
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
            compensate = row[header.index(COMPENSATE)].strip() if COMPENSATE in header else ""
            if compensate:
                model = read_printer_model(path.parent / compensate)
                model.require_for(printer, filament)
                block = replace(block, correction=model)
            copy = _number(int, "copy", word["copy"])
            blocks.append(PrintedBlock(block=block, printer=printer, filament=filament, copy=copy))
    return tuple(blocks)


def _number(kind: Callable[[str], T], name: str, word: str) -> T:
    try:
        return kind(word)
    except ValueError:
        raise InputError(name, word, f"must be a {'whole ' if kind is int else ''}number") from None
