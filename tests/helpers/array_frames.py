"""Arrays of frames for tests of the import."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from tacbench_cad.lab import Run


def frames(count: int = 12) -> np.ndarray:
    return np.random.default_rng(0).integers(0, 256, (count, 16, 24, 3), dtype=np.uint8)


def require_equal(out: Path, array: Any) -> None:
    """Check that the frames of label a are the even ones and those of label b the odd ones."""
    for first, name in enumerate(("a", "b")):
        run = Run.open(out / name)
        assert len(run.rows) == len(array) // 2
        for row in run.rows:
            assert np.array_equal(stored(run, row), array[first + 2 * (row.number - 1)])


def stored(run: Run, row: Any) -> np.ndarray:
    """Read the file of a frame with Pillow or NumPy."""
    path = run.folder / row.path
    return np.load(path) if path.suffix == ".npy" else np.asarray(Image.open(path))


def write_hdf5(path: Path, **arrays: Any) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        for name, array in arrays.items():
            file.create_dataset(f"data/{name}", data=array)
        file.create_dataset(b"\xff", data=np.zeros(12))  # a name that is not UTF-8 is left out


def read_endlessly(*arguments: Any) -> None:
    """Read a file in a child process for longer than any test waits."""
    time.sleep(600.0)
