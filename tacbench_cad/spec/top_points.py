"""The grid on which the printed top of a block is compared with its formula, and the part that is compared."""

from __future__ import annotations

import math

import numpy as np

from tacbench_cad.spec.block import Block
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Bools, Floats

#: The width of the edge that is left out, in mm.
EDGE_MM = 0.5
#: The usual distance of the points, in mm, and the largest number of points.
PITCH_MM, MAX_POINTS = 0.05, 1_000_000


def points_of(block: Block, pitch_mm: float = PITCH_MM) -> tuple[Floats, Floats]:
    """Divide the block's top into cells and return the x (n,) and the y (m,) of their middles, in mm."""
    x, y = block.size_mm
    pitch = max(pitch_mm, math.sqrt(x * y / MAX_POINTS))
    counts = (max(1, round(side / pitch)) for side in (x, y))
    across, down = ((np.arange(count) + 0.5) * side / count for count, side in zip(counts, (x, y), strict=True))
    return across, down


def without_edge(block: Block, x_mm: Floats, y_mm: Floats, edge_mm: float = EDGE_MM) -> Bools:
    """Return which points of a grid are compared: those that are not near the edge or the cut of the key.

    Args:
        block: The block.
        x_mm: The x coordinates of the grid, shape (n,).
        y_mm: The y coordinates of the grid, shape (m,).
        edge_mm: The width of the edge that is left out.

    Returns:
        Shape (n, m).

    Raises:
        InputError: No point is left.
    """
    across, down = block.size_mm
    along_x, along_y = (x_mm > edge_mm) & (x_mm < across - edge_mm), (y_mm > edge_mm) & (y_mm < down - edge_mm)
    inside = along_x[:, None] & along_y[None, :]
    if block.region is not None:
        inside &= block.region.distance(x_mm[:, None], y_mm[None, :]) < -edge_mm
    if not inside.any():
        raise InputError("texture", block.name, f"is too small: nothing remains without its edge of {edge_mm:g} mm")
    return inside
