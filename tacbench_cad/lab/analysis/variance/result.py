"""The result of a variance table: its cells, components, tests and maps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.feature import Feature
from tacbench_cad.lab.analysis.variance.between import TextureMatrix
from tacbench_cad.lab.analysis.variance.cells import Cell, CellKey, Level
from tacbench_cad.lab.analysis.variance.intervals import (
    CellSums,
)
from tacbench_cad.lab.analysis.variance.permutation import PermutationTest
from tacbench_cad.lab.analysis.variance.streaming import Pass
from tacbench_cad.util.types import Floats

#: The sums over positions, by cell in the study's order, then by level from low to high.
Sums = Mapping[CellKey, Mapping[int, CellSums]]

#: ``paper``: the variance of prints and repeats, as in the paper's text; ``as-published``: the quantity of the paper's
#: printed figures.
Protocol = Literal["paper", "as-published"]


@dataclass(frozen=True, kw_only=True)
class PrinterTest:
    """A test whether two printer-filaments have the same variance between prints.

    Args:
        force_level: The level, or ``all``.
        first: The first printer and filament.
        second: The second printer and filament.
        outcome: The result of the permutation test.
        p_holm: The p of the test, adjusted for all pairs at its level (Holm 1979).
    """

    force_level: Level
    first: str
    second: str
    outcome: PermutationTest
    p_holm: float


@dataclass(frozen=True, kw_only=True, eq=False)
class VarianceResult:
    """All results of ``tacbench variance``.

    Args:
        collection: The study; with the protocol ``as-published``, its presses at one force level.
        protocol: The protocol, which defines the quantity of the table.
        feature: The fitted feature.
        ddof: 0 as in the paper, or 1.
        seed: The seed of the intervals and permutations.
        cells: The cells of the table, by level (``all`` last), combination and texture.
        components: The rows of ``components.csv``.
        matrices: The matrices between textures, by combination and level.
        tests: The permutation tests between printers, by level.
        positions: The variance at each position, by level and cell, shape (positions,); NaN if unknown.
        maps: The variance of each pixel (same ddof as the table), mean over positions and over the levels at which the
            cell has the most prints, at a resolution for figures.
        means: The mean of each number over positions, prints and repeats, by level and cell; empty unless the feature
            exhibits them.
        steps: For series, the variance at each time step (same ddof as the table), mean over pixels and positions, by
            level and cell, shape (frames of a press,).
        outside: The fraction of the pixels that lie outside of the sensor. None if a region of interest leaves them
            out, or if the program is not sure where the sensor is.
        sums: The sums from which intervals are computed, by cell and level.
        left_out: The frames that could not be used.
        passed: The pass over the frames, with counts and times.
    """

    collection: Collection
    protocol: Protocol
    feature: Feature
    ddof: int
    seed: int
    cells: tuple[Cell, ...]
    components: tuple[Mapping[str, Any], ...]
    matrices: tuple[TextureMatrix, ...]
    tests: tuple[PrinterTest, ...]
    positions: Mapping[tuple[int, CellKey], Floats]
    maps: Mapping[CellKey, Floats]
    means: Mapping[tuple[int, CellKey], Floats]
    steps: Mapping[tuple[int, CellKey], Floats]
    outside: float | None
    sums: Sums
    left_out: tuple[str, ...]
    passed: Pass

    @property
    def units(self) -> str:
        """The unit of the numbers."""
        return self.feature.unit or self.collection.units

    def cell(self, level: Level, combination: str, texture: str) -> Cell | None:
        """Return a cell of the table, or None if the table does not have it."""
        return self._by_key.get((level, combination, texture))

    @cached_property
    def _by_key(self) -> dict[tuple[Level, str, str], Cell]:
        return {(cell.force_level, cell.combination, cell.texture): cell for cell in self.cells}
