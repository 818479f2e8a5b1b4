"""The displacements of a sensor's markers in each press of some runs, which do not depend on the lighting.

The markers are learned from all runs. Marker 17 is therefore the same pin in every run, and displacements of different
runs can be compared. The displacements of a run are measured from its own frames without contact, so they do not change
if the camera is mounted again between two runs.

Imported runs often have no frame without contact. Their displacements are measured from the median position of each
marker over frames of all such runs. A median over the frames of a single run would remove what distinguishes its
texture from the others.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tacbench_cad.extensions.markers.markers import MarkerFinder, MarkerSettings
from tacbench_cad.extensions.markers.tracking import MarkerTracker, Track
from tacbench_cad.lab.rig import Frame, is_image
from tacbench_cad.lab.runs import Region, Run, read_frame
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.types import Floats

#: The number of frames of a run whose median is the reference, and the number of frames that markers are learned from.
REFERENCE_FRAMES, _LEARNED_FRAMES = 3, 5
#: The number of frames of all runs together for the median position of the markers, and the smallest of each run.
_MEDIAN_FRAMES, _MIN_OF_RUN = 30, 3
#: The positions from which displacements are measured, for texts.
AT_REST, MEDIAN = "position without contact", "median position"
#: The smallest fraction of the markers that must be found in a frame. Other frames are not used.
MIN_FOUND = 0.5
#: The smallest fraction of the reference's frames in which a marker must be found to belong to the sensor.
_IN_RUNS = 0.5
#: The size of a pixel of a picture of markers, in pixels of the frame.
_PICTURE_STEP = 4


@dataclass(frozen=True, kw_only=True, eq=False)
class MarkerFeatures:
    """The markers of the sensor of some runs.

    Args:
        finder: The finder of the markers.
        trackers: The trackers from the positions from which displacements are measured, by the path of the run folder.
        shape: The height and width of a frame.
        origin: What these positions are, see :func:`origin_of`.
    """

    finder: MarkerFinder
    trackers: dict[str, MarkerTracker]
    shape: tuple[int, int]
    origin: str = AT_REST

    @classmethod
    def learn(
        cls, runs: Sequence[Run], settings: MarkerSettings | None = None, region: Region | None = None
    ) -> MarkerFeatures:
        """Learn the appearance of the markers, and their positions without contact or their median positions.

        Args:
            runs: Runs of the same sensor.
            settings: The known properties of the markers.
            region: The region in which markers are searched; None for the whole frame.

        Raises:
            InputError: A run has no images, or no markers can be found in them.
        """
        in_contact = [not run.references for run in runs]
        of_each = max(_MIN_OF_RUN, math.ceil(_MEDIAN_FRAMES / max(1, sum(in_contact))))
        counts = [of_each if without else REFERENCE_FRAMES for without in in_contact]
        resting = [run.resting_frames(count) for run, count in zip(runs, counts, strict=True)]
        for run, frames in zip(runs, resting, strict=True):
            if not frames:
                raise InputError("features", "markers", f"need images, but {run.folder} has no readable image")
        some = np.unique(np.linspace(0, sum(map(len, resting)) - 1, _LEARNED_FRAMES).astype(int))
        samples = [frame for at, frame in enumerate(itertools.chain(*resting)) if at in some]
        finder = MarkerFinder.learn(samples, settings, None if region is None else region.mask)
        first = max((finder.find(frame).centres_px for frame in samples), key=len)
        tracker = MarkerTracker(reference_px=first)
        tracks = [[tracker.follow(finder.find(frame).centres_px) for frame in frames] for frames in resting]
        seen = np.mean([track.found for of_run in tracks for track in of_run], axis=0) >= _IN_RUNS
        trackers: dict[str, MarkerTracker] = {}
        pressed = [track for of_run, without in zip(tracks, in_contact, strict=True) if without for track in of_run]
        for run, of_run, without in zip(runs, tracks, in_contact, strict=True):
            what = "its frames" if without else "its frames without contact"
            _require_found(max(of_run, key=lambda track: track.found.sum()), f"{run.folder}: {what}")
            displacement = np.median([track.displacement_px for track in (pressed if without else of_run)], axis=0)
            trackers[str(run.folder)] = MarkerTracker(reference_px=(first + displacement)[seen])
        return cls(finder=finder, trackers=trackers, shape=samples[0].shape[:2], origin=origin_of(runs))

    @property
    def count(self) -> int:
        """The number of markers."""
        return len(self.first.reference_px)

    @property
    def first(self) -> MarkerTracker:
        """The tracker of the first run."""
        return next(iter(self.trackers.values()))

    def track(self, folder: str | Path, frame: Frame) -> Track:
        """Find the markers in a frame of the run in a folder."""
        return self.trackers[str(folder)].follow(self.finder.find(frame).centres_px)

    def displacement_px(self, folder: str | Path, path: str | Path) -> Floats:
        """Return the displacements of the markers in the file of a frame, as column and row, shape (n, 2).

        Args:
            folder: The folder of the run.
            path: The path of the file.

        Raises:
            CheckFailedError: The frame cannot be read, or fewer than half of the markers are found in it.
        """
        frame = read_frame(path, folder)
        if not is_image(frame):
            raise CheckFailedError(f"{path}: is not an image, so it has no markers")
        track = self.track(folder, frame)
        _require_found(track, str(path))
        return track.displacement_px

    def picture(self, values: Floats) -> Floats:
        """Draw a value of each marker as a picture with a quarter of the frame's width and height.

        Args:
            values: A value for each marker, shape (n,).

        Returns:
            The picture; NaN where no marker is near.
        """
        from scipy.spatial import cKDTree

        tracker = self.first
        y, x = np.mgrid[: self.shape[0] : _PICTURE_STEP, : self.shape[1] : _PICTURE_STEP]
        places = np.column_stack([x.ravel(), y.ravel()])
        distance, nearest = cKDTree(tracker.reference_px).query(places)
        near = distance <= tracker.spacing_px
        return np.where(near, values[nearest], np.nan).reshape(x.shape)


def origin_of(runs: Sequence[Run]) -> str:
    """Return from which positions the displacements of some runs are measured: at rest, the median, or both."""
    kinds = [AT_REST if run.references else MEDIAN for run in runs]
    return " or ".join(kind for kind in (AT_REST, MEDIAN) if kind in kinds)


def _require_found(track: Track, where: str) -> None:
    """Check that enough markers were found in a frame.

    Raises:
        CheckFailedError: Fewer than half of the markers were found.
    """
    if np.mean(track.found) < MIN_FOUND:
        raise CheckFailedError(
            f"{where}: only {int(track.found.sum())} of {len(track.found)} markers were found; at least half are needed"
        )
