"""A table of a surface and its derivatives on small cells, for fast estimates at many points.

The estimates guide the adaptive mesh. Proved bounds never use them.
"""

from __future__ import annotations

import itertools
import math

import numpy as np

from tacbench_cad.geometry.meshing.certify_triangles import DerivativeBounds, leaning, shortest
from tacbench_cad.spec.surface import Surface
from tacbench_cad.util.types import Floats, Ints

#: The error of a height, as a fraction of the tolerance, from which the size of the cells is computed.
FRACTION = 0.02
#: The smallest and the largest number of cells along a side.
CELLS = (32, 1100)
#: The number of bisections for the allowed vertical distance of each cell.
BISECTIONS = 6
_ORDERS = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))


class Heights:
    """The Taylor polynomials of a surface about the centres of small cells. Creases are borders of cells.

    Args:
        surface: The surface.
        sides: The lengths of the rectangle along x and y. It begins at (0, 0).
        tolerance: The tolerance of the mesh.
    """

    def __init__(self, surface: Surface, sides: tuple[float, float], tolerance: float) -> None:
        third = max(surface.bound(i, 3 - i) for i in range(4))
        # a point is at most size / sqrt(2) away from the centre of its cell
        size = (6.0 * FRACTION * tolerance / max(third, 1e-12)) ** (1.0 / 3.0)
        self.axes = [
            _CellAxis(side, int(np.clip(math.ceil(side / size), *CELLS)), creases)
            for side, creases in zip(sides, surface.creases, strict=True)
        ]
        #: The bounds of the derivatives over any boxes.
        self.bounds = DerivativeBounds(surface, *(axis.edges for axis in self.axes))
        x, y = (axis.middle for axis in self.axes)
        table = np.empty((len(x), len(y), 8))
        for column, order in enumerate(_ORDERS):
            table[:, :, column] = surface.grid(x, y, order)
        self._add_ratios(table, tolerance)
        self._columns = len(y)
        self._table = table.reshape(-1, 8)

    def _add_ratios(self, table: Floats, tolerance: float) -> None:
        """Add the ratio of the tolerance to the vertical distance that it allows, about the cosine of the slope."""
        slope = np.hypot(table[:, :, 1], table[:, :, 2]).ravel()
        x, y = (axis.edges for axis in self.axes)
        low, high = (
            np.stack(np.meshgrid(*ends, indexing="ij")).reshape(2, -1) for ends in ((x[:-1], y[:-1]), (x[1:], y[1:]))
        )
        room, low, high = self.bounds.around(low, high, tolerance)
        with np.errstate(invalid="ignore"):  # an infinite bend beside a crease, where the surface is level
            bend = self.bounds.bend(low, high) * leaning(slope, slope)
        # the distance grows with the vertical distance
        low, high = np.zeros(slope.shape), np.log1p(slope**2) / 2.0
        for _ in range(BISECTIONS):
            middle = (low + high) / 2.0
            near = shortest(tolerance * np.exp(middle), slope, room, bend) <= tolerance
            low, high = np.where(near, middle, low), np.where(near, high, middle)
        table[:, :, 6] = np.exp(-low).reshape(table.shape[:2])

    @property
    def cells(self) -> Floats:
        """The rows of the table: value, first and second derivatives, and the ratio, shape (8, n)."""
        return self._table.T

    def rows(self, x: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the rows of the cells of some points, with the coordinates relative to the centres."""
        i, j = self.axes[0].cell(x), self.axes[1].cell(y)
        row = self._table.take(i * self._columns + j, axis=0)
        return row, x - self.axes[0].middle.take(i), y - self.axes[1].middle.take(j)

    def height(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Return the heights and the ratios, with the shape of x."""
        row, dx, dy = self.rows(x, y)
        cross = row[..., 1] + 0.5 * dx * row[..., 3] + dy * row[..., 4]
        return row[..., 0] + dx * cross + dy * (row[..., 2] + 0.5 * dy * row[..., 5]), row[..., 6]

    def slopes(self, x: Floats, y: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Return the heights, both first derivatives, and the ratios, with the shape of x."""
        row, dx, dy = self.rows(x, y)
        bend_x, bend_y = dx * row[..., 3] + dy * row[..., 4], dx * row[..., 4] + dy * row[..., 5]
        slope_x, slope_y = row[..., 1], row[..., 2]
        height = row[..., 0] + dx * (slope_x + 0.5 * bend_x) + dy * (slope_y + 0.5 * bend_y)
        return height, slope_x + bend_x, slope_y + bend_y, row[..., 6]

    def bends(self, x: Floats, y: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Return the second derivatives xx, xy and yy, and the ratios, with the shape of x."""
        i, j = self.axes[0].cell(x), self.axes[1].cell(y)
        row = self._table.take(i * self._columns + j, axis=0)
        return row[..., 3], row[..., 4], row[..., 5], row[..., 6]


class _CellAxis:
    """Cells along one side: of equal length between two creases."""

    def __init__(self, side: float, count: int, creases: Floats) -> None:
        ends = np.concatenate([[0.0], creases[(creases > 0.0) & (creases < side)], [side]])
        runs = [
            np.linspace(low, high, max(1, math.ceil((high - low) / side * count)) + 1)[:-1]
            for low, high in itertools.pairwise(ends)
        ]
        self.edges = np.append(np.concatenate(runs), side)
        self.middle = (self.edges[:-1] + self.edges[1:]) / 2.0
        self._even = len(ends) == 2
        self._scale = len(self.middle) / side

    def cell(self, t: Floats) -> Ints:
        """Return the cell of each coordinate."""
        if not self._even:
            return np.asarray(np.searchsorted(self.edges[1:-1], t, "right"))
        return np.clip((t * self._scale).astype(np.int64), 0, len(self.middle) - 1)
