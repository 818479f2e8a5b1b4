"""Proved bounds for sample grids of surfaces that are not separable. Each cell of the grid consists of two triangles.

Every cell is divided into ``s`` by ``s`` parts. On a part, the deviation ``e = fit - f`` is at most its largest value
at the four corners plus its possible change between the corners. A part on a diagonal is divided along the diagonal, so
``e`` is smooth on each right triangle. On a triangle with legs ``a, b``, it differs from its linear interpolation by at
most ``(a^2 M_uu + 2 a b M_uv + b^2 M_vv) / 8``. Here ``M`` bounds the second derivatives of f. It follows from their
values at the corners of the cell and a remainder from the fourth derivatives. Across creases, the first derivatives
give the bound ``(a M_u + b M_v) / 2``.
"""

from __future__ import annotations

import math

import numpy as np

from tacbench_cad.spec.surface import Surface
from tacbench_cad.util.types import Floats

#: The largest number of parts of all cells together, unless there are more cells than this.
MAX_PARTS = 1_000_000
#: The largest number of parts along each side of a cell.
MAX_PARTS_A_SIDE = 12


class Cells:
    """A formula on the cells of a tensor grid. It is evaluated once for both choices of the diagonals.

    Args:
        surface: The formula.
        x: The positions of the lines along x, ascending, shape (n,).
        y: The positions of the lines along y, ascending, shape (m,).
    """

    def __init__(self, surface: Surface, x: Floats, y: Floats) -> None:
        cells = (len(x) - 1) * (len(y) - 1)
        self._parts = max(1, min(MAX_PARTS_A_SIDE, math.isqrt(MAX_PARTS // cells)))
        fine_x, fine_y = _refined(x, self._parts), _refined(y, self._parts)
        self._value = surface.grid(fine_x, fine_y)
        a, b = np.diff(x)[:, None], np.diff(y)[None, :]
        uu, uv, vv = (surface.cell_bounds(x, y, order) for order in ((2, 0), (1, 1), (0, 2)))
        parts = self._parts
        bent = (uu * a**2 + 2.0 * uv * a * b + vv * b**2) / (8.0 * parts**2)
        # the slopes are bounded across creases as well, where the second derivatives are not
        sloped = (surface.cell_bounds(x, y, (1, 0)) * a + surface.cell_bounds(x, y, (0, 1)) * b) / (2.0 * parts)
        self._between = self._spread(np.minimum(bent, sloped))

    def _spread(self, per_cell: Floats) -> Floats:
        return np.repeat(np.repeat(per_cell, self._parts, axis=0), self._parts, axis=1)

    def prove(self, z: Floats, rising: bool) -> Floats:
        """Bound the vertical deviation ``|fit - f|`` of the faceted surface with these heights.

        Args:
            z: The heights above the formula's zero at the crossings of the lines, shape (n, m).
            rising: True if the diagonals run from (i, j) to (i + 1, j + 1), False if they run from (i + 1, j) to
                (i, j + 1).

        Returns:
            The bound for each cell, shape (n - 1, m - 1).
        """
        vertical = _largest_corner(np.abs(self._facets(z, rising) - self._value)) + self._between
        n, m = z.shape
        return np.asarray(vertical.reshape(n - 1, self._parts, m - 1, self._parts).max(axis=(1, 3)))

    def _facets(self, z: Floats, rising: bool) -> Floats:
        """Return the heights of the facets at the corners of all parts."""
        parts = self._parts
        z00, z10, z01, z11 = z[:-1, :-1], z[1:, :-1], z[:-1, 1:], z[1:, 1:]
        fit = np.empty(self._value.shape)
        for k in range(parts + 1):
            for j in range(parts + 1):
                s, t = k / parts, j / parts
                if rising:
                    low = k >= j
                    value = z00 + s * (z10 - z00) + t * (z11 - z10) if low else z00 + t * (z01 - z00) + s * (z11 - z01)
                else:
                    low = k + j <= parts
                    first = z00 + s * (z10 - z00) + t * (z01 - z00)
                    value = first if low else z11 + (1.0 - s) * (z01 - z11) + (1.0 - t) * (z10 - z11)
                fit[k : k + (len(z) - 2) * parts + 1 : parts, j : j + (z.shape[1] - 2) * parts + 1 : parts] = value
        return fit


def _refined(lines: Floats, parts: int) -> Floats:
    return np.interp(np.arange((len(lines) - 1) * parts + 1) / parts, np.arange(len(lines)), lines)


def _largest_corner(value: Floats) -> Floats:
    rows = np.maximum(value[:-1], value[1:])
    return np.asarray(np.maximum(rows[:, :-1], rows[:, 1:]))
