"""Frames and columns as arrays, for the formats that store only arrays. Images in colours are in RGB."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime
from typing import Any

import numpy as np

from tacbench_cad.extensions.exchange.exporting.columns import json_values
from tacbench_cad.extensions.exchange.exporting.exported_frames import Samples
from tacbench_cad.lab.rig import Frame, outside
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import by


class ArrayColumns:
    """The columns as arrays, which are filled while the frames are read. A column without any value is left out.

    An unknown text is empty. An unknown number is nan, so a column of whole numbers or booleans with unknown values
    becomes a column of floats. A time is stored as text.

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
        """Yield each frame, in RGB if it has colours, after its columns are stored.

        All frames must have the same shape and type.

        Raises:
            InputError: A frame has another shape or type than the first.
            CheckFailedError: A frame is missing, damaged or changed.
        """
        first: Frame | None = None
        for index, sample in enumerate(self._samples):
            values = json_values(sample.values)
            for name, array in self.arrays.items():
                value = values[name]
                array[index] = ("" if array.dtype.kind == "T" else np.nan) if value is None else value
            frame = outside(sample.decoded())
            first = frame if first is None else first
            if (frame.shape, frame.dtype) != (first.shape, first.dtype):
                raise InputError(
                    "runs",
                    sample.values["run"],
                    f"has frames of {by(*frame.shape)} {frame.dtype}, but the others have {by(*first.shape)} "
                    f"{first.dtype}; export each sensor separately",
                )
            yield frame
