"""The feature ``pixels``: grey values or colours, with a lower resolution or in a region of interest if wanted.

Frames that are not images are only converted to float64.
"""

from __future__ import annotations

from typing import Any, ClassVar, Self

import numpy as np
import pandas as pd

from tacbench_cad.lab.analysis.feature import Feature, small_map
from tacbench_cad.lab.analysis.regions import region_in
from tacbench_cad.lab.rig.sensor import Frame, is_image
from tacbench_cad.lab.runs.press_table import resized
from tacbench_cad.lab.runs.region import Region, require_size
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Bytes, Floats

#: The weights of the channels of a stored image in the authors' notebooks: those of BT.601 for red, green and blue. The
#: frames are stored as blue, green, red, so the weights of red and blue are exchanged.
NOTEBOOK_GREY = (0.2989, 0.5870, 0.1140)


class Pixels(Feature):
    """The pixels of a frame.

    Args:
        size: The width and height to which images are reduced by averaging areas; None to use ``resolution``.
        resolution: The fraction of the image's width and height that remains; 1 keeps every pixel.
        colour: Whether an image keeps its colours. Otherwise it is converted to grey and rounded to whole counts.
        roi: The region whose pixels are used: a region, or a value of ``--roi``. None uses the region that is stored
            with the runs, if there is one.
        notebook: Convert an image to grey as the authors' notebooks do (:data:`NOTEBOOK_GREY`), without rounding.
        edges: Replace each pixel by the magnitude of its Sobel derivatives, rounded and limited to 255.
    """

    name: ClassVar[str] = "pixels"

    def __init__(
        self,
        size: tuple[int, int] | None = None,
        resolution: float = 1.0,
        colour: bool = False,
        roi: Region | str | None = None,
        notebook: bool = False,
        edges: bool = False,
    ) -> None:
        self.size = size
        self.resolution = resolution
        self.colour = colour
        self.roi = roi
        self.notebook = notebook
        self.edges = edges

    def fit(self, presses: pd.DataFrame, y: object = None) -> Self:
        """Find the region of interest, and learn the shape of a frame.

        Raises:
            InputError: A setting is not allowed, or the region cannot be found in these frames.
            CheckFailedError: No frame can be read.
        """
        if not isinstance(self.resolution, int | float) or not 0.001 <= self.resolution <= 1.0:
            raise InputError("resolution", self.resolution, "must be from 0.001 to 1")
        self.region_ = region_in(presses, self.roi)
        return super().fit(presses, y)

    def numbers(self, frame: Frame) -> Bytes | Floats:
        """Transform one frame.

        Args:
            frame: An image, uint8 (height, width) or (height, width, 3) in BGR, or any array of real numbers.

        Returns:
            For an image, uint8 with shape (height', width') or (height', width', 3), or (pixels,) or (pixels, 3) with a
            region; float64 if the image is not rounded. For other frames, the same numbers as float64.

        Raises:
            InputError: The region belongs to images of another size.
        """
        if not is_image(frame):
            return np.asarray(frame, dtype=np.float64)
        import cv2

        image: Any = frame
        if self.notebook:
            image = image.astype(np.float64)
            image = image @ NOTEBOOK_GREY if image.ndim == 3 else image
        elif image.ndim == 3 and not self.colour:
            image = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        size = self._size(*image.shape[:2])
        if size != image.shape[1::-1]:
            image = resized(image, size)
        if self.edges:
            slopes = (cv2.Sobel(image, cv2.CV_64F, *axis, ksize=3) for axis in ((1, 0), (0, 1)))
            image = cv2.convertScaleAbs(np.hypot(*slopes))
        if self.region_ is not None:
            require_size(self.region_.mask, frame)
            image = image[self.region_.scaled(*image.shape[:2])]
        return np.asarray(image)

    def picture(self, values: Floats) -> Floats:
        """Arrange one value for each pixel as a small picture, with NaN at pixels outside the region."""
        if self.region_ is not None and len(self.shape_) < 3:
            width, height = self._size(*self.region_.mask.shape)
            whole = np.full((height, width, *self.shape_[1:]), np.nan)
            whole[self.region_.scaled(height, width)] = values.reshape(self.shape_)
            return small_map(whole.ravel(), whole.shape)
        return super().picture(values)

    def _size(self, height: int, width: int) -> tuple[int, int]:
        """Return the width and height of a transformed image."""
        if self.size is not None:
            return self.size
        whole = int if self.notebook else round
        return max(1, whole(width * self.resolution)), max(1, whole(height * self.resolution))


def as_published(resolution: float = 0.4, *, edges: bool = False) -> Pixels:
    """Return the pixels of which the authors' notebooks compute the variance; for the classification, with edges."""
    return Pixels(resolution=resolution, notebook=True, edges=edges, roi="none")
