"""NumPy files read without trust: header first, nothing unpickled, nothing allocated that the file does not hold."""

from __future__ import annotations

import io
import math
from pathlib import Path
from typing import IO, Any, BinaryIO

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from tacbench_cad.util import door
from tacbench_cad.util.errors import CheckFailedError, InputError

#: The most dimensions of an array that is read.
MAX_DIMENSIONS = 8


def array_head(stream: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Shape, whether it is stored column by column, and type of the array in a NumPy file, which is read so far.

    Raises:
        CheckFailedError: It is no NumPy file, or holds pickled objects; the message begins with what.
    """
    magic = stream.read(npy.MAGIC_LEN)
    if magic[:1] == b"\x80":
        raise CheckFailedError("is pickled; such files can run anything when they are read, so it is not opened")
    try:
        version = npy.read_magic(io.BytesIO(magic))
        read = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}.get(version)
        if read is None:
            raise ValueError(f"version {version}")
        shape, fortran, dtype = read(stream)
    # NumPy reads the head with Python's own parser, which can end in almost any error on damaged text.
    except Exception as error:
        raise CheckFailedError(f"is not a NumPy file, or its head is damaged: {str(error)[:80]}") from None
    if dtype.hasobject:
        raise CheckFailedError("holds pickled objects; such files can run anything when they are read")
    # A flag counts as a whole number in Python, so a shape of flags passes NumPy's own reader.
    if len(shape) > MAX_DIMENSIONS or any(type(side) is not int or not 0 <= side < 2**62 for side in shape):
        raise CheckFailedError(f"is not a NumPy file, or its head is damaged: shape {str(shape)[:80]}")
    return shape, fortran, dtype


def _require_real_numbers(stream: BinaryIO) -> None:
    """Compare the header of a NumPy file with its size, and go back to its beginning.

    Raises:
        CheckFailedError: It is no NumPy file, is truncated, or holds something else; the message begins with what.
    """
    shape, _, dtype = array_head(stream)
    if 0 in shape:
        raise CheckFailedError(f"has shape {shape}, which is empty")
    if dtype.subdtype is not None or dtype.kind not in "biuf" or dtype.itemsize > 8:
        raise CheckFailedError(f"holds {str(dtype)[:80]}, not real numbers of up to 64 bits")
    need, size = stream.tell() + math.prod(shape) * dtype.itemsize, stream.seek(0, 2)
    if size != need:
        fault = "is truncated" if size < need else "is longer than it says"
        raise CheckFailedError(f"{fault}: {size} bytes where its header asks for {need}")
    stream.seek(0)


def array_of(data: bytes) -> NDArray[Any]:
    """The array in the bytes of a file.

    Raises:
        CheckFailedError: It is no whole NumPy file of real numbers.
    """
    stream = io.BytesIO(data)
    _require_real_numbers(stream)
    array: NDArray[Any] = npy.read_array(stream, allow_pickle=False)
    return array


def mapped(path: Path) -> NDArray[Any]:
    """Map a whole file into memory, read-only: only what is looked at is read.

    Raises:
        InputError: It cannot be opened, or is no whole NumPy file of real numbers.
    """
    with door.open_input(path, kind="array") as stream:
        try:
            _require_real_numbers(stream)
        except CheckFailedError as error:
            raise InputError("file", str(path), str(error)) from None
    array: NDArray[Any] = np.load(path, mmap_mode="r", allow_pickle=False)
    return array
