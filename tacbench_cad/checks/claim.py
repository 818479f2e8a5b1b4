"""The part name in a file of this package (STL header, 3MF metadata or STEP header), and the block that it describes.

Such a name contains all settings of a block: ``texture-2_paper_x1_40x35x8_key2.5_tol0.05``.
"""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import Any, Literal

from tacbench_cad.formats.stl import HEADER_BYTES, stl_header
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.outlines import outline_of_word
from tacbench_cad.spec.presets import PRESETS, VALUES, with_table
from tacbench_cad.spec.sampling import SampleGrid, Tolerance
from tacbench_cad.spec.texture_files import find_texture, is_texture_name
from tacbench_cad.spec.textures import BlockTable, Texture
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.files import MANIFEST_NAME
from tacbench_cad.util.untrusted import open_input, read_document

_NUMBER = r"-?\d+(?:\.\d+)?"
_STEP_NAME = re.compile(r"FILE_NAME\(\s*'([^']*)'.*?'tacbench-cad ", re.DOTALL)


def claimed_name(path: Path, metadata: dict[str, str] | None = None) -> str | None:
    """Return the part name in a file of this package, or None if another program wrote the file.

    The header of an STL file has room for 67 characters of the name. A longer name is in the manifest in the folder of
    the file.

    Args:
        path: The file.
        metadata: The metadata of a 3MF file; None for other formats.

    Raises:
        InputError: The name is cut off, and the manifest is missing.
    """
    suffix = path.suffix.lower()
    if metadata is not None:
        own_file = metadata.get("Application", "").startswith("tacbench-cad ")
        return metadata.get("name") if own_file else None
    if suffix == ".stl":
        header = stl_header(path)
        first, _, name = header.partition(" ")
        if first != "tacbench-cad" or not name:
            return None
        return name if len(header) < HEADER_BYTES else _full_name(path, name)
    with open_input(path, kind="step") as stream:
        found = _STEP_NAME.search(stream.read(2048).decode("ascii", "replace"))
    # The kernel breaks long lines, also within a name.
    return found.group(1).replace("\r", "").replace("\n", "") if found else None


def _full_name(path: Path, begin: str) -> str:
    """Return the part name in the manifest that begins with the name in the header of an STL file."""
    row = _row_beside(path)
    name = row.get("part")
    if isinstance(name, str) and name.startswith(begin):
        return name
    allowed = f"has room for only {len(begin)} characters of the name of its part in its header"
    raise InputError("file", str(path), f"{allowed}; keep {MANIFEST_NAME} beside it, or check the 3MF or STEP file")


def _row_beside(path: Path) -> dict[str, Any]:
    """Return the row of a file in the manifest in its folder; an empty row if there is none."""
    manifest = path.parent / MANIFEST_NAME
    if not manifest.is_file():
        return {}
    try:
        rows = read_document(manifest, "manifest", "json")["files"]
        return next((row for row in rows if row["file"] == path.name), {})
    except (InputError, LookupError, TypeError):
        return {}


def claimed_block(name: str, texture: Texture | None = None) -> Block | None:
    """Return the block with a given ``name``, or None if the name is not the name of a block.

    Args:
        name: The name.
        texture: A texture that replaces the texture in the name. It is necessary if the texture in the name is not one
            of the six.
    """
    words = name.split("_")
    if len(words) < 3 or words[1] not in PRESETS or not (scale := re.fullmatch(rf"x({_NUMBER})", words[2])):
        return None
    if texture is None and not is_texture_name(words[0]):  # a name in a file must not make the program open files
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
        own = texture or find_texture(words[0], words[1])
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
        return dataclasses.replace(block, origin_uv=(origin[0], origin[1]) if origin else own_origin)
    except InputError:
        return None


def _numbers(words: list[str], prefix: str, count: int) -> list[float] | None:
    """Find the word that consists of a prefix and ``count`` numbers joined by ``x``; return the numbers."""
    pattern = re.compile(prefix + "x".join([f"({_NUMBER})"] * count))
    for word in words:
        if numbers := pattern.fullmatch(word):
            return [float(number) for number in numbers.groups()]
    return None
