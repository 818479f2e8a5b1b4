"""The two ways in which a mesh approximates the formula: within a tolerance, or through the samples of a grid."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tacbench_cad.spec.extremes import Footprint
from tacbench_cad.spec.surface import Surface
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats

#: The default tolerance of a mesh, in mm.
TOLERANCE_MM = 0.01
#: The default tolerance of a solid, in mm.
STEP_TOLERANCE_MM = 0.001


def attainable_mm(default_mm: float, least_mm: float) -> float:
    """Return a default tolerance, or the next of 1, 2, 5, 10 ... above the least possible one if it is too small.

    >>> attainable_mm(0.01, 0.0), attainable_mm(0.01, 0.031)
    (0.01, 0.05)

    Args:
        default_mm: The default tolerance in mm.
        least_mm: The smallest tolerance in mm that the texture's own error allows.
    """
    # a scale that is not a finite number is refused later
    if not default_mm < least_mm < math.inf:
        return default_mm
    power = 10.0 ** math.floor(math.log10(least_mm))
    # a number such as 0.02 is written without the rounding of the product
    return float(f"{next(step for step in (1.0, 2.0, 5.0, 10.0) if step * power >= least_mm) * power:.1g}")


@dataclass(frozen=True, kw_only=True)
class Tolerance:
    """A largest distance between the mesh and the formula, which holds everywhere.

    Args:
        mm: The distance, in mm.
    """

    mm: float = TOLERANCE_MM

    def __post_init__(self) -> None:
        if not (math.isfinite(self.mm) and self.mm > 0.0):
            raise InputError("tolerance", self.mm, "must be a positive number of mm")


@dataclass(frozen=True, kw_only=True)
class SampleGrid:
    """A grid of samples of the formula that the mesh connects by straight lines, as in the authors' files.

    Args:
        nx: The number of samples along x. They are equally spaced, and include both ends.
        ny: The number of samples along y.
    """

    nx: int
    ny: int

    def __post_init__(self) -> None:
        for name in ("nx", "ny"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or not 2 <= value <= 100_000:
                raise InputError(f"grid {name}", value, "must be a whole number from 2 to 100000")

    def lines(self, size_mm: tuple[float, float]) -> tuple[Floats, Floats]:
        """Return the coordinates x (nx,) and y (ny,) of the samples for the given sides, in mm."""
        x, y = size_mm
        return x * np.arange(self.nx) / (self.nx - 1), y * np.arange(self.ny) / (self.ny - 1)


def highest_sample(surface: Surface, samples: tuple[Floats, Floats], region: Footprint | None) -> float:
    """Return the highest point of the triangulated samples. If there is a key, the points on its cut count as well."""
    x, y = samples
    if region is None and surface.is_separable:
        return float(surface.along_u(x).max() + surface.along_v(y).max())
    z = surface.grid(x, y)
    if region is None:
        return float(z.max())
    excess = region.distance(x[:, None], y[None, :])
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
