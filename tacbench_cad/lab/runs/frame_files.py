"""Frames as files: images as PNG (simulated ones are marked), and all other arrays as NumPy files.

Imported JPEG files are read, but no JPEG files are written. Grey values and the noise of an image are here, too.
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
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacbench_cad.lab.rig.colours import INSIDE, from_outside
from tacbench_cad.lab.rig.sensor import Frame, is_image
from tacbench_cad.util import untrusted
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.files import refusing, replacing
from tacbench_cad.util.npyfile import NUMPY_FILES, array_of
from tacbench_cad.util.types import Bytes, Floats32

#: The keyword of the PNG text that lists the simulated devices.
SIMULATED_KEYWORD = "simulated"
#: The formats of images by the first bytes of their files.
_FORMATS = {b"\x89PNG\r\n\x1a\n": "PNG", b"\xff\xd8": "JPEG", b"BM": "BMP", b"II*\0": "TIFF", b"MM\0*": "TIFF"}
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
    """Write an image as a PNG file, completely or not at all. Its folder is made if it does not exist.

    Raises:
        InputError: The file cannot be written.
    """
    with refusing(path.parent):
        path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as temporary:
        temporary.write_bytes(encoded(image, ())[0])


def read_bytes(path: Path, within: Path | None, digest: str | None = None) -> bytes:
    """Read the bytes of a frame's file.

    Args:
        path: The file.
        within: The folder in which the file must lie, also if it is a link; None if there is none.
        digest: The expected SHA-256 of the file; None to skip the check.

    Raises:
        CheckFailedError: The file cannot be read, is too large, is a link out of the folder, or was changed.
    """
    try:
        data = untrusted.read_bytes(path, "frame", "image", within=within)
    except InputError as error:
        raise CheckFailedError(f"{path}: {error.allowed}") from None
    if digest is not None and sha256(data) != digest:
        raise CheckFailedError(f"{path}: was changed: its checksum differs from the recorded one")
    return data


def read_decoded(path: Path, within: Path | None, digest: str | None = None) -> Frame:
    """Read and decode the file of a frame.

    Args:
        path: See :func:`read_bytes`.
        within: See :func:`read_bytes`.
        digest: See :func:`read_bytes`.

    Raises:
        CheckFailedError: Same as for :func:`read_bytes`, or the file is damaged. The message names it.
    """
    data = read_bytes(path, within, digest)
    try:
        return decoded(data)
    except CheckFailedError as error:
        raise CheckFailedError(f"{path}: {error}") from None


def type_fault(frame: Frame) -> str | None:
    """Describe a fault of a frame's type; None if there is none."""
    return None if frame.dtype.kind in "iufb" else f"contains {frame.dtype}; it must contain real numbers"


def image_format(data: bytes) -> str | None:
    """Return the format of an image by the first bytes of its file: PNG, JPEG, BMP or TIFF; None for other files."""
    return next((kind for start, kind in _FORMATS.items() if data.startswith(start)), None)


def decoded(data: bytes) -> Frame:
    """Decode the file of a frame. Its first bytes decide whether it is an image.

    Raises:
        CheckFailedError: The bytes are not a complete image, its size or pixels are not allowed, and they are not a
            complete NumPy file.
    """
    return array_of(data) if data.startswith(NUMPY_FILES) else as_frame(decoded_image(data))


def as_frame(image: Frame) -> Frame:
    """Return the frame of a decoded image: without its alpha channel, and an image of 8 bits in BGR.

    Raises:
        CheckFailedError: The image has transparent pixels.
    """
    if image.ndim == 3 and image.shape[2] == 4:
        if not (image[..., 3] == np.iinfo(image.dtype).max).all():
            raise CheckFailedError("has transparent pixels, whose colour is unknown")
        image = np.ascontiguousarray(image[..., :3])
    return from_outside(image, INSIDE)


def decoded_image(data: bytes) -> NDArray[Any]:
    """Decode an image with all of its channels, and check its size.

    Raises:
        CheckFailedError: It is not an image of a known format, or is too large, incomplete or damaged.
    """
    import cv2

    kind, image = image_format(data), None
    if kind is None:
        raise CheckFailedError("is not a readable image (PNG, JPEG, BMP or TIFF) and not a NumPy file")
    if (size := _size(data, kind)) is not None:
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


def _size(data: bytes, kind: str) -> tuple[int, int] | None:
    """Return the width and height of a complete image; None if it is incomplete or damaged.

    Pillow reads the header and compares the checksums of all chunks of a PNG. OpenCV would decode a part of a truncated
    file. With a wrong length in a damaged chunk, it would allocate gigabytes and take seconds.

    Raises:
        CheckFailedError: The image is too large.
    """
    from PIL import BmpImagePlugin, JpegImagePlugin, PngImagePlugin, TiffImagePlugin

    # Image.open would warn about large images, and warnings cannot be silenced in one of several threads.
    readers = {
        "PNG": PngImagePlugin.PngImageFile,
        "JPEG": JpegImagePlugin.JpegImageFile,
        "BMP": BmpImagePlugin.BmpImageFile,
        "TIFF": TiffImagePlugin.TiffImageFile,
    }
    if kind == "JPEG" and b"\xff\xd9" not in data[-_JPEG_PADDING:]:
        return None
    try:
        with readers[kind](io.BytesIO(data)) as image:
            width, height = image.size
            untrusted.require_within("image", width * height / 1e6, MAX_MEGAPIXELS, "megapixels", "image")
            if kind in ("PNG", "JPEG"):
                image.verify()
            else:
                image.load()
    except InputError as error:
        raise CheckFailedError(error.allowed) from None
    except Exception:  # Pillow raises errors of many kinds for damaged files
        return None
    return width, height


def sha256(data: bytes) -> str:
    """Return the SHA-256 as 64 hexadecimal digits."""
    return hashlib.sha256(data).hexdigest()


def grey(frame: Frame) -> Floats32:
    """Convert a frame to grey.

    Raises:
        InputError: The frame is not an image.
    """
    import cv2

    if not is_image(frame):
        raise InputError("frame", f"{frame.dtype} {frame.shape}", "must be an image")
    image: Bytes = frame if frame.ndim == 2 else np.asarray(cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY))
    return image.astype(np.float32)


def noise_counts(image: Floats32) -> float:
    """Estimate the noise of a frame, in counts, by the median deviation of pixels from their neighbours (Immerkaer)."""
    import cv2

    mask = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], dtype=np.float32)
    return float(np.median(np.abs(cv2.filter2D(image, cv2.CV_32F, mask)))) / 6.0 * 1.4826
