"""A scan as points, whatever kind of file it came from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class HeightGrid:
    """The heights of a height map.

    Args:
        heights_mm: The heights, shape (ny, nx): row by row from low y, each from low x; ``nan`` for no value.
        step_mm: The distances of neighbouring columns and rows.
    """

    heights_mm: Floats
    step_mm: tuple[float, float]

    def __post_init__(self) -> None:
        if self.heights_mm.ndim != 2 or self.heights_mm.size == 0:
            raise InputError("heights_mm", list(self.heights_mm.shape), "must have rows and columns")
        if not min(self.step_mm) > 0.0:
            raise InputError("step_mm", self.step_mm, "must be above 0")

    def points_mm(self) -> Floats:
        """Return the measured points in the frame of the map, shape (n, 3). The first column and row lie at 0."""
        rows, columns = np.nonzero(np.isfinite(self.heights_mm))
        return np.column_stack([columns * self.step_mm[0], rows * self.step_mm[1], self.heights_mm[rows, columns]])


@dataclass(frozen=True, kw_only=True, eq=False)
class Cloud:
    """The points of a scan, in the frame of the scanner.

    Args:
        points_mm: The points, shape (n, 3). All are finite.
        source: The name of the file, or a word for the simulation.
        simulated: Whether the points come from the simulator.
        grid: The heights, if the source is a height map.
    """

    points_mm: Floats
    source: str
    simulated: bool = False
    grid: HeightGrid | None = None

    def __post_init__(self) -> None:
        if self.points_mm.ndim != 2 or self.points_mm.shape[1] != 3:
            raise InputError("points_mm", list(self.points_mm.shape), "must have the shape (n, 3)")

    def __len__(self) -> int:
        return len(self.points_mm)
