"""What lies under the simulated sensor as one height map: block, clearance gap and holder rim, in the work frame."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tacbench_cad.lab.study.spec import HolderRim
from tacbench_cad.spec.block import Block
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats

#: Side of a cell, in mm: a quarter of the paper's nozzles, and some 20 cells under the lightest contact.
CELL_MM = 0.1
#: A large block has larger cells, so that the map keeps its size: at most so many along the block's longer side.
MAX_CELLS = 1500
#: Width of the holder's plate round the pocket, in mm: that of the project's own holder.
PLATE_MM = 11.0
#: Lengths that differ by less are equal.
ROUNDING_MM = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class HeightMap:
    """Heights on square cells.

    Args:
        z_mm: Height of each cell, shape (ny, nx): row by row from low y, each from low x; ``-inf`` where nothing is.
        x0_mm: x of the first column's centre.
        y0_mm: y of the first row's centre.
        cell_mm: Side of a cell.

    Raises:
        InputError: The map has no cells, or a height is NaN or ``+inf``.
    """

    z_mm: Floats
    x0_mm: float
    y0_mm: float
    cell_mm: float = CELL_MM

    def __post_init__(self) -> None:
        if self.z_mm.ndim != 2 or self.z_mm.size == 0:
            raise InputError("z_mm", list(self.z_mm.shape), "must have rows and columns")
        if not bool(np.all(self.z_mm < math.inf)):
            raise InputError("z_mm", None, "a height is not a number")
        if not self.cell_mm > 0.0:
            raise InputError("cell_mm", self.cell_mm, "must be above 0")

    @cached_property
    def top_mm(self) -> float:
        """The highest height; ``-inf`` where nothing is at all."""
        return float(np.max(self.z_mm))

    @cached_property
    def x_mm(self) -> Floats:
        """The columns' centres, shape (nx,)."""
        return self.x0_mm + self.cell_mm * np.arange(self.z_mm.shape[1], dtype=np.float64)

    @cached_property
    def y_mm(self) -> Floats:
        """The rows' centres, shape (ny,)."""
        return self.y0_mm + self.cell_mm * np.arange(self.z_mm.shape[0], dtype=np.float64)

    def near(self, x_mm: float, y_mm: float, radius_mm: float) -> tuple[slice, slice]:
        """Rows and columns of the cells whose centres can lie within a radius of a place; both may be empty."""

        def span(centre: float, start: float, count: int) -> slice:
            low = math.ceil((centre - radius_mm - start) / self.cell_mm)
            high = math.floor((centre + radius_mm - start) / self.cell_mm) + 1
            return slice(min(max(low, 0), count), min(max(high, 0), count))

        ny, nx = self.z_mm.shape
        return span(y_mm, self.y0_mm, ny), span(x_mm, self.x0_mm, nx)


def flat_plate(side_mm: float = 60.0, cell_mm: float = CELL_MM) -> HeightMap:
    """A flat plate at z = 0, its middle at (0, 0): what calibrations are checked on.

    Args:
        side_mm: Its side.
        cell_mm: Side of a cell.
    """
    count = max(1, round(side_mm / cell_mm))
    first = -cell_mm * (count - 1) / 2.0
    return HeightMap(z_mm=np.zeros((count, count)), x0_mm=first, y0_mm=first, cell_mm=cell_mm)


def cell_of(block: Block) -> float:
    """Side of a block's cells in mm."""
    return max(CELL_MM, max(block.size_mm) / MAX_CELLS)


def centres(block: Block) -> tuple[Floats, Floats]:
    """Centres of the columns (nx,) and the rows (ny,) of the cells that lie on a block, in mm of its frame."""
    cell = cell_of(block)
    x, y = (cell * (np.arange(max(1, round(side / cell)), dtype=np.float64) + 0.5) for side in block.size_mm)
    return x, y


def on_block(block: Block, z_mm: Floats) -> HeightMap:
    """Heights on a block's own cells as a map.

    Args:
        block: The block.
        z_mm: Heights of the cells that :func:`centres` names, (ny, nx).
    """
    x, y = centres(block)
    return HeightMap(z_mm=z_mm, x0_mm=float(x[0]), y0_mm=float(y[0]), cell_mm=cell_of(block))


def held(block: Block, top: HeightMap, holder: HolderRim) -> HeightMap:
    """A block's top in its holder: beyond the block the clearance gap, then the rim, then nothing.

    Args:
        block: Its sides and its key say where the gap begins; the pocket follows the key.
        top: The heights on the block's own cells.
        holder: Height of the rim and width of the gap; a gap below a cell's side may fall between two cells.
    """
    cell = top.cell_mm
    # Cells whose centres lie on its edge belong to the gap on every side.
    gap = max(holder.gap_mm, 0.0) + ROUNDING_MM
    border = math.ceil((gap + PLATE_MM) / cell)
    ny, nx = top.z_mm.shape
    z = np.full((ny + 2 * border, nx + 2 * border), -math.inf)
    z[border : border + ny, border : border + nx] = top.z_mm
    ground = HeightMap(z_mm=z, x0_mm=top.x0_mm - border * cell, y0_mm=top.y0_mm - border * cell, cell_mm=cell)
    x, y = ground.x_mm[None, :], ground.y_mm[:, None]
    # How far each cell lies outside of the block's outline, in mm: the corners of gap and plate are square.
    outside = np.abs(x - block.size_mm[0] / 2.0) - block.size_mm[0] / 2.0
    outside = np.maximum(outside, np.abs(y - block.size_mm[1] / 2.0) - block.size_mm[1] / 2.0)
    beyond_plate = outside > gap + PLATE_MM
    if block.keep is not None:
        outside = np.maximum(outside, block.keep.excess(x, y) / math.sqrt(2.0))
    z[outside > 0.0] = -math.inf
    z[outside > gap] = -holder.rim_mm
    z[beyond_plate] = -math.inf
    return ground
