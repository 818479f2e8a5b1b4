"""What is done to a reading before any statistics: grey, resolution, the part that shows the sensor, or its markers.

Other sensors' arrays pass as they are.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal

import numpy as np

from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.variance.moments import small_map
from tacbench_cad.lab.rig.sensor import Frame, is_image
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.lab.vision.displacements import MarkerFeatures
from tacbench_cad.lab.vision.markers import MarkerSettings
from tacbench_cad.lab.vision.region import Region, require_size
from tacbench_cad.lab.vision.resting import region_of
from tacbench_cad.util.convert import Bounds, check_fields
from tacbench_cad.util.errors import CheckFailedError
from tacbench_cad.util.types import Bytes, Floats

#: Weights of the channels of a stored image in the authors' notebooks: BT.601's for red, green and blue. The frames are
#: stored as blue, green, red, so that red and blue have each other's weight.
NOTEBOOK_GREY = (0.2989, 0.5870, 0.1140)


@dataclass(frozen=True, kw_only=True)
class Preprocess:
    """Steps from a recorded reading to the numbers that are analysed.

    Args:
        colour: Keep the colours of an image; else it is made grey and rounded to whole counts, as the usual tools do.
        resolution: Fraction of the image's width and height that is kept, by averaging areas; 1 keeps every pixel.
        region: Only its pixels are kept; None keeps all.
        markers: How far these moved is kept instead of the pixels.
        notebook: Make an image grey as the authors' notebooks do (:data:`NOTEBOOK_GREY`) and do not round it.
        edges: Replace each pixel by the magnitude of its Sobel derivatives, rounded and cut at 255.
    """

    colour: bool = False
    resolution: Annotated[float, Bounds(0.001, 1.0)] = 1.0
    region: Region | None = field(default=None, metadata={"key": None})
    markers: MarkerFeatures | None = field(default=None, metadata={"key": None})
    notebook: bool = False
    edges: bool = False

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def features(self) -> Literal["pixels", "markers"]:
        """What is taken of a reading."""
        return "pixels" if self.markers is None else "markers"

    def __call__(self, reading: Frame) -> Bytes | Floats:
        """The numbers of one reading.

        Args:
            reading: An image, uint8 (height, width) or (height, width, 3) in BGR, or any array of real numbers.

        Returns:
            uint8 (height', width') or (height', width', 3) for an image, (pixels,) or (pixels, 3) of a region; float64
            for an image that is not rounded; the same numbers as float64 for the rest.

        Raises:
            InputError: The region is for images of another size.
        """
        if not is_image(reading):
            return np.asarray(reading, dtype=np.float64)
        import cv2

        image = reading
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
            require_size(self.region.mask, reading)
            image = image[self.region.scaled(*image.shape[:2])]
        return np.asarray(image)

    def of(self, run: Run, path: str) -> Bytes | Floats:
        """The numbers of a frame of a run: as of calling, or (markers, 2) displacements in pixels.

        Raises:
            CheckFailedError: Its file is missing or damaged, or its markers are not found.
            InputError: The region is for images of another size.
        """
        return self(run.read(path)) if self.markers is None else self.markers.displacement_px(run, path)

    def picture(self, values: Floats, shape: tuple[int, ...]) -> Floats:
        """A value for each number of a reading as a small picture; NaN where there is none.

        Args:
            values: The values, in the order of the numbers.
            shape: The shape of a reading.
        """
        if self.markers is not None:
            return self.markers.picture(values.reshape(shape).mean(axis=1))
        if self.region is not None and len(shape) < 3:
            height, width = (max(1, round(side * self.resolution)) for side in self.region.mask.shape)
            whole = np.full((height, width, *shape[1:]), np.nan)
            whole[self.region.scaled(height, width)] = values.reshape(shape)
            return small_map(whole.ravel(), whole.shape)
        return small_map(values, shape)


#: What the notebooks do to an image before its variance is taken. With ``edges``, before it is classified.
AS_PUBLISHED = Preprocess(resolution=0.4, notebook=True)


def preprocess_of(
    collection: Collection,
    features: Literal["pixels", "markers"] = "pixels",
    roi: Region | str | None = None,
    *,
    colour: bool = False,
    resolution: float = 1.0,
    markers: MarkerSettings | None = None,
) -> Preprocess:
    """What is analysed of a study's readings.

    Args:
        collection: The study.
        features: The numbers of a reading, or how far the markers in its image moved.
        roi: The region of interest, or what :func:`~tacbench_cad.lab.vision.resting.region_of` makes one of.
        colour: Keep the colours.
        resolution: Fraction of an image's width and height that is kept.
        markers: What is known of the markers.

    Raises:
        InputError: The region is not allowed or there is none, or no markers can be found.
        CheckFailedError: Fewer than half of the markers can be found in a run's frames without contact.
    """
    region = roi if isinstance(roi, Region) else region_of(collection.runs, roi)
    known = MarkerFeatures.learn(collection.runs, markers, region) if features == "markers" else None
    return Preprocess(colour=colour, resolution=resolution, region=region, markers=known)


def read_usable(run: Run, path: str, preprocess: Preprocess) -> Frame:
    """A reading, preprocessed.

    Raises:
        CheckFailedError: Its file is missing or damaged, or holds NaN or infinity; the message names it.
    """
    values = preprocess.of(run, path)
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        raise CheckFailedError(f"{run.folder / path}: holds NaN or infinity")
    return values
