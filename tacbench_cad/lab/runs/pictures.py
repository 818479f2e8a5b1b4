"""Frames as bytes: images as PNG (with a word that they are simulated), everything else as NumPy files."""

from __future__ import annotations

import contextlib
import hashlib
import io
import struct
import zlib
from collections.abc import Sequence

import numpy as np

from tacbench_cad.lab.rig.sensor import Frame, is_image
from tacbench_cad.lab.runs.npyfile import array_of
from tacbench_cad.util.door import require_within
from tacbench_cad.util.errors import CheckFailedError, InputError

#: Keyword of the PNG text that says what was simulated.
SIMULATED_KEYWORD = "simulated"
#: A PNG's signature and its first chunk, IHDR, take so many bytes; text chunks may follow.
_HEAD_BYTES = 33
#: An image with more pixels is refused before it is decoded, in millions.
MAX_MEGAPIXELS = 60.0


def encoded(frame: Frame, simulated: Sequence[str]) -> tuple[bytes, bool]:
    """A frame as the bytes of its file.

    OpenCV's own settings are used: run lengths after the Sub filter. On images with camera noise they are both
    quicker and smaller than any level of full compression.

    Args:
        frame: The frame.
        simulated: What of the rig was simulated; it goes into an image's metadata.

    Returns:
        The bytes, and whether they are a PNG.
    """
    if not is_image(frame):
        stream = io.BytesIO()
        np.save(stream, np.asarray(frame), allow_pickle=False)
        return stream.getvalue(), False
    import cv2

    data = cv2.imencode(".png", frame)[1].tobytes()
    if simulated:
        text = SIMULATED_KEYWORD.encode() + b"\0" + "; ".join(simulated).encode("latin-1", "replace")
        kind = b"tEXt" + text
        chunk = struct.pack(">I", len(text)) + kind + struct.pack(">I", zlib.crc32(kind))
        data = data[:_HEAD_BYTES] + chunk + data[_HEAD_BYTES:]
    return data, True


def decoded(data: bytes, name: str) -> Frame:
    """The frame in the bytes of its file; an image is uint8, (height, width) or (height, width, 3), BGR.

    Args:
        data: The bytes.
        name: The file's name, whose ending says what it is.

    Raises:
        CheckFailedError: They are no whole PNG of at most :data:`MAX_MEGAPIXELS`, or no whole NumPy file.
    """
    if not name.endswith(".png"):
        return array_of(data)
    import cv2

    image = None
    if _is_whole_png(data):
        width, height = struct.unpack(">II", data[16:24])
        try:
            require_within("image", width * height / 1e6, MAX_MEGAPIXELS, "megapixels", name)
        except InputError as error:
            raise CheckFailedError(error.allowed) from None
        with contextlib.suppress(cv2.error):
            image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise CheckFailedError("is not a readable PNG image")
    return np.asarray(image)


def simulated_text(data: bytes) -> str:
    """What a PNG of ours says that was simulated; empty where it says nothing."""
    head = data[_HEAD_BYTES : _HEAD_BYTES + 8]
    if head[4:] != b"tEXt":
        return ""
    word, _, text = data[_HEAD_BYTES + 8 : _HEAD_BYTES + 8 + int.from_bytes(head[:4])].partition(b"\0")
    return text.decode("latin-1") if word == SIMULATED_KEYWORD.encode() else ""


def _is_whole_png(data: bytes) -> bool:
    """Whether the chunks of a PNG are whole, from its header to its end.

    OpenCV decodes what it finds of a truncated file, and allocates what a damaged chunk says of its length: seconds and
    gigabytes.
    """
    at, kinds = 8, []
    while data.startswith(b"\x89PNG\r\n\x1a\n") and at + 12 <= len(data):
        length, kind = struct.unpack(">I4s", data[at : at + 8])
        at, begin = at + 12 + length, at + 4
        if at > len(data) or struct.pack(">I", zlib.crc32(data[begin : at - 4])) != data[at - 4 : at]:
            return False
        kinds.append(kind)
    return at == len(data) and kinds[:1] == [b"IHDR"] and kinds[-1:] == [b"IEND"] and len(data) > _HEAD_BYTES


def sha256(data: bytes) -> str:
    """SHA-256 as 64 hexadecimal digits."""
    return hashlib.sha256(data).hexdigest()
