"""A plate's layout file, as ``tacbench plate`` writes it: which blocks were printed together, read for ``acquire``."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path

from tacbench_cad.lab.study import names
from tacbench_cad.lab.study.spec import PrintedBlock
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.textures import read_texture
from tacbench_cad.util.errors import InputError

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
        found = read_texture(folder / word)
        return Block.of(found.texture, preset, scale=scale, key_mm=key_mm, table=found.block)
    return Block.of(word, preset, scale=scale, key_mm=key_mm)


def read_layout(path: Path) -> tuple[PrintedBlock, ...]:
    """The blocks of a layout file, in its order.

    Args:
        path: The CSV file; texture files in it are found from its folder.

    Raises:
        InputError: The file cannot be read, lacks a column, or a value in it is not allowed; the message names the
            line.
    """
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            reader = csv.DictReader(stream, strict=True)
            missing = [name for name in NEEDED if name not in (reader.fieldnames or ())]
            if missing:
                raise InputError(
                    f"layout {path}", None, f"has no column {missing[0]}; tacbench plate writes such files"
                )
            rows = [(reader.line_num, row) for row in reader]
    except OSError as error:
        raise InputError("layout", str(path), f"cannot be read: {error.strerror}") from None
    except (UnicodeDecodeError, csv.Error):
        raise InputError("layout", str(path), "is no CSV text") from None
    if not rows:
        raise InputError("layout", str(path), "has no block")
    return tuple(_printed(row, f"layout {path}, line {number}: ", path.parent) for number, row in rows)


def _printed(row: Mapping[str, str | None], where: str, folder: Path) -> PrintedBlock:
    words = {name: (row[name] or "").strip() for name in NEEDED}
    try:
        return PrintedBlock(
            block=block_of_word(
                words["texture"],
                words["preset"],
                _number("scale", words["scale"]),
                _number("key_mm", words["key_mm"]) if words["key_mm"] else None,
                folder,
            ),
            printer=names.own_name("printer", words["printer"]),
            filament=names.own_name("filament", words["filament"]),
            copy=_whole("copy", words["copy"]),
        )
    except InputError as error:
        raise InputError(f"{where}{error.field}", error.value, error.allowed) from None


def _number(name: str, word: str) -> float:
    try:
        return float(word)
    except ValueError:
        raise InputError(name, word, "must be a number") from None


def _whole(name: str, word: str) -> int:
    try:
        return int(word)
    except ValueError:
        raise InputError(name, word, "must be a whole number") from None
