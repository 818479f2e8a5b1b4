"""The positions and forces of the paper's press protocol. The jig, the rig and the analysis use this module."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats

if TYPE_CHECKING:
    from tacbench_cad.spec.block import Block

#: The two readings of the spacing of the positions along y.
Spacing = Literal["even", "1mm"]

#: The paper's three contact forces, in newtons.
FORCES_N = (0.08045, 1.91295, 3.0137)
#: The tolerances that the paper states for the forces (after the sign +-), in newtons.
FORCE_SPREADS_N = (0.00195, 0.00985, 0.0098)
#: The number of presses at each position and force.
REPEATS = 2
#: The number of positions along each side of the grid.
PER_SIDE = 5
#: The outer radius of the sensor's dome, in mm, measured on one TacTip.
DOME_RADIUS_MM = 20.0
#: The foundation stiffness of the dome, in N/mm^3, measured on one TacTip.
FOUNDATION_N_PER_MM3 = 0.0105


@dataclass(frozen=True, kw_only=True)
class PressGrid:
    """The 5 x 5 positions of a block at which the tip of the sensor presses.

    Args:
        x_mm: The x coordinates of the five columns in the block frame, ascending, in mm.
        y_mm: The y coordinates of the five rows in the block frame, ascending, in mm.
    """

    x_mm: tuple[float, ...]
    y_mm: tuple[float, ...]

    @classmethod
    def paper(cls, scale: float = 1.0, spacing: Spacing = "even") -> PressGrid:
        """Return the paper's grid: x from 4 to 9 mm in 1.25 mm steps; y from 18 mm in steps of 1.25 mm or 1 mm.

        Args:
            scale: The scale of the block. The grid has the same scale, so that the positions on the texture are the
                same.
            spacing: How to interpret the paper's "5 equally spaced 1 mm positions between 18 and 23 mm" along y:
                ``even`` for steps of 1.25 mm up to 23 mm, ``1mm`` for steps of 1 mm up to 22 mm.
        """
        if spacing not in ("even", "1mm"):
            raise InputError("spacing", spacing, "allowed: even, 1mm")
        last = 23.0 if spacing == "even" else 22.0
        x = tuple(scale * (4.0 + 1.25 * i) for i in range(PER_SIDE))
        y = tuple(scale * (18.0 + (last - 18.0) / 4 * i) for i in range(PER_SIDE))
        return cls(x_mm=x, y_mm=y)

    @property
    def positions_mm(self) -> Floats:
        """All positions, shape (25, 2): row after row by ascending y, and each row by ascending x."""
        return np.array([(x, y) for y in self.y_mm for x in self.x_mm])

    @property
    def spacing_mm(self) -> tuple[float, float]:
        """The distances between neighbouring columns and between neighbouring rows, in mm."""
        return (self.x_mm[1] - self.x_mm[0], self.y_mm[1] - self.y_mm[0])

    def require_on(self, block: Block) -> None:
        """Check that all positions lie on the top of a block.

        Raises:
            InputError: A position lies outside the top of the block.
        """
        x, y = block.size_mm
        if self.x_mm[-1] > x or self.y_mm[-1] > y:
            need = f"needs {self.x_mm[-1]:g} x {self.y_mm[-1]:g} mm"
            allowed = f"the block is too small for the press grid, which {need}; use a larger block or a smaller grid"
            raise InputError("size", f"{x:g} x {y:g} mm", allowed)
        beyond = beyond_top_mm(block, self.positions_mm)
        if beyond.max() > 1e-9:
            field, value = ("key", block.key_mm) if block.outline is None else ("outline", str(block.outline))
            a, b = self.positions_mm[int(beyond.argmax())]
            raise InputError(
                field,
                value,
                f"{np.count_nonzero(beyond > 1e-9)} of the {len(beyond)} press positions are outside of it; the "
                f"furthest, x {a:g}, y {b:g} mm, by {beyond.max():.3g} mm; use a larger block or another grid",
            )


def beyond_top_mm(block: Block, points_mm: Floats) -> Floats:
    """Return how far each point lies outside of the top of a block, in mm; at most 0 for a point on the top.

    Args:
        block: The block.
        points_mm: The x and y of the points in the block frame, shape (n, 2).
    """
    (x, y), size = np.asarray(points_mm).T, block.size_mm
    beyond = np.maximum.reduce([-x, -y, x - size[0], y - size[1]])
    if block.region is not None:
        beyond = np.maximum(beyond, block.region.distance(x, y))
    return np.asarray(beyond)


def contact_radius_mm(force_n: float) -> float:
    """Return the radius of the sensor's contact with a flat plate, in mm.

    The model is a sphere of radius R on a Winkler foundation of stiffness k. For a contact radius a much smaller than
    R, the force is ``F = pi k a^4 / (4 R)``.

    Args:
        force_n: The contact force, in newtons.
    """
    return float((4.0 * DOME_RADIUS_MM * force_n / (math.pi * FOUNDATION_N_PER_MM3)) ** 0.25)
