"""A cell of the variance table, used by the table, its intervals and the grade."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from tacbench_cad.lab.analysis.published import PAPER_ROW_NAMES
from tacbench_cad.lab.study.spec import UNKNOWN

#: The ``force_level`` of a cell that is the mean over the force levels.
ALL_LEVELS = "all"
#: The two sources of a noise floor.
FRAMES, REPEATS = "stationary frames", "repeats (upper bound)"

#: The printer-filament and the texture of a cell.
CellKey = tuple[str, str]
#: The samples of a variance: all presses at a position (prints and repeats), or the repeats on each print.
Quantity = Literal["prints and repeats", "repeats of one print"]
#: A force level from 1, or :data:`ALL_LEVELS`.
Level = int | str


@dataclass(frozen=True, kw_only=True)
class Cell:
    """The variance of one printer, filament and texture at one force level, as a row of ``variance.csv``.

    All variances are in the squared unit of the frames (counts^2 for images).

    Args:
        printer: The name of the printer.
        filament: The name of the filament.
        texture: The name of the texture: ``texture-4``.
        force_level: The level from 1, 0 if it is unknown, or ``"all"`` for the mean over the levels.
        variance: The variance of each pixel over prints x repeats at each position, then the mean over pixels and
            positions. ``quantity`` names the samples if they are others.
        floor: The noise floor in the same unit, for ddof 1; None if it could not be measured.
        low: The lower end of the 95 % interval of ``variance``; None if there is no interval.
        high: The upper end of this interval; None if there is no interval. It is never ``inf``.
        prints: The number of prints in the cell.
        presses: The number of presses in the cell.
        noise_alone: The value of ``variance`` expected from sensor noise alone; None without a noise floor.
        floor_from: The source of the noise floor, :data:`FRAMES` or :data:`REPEATS`; empty without a noise floor.
        unbiased: The variance for ddof 1.
        floor_removed: ``unbiased`` minus the noise floor; may be negative. None without a noise floor.
        floor_removed_low: The lower end of its 95 % interval; None without one.
        floor_removed_high: The upper end of its 95 % interval; None without one.
        quantity: The samples of ``variance``.
        published: The paper's figure for this printer, filament and texture, if ``variance`` is the quantity that the
            paper printed; None otherwise.
    """

    printer: str
    filament: str
    texture: str
    force_level: Level
    variance: float
    floor: float | None = None
    low: float | None = None
    high: float | None = None
    prints: int
    presses: int
    noise_alone: float | None = None
    floor_from: str = ""
    unbiased: float | None = None
    floor_removed: float | None = None
    floor_removed_low: float | None = None
    floor_removed_high: float | None = None
    quantity: Quantity = "prints and repeats"
    published: float | None = None

    @property
    def combination(self) -> str:
        """The printer and the filament in one word: ``bambu-p1p_pla-minus``."""
        return f"{self.printer}_{self.filament}"


def parts_of(combination: str) -> dict[str, str]:
    """Split ``bambu-p1p_pla-minus`` into the values of the columns ``printer`` and ``filament``."""
    return dict(zip(("printer", "filament"), combination.split("_", 1), strict=True))


def name_of(combination: str) -> str:
    """Return the name of a printer-filament for figures and tables; the paper's combinations have the paper's names."""
    printer, filament = parts_of(combination).values()
    known = " ".join(part for part in (printer, filament) if part != UNKNOWN) or "unknown printer"
    return PAPER_ROW_NAMES.get((printer, filament), known)


def squared(units: str) -> str:
    """Return the unit of a variance for values in the given unit: ``counts^2``."""
    return f"{units}^2" if units.isalnum() else f"({units})^2"


def short_texture(texture: str) -> str:
    """Shorten ``texture-4`` to ``4``; other names do not change."""
    return texture.removeprefix("texture-")


def shown_levels(cells: Iterable[Cell]) -> tuple[Level, ...]:
    """Return the levels to show: all levels and their mean, or the only level."""
    levels = tuple(dict.fromkeys(cell.force_level for cell in cells))
    return levels[:1] if len(levels) == 2 else levels
