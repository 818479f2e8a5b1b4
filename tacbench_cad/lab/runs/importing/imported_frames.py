"""Conversion of loaded frames to files of a run folder. PNG and JPEG files are kept byte for byte if possible."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tacbench_cad.lab.rig.colours import INSIDE, Channels, from_outside
from tacbench_cad.lab.rig.sensor import is_image
from tacbench_cad.lab.runs.frame_files import JPEG, PNG, FrameFile, decoded, decoded_image, encoded, simulated_text
from tacbench_cad.lab.runs.importing.sources import Loaded
from tacbench_cad.util.errors import CheckFailedError

_BMP, _TIFF = b"BM", (b"II*\0", b"MM\0*")


class Prepared(NamedTuple):
    """A frame as it will be stored: its file, its shape, and its simulated devices."""

    file: FrameFile
    shape: tuple[int, ...]
    simulated: str


def prepared(loaded: Loaded, channels: Channels) -> Prepared:
    """Return the file of a frame.

    PNG and JPEG files with grey or colour pixels of 8 bits are kept unchanged. Other frames are converted without loss.

    Args:
        loaded: The loaded frame.
        channels: The order of the colours of an array. The order in the file of an image is known.

    Raises:
        CheckFailedError: The image is incomplete or too large, or the array does not contain real numbers.
    """
    if not isinstance(loaded, bytes):
        frame, simulated = from_outside(_without_last_axis(loaded), channels), ""
    else:
        suffix = next((suffix for start, suffix in ((PNG, ".png"), (JPEG, ".jpg")) if loaded.startswith(start)), "")
        frame = decoded(loaded, suffix) if suffix else _other_image(loaded)
        simulated = simulated_text(loaded) if suffix == ".png" else ""
        if suffix and is_image(frame):
            return Prepared(FrameFile.of(loaded, suffix), frame.shape, simulated)
        if frame.ndim == 3 and frame.shape[2] == 4:
            if not (frame[..., 3] == np.iinfo(frame.dtype).max).all():
                raise CheckFailedError("has transparent pixels, whose colour is unknown")
            frame = np.ascontiguousarray(frame[..., :3])
        frame = from_outside(frame, INSIDE)
    if frame.dtype.kind not in "iufb" or not frame.size:
        raise CheckFailedError(f"contains {frame.dtype} of shape {frame.shape}; it must contain real numbers")
    file = FrameFile.of(*encoded(np.ascontiguousarray(frame), (simulated,) if simulated else ()))
    return Prepared(file, frame.shape, simulated)


def _without_last_axis(array: NDArray[Any]) -> NDArray[Any]:
    """Return a grey image of shape (height, width, 1), as many networks take it, without its last axis."""
    is_grey = array.ndim == 3 and array.shape[2] == 1 and is_image(array[..., 0])
    return array[..., 0] if is_grey else array


def _other_image(data: bytes) -> NDArray[Any]:
    """Decode a BMP or TIFF image. An incomplete or too large image is refused before it is decoded."""
    if data.startswith(_BMP):
        return decoded_image(data, "BMP")
    if data[:4] in _TIFF:
        return decoded_image(data, "TIFF")
    raise CheckFailedError("is not a readable image (PNG, JPEG, BMP or TIFF)")
