"""The names of the cells of the variance table: printer-filaments, textures, force levels, quantities and units."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, Literal

import pandas as pd

from tacbench_cad.lab.analysis.published import PAPER_ROW_NAMES
from tacbench_cad.lab.study.spec import UNKNOWN

#: The ``force_level`` of a cell that is the mean over the force levels.
ALL_LEVELS = "all"
#: The two sources of a noise floor.
FRAMES, REPEATS = "stationary frames", "repeats (upper bound)"
#: The columns that name a cell of the table.
CELL = ("printer", "filament", "texture", "force_level")

#: ``paper``: the variance of prints and repeats, as in the paper's text; ``as-published``: the quantity of the paper's
#: printed figures.
Protocol = Literal["paper", "as-published"]
#: The printer-filament and the texture of a cell.
CellKey = tuple[str, str]
#: A force level from 1, or :data:`ALL_LEVELS`.
Level = int | str


def place_of(level: Level, key: CellKey) -> dict[str, Any]:
    """Return the values of :data:`CELL`."""
    return {**parts_of(key[0]), "texture": key[1], "force_level": level}


def cells_of(table: pd.DataFrame) -> dict[tuple[Level, CellKey], Any]:
    """Return the rows of a variance table, with the columns as attributes, by level and cell."""
    return {(row.force_level, (f"{row.printer}_{row.filament}", row.texture)): row for row in table.itertuples()}  # type: ignore[misc]


def groups(table: pd.DataFrame, columns: Sequence[str]) -> Iterator[tuple[Any, pd.DataFrame]]:
    """Yield the values of some columns and the rows that have them, in the order of the table."""
    yield from table.groupby(list(columns), sort=False)


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


def shown_levels(table: pd.DataFrame) -> tuple[Level, ...]:
    """Return the levels to show of a variance table: all levels and their mean, or the only level."""
    levels = tuple(table["force_level"].unique().tolist())
    return levels[:1] if len(levels) == 2 else levels
