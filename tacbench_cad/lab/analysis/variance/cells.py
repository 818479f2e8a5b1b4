"""One cell of the variance table as a value: what the table, its interval and the grade have in common."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated, Literal

from tacbench_cad.lab.analysis.published import PAPER_ROW_NAMES
from tacbench_cad.lab.study.spec import UNKNOWN
from tacbench_cad.util.convert import Bounds, check_fields
from tacbench_cad.util.errors import InputError

#: ``force_level`` of a cell that pools the forces.
ALL_LEVELS = "all"
#: Where a noise floor comes from.
FRAMES, REPEATS = "stationary frames", "repeats (upper bound)"

#: What a figure is the variance of: all presses of a place (prints and repeats), or the repeats on each of its prints.
Quantity = Literal["prints and repeats", "repeats of one print"]
#: A force level from 1, or :data:`ALL_LEVELS`.
Level = int | str
_Variance = Annotated[float, Bounds(0.0)]
_Count = Annotated[int, Bounds(1)]


@dataclass(frozen=True, kw_only=True)
class Cell:
    """The variance of one printer, filament and texture at one force level, as a row of ``variance.csv``.

    All variances are in the reading's unit squared (counts^2 for images).

    Args:
        printer: Printer.
        filament: Filament.
        texture: Name of the texture: ``texture-4``.
        force_level: Level from 1, 0 if it is unknown, or ``"all"`` for the mean over the levels.
        variance: Variance of each pixel over prints x repeats at each position, then the mean over pixels and
            positions; or what ``quantity`` says.
        floor: Noise floor in the same unit, for ddof 1; None where none could be measured.
        low: Lower end of the 95 % interval of ``variance``; None where there is no interval.
        high: Upper end; ``inf`` never stands here, None does.
        prints: Prints in the cell.
        presses: Presses in the cell.
        noise_alone: What ``variance`` would be if the readings differed by noise only; None without a floor.
        floor_from: Where the floor comes from, :data:`FRAMES` or :data:`REPEATS`; empty without a floor.
        unbiased: The variance for ddof 1.
        floor_removed: ``unbiased`` less the floor; may be negative. None without a floor.
        floor_removed_low: Lower end of its 95 % interval, None without one.
        floor_removed_high: Upper end.
        quantity: What ``variance`` is taken over.
        published: The paper's figure for this printer, filament and texture, if ``variance`` is the quantity that the
            paper printed.
    """

    printer: str
    filament: str
    texture: str
    force_level: Level
    variance: _Variance
    floor: _Variance | None
    low: _Variance | None
    high: _Variance | None
    prints: _Count
    presses: _Count
    noise_alone: float | None = None
    floor_from: str = ""
    unbiased: float | None = None
    floor_removed: float | None = None
    floor_removed_low: float | None = None
    floor_removed_high: float | None = None
    quantity: Quantity = "prints and repeats"
    published: float | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        if self.force_level != ALL_LEVELS and (not isinstance(self.force_level, int) or self.force_level < 0):
            raise InputError("force_level", self.force_level, f'must be a whole number from 0, or "{ALL_LEVELS}"')
        if (self.low is None) != (self.high is None):
            raise InputError("low, high", (self.low, self.high), "must both be numbers or both be left out")

    @property
    def combination(self) -> str:
        """Printer and filament: ``bambu-p1p_pla-minus``."""
        return f"{self.printer}_{self.filament}"


def parts_of(combination: str) -> dict[str, str]:
    """Printer and filament of ``bambu-p1p_pla-minus``, by the names of their columns."""
    return dict(zip(("printer", "filament"), combination.split("_", 1), strict=True))


def name_of(combination: str) -> str:
    """A printer-filament as figures and tables call it: as the paper does, where it is one of the paper's."""
    printer, filament = parts_of(combination).values()
    known = " ".join(part for part in (printer, filament) if part != UNKNOWN) or "unknown printer"
    return PAPER_ROW_NAMES.get((printer, filament), known)


def squared(units: str) -> str:
    """The unit of a variance of readings in these units: ``counts^2``."""
    return f"{units}^2" if units.isalnum() else f"({units})^2"


def short_texture(texture: str) -> str:
    """``4`` for ``texture-4``; a user's own name as it is."""
    return texture.removeprefix("texture-")


def shown_levels(cells: Iterable[Cell]) -> tuple[Level, ...]:
    """The levels that are shown: all of them and their mean, or the only one."""
    levels = tuple(dict.fromkeys(cell.force_level for cell in cells))
    return levels[:1] if len(levels) == 2 else levels
