"""The blocks that a file claims to contain: in its own metadata or header, or in the manifest beside it."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from tacbench_cad.formats import format_of
from tacbench_cad.formats.step_text import MAX_HEADER, blocks_in_header
from tacbench_cad.formats.threemf import BLOCKS
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.families import catalogue
from tacbench_cad.spec.sampling import STEP_TOLERANCE_MM, Tolerance
from tacbench_cad.spec.storage import block_from, unpacked_blocks
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.files import MANIFEST_NAME, sha256
from tacbench_cad.util.processes import read_isolated
from tacbench_cad.util.untrusted import open_input, parse_json, read_document

#: The time limit for making the blocks, in s, and the additional time for each MB of the file.
LIMITS_S = (60.0, 10.0)


def claimed_blocks(path: Path, metadata: Mapping[str, str] | None = None) -> dict[str, Block]:
    """Return the blocks that a file of this package claims to contain, by the names of their bodies.

    The blocks are in the metadata of a 3MF file and in the header of a STEP file. An STL file has no room for them, so
    they are in the manifest in its folder, where a renamed file is found by its SHA-256.

    Args:
        path: The file.
        metadata: The metadata of a 3MF file; None for other formats.

    Returns:
        The blocks; empty if neither the file nor a manifest names one.

    Raises:
        CheckFailedError: The stored values are damaged, or state another surface for a built-in texture.
    """
    try:
        stored = _in_file(path, metadata) or _beside(path)
        if format_of(path).shape == "solid":  # this is already a child process
            return {name: _of_solid(block) for name, block in _blocks(stored).items()}
        made: dict[str, Block] = stored and read_isolated(path, "the check of its blocks", LIMITS_S, _blocks, stored)
        return made
    except (InputError, TypeError, ValueError) as error:
        detail = str(error) if isinstance(error, InputError) else "the blocks are damaged"
        raise CheckFailedError(f"{path}: the stored description of the file cannot be used: {detail}") from None


def _in_file(path: Path, metadata: Mapping[str, str] | None) -> dict[str, Any]:
    """Return the blocks in the metadata or in the header of a file as plain values."""
    packed: str | bytes | None = None
    if metadata is not None:
        names = itertools.takewhile(metadata.__contains__, (f"{BLOCKS}{i or ''}" for i in itertools.count()))
        packed = "".join(metadata[name] for name in names)
    elif format_of(path).shape == "solid":
        with open_input(path, kind="step") as stream:
            packed = blocks_in_header(stream.read(MAX_HEADER))
    return dict(parse_json(unpacked_blocks(packed), "file", str(path))) if packed else {}


def _beside(path: Path) -> dict[str, Any]:
    """Return the block of a file in the manifest in its folder as plain values; nothing if the manifest has none."""
    manifest = path.parent / MANIFEST_NAME
    if not manifest.is_file():
        return {}
    try:
        rows = read_document(manifest, "manifest", "json")["files"]
        named = [row for row in rows if row["file"] == path.name]
        row = (named or [row for row in rows if row["sha256"] == sha256(path)])[0]
        return {str(row["part"]): row["block"]}
    except (InputError, LookupError, TypeError):
        return {}


def _blocks(stored: dict[str, Any]) -> dict[str, Block]:
    """Return blocks from their plain values. A texture of the paper must have the surface of the catalogue."""
    blocks = {name: block_from(values) for name, values in stored.items()}
    for block in blocks.values():
        texture, of_paper = block.texture, {of.name: of for of in catalogue(block.preset)}
        differs = of_paper[texture.name] != texture if texture.name in of_paper else texture.number is not None
        if differs:
            allowed = "is the name or has the number of a texture of the paper, but its surface is another one"
            raise InputError("texture", texture.name, allowed)
    return blocks


def _of_solid(block: Block) -> Block:
    """Return a block whose tolerance is that of its solid."""
    if block.step_tolerance_mm != STEP_TOLERANCE_MM:
        return replace(block, sampling=Tolerance(mm=block.step_tolerance_mm))
    return replace(block, sampling=Tolerance()) if isinstance(block.sampling, Tolerance) else block
