"""Import of arrays of frames in HDF5 files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacbench_cad.lab.runs import (
    Frames,
    ImportFormat,
    ImportOptions,
    Paths,
    Source,
    array_name,
    array_source,
    columns_of_array,
    describes_frames,
    require_frames,
)
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.packages import require
from tacbench_cad.util.processes import read_isolated
from tacbench_cad.util.untrusted import open_input

#: The suffixes of HDF5 files.
SUFFIXES = (".h5", ".hdf5")
#: The time limit in s for reading from a file, and the additional time for each MB of the file.
LIMITS_S = (12.0, 0.01)


def _read(path: Path, paths: Paths, options: ImportOptions) -> Source:
    return array_source(path, _opened(path, options.columns.get("array", "")), paths, options, "hdf5")


def _opened(path: Path, name: str) -> Frames:
    """Open the array of frames in a file; the only array that can have frames if the name is empty."""
    require("the import of HDF5 files", "h5py")
    open_input(path, kind="array").close()
    chosen, shape, columns = _isolated(path, _content, path, name)
    require_frames(path, shape)
    failed: list[InputError] = []  # a damaged file is read no further, because each frame could take the time limit

    def frame(index: int) -> NDArray[Any]:
        if failed:
            raise failed[0]
        try:
            return np.asarray(_isolated(path, _frame, path, chosen, index))
        except InputError as error:
            failed.append(error)
            raise

    return Frames(shape=shape, frame=frame, columns=columns)


def _isolated(path: Path, function: Callable[..., Any], *arguments: Any) -> Any:
    """Read in a child process, because a damaged file can block the library while it holds Python's global lock."""
    return read_isolated(path, "the HDF5 library", LIMITS_S, function, *arguments)


def _content(path: Path, name: str) -> tuple[str, tuple[int, ...], dict[str, list[str]]]:
    """Return the name and the shape of the array of frames, and the columns beside it."""
    import h5py

    try:
        with h5py.File(path, "r") as file:
            items: dict[str | bytes, Any] = {}  # a name is bytes if it is not UTF-8
            file.visititems(lambda word, item: items.update({word: item}))  # it does not follow links out of the file
            sets = {
                word: item for word, item in items.items() if isinstance(word, str) and isinstance(item, h5py.Dataset)
            }
            for word, item in sets.items():
                if item.external or item.is_virtual:
                    raise InputError("array", str(path), f"{word} is stored in other files; copy it into this file")
            shapes = {word: item.shape for word, item in sets.items() if item.shape and item.dtype.kind in "biuf"}
            if not shapes and any(item.dtype.hasobject for item in sets.values()):
                raise InputError("array", str(path), "has objects or texts, but no array of numbers")
            chosen = array_name(path, shapes, name.strip("/"))
            columns: dict[str, list[str]] = {}
            for word, item in sets.items():
                is_text = bool(h5py.check_string_dtype(item.dtype))
                if (is_text or item.dtype.kind in "biuf") and describes_frames(word, item.shape, shapes[chosen]):
                    columns |= columns_of_array(word, item.asstr()[:] if is_text else item[:])
    except InputError:
        raise
    except Exception as error:  # h5py can raise almost any exception for a damaged file
        raise InputError("file", str(path), f"is not a complete HDF5 file: {str(error)[:120]}") from None
    return chosen, shapes[chosen], columns


def _frame(path: Path, name: str, index: int) -> NDArray[Any]:
    import h5py

    try:
        with h5py.File(path, "r") as file:
            return np.asarray(file[name][index])
    except Exception as error:
        raise CheckFailedError(f"cannot be read: {str(error)[:120]}") from None


FORMAT = ImportFormat(recognises=lambda path, *_: path.suffix.lower() in SUFFIXES, read=_read, suffixes=SUFFIXES)
