"""The feature ``forces``: the forces that were recorded during the motion of a press."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar, Self

import numpy as np

from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.feature import Feature, Words
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.lab.runs.region import Region
from tacbench_cad.lab.runs.schema import SERIES_FILE, series_folder
from tacbench_cad.lab.runs.series import series_rows
from tacbench_cad.util.convert import NOT_STORED
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.types import Floats


@dataclass(frozen=True, kw_only=True)
class Forces(Feature):
    """The forces in the table of a series, in N.

    Args:
        frames: The number of forces from the start of each series; None for all.
    """

    name: ClassVar[str] = "forces"
    unit: ClassVar[str | None] = "N"
    from_frames: ClassVar[bool] = False
    few_numbers: ClassVar[bool] = True
    summary: ClassVar[str] = "the forces during the motion"
    frames: int | None = field(default=None, metadata=NOT_STORED)

    @property
    def words(self) -> Words:
        """The words with which the forces are described."""
        return Words(numbers="forces (N)", one="number", each="number of the series", over="numbers")

    def fit(self, collection: Collection, region: Region | None = None) -> Self:
        """Return the feature for the used part of each series. There is nothing to learn.

        Raises:
            InputError: The series are not analysed, or there was no gauge.
        """
        if not collection.series:
            raise InputError("features", self.name, "are recorded during a motion; also give --series")
        if any(row.force_n is None for row in collection.moving(0)):
            folder = collection.runs[0].folder
            raise InputError("features", self.name, f"need a force gauge, but {folder} has no forces")
        return replace(self, frames=collection.frames)

    def paths(self, collection: Collection, index: int) -> tuple[str, ...]:
        """Return the path of the table of a press's series."""
        return (f"{series_folder(int(collection.number[index]))}/{SERIES_FILE}",)

    def transform(self, run: Run, path: str) -> Floats:
        """Return the forces in the table of a series in N, (frames,).

        Raises:
            CheckFailedError: The table is missing, damaged or incomplete, or a force is unknown.
        """
        try:
            number = int(path.split("/")[-2].rpartition("_")[2])
            rows = series_rows(run.folder, number, run.info.series_frames)
        except InputError as error:
            raise CheckFailedError(str(error)) from None
        unknown = next((row.frame for row in rows if row.force_n is None), None)
        if unknown is not None:
            raise CheckFailedError(f"{run.folder / path}: has no force of {unknown}")
        return np.array([row.force_n for row in rows], dtype=np.float64)[: self.frames]
