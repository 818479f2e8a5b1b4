"""Safe reading of NumPy files. The header is checked first; pickled objects and wrong sizes are refused."""

from __future__ import annotations

import io
import math
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from tacbench_cad.util import untrusted
from tacbench_cad.util.errors import CheckFailedError, InputError

#: The largest allowed number of dimensions of an array.
MAX_DIMENSIONS = 8
#: The first bytes of NumPy files, and of pickled ones, which are refused.
NUMPY_FILES = (b"\x93NUMPY", b"\x80")


def _require_complete(stream: BinaryIO, texts: bool = False) -> None:
    """Compare the header of a NumPy file with the file's size, and go back to the beginning of the file.

    Args:
        stream: The file.
        texts: Whether texts are allowed, too.

    Raises:
        CheckFailedError: The file is not a complete NumPy file of real numbers. The message is the end of a sentence
            that begins with the file.
    """
    magic = stream.read(npy.MAGIC_LEN)
    if magic[:1] == b"\x80":
        raise CheckFailedError("is pickled; reading a pickled file can run any program code, so it is not opened")
    try:
        readers = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
        shape, _, dtype = readers[npy.read_magic(io.BytesIO(magic))](stream)
    # NumPy reads the header with Python's own parser, which can raise almost any exception for a damaged text.
    except Exception as error:
        raise CheckFailedError(f"is not a NumPy file, or its header is damaged: {str(error)[:80]}") from None
    if dtype.hasobject:
        raise CheckFailedError("contains pickled objects; reading them can run any program code")
    # A boolean is a whole number in Python, so NumPy's own reader accepts a shape of booleans.
    if len(shape) > MAX_DIMENSIONS or any(type(side) is not int or not 0 <= side < 2**62 for side in shape):
        raise CheckFailedError(f"is not a NumPy file, or its header is damaged: shape {str(shape)[:80]}")
    if 0 in shape:
        raise CheckFailedError(f"has shape {shape}, so it has no values")
    numbers = dtype.kind in "biuf" and dtype.itemsize <= 8
    if dtype.subdtype is not None or not (numbers or (texts and dtype.kind in "US")):
        raise CheckFailedError(f"contains {str(dtype)[:80]}; it must contain real numbers of at most 64 bits")
    need, size = stream.tell() + math.prod(shape) * dtype.itemsize, stream.seek(0, 2)
    if size != need:
        fault = "is truncated" if size < need else "is too long"
        raise CheckFailedError(f"{fault}: it has {size} bytes, but its header requires {need}")
    stream.seek(0)


def array_of(data: bytes) -> NDArray[Any]:
    """Read an array from the bytes of a file.

    Raises:
        CheckFailedError: The bytes are not a complete NumPy file of real numbers.
    """
    stream = io.BytesIO(data)
    _require_complete(stream)
    array: NDArray[Any] = npy.read_array(stream, allow_pickle=False)
    return array


def mapped(path: Path, texts: bool = False, what: str = "file") -> NDArray[Any]:
    """Map a file into memory, read-only. Only the parts that are used are read.

    Args:
        path: The file.
        texts: Whether an array of texts is allowed, too.
        what: The meaning of the file, for error messages.

    Raises:
        InputError: The file cannot be opened, or is not a complete NumPy file of real numbers.
    """
    with untrusted.open_input(path, what, "array") as stream:
        try:
            _require_complete(stream, texts)
        except CheckFailedError as error:
            raise InputError(what, str(path), str(error)) from None
    array: NDArray[Any] = np.load(path, mmap_mode="r", allow_pickle=False)
    return array
