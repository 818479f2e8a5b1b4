"""Frames and columns as arrays, for the formats that hold nothing else."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime
from typing import Any

import numpy as np

from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.runs.exporting.columns import json_values
from tacbench_cad.lab.runs.exporting.samples import Samples
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import by


class ArrayColumns:
    """The columns as arrays, filled while the frames pass. A column without any value is left out.

    A text that is unknown is empty; an unknown number is nan, which makes a column of whole numbers or flags one of
    floats. A time is its text.

    Args:
        samples: The samples.

    Attributes:
        arrays: The arrays by name.
    """

    def __init__(self, samples: Samples) -> None:
        self._samples = samples
        self.arrays: dict[str, Any] = {}
        for column in samples.columns:
            number = float if samples.unknown[column.name] else column.kind
            dtype = np.dtypes.StringDType() if column.kind in (str, datetime) else np.dtype(number)
            self.arrays[column.name] = np.empty(len(samples), dtype)

    def frames(self) -> Iterator[Frame]:
        """Each frame, once its columns are kept. All have one shape and type.

        Raises:
            InputError: One has another shape or type than the first.
            CheckFailedError: One is missing, damaged or changed.
        """
        first: Frame | None = None
        for index, sample in enumerate(self._samples):
            values = json_values(sample.values)
            for name, array in self.arrays.items():
                value = values[name]
                array[index] = ("" if array.dtype.kind == "T" else np.nan) if value is None else value
            frame = sample.decoded()
            first = frame if first is None else first
            if (frame.shape, frame.dtype) != (first.shape, first.dtype):
                raise InputError(
                    "runs",
                    sample.values["run"],
                    f"holds frames of {by(*frame.shape)} {frame.dtype} where the others have {by(*first.shape)} "
                    f"{first.dtype}; export each sensor alone",
                )
            yield frame
