"""Every picture of parts: the sheet of a print set, single parts, assemblies, and a texture with its cuts or presses.

The functions need matplotlib (extra ``plot``), which is imported when a picture is made. Each file is written whole or
not at all, without a date, and is the same on every run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tacbench_cad.geometry.block_part import as_part
from tacbench_cad.geometry.part import rgb_of
from tacbench_cad.render.bodies import body_of, fine_body
from tacbench_cad.render.picture_sheet import Item, draw_sheet
from tacbench_cad.render.raster import linear
from tacbench_cad.render.texture_figures import cuts_figure, formula, heading, press_figure
from tacbench_cad.util.plotting import save_figure, styled

if TYPE_CHECKING:
    from tacbench_cad.spec.block import Block


def preview_sheet(items: Sequence[tuple[str, Any]], path: Path) -> None:
    """Draw a sheet of shaded parts with captions, all at one scale, with a scale bar.

    A part with an engraved underside is shown from below as well. The scale bar is true for lengths across the picture.

    Args:
        items: The caption (its lines separated by newlines) and the part: a block, a fixture, any other part, or a
            mesh.
        path: The file; its name ends in ``.png``, ``.svg`` or ``.pdf``.

    Raises:
        MissingToolError: matplotlib is not installed, or the CAD kernel that a fixture needs.
        InputError: The file's name has another ending, or the file cannot be written.
    """
    with styled():
        draw_sheet([Item(caption, [body_of(thing)]) for caption, thing in items], path)


def part_picture(part: Any, path: Path) -> None:
    """Draw one part with its title and a scale bar; an engraved underside is shown as well.

    Args:
        part: A block, a fixture, or any other part.
        path: The file; its name ends in ``.png``, ``.svg`` or ``.pdf``.

    Raises:
        MissingToolError: matplotlib is not installed, or the CAD kernel that a fixture needs.
        InputError: The file's name has another ending, or the file cannot be written.
    """
    part = as_part(part)
    with styled():
        draw_sheet([Item(f"{part.title}\n{part.name}", [fine_body(part)])], path)


def assembly_picture(assembly: Any, path: Path, apart_mm: float = 0.0) -> None:
    """Draw holder, blocks and jig where they are used, each kind of part in its own colour.

    Args:
        assembly: A :class:`housing.Assembly`, or a part that is made of placed parts.
        path: The file; its name ends in ``.png``, ``.svg`` or ``.pdf``.
        apart_mm: How far the blocks are lifted off the holder, and the jig off the blocks, in mm.

    Raises:
        MissingToolError: matplotlib or the CAD kernel is not installed.
        InputError: The file's name has another ending, or the file cannot be written.
    """
    bodies, whole = [], as_part(assembly)
    kinds = list(dict.fromkeys(part.kind for part, _ in whole.placed))
    for part, matrix in whole.placed:
        lift = np.eye(4)
        lift[2, 3] = apart_mm * kinds.index(part.kind)
        bodies.append(replace(fine_body(part, linear(rgb_of(part.kind))), matrix=lift @ matrix))
    with styled():
        draw_sheet([Item(f"{whole.title}\n{whole.name}", bodies, from_below=False)], path)


def texture_picture(block: Block, path: Path, press: bool = False) -> None:
    """Draw a block's surface from above with cuts through it, or with the press protocol on it.

    Args:
        block: The block.
        path: The file; its name ends in ``.png``, ``.svg`` or ``.pdf``.
        press: Show the block's outline, the 25 positions and the contact circles at the paper's forces.

    Raises:
        MissingToolError: matplotlib is not installed.
        InputError: The file's name has another ending, the file cannot be written, or the press grid leaves the block.
    """
    with styled():
        save_figure(press_figure(block) if press else cuts_figure(block), path)


def catalogue_picture(blocks: Sequence[Block], path: Path) -> None:
    """Draw several blocks at one scale, each with its name, its formula, its size and its relief.

    Args:
        blocks: The blocks.
        path: The file; its name ends in ``.png``, ``.svg`` or ``.pdf``.

    Raises:
        MissingToolError: matplotlib is not installed.
        InputError: The file's name has another ending, or the file cannot be written.
    """
    items = []
    for block in blocks:
        x, y = block.size_mm
        size = f"{x:g} x {y:g} x {block.height_mm:g} mm, relief {block.relief_mm:.2f} mm"
        items.append(Item(f"{heading(block)}\n{formula(block, 42)}\n{size}", [fine_body(as_part(block))]))
    with styled():
        draw_sheet(items, path)
