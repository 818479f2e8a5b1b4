"""Frames as bytes: images as PNG (with a word that they are simulated), everything else as NumPy files.

Imported JPEG files are read as well; none is written.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import struct
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tacbench_cad.lab.rig.sensor import Frame, is_image
from tacbench_cad.lab.runs.npyfile import array_of
from tacbench_cad.util.door import require_within
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.files import replacing

#: Keyword of the PNG text that says what was simulated.
SIMULATED_KEYWORD = "simulated"
#: What the files begin with.
PNG, JPEG = b"\x89PNG\r\n\x1a\n", b"\xff\xd8"
#: A PNG's signature and its first chunk, IHDR, take so many bytes; text chunks may follow.
_HEAD_BYTES = 33
#: An image with more pixels is refused before it is decoded, in millions.
MAX_MEGAPIXELS = 60.0
#: A JPEG's end mark stands this near to its end; cameras pad.
_JPEG_PADDING = 4096


def encoded(frame: Frame, simulated: Sequence[str]) -> tuple[bytes, str]:
    """A frame as the bytes of its file.

    OpenCV's own settings are used: run lengths after the Sub filter. On images with camera noise they are both
    quicker and smaller than any level of full compression.

    Args:
        frame: The frame.
        simulated: What of the rig was simulated; it goes into an image's metadata.

    Returns:
        The bytes, and ``.png`` or ``.npy``, the ending of the file's name.
    """
    if not is_image(frame):
        stream = io.BytesIO()
        np.save(stream, np.asarray(frame), allow_pickle=False)
        return stream.getvalue(), ".npy"
    import cv2

    data = cv2.imencode(".png", frame)[1].tobytes()
    if simulated:
        text = SIMULATED_KEYWORD.encode() + b"\0" + "; ".join(simulated).encode("latin-1", "replace")
        kind = b"tEXt" + text
        chunk = struct.pack(">I", len(text)) + kind + struct.pack(">I", zlib.crc32(kind))
        data = data[:_HEAD_BYTES] + chunk + data[_HEAD_BYTES:]
    return data, ".png"


def write_png(path: Path, image: Frame) -> None:
    """Write an image as a PNG, whole or not at all.

    Raises:
        InputError: The file cannot be written.
    """
    with replacing(path) as temporary:
        temporary.write_bytes(encoded(image, ())[0])


def decoded(data: bytes, name: str) -> Frame:
    """The frame in the bytes of its file; an image is uint8, (height, width) or (height, width, 3), BGR.

    Args:
        data: The bytes.
        name: The file's name, whose ending says what it is.

    Raises:
        CheckFailedError: They are no whole PNG or JPEG of at most :data:`MAX_MEGAPIXELS`, or no whole NumPy file.
    """
    if name.endswith(".png"):
        return decoded_image(data, _png_size(data), "PNG")
    return decoded_image(data, _jpeg_size(data), "JPEG") if name.endswith(".jpg") else array_of(data)


def decoded_image(data: bytes, size: tuple[int, int] | None, kind: str) -> Frame:
    """Decode an image that is not too large and has the size that its header says.

    Args:
        data: The bytes of its file.
        size: Width and height by its header; None if the file is not whole.
        kind: The name of its format.

    Raises:
        CheckFailedError: It is too large, torn or damaged.
    """
    import cv2

    image = None
    if size is not None:
        try:
            require_within("image", size[0] * size[1] / 1e6, MAX_MEGAPIXELS, "megapixels", "image")
        except InputError as error:
            raise CheckFailedError(error.allowed) from None
        with contextlib.suppress(cv2.error):
            image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None or (image.shape[1], image.shape[0]) != size:
        raise CheckFailedError(f"is not a readable {kind} image: it is torn or damaged")
    return np.asarray(image)


def simulated_text(data: bytes) -> str:
    """What a PNG of ours says that was simulated; empty where it says nothing."""
    head = data[_HEAD_BYTES : _HEAD_BYTES + 8]
    if head[4:] != b"tEXt":
        return ""
    word, _, text = data[_HEAD_BYTES + 8 : _HEAD_BYTES + 8 + int.from_bytes(head[:4])].partition(b"\0")
    return text.decode("latin-1") if word == SIMULATED_KEYWORD.encode() else ""


def _png_size(data: bytes) -> tuple[int, int] | None:
    """Width and height of a PNG whose chunks are whole, from its header to its end; else None.

    OpenCV decodes what it finds of a truncated file, and allocates what a damaged chunk says of its length: seconds and
    gigabytes.
    """
    at, kinds = 8, []
    while data.startswith(PNG) and at + 12 <= len(data):
        length, kind = struct.unpack(">I4s", data[at : at + 8])
        at, begin = at + 12 + length, at + 4
        if at > len(data) or struct.pack(">I", zlib.crc32(data[begin : at - 4])) != data[at - 4 : at]:
            return None
        kinds.append(kind)
    if at != len(data) or kinds[:1] != [b"IHDR"] or kinds[-1:] != [b"IEND"] or len(data) <= _HEAD_BYTES:
        return None
    width, height = struct.unpack(">II", data[16:24])
    return width, height


def _jpeg_size(data: bytes) -> tuple[int, int] | None:
    """Width and height of a JPEG that has its end mark; else None."""
    at = 2 if b"\xff\xd9" in data[-_JPEG_PADDING:] else len(data)
    while at + 9 <= len(data) and data[at] == 0xFF:
        mark, length = data[at + 1], int.from_bytes(data[at + 2 : at + 4])
        if 0xC0 <= mark <= 0xCF and mark not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack(">HH", data[at + 5 : at + 9])
            return width, height
        at += 2 + length if mark != 0xFF else 1
    return None


def sha256(data: bytes) -> str:
    """SHA-256 as 64 hexadecimal digits."""
    return hashlib.sha256(data).hexdigest()
