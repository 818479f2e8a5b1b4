"""The data of a variance table: its tables and maps, and the settings with which they were computed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import pandas as pd

from tacbench_cad import __version__
from tacbench_cad.lab.analysis.conclusions import answer_table
from tacbench_cad.lab.analysis.feature import Feature
from tacbench_cad.lab.analysis.study_design import Design
from tacbench_cad.lab.analysis.variance.cells import CellKey, Protocol, squared
from tacbench_cad.util.types import Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class VarianceData:
    """The tables and maps of a variance table, from which :class:`.Variance` makes texts and figures.

    Args:
        design: The design of the study; with the protocol ``as-published``, of its presses at one force level.
        feature: The fitted feature.
        protocol: The protocol, which defines the quantity of the table.
        ddof: 0 as in the paper, or 1.
        seed: The seed of the intervals and permutations.
        tables: The tables by the names of their CSV files: ``variance``, ``positions``, and unless the protocol is
            ``as-published``, ``printer_answers``, ``components``, ``between_textures``, ``print_distances`` and
            ``permutation``; ``registration`` and ``motion`` if they were computed, and the exhibit of the feature. All
            variances are in the squared unit of the numbers (counts^2 for images).
        maps: The variance of each pixel (same ddof as the table), mean over positions and over the levels at which the
            cell has the most prints, at a resolution for figures, by cell.
        means: The mean of each number over positions, prints and repeats, by level and cell; empty unless the feature
            exhibits them.
        outside: The fraction of the pixels that lie outside of the sensor. None if a region of interest leaves them
            out, or if the program is not sure where the sensor is.
        left_out: The frames that could not be used, each with the reason.
    """

    design: Design
    feature: Feature
    protocol: Protocol
    ddof: int
    seed: int
    tables: Mapping[str, pd.DataFrame]
    maps: Mapping[CellKey, Floats]
    means: Mapping[tuple[int, CellKey], Floats]
    outside: float | None
    left_out: tuple[str, ...]

    @property
    def table(self) -> pd.DataFrame:
        """The variance table, one row for each level (``all`` last), printer-filament and texture."""
        return self.tables["variance"]

    @property
    def answers(self) -> pd.DataFrame:
        """The answers to the main questions; none with the protocol ``as-published``."""
        return self.tables.get("printer_answers", answer_table([]))

    @property
    def units(self) -> str:
        """The unit of the numbers whose variance was computed."""
        return self.feature.unit or self.design.units

    @property
    def settings(self) -> dict[str, Any]:
        """The settings, as they are written beside the tables."""
        region = self.feature.region_
        return {
            "analysis": "variance",
            "version": __version__,
            "protocol": self.protocol,
            "features": self.feature.name,
            "units": squared(self.units),
            "numbers": self.feature.words.numbers,
            **{name: getattr(self.feature, name) for name in ("colour", "resolution") if hasattr(self.feature, name)},
            "ddof": self.ddof,
            "seed": self.seed,
            "series": bool(self.design.steps),
            "roi": region.text if region else "",
            "outside": self.outside,
            "left_out": list(self.left_out),
            "data": self.design.data_key,
        }
