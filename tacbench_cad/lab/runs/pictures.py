"""Frames as files: images as PNG (simulated ones are marked), and all other arrays as NumPy files.

Imported JPEG files are read, but no JPEG files are written.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import os
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tacbench_cad.lab.rig.sensor import Frame, is_image
from tacbench_cad.lab.runs.npyfile import array_of
from tacbench_cad.util.door import require_within
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.files import replacing

#: The keyword of the PNG text that lists the simulated devices.
SIMULATED_KEYWORD = "simulated"
#: The first bytes of PNG and JPEG files.
PNG, JPEG = b"\x89PNG\r\n\x1a\n", b"\xff\xd8"
#: The number of bytes of a PNG's signature and first chunk, IHDR. Text chunks may follow them.
_HEAD_BYTES = 33
#: The largest allowed number of pixels, in millions. A larger image is refused before it is decoded.
MAX_MEGAPIXELS = 60.0
#: The end mark of a JPEG must be within this number of bytes from the end, because cameras add padding after it.
_JPEG_PADDING = 4096


@dataclass(frozen=True, kw_only=True)
class FrameFile:
    """The file of a frame.

    Args:
        data: The bytes.
        suffix: The suffix of the file name: ``.png``, ``.jpg`` or ``.npy``.
        sha256: The SHA-256 of the bytes.
    """

    data: bytes
    suffix: str
    sha256: str

    @classmethod
    def of(cls, data: bytes, suffix: str) -> FrameFile:
        """Make a file from its bytes."""
        return cls(data=data, suffix=suffix, sha256=sha256(data))

    def write(self, path: Path, *, durable: bool) -> None:
        """Write the file, and with ``durable`` force it to the disk."""
        with path.open("wb") as stream:
            stream.write(self.data)
            if durable:
                stream.flush()
                os.fsync(stream.fileno())


def encoded(frame: Frame, simulated: Sequence[str]) -> tuple[bytes, str]:
    """Encode a frame as the bytes of a file.

    PNG files are written with OpenCV's default settings (run-length encoding after the Sub filter). For images with
    camera noise this is faster than any level of full compression, and the files are smaller.

    Args:
        frame: The frame.
        simulated: The simulated devices, which are stored in the metadata of an image.

    Returns:
        The bytes, and ``.png`` or ``.npy`` as the suffix of the file name.
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
    """Write an image as a PNG file, completely or not at all.

    Raises:
        InputError: The file cannot be written.
    """
    with replacing(path) as temporary:
        temporary.write_bytes(encoded(image, ())[0])


def decoded(data: bytes, name: str) -> Frame:
    """Decode a frame. An image becomes a uint8 array of shape (height, width) or (height, width, 3), in BGR.

    Args:
        data: The bytes of the file.
        name: The name of the file. Its suffix decides the format.

    Raises:
        CheckFailedError: The bytes are not a complete PNG or JPEG image of at most :data:`MAX_MEGAPIXELS`, and not a
            complete NumPy file.
    """
    if name.endswith(".png"):
        return decoded_image(data, _png_size(data), "PNG")
    return decoded_image(data, _jpeg_size(data), "JPEG") if name.endswith(".jpg") else array_of(data)


def decoded_image(data: bytes, size: tuple[int, int] | None, kind: str) -> Frame:
    """Decode an image, and check its size.

    Args:
        data: The bytes of the file.
        size: The width and height in the header; None if the file is incomplete.
        kind: The name of the format, for error messages.

    Raises:
        CheckFailedError: The image is too large, incomplete or damaged.
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
        raise CheckFailedError(f"is not a readable {kind} image; the file is incomplete or damaged")
    return np.asarray(image)


def simulated_text(data: bytes) -> str:
    """Return the list of simulated devices in a PNG file of this program; empty if there is none."""
    head = data[_HEAD_BYTES : _HEAD_BYTES + 8]
    if head[4:] != b"tEXt":
        return ""
    word, _, text = data[_HEAD_BYTES + 8 : _HEAD_BYTES + 8 + int.from_bytes(head[:4])].partition(b"\0")
    return text.decode("latin-1") if word == SIMULATED_KEYWORD.encode() else ""


def _png_size(data: bytes) -> tuple[int, int] | None:
    """Return the width and height of a PNG whose chunks are complete from the header to the end; else None.

    OpenCV would decode a part of a truncated file. With a wrong length in a damaged chunk, it would allocate gigabytes
    and take seconds.
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
    """Return the width and height of a JPEG that has an end mark; else None."""
    at = 2 if b"\xff\xd9" in data[-_JPEG_PADDING:] else len(data)
    while at + 9 <= len(data) and data[at] == 0xFF:
        mark, length = data[at + 1], int.from_bytes(data[at + 2 : at + 4])
        if 0xC0 <= mark <= 0xCF and mark not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack(">HH", data[at + 5 : at + 9])
            return width, height
        at += 2 + length if mark != 0xFF else 1
    return None


def sha256(data: bytes) -> str:
    """Return the SHA-256 as 64 hexadecimal digits."""
    return hashlib.sha256(data).hexdigest()
