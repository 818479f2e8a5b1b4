"""Arrays and images with headers that no sensor writes are refused before memory is allocated."""

from __future__ import annotations

import io
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from numpy.lib import format as npy

from tacbench_cad.lab.runs.frame_files import decoded
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.npyfile import array_of, mapped


def npy_file(header: str, data: bytes = b"") -> bytes:
    """Return the bytes of a NumPy file with any text as its header."""
    padded = header.encode("latin-1").ljust((len(header) // 64 + 1) * 64 - 11) + b"\n"
    return npy.magic(1, 0) + struct.pack("<H", len(padded)) + padded + data


def header(shape: str, descr: str = "'<f8'") -> str:
    return f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}"


@pytest.mark.parametrize(
    ("content", "needle"),
    [
        (npy_file(header("(0, 3)")), "has no values"),
        (npy_file(header("(-2, -2)"), b"\0" * 32), "header is damaged: shape"),
        (npy_file(header("(True, 2)"), b"\0" * 16), "header is damaged: shape"),
        (npy_file(header("(" + "1, " * 70 + ")"), b"\0" * 8), "header is damaged"),
        (npy_file(header("(1000000000, 1000000000)")), "is truncated"),
        (npy_file(header("(2,)", "'<f16'"), b"\0" * 32), "must contain real numbers"),
        (npy_file(header("(2,)", "'|V8'"), b"\0" * 16), "must contain real numbers"),
        (npy_file(header("(2,)", "'<c16'"), b"\0" * 32), "must contain real numbers"),
        (npy_file(header("(2,)", "'<M8[s]'"), b"\0" * 16), "must contain real numbers"),
        (npy_file(header("(2,)", "('<f8', (3,))"), b"\0" * 48), "NumPy file|real numbers"),
        (npy_file(header("(2,)", "[('a', '<f8')]"), b"\0" * 16), "must contain real numbers"),
        (npy_file(header("(2,)", "'|O'"), b"\0" * 16), "pickled"),
        (npy_file(header("(" * 3000)), "header is damaged"),
    ],
)
def test_an_array_that_cannot_be_a_frame_is_refused(content: bytes, needle: str, tmp_path: Path) -> None:
    path = tmp_path / "a.npy"
    path.write_bytes(content)
    for read in (lambda: array_of(content), lambda: mapped(path)):
        with pytest.raises((CheckFailedError, InputError), match=needle) as caught:
            read()
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("dtype", ["bool", "u1", "<u2", ">i4", "<f4", "<f8", "<f2"])
def test_arrays_of_sensors_are_read(dtype: str) -> None:
    array = np.arange(24).reshape(2, 3, 4).astype(dtype)
    for order in "CF":
        stream = io.BytesIO()
        np.save(stream, np.asarray(array, order=order))  # type: ignore[call-overload]
        assert np.array_equal(array_of(stream.getvalue()), array)


def png(width: int, height: int, bits: int = 8, colour: int = 2) -> bytes:
    """Return the bytes of a PNG with the given size in its header, but with little data."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", head)
        + chunk(b"IDAT", zlib.compress(b"\0" * 1000))
        + b"\0\0\0\0IEND\xaeB`\x82"
    )


@pytest.mark.parametrize(
    "content",
    [
        png(100_000, 100_000),
        png(30_000, 30_000, bits=16, colour=6),
        png(2**31 - 1, 1),
        png(0, 5),
        png(10, 10, bits=3),
        png(10, 10, colour=7),
    ],
)
def test_an_image_is_refused_by_its_header(content: bytes) -> None:
    with pytest.raises(CheckFailedError, match=r"megapixels|not a readable PNG"):
        decoded(content)


def test_the_size_limit_of_images_can_be_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(CheckFailedError, match="set the environment variable TACBENCH_LIMITS=2 to allow it"):
        decoded(png(10_000, 10_000))
    monkeypatch.setenv("TACBENCH_LIMITS", "2")
    with pytest.raises(CheckFailedError, match="not a readable PNG"):
        decoded(png(10_000, 10_000))
