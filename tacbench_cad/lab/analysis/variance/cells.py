"""One cell of the variance table as a value: what the table, its interval and the grade have in common."""

from __future__ import annotations

import math
from dataclasses import dataclass

from tacbench_cad.util.errors import InputError

#: ``force_level`` of a cell that pools the forces.
ALL_LEVELS = "all"


@dataclass(frozen=True, kw_only=True)
class Cell:
    """The variance of one printer, filament and texture at one force level, as a row of ``variance.csv``.

    All variances are in the reading's unit squared (counts^2 for images).

    Args:
        printer: Printer.
        filament: Filament.
        texture: Name of the texture: ``texture-4``.
        force_level: Level from 1, or ``"all"`` for the mean over the levels.
        variance: Variance of each pixel over prints x repeats at each position, then the mean over pixels and
            positions.
        floor: Noise floor in the same unit, for ddof 1; None where none could be measured.
        low: Lower end of the 95 % interval of ``variance``; None where there is no interval.
        high: Upper end; ``inf`` never stands here, None does.
        prints: Prints in the cell.
        presses: Presses in the cell.
    """

    printer: str
    filament: str
    texture: str
    force_level: int | str
    variance: float
    floor: float | None
    low: float | None
    high: float | None
    prints: int
    presses: int

    def __post_init__(self) -> None:
        if self.force_level != ALL_LEVELS and (not isinstance(self.force_level, int) or self.force_level < 1):
            raise InputError("force_level", self.force_level, f'must be a whole number from 1, or "{ALL_LEVELS}"')
        for name in ("variance", "floor", "low", "high"):
            value = getattr(self, name)
            if value is None and name != "variance":
                continue
            if not (math.isfinite(value) and value >= 0.0):
                raise InputError(name, value, "must be a finite number from 0")
        if (self.low is None) != (self.high is None):
            raise InputError("low, high", (self.low, self.high), "must both be numbers or both be left out")
        for name in ("prints", "presses"):
            if getattr(self, name) < 1:
                raise InputError(name, getattr(self, name), "must be at least 1")

    @property
    def combination(self) -> str:
        """Printer and filament: ``bambu-p1p_pla-minus``."""
        return f"{self.printer}_{self.filament}"
