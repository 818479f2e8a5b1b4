"""Where and how hard the sensor presses: the paper's protocol, read by jig, rig and analysis alike."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats

if TYPE_CHECKING:
    from tacbench_cad.spec.block import Block

Spacing = Literal["even", "1mm"]

#: The paper's three contact forces, in newtons.
FORCES_N = (0.08045, 1.91295, 3.0137)
#: The spread of each force that the paper observed, in newtons.
FORCE_SPREADS_N = (0.00195, 0.00985, 0.0098)
#: Readings at each position and force.
REPEATS = 2
#: Positions along each side of the grid.
PER_SIDE = 5
#: Outer radius of the sensor's dome and its foundation's stiffness: calibration constants of one TacTip, not laws.
DOME_RADIUS_MM = 20.0
#: Stiffness of the dome's foundation, in N/mm^3: as measured on one TacTip.
FOUNDATION_N_PER_MM3 = 0.0105


@dataclass(frozen=True, kw_only=True)
class PressGrid:
    """The 5 x 5 places of a block on which the sensor's summit is pressed.

    Args:
        x_mm: The five columns, mm in the block's frame, ascending.
        y_mm: The five rows, mm in the block's frame, ascending.
    """

    x_mm: tuple[float, ...]
    y_mm: tuple[float, ...]

    @classmethod
    def paper(cls, scale: float = 1.0, spacing: Spacing = "even") -> PressGrid:
        """The paper's grid: x from 4 to 9 mm; y from 18 to 23 mm in 1.25 mm steps, or 18 to 22 in 1 mm steps.

        Args:
            scale: The block's scale; the grid scales with it, so that the same places of the texture are pressed.
            spacing: Which reading of "5 equally spaced 1 mm positions between 18 and 23 mm" is taken along y.
        """
        if spacing not in ("even", "1mm"):
            raise InputError("spacing", spacing, "allowed: even, 1mm")
        last = 23.0 if spacing == "even" else 22.0
        x = tuple(scale * (4.0 + 1.25 * i) for i in range(PER_SIDE))
        y = tuple(scale * (18.0 + (last - 18.0) / 4 * i) for i in range(PER_SIDE))
        return cls(x_mm=x, y_mm=y)

    @property
    def positions_mm(self) -> Floats:
        """All positions, shape (25, 2): row by row (y), each from low to high x."""
        return np.array([(x, y) for y in self.y_mm for x in self.x_mm])

    @property
    def spacing_mm(self) -> tuple[float, float]:
        """Distance between neighbouring columns and between neighbouring rows, in mm."""
        return (self.x_mm[1] - self.x_mm[0], self.y_mm[1] - self.y_mm[0])

    def require_on(self, block: Block) -> None:
        """Refuse a block that the grid leaves.

        Raises:
            InputError: A position lies off the block's top; the message has the numbers.
        """
        x, y = block.size_mm
        if self.x_mm[-1] > x or self.y_mm[-1] > y:
            need = f"{self.x_mm[-1]:g} x {self.y_mm[-1]:g} mm"
            allowed = (
                f"the press grid reaches {need}, so it leaves the block: a larger block or a smaller grid would do"
            )
            raise InputError("size", f"{x:g} x {y:g} mm", allowed)
        if block.key_mm is not None:
            gap = (x - block.key_mm) - (self.x_mm[-1] - self.y_mm[0])
            if gap < 0.0:
                raise InputError(
                    "key", block.key_mm, f"cuts off the press grid; at most {block.key_mm + math.floor(gap):g} mm"
                )


def contact_radius_mm(force_n: float) -> float:
    """Radius of the sensor's contact on a flat plate, in mm.

    A Winkler foundation of stiffness k under a sphere of radius R carries ``F = pi k a^4 / (4 R)`` on a contact of
    radius a, for contacts small against the sphere.

    Args:
        force_n: Contact force in newtons.
    """
    return float((4.0 * DOME_RADIUS_MM * force_n / (math.pi * FOUNDATION_N_PER_MM3)) ** 0.25)
