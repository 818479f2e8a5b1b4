"""Files that describe others: a table beside images, ``y.npy`` beside ``X.npy``, or ``y`` beside ``X`` in a file."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacbench_cad.util.errors import InputError
from tacbench_cad.util.npyfile import mapped

#: The words by which the name of an array says that it has labels, and that it has frames.
LABELS = frozenset(("y", "label", "labels", "target", "targets", "class", "classes"))
FRAMES = frozenset(("x", "data", "frame", "frames", "image", "images", "sample", "samples", "input", "inputs"))
#: The words of other arrays with several numbers for each frame.
NUMBERS = frozenset(("pose", "poses", "move", "moves", "shear", "position", "positions", "force", "forces", "time"))
#: The largest number of columns that an array with several numbers for each frame gives.
MAX_COLUMNS = 64


def words_of(name: str) -> frozenset[str]:
    """Return the words in the name of an array: ``X_train`` has ``x`` and ``train``, like ``Xtrain``."""
    name = re.sub(r"^([xXyY])(?=train|test|val)", r"\1_", name)
    return frozenset(re.findall(r"[a-z]+|\d+", name.lower()))


def is_label(name: str) -> bool:
    """Return whether the name of an array says that it has labels."""
    return bool(words_of(name) & LABELS)


def subject(name: str) -> frozenset[str]:
    """Return the words of a name that are left without those for labels, frames and numbers."""
    return words_of(name) - LABELS - FRAMES - NUMBERS


def describes_frames(name: str, shape: tuple[int, ...], frames: tuple[int, ...]) -> bool:
    """Return whether an array can have one or several values for each frame of another.

    Args:
        name: The name of the array.
        shape: Its shape.
        frames: The shape of the array of frames.
    """
    if shape[:1] != frames[:1] or len(frames) < 2:
        return False
    several = len(shape) == 2 and shape[1] <= MAX_COLUMNS and bool(words_of(name) & (LABELS | NUMBERS))
    return len(shape) == 1 or shape[1:] == (1,) or (several and shape != frames)


def pairs(paths: Sequence[Path]) -> dict[Path, list[Path]]:
    """Return the files with frames, each with the files that describe its frames.

    A ``.npy`` file describes the frames of another if it has a value for each of them, and its name does not say that
    it belongs to others (``y_test`` beside ``X_train``) or no other file has so many frames.
    """
    shapes = {path: shape for path in paths if (shape := _shape(path))}
    describing = {
        path: [other for other, of in shapes.items() if other != path and describes_frames(path.stem, shape, of)]
        for path, shape in shapes.items()
    }
    result: dict[Path, list[Path]] = {path: [] for path in paths}
    for path, others in describing.items():
        fitting = [other for other in others if not describing[other]]
        named = [other for other in fitting if subject(path.stem) <= subject(other.stem)]
        for other in named or (fitting if len(fitting) == 1 else []):
            result[other].append(path)
            result.pop(path, None)
    return result


def columns_of_array(name: str, array: NDArray[Any]) -> dict[str, list[str]]:
    """Return an array with one or several values for each frame as columns of texts."""
    if array.ndim == 2 and array.shape[1] == 1:
        array = array[:, 0]
    if array.ndim == 2 and is_label(name) and _is_one_hot(array):
        array = array.argmax(axis=1)
    if array.ndim == 2:
        return {f"{name}_{number}": texts(column) for number, column in enumerate(array.T, start=1)}
    if is_label(name) and array.dtype.kind == "f" and np.isfinite(array).all() and (array % 1 == 0).all():
        array = array.astype(np.int64)
    return {name: texts(array)}


def label_column(columns: Mapping[str, Any]) -> str | None:
    """Return the only column whose name says that it has labels; None if there is none, or several."""
    labels = [name for name in columns if is_label(name.rpartition("/")[2])]
    return labels[0] if len(labels) == 1 else None


def texts(values: NDArray[Any]) -> list[str]:
    """Return the values of an array as texts."""
    return [value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value) for value in values.tolist()]


def _is_one_hot(array: NDArray[Any]) -> bool:
    kind = array.dtype.kind in "biuf"
    return kind and bool(np.isin(array, (0, 1)).all()) and bool((array.sum(axis=1, dtype=float) == 1).all())


def _shape(path: Path) -> tuple[int, ...] | None:
    if path.suffix.lower() != ".npy":
        return None
    try:
        return mapped(path, texts=True).shape
    except InputError:  # it is reported when it is imported
        return None


@dataclass(frozen=True, kw_only=True)
class Paths:
    """The paths that the user gave, for the tables and arrays that describe other paths."""

    given: tuple[Path, ...]
    _pairs: dict[Path, dict[Path, list[Path]]] = field(default_factory=dict)

    @property
    def tables(self) -> tuple[Path, ...]:
        """The tables."""
        return self.with_suffix(".csv")

    def with_suffix(self, *suffixes: str) -> tuple[Path, ...]:
        """Return the paths with one of some suffixes."""
        return tuple(path for path in self.given if path.suffix.lower() in suffixes)

    def table(self, path: Path) -> Path | None:
        """Return the table that belongs to a path.

        This is the table that the user gave, else the path itself if it is a table, else the only table in the path if
        it is a folder, else the table with the name of the file. The result is None if there is no such table.
        """
        if path.suffix.lower() == ".csv":
            return path
        if self.tables:
            return self.tables[0]
        if path.is_dir():
            return _only_table(path)
        beside = path.with_suffix(".csv")
        return beside if beside.is_file() else None

    def describing(self, path: Path) -> list[Path]:
        """Return the ``.npy`` files that describe the frames in a file: other paths of the user, or files beside it."""
        if path.parent not in self._pairs:
            files = dict.fromkeys([*self.with_suffix(".npy"), *sorted(path.parent.glob("[!.]*.npy"))])
            self._pairs[path.parent] = pairs(list(files))
        return self._pairs[path.parent].get(path, [])


def _only_table(folder: Path) -> Path | None:
    """Return the only table in a folder; None if there is none.

    Raises:
        InputError: There are several tables.
    """
    tables = sorted(path for path in folder.glob("[!.]*.csv") if path.is_file())
    if len(tables) > 1:
        names = ", ".join(table.name for table in tables[:6])
        raise InputError("folder", str(folder), f"has several tables ({names}); also give the path of the one to use")
    return tables[0] if tables else None
