"""All readings of a study as rows of numbers, the input of every classifier."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.preprocess import Preprocess, read_usable
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.types import Bytes, Floats

Rows = Bytes | Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class Features:
    """Readings as rows.

    Args:
        rows: One a press, (n, numbers): uint8 for images, else float64.
        shape: Of a reading before it became a row: (height, width) of a whole image, (pixels,) of a region.
    """

    rows: Rows
    shape: tuple[int, ...]

    @property
    def is_image(self) -> bool:
        """Whether the rows are images' pixels."""
        return self.rows.dtype == np.uint8

    def __len__(self) -> int:
        return len(self.rows)


def read_features(
    collection: Collection,
    preprocess: Preprocess,
    jobs: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> Features:
    """Read every press of a collection, each once.

    Args:
        collection: The presses.
        preprocess: What is done to each reading.
        jobs: Threads that decode at once.
        progress: Called with readings read and readings in all.

    Raises:
        CheckFailedError: Readings are missing or damaged, hold NaN or infinite numbers, or are of another size; the
            message names the first one and says how many there are.
        InputError: All readings are the same.
    """
    from joblib import Parallel, delayed

    def read(index: int) -> tuple[NDArray[Any] | None, str]:
        try:
            return read_usable(collection.runs[int(collection.run[index])], collection.path(index), preprocess), ""
        except CheckFailedError as error:
            return None, str(error)

    count = len(collection)
    rows: NDArray[Any] | None = None
    shape: tuple[int, ...] = ()
    faults: list[str] = []
    done = Parallel(n_jobs=jobs, backend="threading", return_as="generator")(delayed(read)(i) for i in range(count))
    for index, (row, fault) in enumerate(done):
        if row is not None and rows is None:
            shape = row.shape
            rows = np.empty((count, row.size), row.dtype)
        if row is not None and rows is not None:
            if row.shape != shape or row.dtype != rows.dtype:
                path = f"{collection.runs[int(collection.run[index])].folder}/{collection.path(index)}"
                fault = f"{path}: is {row.dtype} {row.shape}, the others {rows.dtype} {shape}"
            else:
                rows[index] = row.ravel()
        if fault:
            faults.append(fault)
        if progress is not None:
            progress(index + 1, count)
    if faults:
        more = f" (and {len(faults) - 1} more of {count:,} readings)" if len(faults) > 1 else ""
        raise CheckFailedError(f"{faults[0]}{more}; mend or remove them with `tacbench check-runs`, then go on")
    assert rows is not None  # a collection has at least one press
    if not any((row != rows[0]).any() for row in rows):
        raise InputError("readings", None, "are all the same, so they tell nothing apart; check the sensor")
    return Features(rows=rows, shape=shape)
