"""All frames of a study as rows of numbers, the input of every classifier."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.feature import Feature, read_usable
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.types import Bytes, Floats

Rows = Bytes | Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class Features:
    """Frames as rows.

    Args:
        rows: A row for each press, (n, numbers): uint8 for images, otherwise float64.
        shape: The shape of a frame before it became a row: (height, width) of a whole image, (pixels,) of a region. For
            series, the number of frames is the first axis: (frames, height, width).
    """

    rows: Rows
    shape: tuple[int, ...]

    @property
    def is_image(self) -> bool:
        """Whether the rows are the pixels of images."""
        return self.rows.dtype == np.uint8

    def __len__(self) -> int:
        return len(self.rows)


def read_features(
    collection: Collection,
    feature: Feature,
    jobs: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> Features:
    """Read the frames, or the series of frames, of all presses of a collection, each frame once.

    Args:
        collection: The presses.
        feature: The fitted feature.
        jobs: The number of threads that decode at the same time.
        progress: Receives progress updates: the number of presses done and their total number.

    Raises:
        CheckFailedError: Frames are missing or damaged, contain NaN or infinite numbers, or have another size. The
            message names the first of these frames and their number.
        InputError: All frames are equal.
    """
    from joblib import Parallel, delayed

    def read(index: int) -> tuple[NDArray[Any] | None, str]:
        run = collection.runs[int(collection.run[index])]
        try:
            frames = [read_usable(run, path, feature) for path in feature.paths(collection, index)]
            return np.stack(frames) if collection.series and feature.from_frames else frames[0], ""
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
                path = f"{collection.runs[int(collection.run[index])].folder}/{feature.paths(collection, index)[0]}"
                fault = f"{path}: is {row.dtype} {row.shape}, but the other frames are {rows.dtype} {shape}"
            else:
                rows[index] = row.ravel()
        if fault:
            faults.append(fault)
        if progress is not None:
            progress(index + 1, count)
    if faults:
        more = f" (and {len(faults) - 1} more of {count:,} frames)" if len(faults) > 1 else ""
        raise CheckFailedError(f"{faults[0]}{more}; find them with `tacbench check-runs` and repair or remove them")
    assert rows is not None  # a collection has at least one press
    if not any((row != rows[0]).any() for row in rows):
        raise InputError("frames", None, "are all equal, so they cannot be classified; check the sensor")
    return Features(rows=rows, shape=shape)
