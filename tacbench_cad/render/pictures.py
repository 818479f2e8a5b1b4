"""Every picture of parts: the sheet of a print set, a texture with its cuts, the press protocol on a block.

Needs matplotlib (extra ``plot``), which is imported when a picture is made. Pictures are PNG files, written whole or
not at all, with no date in them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from tacbench_cad.geometry.block_mesh import fine_mesh
from tacbench_cad.geometry.block_part import as_part
from tacbench_cad.geometry.mesh import Mesh
from tacbench_cad.geometry.part import rgb_of
from tacbench_cad.render.raster import BELOW, render
from tacbench_cad.render.texture_figures import cuts_figure, formula, heading, press_figure
from tacbench_cad.util.plotting import INK, new_figure, save_figure, styled
from tacbench_cad.util.types import Bytes

if TYPE_CHECKING:
    from tacbench_cad.spec.block import Block


#: A hollow in the underside that is shallower than this is an engraving, in mm.
_ENGRAVED_MM = 1.0


class _Tile(NamedTuple):
    """A place on a sheet: width and height in pixels, and the size of its caption's letters."""

    width: int
    height: int
    font: float


#: For the picture of a single part, for the catalogue, for sheets of up to 16 parts, and for longer ones.
_LARGE, _CATALOGUE = _Tile(1080, 620, 15.0), _Tile(420, 320, 12.0)
_MIDDLE, _SMALL = _Tile(420, 320, 10.0), _Tile(300, 230, 7.5)


def preview_sheet(items: Sequence[tuple[str, Mesh]], path: Path) -> None:
    """Draw a sheet of shaded parts with captions. A part with something in its underside shows that as well, smaller.

    Args:
        items: Caption (its lines separated by newlines) and mesh of each part.
        path: The PNG file.

    Raises:
        MissingToolError: matplotlib is not installed.
        InputError: The file cannot be written.
    """
    tile = _MIDDLE if _columns(len(items)) <= 4 else _SMALL
    with styled():
        _draw_sheet([(caption, partial(_both_sides, mesh)) for caption, mesh in items], path, tile)


def part_picture(part: Any, path: Path) -> None:
    """Draw one part, large, with its title and its size; where its underside is engraved, that side as well.

    Args:
        part: A block, a fixture, or any other part.
        path: The PNG file.

    Raises:
        MissingToolError: matplotlib is not installed, or a fixture's CAD kernel.
        InputError: The file cannot be written.
    """
    part = as_part(part)
    mesh = part.mesh[0] if part.block is None else fine_mesh(part.block)
    with styled():
        _draw_sheet([(f"{part.title}\n{part.name}", partial(_both_sides, mesh))], path, _LARGE)


def assembly_picture(assembly: Any, path: Path, apart_mm: float = 0.0) -> None:
    """Draw holder, blocks and jig where they are used, each kind of part in its own colour.

    Args:
        assembly: A :class:`housing.Assembly`, or a part that is made of placed parts.
        path: The PNG file.
        apart_mm: How far the blocks are lifted off the holder, and the jig off the blocks, in mm.

    Raises:
        MissingToolError: matplotlib or the CAD kernel is not installed.
        InputError: The file cannot be written.
    """
    meshes, colours, whole_part = [], [], as_part(assembly)
    kinds = list(dict.fromkeys(part.kind for part, _ in whole_part.placed))
    for part, matrix in whole_part.placed:
        mesh = part.mesh[0] if part.block is None else fine_mesh(part.block)
        lift = np.eye(4)
        lift[2, 3] = apart_mm * kinds.index(part.kind)
        meshes.append(mesh.transformed(lift @ matrix))
        colours.append(np.tile(np.array(rgb_of(part.kind)) ** 2.2, (len(mesh.faces), 1)))
    whole = Mesh.joined(meshes)

    def draw(width: int, height: int) -> Bytes:
        return render(whole, width, height, materials=np.concatenate(colours))

    with styled():
        _draw_sheet([(f"{whole_part.title}\n{whole_part.name}", draw)], path, _LARGE)


def _draw_sheet(items: Sequence[tuple[str, Callable[[int, int], Bytes]]], path: Path, tile: _Tile) -> None:
    """A sheet of pictures with captions, each picture drawn at the width and height of a tile in pixels."""
    columns = _columns(len(items))
    rows = max(1, math.ceil(len(items) / columns))
    width, height, font = tile
    lines = max((caption.count("\n") + 1 for caption, _ in items), default=1)
    band, gap, dpi = round(max(18.0, 1.9 * font)) * lines + 10, 22, 100
    total = (columns * (width + gap) + gap, rows * (height + band + gap) + gap)
    sheet = np.full((total[1], total[0], 3), 255, dtype=np.uint8)
    figure = new_figure((total[0] / dpi, total[1] / dpi), dpi)
    for i, (caption, draw) in enumerate(items):
        left, top = gap + (i % columns) * (width + gap), gap + (i // columns) * (height + band + gap)
        sheet[top : top + height, left : left + width] = draw(width, height)
        x, y = (left + width / 2) / total[0], 1.0 - (top + height + 8) / total[1]
        figure.text(x, y, caption, ha="center", va="top", fontsize=font, color=INK, linespacing=1.35)
    figure.figimage(sheet, 0, 0, origin="upper")
    save_figure(figure, path)


def texture_picture(block: Block, path: Path, press: bool = False) -> None:
    """Draw a block's surface from above with cuts through it, or with the press protocol on it.

    Args:
        block: The block.
        path: The PNG file.
        press: Show the block's outline, the 25 positions and the contact circles at the paper's forces.

    Raises:
        MissingToolError: matplotlib is not installed.
        InputError: The file cannot be written, or the press grid leaves the block.
    """
    with styled():
        figure = press_figure(block) if press else cuts_figure(block)
        save_figure(figure, path)


def catalogue_picture(blocks: Sequence[Block], path: Path) -> None:
    """Draw several blocks in one figure, each with its name, its formula and its relief.

    Args:
        blocks: The blocks, three in a row.
        path: The PNG file.

    Raises:
        MissingToolError: matplotlib is not installed.
        InputError: The file cannot be written.
    """
    items = []
    for block in blocks:
        x, y = block.size_mm
        size = f"{x:g} x {y:g} x {block.height_mm:g} mm, relief {block.relief_mm:.2f} mm"
        draw = partial(_both_sides, fine_mesh(block))
        items.append((f"{heading(block)}\n{formula(block, 42)}\n{size}", draw))
    with styled():
        _draw_sheet(items, path, _CATALOGUE)


def _columns(count: int) -> int:
    """Columns of a sheet: up to four large tiles a row, six smaller ones from 17 parts on."""
    if count > 16:
        return 6
    return 3 if count in (3, 5, 6, 9) else max(1, min(4, count))


def _both_sides(mesh: Mesh, width: int, height: int) -> Bytes:
    """The part from above; where its underside is engraved, that side as well, to the right."""
    corners = mesh.triangle_points
    normal = mesh.doubled_normals
    depth = corners[:, :, 2].min(axis=1) - mesh.vertices[:, 2].min()
    downward = normal[:, 2] < -0.7 * np.linalg.norm(normal, axis=1)
    if not (downward & (depth > 0.05) & (depth < _ENGRAVED_MM)).any():
        return render(mesh, width, height)
    picture = np.full((height, width, 3), 255, dtype=np.uint8)
    left, right = round(0.56 * width), round(0.42 * width)
    picture[:, :left] = render(mesh, left, height)
    picture[:, width - right :] = render(mesh, right, height, BELOW)
    return picture
