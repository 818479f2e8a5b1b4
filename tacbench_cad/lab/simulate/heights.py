"""The surface under the simulated sensor as one height map: block, clearance gap and holder rim, in the work frame."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tacbench_cad.lab.study.spec import HolderRim
from tacbench_cad.spec.block import Block
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats

#: The side of a cell in mm: a quarter of the paper's nozzles, with about 20 cells under the lightest contact.
CELL_MM = 0.1
#: The largest number of cells along a block's longer side. A large block has larger cells.
MAX_CELLS = 1500
#: The width of the holder's plate around the pocket in mm, as in the project's own holder.
PLATE_MM = 11.0
#: Lengths with a smaller difference than this count as equal, in mm.
ROUNDING_MM = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class HeightMap:
    """Heights on square cells.

    Args:
        z_mm: The height of each cell, shape (ny, nx): row by row from low y, each from low x; ``-inf`` for no surface.
        x0_mm: The x of the first column's centre.
        y0_mm: The y of the first row's centre.
        cell_mm: The side of a cell.

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
        """The highest height; ``-inf`` if there is no surface at all."""
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
        """Return the rows and columns of the cells that can be within a radius of a point; both may be empty."""

        def span(centre: float, start: float, count: int) -> slice:
            low = math.ceil((centre - radius_mm - start) / self.cell_mm)
            high = math.floor((centre + radius_mm - start) / self.cell_mm) + 1
            return slice(min(max(low, 0), count), min(max(high, 0), count))

        ny, nx = self.z_mm.shape
        return span(y_mm, self.y0_mm, ny), span(x_mm, self.x0_mm, nx)


def flat_plate(side_mm: float = 60.0, cell_mm: float = CELL_MM) -> HeightMap:
    """Create a flat plate at z = 0 with its centre at (0, 0), for checks of calibrations.

    Args:
        side_mm: The side of the plate.
        cell_mm: The side of a cell.
    """
    count = max(1, round(side_mm / cell_mm))
    first = -cell_mm * (count - 1) / 2.0
    return HeightMap(z_mm=np.zeros((count, count)), x0_mm=first, y0_mm=first, cell_mm=cell_mm)


def cell_of(block: Block) -> float:
    """Return the side of a block's cells in mm."""
    return max(CELL_MM, max(block.size_mm) / MAX_CELLS)


def centres(block: Block) -> tuple[Floats, Floats]:
    """Return the centres of the columns (nx,) and the rows (ny,) of a block's cells, in mm of its frame."""
    cell = cell_of(block)
    x, y = (cell * (np.arange(max(1, round(side / cell)), dtype=np.float64) + 0.5) for side in block.size_mm)
    return x, y


def on_block(block: Block, z_mm: Floats) -> HeightMap:
    """Create a height map of a block's own cells.

    Args:
        block: The block.
        z_mm: The heights of the cells at :func:`centres`, (ny, nx).
    """
    x, y = centres(block)
    return HeightMap(z_mm=z_mm, x0_mm=float(x[0]), y0_mm=float(y[0]), cell_mm=cell_of(block))


def held(block: Block, top: HeightMap, holder: HolderRim) -> HeightMap:
    """Add the holder to a block's top: the clearance gap around the block, then the rim, then no surface.

    The pocket has no pin in the hole of a ring, so there is no surface in it.

    Args:
        block: The block. Its sides and its key or its outline determine the gap; the pocket follows them.
        top: The heights on the block's own cells.
        holder: The height of the rim and the width of the gap. A gap below a cell's side may fall between two cells.
    """
    cell = top.cell_mm
    # Cells whose centres are exactly on the edge belong to the gap, on every side.
    gap = max(holder.gap_mm, 0.0) + ROUNDING_MM
    border = math.ceil((gap + PLATE_MM) / cell)
    ny, nx = top.z_mm.shape
    z = np.full((ny + 2 * border, nx + 2 * border), -math.inf)
    z[border : border + ny, border : border + nx] = top.z_mm
    ground = HeightMap(z_mm=z, x0_mm=top.x0_mm - border * cell, y0_mm=top.y0_mm - border * cell, cell_mm=cell)
    x, y = ground.x_mm[None, :], ground.y_mm[:, None]
    # The distance of each cell from the block's outline, outside, in mm. The corners of gap and plate are square.
    outside = np.abs(x - block.size_mm[0] / 2.0) - block.size_mm[0] / 2.0
    outside = np.maximum(outside, np.abs(y - block.size_mm[1] / 2.0) - block.size_mm[1] / 2.0)
    beyond_plate = outside > gap + PLATE_MM
    if block.region is not None:
        outside = np.maximum(outside, block.region.distance(x, y))
    z[outside > 0.0] = -math.inf
    z[outside > gap] = -holder.rim_mm
    z[beyond_plate] = -math.inf
    for hole in () if block.outline is None else block.outline.loops[1:]:
        z[hole.distance(x, y) < 0.0] = -math.inf
    return ground
