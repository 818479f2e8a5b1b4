"""The arrangement of blocks on the beds of a printer, with the copies of each texture distributed over the bed.

If all copies of a texture were printed in one corner, and the bed were warmer or lower there, the effect would look
like a property of the texture. Therefore the program exchanges the blocks of a plate until, for each texture, the
middle of its copies is near the middle of the plate, and the mean distance of its copies from there is about the same
as for all blocks. Each plate gets nearly the same number of copies of each texture.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from tacbench_cad.extensions.slicing.printers import Printer
from tacbench_cad.spec import MAX_COPIES, Block
from tacbench_cad.util.errors import InputError, require_between
from tacbench_cad.util.files import replacing
from tacbench_cad.util.types import Floats, Ints

#: The default distance between two blocks, in mm.
SPACING_MM = 5.0
#: The number of random starts for each plate, and of exchanges that are tried after each start.
_STARTS, _SWAPS = 4, 2000
#: The columns of the layout file, which ``tacbench acquire`` reads.
COLUMNS = (
    *("plate", "label", "texture", "preset", "scale", "key_mm", "copy", "printer", "filament"),
    *("x_mm", "y_mm", "width_mm", "depth_mm", "file"),
)


@dataclass(frozen=True, kw_only=True)
class PlacedBlock:
    """A block on a plate.

    Args:
        block: The block, with the number of its copy.
        x_mm: The smallest x of the block on the bed.
        y_mm: The smallest y of the block on the bed.
    """

    block: Block
    x_mm: float
    y_mm: float

    @property
    def label(self) -> str:
        """The label: ``T4 PAPER X1 02``. It is engraved in the underside if there is enough room."""
        return " ".join(self.block.label_words)


@dataclass(frozen=True, kw_only=True)
class Plate:
    """Blocks that are printed together on a bed.

    Args:
        printer: The printer.
        number: The number of the plate, beginning with 1.
        blocks: The blocks on the plate.
    """

    printer: Printer
    number: int
    blocks: tuple[PlacedBlock, ...]

    @property
    def name(self) -> str:
        """The stem of the file names."""
        return f"{self.printer.name}_plate{self.number:02d}"

    @property
    def imbalance_mm(self) -> float | None:
        """The largest distance between the middle of a texture's copies and the middle of the plate, in mm.

        None if a texture has a single copy on the plate: one place cannot be spread over the bed.
        """
        places = np.array([[placed.x_mm, placed.y_mm] for placed in self.blocks])
        texture = _index([placed.block.texture.name for placed in self.blocks])
        return None if np.bincount(texture).min() < 2 else float(_off(places, texture).max())


def arrange_plates(
    blocks: Sequence[Block], copies: int, printer: Printer, spacing_mm: float = SPACING_MM
) -> list[Plate]:
    """Arrange copies of some blocks on as many plates as needed.

    Args:
        blocks: One block for each texture. The label is engraved in all copies with enough room for it.
        copies: The number of copies of each block.
        printer: The printer.
        spacing_mm: The smallest distance between two blocks.

    Returns:
        The plates. The same arguments always give the same plates.

    Raises:
        InputError: The number of copies or the spacing is not allowed, or a block does not fit on the bed.
    """
    require_between("copies", copies, 1, MAX_COPIES)
    require_between("spacing", spacing_mm, 0.0, 100.0, " mm")
    for block in blocks:
        if block.height_mm > printer.height_mm:
            raise InputError(
                "printer",
                printer.name,
                f"can print up to {printer.height_mm:g} mm, but {block.name} is {block.height_mm:g} mm high; use a "
                "smaller --scale or another printer",
            )
    size = (max(block.size_mm[0] for block in blocks), max(block.size_mm[1] for block in blocks))
    cells = _cells(size, printer, spacing_mm)
    if len(cells) == 0:
        x, y = printer.bed_mm
        raise InputError(
            "printer",
            printer.name,
            f"has a bed of {x:g} x {y:g} mm with a margin of {printer.margin_mm:g} mm, and a block of "
            f"{size[0]:.4g} x {size[1]:.4g} mm does not fit; use a smaller --scale or another printer",
        )
    queue = [(block, copy) for copy in range(1, copies + 1) for block in blocks]
    count = math.ceil(len(queue) / len(cells))
    ends = [round(len(queue) * i / count) for i in range(count + 1)]
    return [_plate(printer, i + 1, queue[first:last], cells, size) for i, (first, last) in enumerate(pairwise(ends))]


def _cells(size: tuple[float, float], printer: Printer, spacing: float) -> Floats:
    """Return the lower corners of all places on a bed, shape (n, 2), beginning with the nearest to the bed's middle."""
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
    order = _assignment(places, _index([block.texture.name for block, _ in queue]))
    placed = []
    for (x, y), i in zip(places.tolist(), order, strict=True):
        block, copy = queue[i]
        # A block that is smaller than its place is in the middle of it.
        corner = (x + (size[0] - block.size_mm[0]) / 2.0, y + (size[1] - block.size_mm[1]) / 2.0)
        placed.append(PlacedBlock(block=_marked(block, copy), x_mm=corner[0], y_mm=corner[1]))
    placed.sort(key=lambda block: (block.y_mm, block.x_mm))
    return Plate(printer=printer, number=number, blocks=tuple(placed))


def _marked(block: Block, copy: int) -> Block:
    """Return a copy of a block with an engraved label, or without a label if the block is too small or too thin."""
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
    """Return the distance of each texture's middle from the plate's middle."""
    counts = np.bincount(texture)
    middles = np.column_stack([np.bincount(texture, weights=places[:, axis]) / counts for axis in (0, 1)])
    return np.asarray(np.hypot(*(middles - places.mean(axis=0)).T), dtype=np.float64)


def _confounding(places: Floats, texture: Ints) -> float:
    """Return how strongly position and texture are confounded, in mm^2.

    This is the sum, over the textures, of two squares: the distance between the middle of the texture's copies and the
    middle of the plate, and the difference between their mean distance from there and that of all blocks.
    """
    away = np.sqrt(((places - places.mean(axis=0)) ** 2).sum(axis=1))
    each = np.bincount(texture, weights=away) / np.bincount(texture)
    return float((_off(places, texture) ** 2).sum() + ((each - away.mean()) ** 2).sum())


def _assignment(places: Floats, texture: Ints) -> list[int]:
    """Assign blocks to places: an exchange of two blocks is kept if it makes :func:`_confounding` smaller."""
    rng = np.random.default_rng(len(places))
    orders: list[tuple[float, list[int]]] = []
    for _ in range(_STARTS):
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


def write_layout(
    plate: Plate, filament: str, path: Path, files: Mapping[str, str], printed: Mapping[str, tuple[str, str]]
) -> None:
    """Write a plate's layout as CSV, with a row for each block, beginning at the bed's lower left.

    Args:
        plate: The plate.
        filament: The name of the filament.
        path: The file.
        files: The file names of users' textures, by the names of the textures.
        printed: For blocks that differ from what their prints are expected to equal, by the names of their textures:
            the texture of the print, and the texture file of the block, relative to the layout.

    Raises:
        InputError: The file cannot be written.
    """
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(COLUMNS)
        for placed in plate.blocks:
            block = placed.block
            key = "" if block.key_mm is None else f"{block.key_mm:g}"
            name, file = printed.get(block.texture.name, (block.texture.name, ""))
            texture = files.get(name, name)
            about = (plate.number, placed.label, texture, block.preset, f"{block.scale:g}", key, block.copy)
            place = (f"{value:.3f}" for value in (placed.x_mm, placed.y_mm, *block.size_mm))
            writer.writerow([*about, plate.printer.name, filament, *place, file])
