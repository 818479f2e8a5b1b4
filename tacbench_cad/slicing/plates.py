"""Blocks on a printer's bed: as many plates as it takes, with the copies of each texture spread over the bed.

Were all copies of one texture printed in one corner, a bed that is warmer or lower there would look like a property of
the texture. So the blocks of a plate change places until every texture's copies have their middle near the plate's
middle, and lie about as far from it as all blocks do. Copies are dealt so that each plate has nearly as many of each
texture.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from tacbench_cad.slicing.printers import Printer
from tacbench_cad.spec.block import MAX_COPIES, Block
from tacbench_cad.util.errors import InputError, require_between
from tacbench_cad.util.files import replacing
from tacbench_cad.util.types import Floats, Ints

#: What stays free between two blocks, in mm.
SPACING_MM = 5.0
#: Beginnings that are tried for each plate, and pairs of blocks that are tried to change places in each.
_BEGINNINGS, _SWAPS = 4, 2000
#: Columns of the layout file, which ``tacbench acquire`` reads.
COLUMNS = (
    *("plate", "label", "texture", "preset", "scale", "key_mm", "copy", "printer", "filament"),
    *("x_mm", "y_mm", "width_mm", "depth_mm"),
)


@dataclass(frozen=True, kw_only=True)
class PlacedBlock:
    """A block on a plate.

    Args:
        block: The block; it has a copy number.
        x_mm: Its lower corner on the bed.
        y_mm: Likewise.
    """

    block: Block
    x_mm: float
    y_mm: float

    @property
    def label(self) -> str:
        """What is engraved in its underside where there is room for it: ``T4 PAPER X1 02``."""
        return " ".join(self.block.label_words)


@dataclass(frozen=True, kw_only=True)
class Plate:
    """One filling of a bed.

    Args:
        printer: The printer.
        number: From 1.
        blocks: What lies on it.
    """

    printer: Printer
    number: int
    blocks: tuple[PlacedBlock, ...]

    @property
    def name(self) -> str:
        """Stem of its file names."""
        return f"{self.printer.name}_plate{self.number:02d}"

    @property
    def imbalance_mm(self) -> float:
        """Largest distance between the middle of one texture's copies and that of the whole plate."""
        places = np.array([[placed.x_mm, placed.y_mm] for placed in self.blocks])
        names = [placed.block.texture.name for placed in self.blocks]
        return _imbalance(places, _index(names))


def arrange_plates(
    blocks: Sequence[Block], copies: int, printer: Printer, spacing_mm: float = SPACING_MM
) -> list[Plate]:
    """Put copies of some blocks on as many plates as it takes.

    Args:
        blocks: One of each texture. Its copies get their label engraved where there is room for it.
        copies: How many of each.
        printer: Whose bed.
        spacing_mm: What stays free between two blocks.

    Returns:
        The plates. The same request gives the same plates.

    Raises:
        InputError: Copies or spacing are not allowed, or one block does not fit on the bed.
    """
    require_between("copies", copies, 1, MAX_COPIES)
    require_between("spacing", spacing_mm, 0.0, 100.0, " mm")
    for block in blocks:
        if block.height_mm > printer.height_mm:
            raise InputError("printer", printer.name, f"prints up to {printer.height_mm:g} mm, {block.name} is higher")
    size = (max(block.size_mm[0] for block in blocks), max(block.size_mm[1] for block in blocks))
    cells = _cells(size, printer, spacing_mm)
    if len(cells) == 0:
        x, y = printer.bed_mm
        raise InputError(
            "printer",
            printer.name,
            f"has a bed of {x:g} x {y:g} mm with a margin of {printer.margin_mm:g} mm: no block of "
            f"{size[0]:.4g} x {size[1]:.4g} mm fits; a smaller --scale or another printer would do",
        )
    queue = [(block, copy) for copy in range(1, copies + 1) for block in blocks]
    count = math.ceil(len(queue) / len(cells))
    ends = [round(len(queue) * i / count) for i in range(count + 1)]
    return [_plate(printer, i + 1, queue[first:last], cells, size) for i, (first, last) in enumerate(pairwise(ends))]


def _cells(size: tuple[float, float], printer: Printer, spacing: float) -> Floats:
    """Lower corners of all places on a bed, shape (n, 2), the one nearest to the bed's middle first."""
    lines = []
    for side, bed in zip(size, printer.bed_mm, strict=True):
        room = bed - 2.0 * printer.margin_mm
        count = math.floor((room + spacing) / (side + spacing) + 1e-9)
        used = count * (side + spacing) - spacing
        lines.append((bed - used) / 2.0 + (side + spacing) * np.arange(count))
    places = np.array([(x, y) for y in lines[1] for x in lines[0]]).reshape(-1, 2)
    free = np.ones(len(places), dtype=bool)
    for x0, y0, x1, y1 in printer.keep_out_mm:
        apart_x = (places[:, 0] >= x1) | (places[:, 0] + size[0] <= x0)
        apart_y = (places[:, 1] >= y1) | (places[:, 1] + size[1] <= y0)
        free &= apart_x | apart_y
    places = places[free]
    off = places + np.array(size) / 2.0 - np.array(printer.bed_mm) / 2.0
    return np.asarray(places[np.argsort(np.round(np.hypot(off[:, 0], off[:, 1]), 6), kind="stable")], dtype=np.float64)


def _plate(
    printer: Printer, number: int, queue: Sequence[tuple[Block, int]], cells: Floats, size: tuple[float, float]
) -> Plate:
    places = cells[: len(queue)]
    order = _spread(places, _index([block.texture.name for block, _ in queue]))
    placed = []
    for (x, y), i in zip(places.tolist(), order, strict=True):
        block, copy = queue[i]
        # A smaller block lies in the middle of its place.
        corner = (x + (size[0] - block.size_mm[0]) / 2.0, y + (size[1] - block.size_mm[1]) / 2.0)
        placed.append(PlacedBlock(block=_marked(block, copy), x_mm=corner[0], y_mm=corner[1]))
    placed.sort(key=lambda block: (block.y_mm, block.x_mm))
    return Plate(printer=printer, number=number, blocks=tuple(placed))


def _marked(block: Block, copy: int) -> Block:
    """The copy with its label engraved, or without it where the block is too small or too thin for one."""
    try:
        marked = replace(block, copy=copy, label=True)
        assert marked.engraving is not None
    except InputError:
        return replace(block, copy=copy, label=False)
    return marked


def _index(names: Sequence[str]) -> Ints:
    known = list(dict.fromkeys(names))
    return np.array([known.index(name) for name in names], dtype=np.int64)


def _off(places: Floats, texture: Ints) -> Floats:
    """Distance of each texture's middle from the plate's middle."""
    counts = np.bincount(texture)
    middles = np.column_stack([np.bincount(texture, weights=places[:, axis]) / counts for axis in (0, 1)])
    return np.asarray(np.hypot(*(middles - places.mean(axis=0)).T), dtype=np.float64)


def _imbalance(places: Floats, texture: Ints) -> float:
    return float(_off(places, texture).max())


def _confounding(places: Floats, texture: Ints) -> float:
    """How much position tells of the texture, in mm^2: by the textures' middles and by their distances from them."""
    away = np.sqrt(((places - places.mean(axis=0)) ** 2).sum(axis=1))
    each = np.bincount(texture, weights=away) / np.bincount(texture)
    return float((_off(places, texture) ** 2).sum() + ((each - away.mean()) ** 2).sum())


def _spread(places: Floats, texture: Ints) -> list[int]:
    """Which block comes to which place: changes of places are kept while position tells less of the texture."""
    rng = np.random.default_rng(len(places))
    orders: list[tuple[float, list[int]]] = []
    for _ in range(_BEGINNINGS):
        order = rng.permutation(len(places))
        best = _confounding(places, texture[order])
        for i, j in rng.integers(0, len(places), (_SWAPS, 2)).tolist():
            if texture[order[i]] == texture[order[j]]:
                continue
            order[[i, j]] = order[[j, i]]
            now = _confounding(places, texture[order])
            if now < best:
                best = now
            else:
                order[[i, j]] = order[[j, i]]
        orders.append((best, order.tolist()))
    return min(orders)[1]


def write_layout(plate: Plate, filament: str, path: Path, files: Mapping[str, str]) -> None:
    """Write a plate's layout as CSV: one row a block, from the bed's lower left.

    Args:
        plate: The plate.
        filament: What it is printed of.
        path: The file.
        files: The names of the files that users' textures come from, by the textures' names.

    Raises:
        InputError: The file cannot be written.
    """
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(COLUMNS)
        for placed in plate.blocks:
            block = placed.block
            key = "" if block.key_mm is None else f"{block.key_mm:g}"
            texture = files.get(block.texture.name, block.texture.name)
            about = (plate.number, placed.label, texture, block.preset, f"{block.scale:g}", key, block.copy)
            place = (f"{value:.3f}" for value in (placed.x_mm, placed.y_mm, *block.size_mm))
            writer.writerow([*about, plate.printer.name, filament, *place])
