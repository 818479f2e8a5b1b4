"""What is done to a reading before any statistics: grey, resolution. Other sensors' arrays pass as they are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from tacbench_cad.lab.rig.sensor import Frame, is_image
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.util.convert import Bounds, check_fields
from tacbench_cad.util.errors import CheckFailedError
from tacbench_cad.util.types import Bytes, Floats


@dataclass(frozen=True, kw_only=True)
class Preprocess:
    """Steps from a recorded reading to the numbers that are analysed.

    Args:
        colour: Keep the colours of an image; else it is made grey and rounded to whole counts, as the usual tools do.
        resolution: Fraction of the image's width and height that is kept, by averaging areas; 1 keeps every pixel.
    """

    colour: bool = False
    resolution: Annotated[float, Bounds(0.001, 1.0)] = 1.0

    def __post_init__(self) -> None:
        check_fields(self)

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


def read_usable(run: Run, path: str, preprocess: Preprocess) -> Frame:
    """A reading, preprocessed.

    Raises:
        CheckFailedError: Its file is missing or damaged, or holds NaN or infinity; the message names it.
    """
    values = preprocess(run.read(path))
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        raise CheckFailedError(f"{run.folder / path}: holds NaN or infinity")
    return values
