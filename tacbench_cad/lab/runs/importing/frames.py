"""From what a source loads to the file of a run folder: checked, decoded, and kept byte for byte where it can be."""

from __future__ import annotations

import io
import struct
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tacbench_cad.lab.rig.sensor import is_image
from tacbench_cad.lab.runs.importing.samples import Loaded
from tacbench_cad.lab.runs.pictures import MAX_MEGAPIXELS, decoded, encoded, simulated_text
from tacbench_cad.lab.runs.writing import FrameFile
from tacbench_cad.util.door import require_within
from tacbench_cad.util.errors import CheckFailedError, InputError

_PNG, _JPEG, _BMP, _TIFF = b"\x89PNG\r\n\x1a\n", b"\xff\xd8", b"BM", (b"II*\0", b"MM\0*")
#: A JPEG's end mark stands this near to its end; cameras pad.
_JPEG_PADDING = 4096


class Prepared(NamedTuple):
    """A frame as it will be stored: its file, its shape, and what of it was simulated."""

    file: FrameFile
    shape: tuple[int, ...]
    simulated: str


def prepared(loaded: Loaded) -> Prepared:
    """The file of a frame. A PNG of grey or BGR pixels is kept as it is; everything else is stored without loss.

    Raises:
        CheckFailedError: It is no whole image, is too large, or holds no real numbers.
    """
    if not isinstance(loaded, bytes):
        frame, simulated = loaded, ""
    else:
        png = loaded.startswith(_PNG)
        frame = decoded(loaded, "frame.png") if png else _other_image(loaded)
        simulated = simulated_text(loaded) if png else ""
        if png and is_image(frame):
            return Prepared(FrameFile.of(loaded, True), frame.shape, simulated)
        if frame.ndim == 3 and frame.shape[2] == 4:
            if not (frame[..., 3] == np.iinfo(frame.dtype).max).all():
                raise CheckFailedError("has transparent pixels, whose colour is not known")
            frame = np.ascontiguousarray(frame[..., :3])
    if frame.dtype.kind not in "iufb" or not frame.size:
        raise CheckFailedError(f"holds {frame.dtype} of shape {frame.shape}; real numbers are needed")
    return Prepared(
        FrameFile.of(*encoded(np.ascontiguousarray(frame), (simulated,) if simulated else ())), frame.shape, simulated
    )


def _other_image(data: bytes) -> NDArray[Any]:
    """A JPEG, BMP or TIFF image, refused if it is torn or too large before it is decoded."""
    import cv2

    size, torn = None, False
    if data.startswith(_JPEG):
        size, torn = _jpeg_size(data), b"\xff\xd9" not in data[-_JPEG_PADDING:]
    elif data.startswith(_BMP) and len(data) >= 26:
        length, _, _, _, width, height = struct.unpack("<IHHIii", data[2:6] + data[6:14] + data[18:26])
        size, torn = (width, abs(height)), length > len(data)
    elif data[:4] in _TIFF:
        size = _tiff_size(data)
    if size is None:
        raise CheckFailedError("is no readable image (PNG, JPEG, BMP or TIFF)")
    try:
        require_within("image", size[0] * size[1] / 1e6, MAX_MEGAPIXELS, "megapixels", "image")
    except InputError as error:
        raise CheckFailedError(error.allowed) from None
    if torn:
        raise CheckFailedError("is torn: its end is missing")
    try:
        image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        image = None
    if image is None or (image.shape[1], image.shape[0]) != size:
        raise CheckFailedError("is torn or damaged: it cannot be decoded")
    return np.asarray(image)


def _jpeg_size(data: bytes) -> tuple[int, int] | None:
    """Width and height in the frame header of a JPEG."""
    at = 2
    while at + 9 <= len(data) and data[at] == 0xFF:
        mark, length = data[at + 1], int.from_bytes(data[at + 2 : at + 4])
        if 0xC0 <= mark <= 0xCF and mark not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack(">HH", data[at + 5 : at + 9])
            return width, height
        at += 2 + length if mark != 0xFF else 1
    return None


def _tiff_size(data: bytes) -> tuple[int, int] | None:
    """Width and height in the first directory of a TIFF."""
    order = "<" if data[:2] == b"II" else ">"
    stream, sides = io.BytesIO(data), {}
    try:
        (start,) = struct.unpack(f"{order}I", data[4:8])
        stream.seek(start)
        (count,) = struct.unpack(f"{order}H", stream.read(2))
        for _ in range(count):
            tag, kind, _, value = struct.unpack(f"{order}HHI4s", stream.read(12))
            if tag in (256, 257):
                sides[tag] = struct.unpack(f"{order}H" if kind == 3 else f"{order}I", value[: 2 if kind == 3 else 4])[0]
    except struct.error:
        return None
    return (sides[256], sides[257]) if len(sides) == 2 else None
