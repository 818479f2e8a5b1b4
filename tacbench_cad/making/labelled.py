"""The blocks that a person names: by texture, by the engraved label, by the name of a file, or by a print set."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from tacbench_cad.checks.claim import claimed_block
from tacbench_cad.making.choice import described
from tacbench_cad.making.manifest import read_rows
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.presets import PRESETS
from tacbench_cad.spec.texture_files import is_texture_name
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.files import MANIFEST_NAME

#: The words of an engraved label: texture, preset, scale and copy.
_LABEL = re.compile(
    r"(?P<texture>[\w.-]+)\s+(?P<preset>[A-Za-z]+)\s+X(?P<scale>\d+(?:\.\d+)?)(?:\s+(?P<copy>\d{1,3}))?",
    re.IGNORECASE,
)


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
    named = claimed_block(word)
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
        block = claimed_block(str(row.get("part"))) if row.get("kind") == "block" else None
        if block is not None:
            yield replace(block, label=False, copy=None)
