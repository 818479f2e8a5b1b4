"""The steps before the statistics: grey values, lower resolution, a region of interest, or marker displacements.

Frames that are not images are only converted to float64. Each frame of a series is preprocessed by itself.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from tacbench_cad.extensions.markers.displacements import MarkerFeatures
from tacbench_cad.extensions.markers.markers import MarkerSettings
from tacbench_cad.lab.analysis.collection import Collection, FeatureName
from tacbench_cad.lab.analysis.variance.moments import small_map
from tacbench_cad.lab.rig.sensor import Frame, is_image
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.lab.runs.region import Region, require_size
from tacbench_cad.lab.runs.region_search import region_of
from tacbench_cad.lab.runs.series import series_rows
from tacbench_cad.util.convert import Bounds, check_fields
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.types import Bytes, Floats

#: The weights of the channels of a stored image in the authors' notebooks: those of BT.601 for red, green and blue. The
#: frames are stored as blue, green, red, so the weights of red and blue are exchanged.
NOTEBOOK_GREY = (0.2989, 0.5870, 0.1140)


@dataclass(frozen=True, kw_only=True)
class Preprocess:
    """The steps from a recorded frame to the numbers that are analysed.

    Args:
        colour: Whether an image keeps its colours. Otherwise it is converted to grey and rounded to whole counts.
        resolution: The fraction of the image's width and height that remains after averaging areas; 1 keeps every
            pixel.
        region: The region whose pixels are analysed; None for all pixels.
        markers: The markers whose displacements are analysed instead of the pixels.
        notebook: Convert an image to grey as the authors' notebooks do (:data:`NOTEBOOK_GREY`), without rounding.
        edges: Replace each pixel by the magnitude of its Sobel derivatives, rounded and limited to 255.
        forces: Whether the forces in the table of a series are analysed instead of frames.
    """

    colour: bool = False
    resolution: Annotated[float, Bounds(0.001, 1.0)] = 1.0
    region: Region | None = field(default=None, metadata={"key": None})
    markers: MarkerFeatures | None = field(default=None, metadata={"key": None})
    notebook: bool = False
    edges: bool = False
    forces: bool = False

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def features(self) -> FeatureName:
        """The analysed features."""
        if self.forces:
            return "forces"
        return "pixels" if self.markers is None else "markers"

    def __call__(self, frame: Frame) -> Bytes | Floats:
        """Preprocess one frame.

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

    def of(self, run: Run, path: str) -> Bytes | Floats:
        """Read and preprocess a frame of a run; with markers, return their displacements in pixels, (markers, 2).

        If forces are analysed, the path is that of a series' table, and the result are its forces in N, (frames,).

        Raises:
            CheckFailedError: The file is missing or damaged, its markers are not found, or a force is unknown.
            InputError: The region belongs to images of another size.
        """
        if self.forces:
            return _forces_n(run, path)
        return self(run.read(path)) if self.markers is None else self.markers.displacement_px(run, path)

    def picture(self, values: Floats, shape: tuple[int, ...]) -> Floats:
        """Arrange one value for each number of a preprocessed frame as a small picture, with NaN at pixels without one.

        Args:
            values: The values, in the order of the frame's numbers.
            shape: The shape of a preprocessed frame.
        """
        if self.markers is not None:
            return self.markers.picture(values.reshape(shape).mean(axis=1))
        if self.region is not None and len(shape) < 3:
            height, width = (max(1, round(side * self.resolution)) for side in self.region.mask.shape)
            whole = np.full((height, width, *shape[1:]), np.nan)
            whole[self.region.scaled(height, width)] = values.reshape(shape)
            return small_map(whole.ravel(), whole.shape)
        return small_map(values, shape)


#: The preprocessing in the authors' notebooks before the variance. Before the classification, ``edges`` is added.
AS_PUBLISHED = Preprocess(resolution=0.4, notebook=True)


def _forces_n(run: Run, path: str) -> Floats:
    """Return the forces in the table of a series.

    Raises:
        CheckFailedError: The table is missing, damaged or incomplete, or a force is unknown.
    """
    try:
        number = int(path.split("/")[-2].rpartition("_")[2])
        rows = series_rows(run.folder, number, run.info.series_frames)
    except InputError as error:
        raise CheckFailedError(str(error)) from None
    unknown = next((row.frame for row in rows if row.force_n is None), None)
    if unknown is not None:
        raise CheckFailedError(f"{run.folder / path}: has no force of {unknown}")
    return np.array([row.force_n for row in rows], dtype=np.float64)


def preprocess_of(
    collection: Collection,
    features: FeatureName = "pixels",
    roi: Region | str | None = None,
    *,
    colour: bool = False,
    resolution: float = 1.0,
    markers: MarkerSettings | None = None,
) -> Preprocess:
    """Return the preprocessing of a study's frames.

    Args:
        collection: The study.
        features: The analysed features, see :class:`~tacbench_cad.lab.analysis.collection.Collection`.
        roi: The region of interest, or its text, as for ``--roi``.
        colour: Whether images keep their colours.
        resolution: The fraction of an image's width and height that remains.
        markers: The known settings of the markers.

    Raises:
        InputError: The region is not allowed or not found, no markers can be found, or there was no gauge for forces.
        CheckFailedError: Fewer than half of the markers can be found in a run's frames without contact.
    """
    if features == "forces":
        if any(row.force_n is None for row in collection.moving(0)):
            raise InputError("features", features, f"need a force gauge, but {collection.runs[0].folder} has no forces")
        return Preprocess(forces=True)
    region = roi if isinstance(roi, Region) else region_of(collection.runs, roi)
    known = MarkerFeatures.learn(collection.runs, markers, region) if features == "markers" else None
    return Preprocess(colour=colour, resolution=resolution, region=region, markers=known)


def read_usable(run: Run, path: str, preprocess: Preprocess) -> Frame:
    """Read and preprocess a frame, and check that its numbers are finite.

    Raises:
        CheckFailedError: The file is missing or damaged, or contains NaN or infinity; the message names it.
    """
    values = preprocess.of(run, path)
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        raise CheckFailedError(f"{run.folder / path}: contains NaN or infinity")
    return values
