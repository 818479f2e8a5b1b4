"""The feature ``pixels``: grey values or colours, with a lower resolution or in a region of interest if wanted.

Frames that are not images are only converted to float64. Each frame of a series is transformed by itself.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated, ClassVar, Self

import numpy as np
from annotated_types import Interval

from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.feature import Feature
from tacbench_cad.lab.analysis.variance.moments import small_map
from tacbench_cad.lab.rig.sensor import Frame, is_image
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.lab.runs.region import Region, require_size
from tacbench_cad.util.convert import NOT_STORED, Checked
from tacbench_cad.util.types import Bytes, Floats

#: The weights of the channels of a stored image in the authors' notebooks: those of BT.601 for red, green and blue. The
#: frames are stored as blue, green, red, so the weights of red and blue are exchanged.
NOTEBOOK_GREY = (0.2989, 0.5870, 0.1140)


@dataclass(frozen=True, kw_only=True)
class Pixels(Checked, Feature):
    """The pixels of a frame.

    Args:
        colour: Whether an image keeps its colours. Otherwise it is converted to grey and rounded to whole counts.
        resolution: The fraction of the image's width and height that remains after averaging areas; 1 keeps every
            pixel.
        region: The region whose pixels are used; None for all pixels.
        notebook: Convert an image to grey as the authors' notebooks do (:data:`NOTEBOOK_GREY`), without rounding.
        edges: Replace each pixel by the magnitude of its Sobel derivatives, rounded and limited to 255.
    """

    name: ClassVar[str] = "pixels"
    colour: bool = False
    resolution: Annotated[float, Interval(ge=0.001, le=1.0)] = 1.0
    region: Region | None = field(default=None, metadata=NOT_STORED)
    notebook: bool = False
    edges: bool = False

    def fit(self, collection: Collection, region: Region | None = None) -> Self:
        """Return the feature with the region of interest."""
        return replace(self, region=region)

    def __call__(self, frame: Frame) -> Bytes | Floats:
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

        image = frame
        if self.notebook:
            image = image.astype(np.float64)
            image = image @ NOTEBOOK_GREY if image.ndim == 3 else image
        elif image.ndim == 3 and not self.colour:
            image = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        if self.resolution != 1.0:
            whole = int if self.notebook else round
            height, width = (max(1, whole(side * self.resolution)) for side in image.shape[:2])
            image = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
        if self.edges:
            slopes = (cv2.Sobel(image, cv2.CV_64F, *axis, ksize=3) for axis in ((1, 0), (0, 1)))
            image = cv2.convertScaleAbs(np.hypot(*slopes))
        if self.region is not None:
            require_size(self.region.mask, frame)
            image = image[self.region.scaled(*image.shape[:2])]
        return np.asarray(image)

    def transform(self, run: Run, path: str) -> Bytes | Floats:
        """Read and transform a frame of a run.

        Raises:
            CheckFailedError: The file is missing or damaged.
            InputError: The region belongs to images of another size.
        """
        return self(run.read(path))

    def picture(self, values: Floats, shape: tuple[int, ...]) -> Floats:
        """Arrange one value for each pixel as a small picture, with NaN at pixels outside the region."""
        if self.region is not None and len(shape) < 3:
            height, width = (max(1, round(side * self.resolution)) for side in self.region.mask.shape)
            whole = np.full((height, width, *shape[1:]), np.nan)
            whole[self.region.scaled(height, width)] = values.reshape(shape)
            return small_map(whole.ravel(), whole.shape)
        return small_map(values, shape)


#: The pixels of which the authors' notebooks compute the variance. For the classification, ``edges`` is added.
AS_PUBLISHED = Pixels(resolution=0.4, notebook=True)
