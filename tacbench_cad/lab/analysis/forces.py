"""The feature ``forces``: the forces that were recorded during the motion of a press."""

from __future__ import annotations

from typing import Any, ClassVar, Self

import numpy as np
import pandas as pd

from tacbench_cad.lab.analysis.feature import Feature, Words
from tacbench_cad.lab.runs.press_table import STEP
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.types import Floats


class Forces(Feature):
    """The measured force of each row in N. A press of a table of series has one for each step of its motion."""

    name: ClassVar[str] = "forces"
    unit: ClassVar[str | None] = "N"
    from_frames: ClassVar[bool] = False
    few_numbers: ClassVar[bool] = True
    summary: ClassVar[str] = "the forces during the motion"

    @property
    def words(self) -> Words:
        """The words with which the forces are described."""
        return Words(numbers="forces (N)", one="number", each="number of the series", over="numbers")

    def fit(self, presses: pd.DataFrame, y: object = None) -> Self:
        """Check that there are forces. There is nothing to learn.

        Raises:
            InputError: The table has no series, or there was no gauge.
        """
        if STEP not in presses:
            raise InputError("features", self.name, "are recorded during a motion; also give --series")
        first = presses.iloc[0]
        if pd.isna(first["measured_force_n"]):
            raise InputError("features", self.name, f"need a force gauge, but {first['folder']} has no forces")
        self.shape_ = (1,)
        return self

    def of_press(self, row: Any) -> Floats:
        """Return the force of a row, (1,).

        Raises:
            CheckFailedError: It is unknown.
        """
        if pd.isna(row.measured_force_n):
            raise CheckFailedError(f"{row.frame}: has no force")
        return np.array([row.measured_force_n], dtype=np.float64)
