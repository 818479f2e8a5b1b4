"""How a mesh follows the formula: within a tolerance, or through the samples of a grid."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tacbench_cad.spec.extremes import HalfPlane
from tacbench_cad.spec.waves import WaveSum
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats

#: Default tolerance of a mesh, in mm.
TOLERANCE_MM = 0.01
#: Default tolerance of a solid, in mm.
STEP_TOLERANCE_MM = 0.001


@dataclass(frozen=True, kw_only=True)
class Tolerance:
    """The mesh stays within a distance of the formula everywhere.

    Args:
        mm: The distance in mm.
    """

    mm: float = TOLERANCE_MM

    def __post_init__(self) -> None:
        if not (math.isfinite(self.mm) and self.mm > 0.0):
            raise InputError("tolerance", self.mm, "must be a positive number of mm")


@dataclass(frozen=True, kw_only=True)
class SampleGrid:
    """The mesh joins samples of the formula by straight lines, as the paper's files do.

    Args:
        nx: Samples along x, at equal steps from side to side.
        ny: Samples along y.
    """

    nx: int
    ny: int

    def __post_init__(self) -> None:
        for name in ("nx", "ny"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or not 2 <= value <= 100_000:
                raise InputError(f"grid {name}", value, "must be a whole number from 2 to 100000")

    def lines(self, size_mm: tuple[float, float]) -> tuple[Floats, Floats]:
        """The lines x (nx,) and y (ny,) over a block's sides, in mm."""
        x, y = size_mm
        return x * np.arange(self.nx) / (self.nx - 1), y * np.arange(self.ny) / (self.ny - 1)


def highest_sample(surface: WaveSum, samples: tuple[Floats, Floats], keep: HalfPlane | None) -> float:
    """Highest point of the faceted sample surface; with a key also along the cut, where facets are crossed."""
    x, y = samples
    if keep is None and surface.is_separable:
        return float(surface.along_u(x).max() + surface.along_v(y).max())
    z = surface.grid(x, y)
    if keep is None:
        return float(z.max())
    excess = keep.excess(x[:, None], y[None, :])
    highest = float(z[excess <= 0.0].max())
    edges: tuple[Callable[[Floats], tuple[Floats, Floats]], ...] = (
        lambda a: (a[:-1, :], a[1:, :]),
        lambda a: (a[:, :-1], a[:, 1:]),
        lambda a: (a[1:, :-1], a[:-1, 1:]),
    )
    for ends in edges:
        (e0, e1), (z0, z1) = ends(excess), ends(z)
        crossed = (e0 < 0.0) != (e1 < 0.0)
        fraction = e0[crossed] / (e0[crossed] - e1[crossed])
        highest = max(highest, float((z0[crossed] + fraction * (z1[crossed] - z0[crossed])).max(initial=-np.inf)))
    return highest
