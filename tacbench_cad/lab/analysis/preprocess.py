"""What is done to a reading before any statistics: grey, resolution. Other sensors' arrays pass as they are."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tacbench_cad.lab.rig.sensor import Frame, is_image
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Bytes, Floats


@dataclass(frozen=True, kw_only=True)
class Preprocess:
    """Steps from a recorded reading to the numbers that are analysed.

    Args:
        colour: Keep the colours of an image; else it is made grey and rounded to whole counts, as the usual tools do.
        resolution: Fraction of the image's width and height that is kept, by averaging areas; 1 keeps every pixel.
    """

    colour: bool = False
    resolution: float = 1.0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.resolution) and 0.001 <= self.resolution <= 1.0):
            raise InputError("resolution", self.resolution, "must be from 0.001 to 1")

    def __call__(self, reading: Frame) -> Bytes | Floats:
        """The numbers of one reading.

        Args:
            reading: An image, uint8 (height, width) or (height, width, 3) in BGR, or any array of real numbers.

        Returns:
            uint8 (height', width') or (height', width', 3) for an image; the same numbers as float64 for the rest.
        """
        if not is_image(reading):
            return np.asarray(reading, dtype=np.float64)
        import cv2

        image = reading
        if image.ndim == 3 and not self.colour:
            image = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        if self.resolution != 1.0:
            height, width = image.shape[:2]
            size = (max(1, round(width * self.resolution)), max(1, round(height * self.resolution)))
            image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        return np.asarray(image, dtype=np.uint8)
