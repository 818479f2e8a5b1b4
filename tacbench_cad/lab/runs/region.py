"""The region of interest: the part of a frame that shows the sensor. The user gives it, or the program finds it."""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from annotated_types import Interval

from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.runs.frame_files import MAX_MEGAPIXELS, decoded_image, write_png
from tacbench_cad.util import untrusted
from tacbench_cad.util.convert import read_json
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.files import refusing, write_json
from tacbench_cad.util.types import Bools

#: The allowed values of ``--roi``.
SYNTAX = "auto, circle:X,Y,R, rect:X0,Y0,X1,Y1 (pixels from the top left) or a PNG file, white where the sensor is"
#: The file of a run's region, and the picture of a region that was given as a picture.
REGION_FILE, MASK_FILE = "roi.json", "roi.png"
#: The certainty from which a region that was found may be used without asking.
SURE = 0.8
#: The smallest allowed number of pixels of a region.
MIN_PIXELS = 100
_NUMBER = r"(-?\d+(?:\.\d+)?)"
_CIRCLE = re.compile(rf"circle[: ]{_NUMBER},{_NUMBER},{_NUMBER}")
_RECTANGLE = re.compile(rf"rect[: ]{_NUMBER},{_NUMBER},{_NUMBER},{_NUMBER}")


@dataclass(frozen=True, kw_only=True, eq=False)
class Region:
    """A region of interest.

    Args:
        text: The region as a value of ``--roi``: ``circle:304,248,210``.
        mask: True for the pixels in the region, shape (height, width).
        sureness: The certainty that this region shows the sensor, from 0 to 1; 1 for a region that a user gave.
    """

    text: str
    mask: Bools
    sureness: float = 1.0

    @property
    def outside(self) -> float:
        """The fraction of the frame's pixels outside the region."""
        return 1.0 - float(np.mean(self.mask))

    @property
    def digest(self) -> str:
        """A hash of the mask."""
        return hashlib.sha256(f"{self.mask.shape}".encode() + np.packbits(self.mask).tobytes()).hexdigest()[:16]

    def scaled(self, height: int, width: int) -> Bools:
        """Return the mask at another resolution, with the pixels that are at least half in the region."""
        import cv2

        if self.mask.shape == (height, width):
            return self.mask
        small = cv2.resize(self.mask.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA)
        return np.asarray(small >= 0.5)

    def drawn(self, frame: Frame) -> Frame:
        """Draw the region's outline in a frame in red, and darken the pixels outside.

        Raises:
            InputError: The frame has another size.
        """
        import cv2

        require_size(self.mask, frame)
        picture = frame.copy() if frame.ndim == 3 else cv2.cvtColor(frame, cv2.COLOR_GRAY2BGR)
        picture[~self.mask] //= 2
        outline = cv2.findContours(self.mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
        cv2.drawContours(picture, outline, -1, (0, 0, 255), max(1, round(frame.shape[1] / 320)))
        return np.asarray(picture)


def require_size(mask: Bools, frame: Frame) -> None:
    """Check that a frame has the size of a mask.

    Raises:
        InputError: The frame has another size.
    """
    if frame.shape[:2] != mask.shape:
        size = " x ".join(map(str, mask.shape[::-1]))
        raise InputError(
            "region of interest", size, f"is for frames of that size; this one has {frame.shape[1]} x {frame.shape[0]}"
        )


def parse_region(text: str, height: int, width: int) -> Region:
    """Make a region from a text or a file.

    Args:
        text: ``circle:X,Y,R``, ``rect:X0,Y0,X1,Y1`` or the path of a PNG.
        height: The height of the frames.
        width: The width of the frames.

    Raises:
        InputError: The text has another form, the region has too few pixels in the frame, or the picture has another
            size.
    """
    y, x = np.mgrid[:height, :width].astype(np.float64)
    if match := _CIRCLE.fullmatch(text):
        column, row, radius = map(float, match.groups())
        mask = (x - column) ** 2 + (y - row) ** 2 <= radius**2
    elif match := _RECTANGLE.fullmatch(text):
        left, top, right, bottom = map(float, match.groups())
        mask = (x >= left) & (x <= right) & (y >= top) & (y <= bottom)
    elif text.lower().endswith(".png"):
        mask = _mask_of(Path(text), height, width)
    else:
        raise InputError("roi", text, f"must be {SYNTAX}")
    if mask.sum() < MIN_PIXELS:
        raise InputError("roi", text, f"has {int(mask.sum())} pixels in a frame of {width} x {height}; at least 100")
    return Region(text=text.replace(" ", ":", 1) if match else text, mask=mask)


def _mask_of(path: Path, height: int, width: int, within: Path | None = None) -> Bools:
    """Read a picture, and return its pixels that are brighter than half of the largest value."""
    try:
        picture = decoded_image(untrusted.read_bytes(path, "roi", "image", within=within))
    except CheckFailedError as error:
        raise InputError("roi", str(path), str(error)) from None
    if picture.shape[:2] != (height, width):
        size = f"{picture.shape[1]} x {picture.shape[0]}"
        raise InputError("roi", str(path), f"is {size} pixels; the frames are {width} x {height}")
    grey_picture = picture if picture.ndim == 2 else picture[..., :3].max(axis=2)
    return np.asarray(grey_picture > np.iinfo(picture.dtype).max // 2)


def store_region(folder: Path, region: Region) -> None:
    """Store a region with a run, in ``roi.json``, and in ``roi.png`` if it was given as a picture.

    Raises:
        InputError: The folder cannot be written.
    """
    text = region.text
    if text.lower().endswith(".png"):
        text = MASK_FILE
        write_png(folder / MASK_FILE, region.mask.astype(np.uint8) * 255)
    height, width = region.mask.shape
    write_json(folder / REGION_FILE, {"roi": text, "width": width, "height": height, "sureness": region.sureness})


def remove_region(folder: Path) -> None:
    """Remove the region that is stored with a run.

    Raises:
        InputError: The folder cannot be written.
    """
    with refusing(folder):
        for name in (REGION_FILE, MASK_FILE):
            (folder / name).unlink(missing_ok=True)


def stored_region(folder: Path) -> Region | None:
    """Read the region that is stored with a run; None if there is none.

    Raises:
        InputError: ``roi.json`` or its picture is damaged.
    """
    path = folder / REGION_FILE
    if not path.exists():
        return None
    kept = read_json(path, _Kept, "region of interest", within=folder)
    untrusted.require_within("width", kept.width * kept.height / 1e6, MAX_MEGAPIXELS, "megapixels", str(path))
    if kept.roi == MASK_FILE:
        mask = _mask_of(folder / MASK_FILE, kept.height, kept.width, within=folder)
        return Region(text=str(folder / MASK_FILE), mask=mask, sureness=kept.sureness)
    if kept.roi.lower().endswith(".png"):
        raise InputError(f"{path} roi", kept.roi, f"must be a circle, a rect or {MASK_FILE}")
    return replace(parse_region(kept.roi, kept.height, kept.width), sureness=kept.sureness)


@dataclass(frozen=True, kw_only=True)
class _Kept:
    """The contents of ``roi.json``."""

    roi: str
    width: Annotated[int, Interval(ge=1, le=100_000)]
    height: Annotated[int, Interval(ge=1, le=100_000)]
    sureness: Annotated[float, Interval(ge=0.0, le=1.0)] = 1.0
