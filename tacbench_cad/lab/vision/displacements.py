"""How far the markers of a sensor move in each press of some runs: numbers that lighting does not touch.

The markers are learned from the frames without contact of all runs, so that marker 17 is the same pin in every run, and
displacements of different runs can be compared. Each run's displacements count from its own frames without contact:
that the camera was mounted anew between two runs is not in them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from tacbench_cad.lab.rig.sensor import Frame, is_image
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.lab.vision.markers import MarkerFinder, MarkerSettings
from tacbench_cad.lab.vision.region import Region
from tacbench_cad.lab.vision.resting import resting_frames
from tacbench_cad.lab.vision.tracking import MarkerTracker, Track
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.types import Floats

#: Frames of a run that its reference is the median of, and frames that markers are learned from.
REFERENCE_FRAMES, _LEARNED_FRAMES = 3, 5
#: A frame in which fewer of the markers are found, as a fraction, is not used.
MIN_FOUND = 0.5
#: A marker belongs to the sensor if it is found in so many of the runs' references, as a fraction.
_IN_RUNS = 0.5
#: Side of a picture of markers, in pixels of the frame for each of its own.
_PICTURE_STEP = 4


@dataclass(frozen=True, kw_only=True, eq=False)
class MarkerFeatures:
    """The markers of some runs' sensor.

    Args:
        finder: Finds them.
        references_px: Where they are without contact, by the name of the run's print, shape (n, 2) each.
        shape: Height and width of a frame.
    """

    finder: MarkerFinder
    references_px: dict[str, Floats]
    shape: tuple[int, int]
    _trackers: dict[str, MarkerTracker] = field(default_factory=dict, repr=False)

    @classmethod
    def learn(
        cls, runs: Sequence[Run], settings: MarkerSettings | None = None, region: Region | None = None
    ) -> MarkerFeatures:
        """Learn what the markers look like and where they rest.

        Args:
            runs: The runs, of one sensor.
            settings: What is known of the markers.
            region: Where they may lie.

        Raises:
            InputError: A run has no image, or no markers can be found in it.
        """
        resting = [resting_frames(run, REFERENCE_FRAMES) for run in runs]
        for run, frames in zip(runs, resting, strict=True):
            if not frames:
                raise InputError("features", "markers", f"need images; {run.folder} has none that can be read")
        spread = [resting[at][0] for at in np.unique(np.linspace(0, len(runs) - 1, _LEARNED_FRAMES).astype(int))]
        finder = MarkerFinder.learn(spread, settings, None if region is None else region.mask)
        first = max((finder.find(frame).centres_px for frame in spread), key=len)
        tracker = MarkerTracker(reference_px=first)
        tracks = [[tracker.follow(finder.find(frame).centres_px) for frame in frames] for frames in resting]
        seen = np.mean([track.found for of_run in tracks for track in of_run], axis=0) >= _IN_RUNS
        references: dict[str, Floats] = {}
        for run, of_run in zip(runs, tracks, strict=True):
            _require_found(
                max(of_run, key=lambda track: track.found.sum()), f"{run.folder}: its frames without contact"
            )
            moved = np.median([track.displacement_px for track in of_run], axis=0)
            references[run.info.printed.name] = (first + moved)[seen]
        return cls(finder=finder, references_px=references, shape=spread[0].shape[:2])

    @property
    def count(self) -> int:
        """The number of markers."""
        return len(next(iter(self.references_px.values())))

    def track(self, run: Run, frame: Frame) -> Track:
        """Where the markers are in a frame of a run."""
        return self._tracker(run.info.printed.name).follow(self.finder.find(frame).centres_px)

    def _tracker(self, name: str) -> MarkerTracker:
        if name not in self._trackers:
            self._trackers[name] = MarkerTracker(reference_px=self.references_px[name])
        return self._trackers[name]

    def displacement_px(self, run: Run, path: str) -> Floats:
        """How far the markers moved in a frame of a run, column and row, shape (n, 2).

        Raises:
            CheckFailedError: The frame cannot be read, or fewer than half of the markers are found in it.
        """
        frame = run.read(path)
        if not is_image(frame):
            raise CheckFailedError(f"{run.folder / path}: is no image, so it has no markers")
        track = self.track(run, frame)
        _require_found(track, str(run.folder / path))
        return track.displacement_px

    def picture(self, values: Floats) -> Floats:
        """A value of each marker as a picture of the frame, a quarter of its size; NaN where no marker is near.

        Args:
            values: One value for each marker, shape (n,).
        """
        from scipy.spatial import cKDTree

        tracker = self._tracker(next(iter(self.references_px)))
        y, x = np.mgrid[: self.shape[0] : _PICTURE_STEP, : self.shape[1] : _PICTURE_STEP]
        places = np.column_stack([x.ravel(), y.ravel()])
        distance, nearest = cKDTree(tracker.reference_px).query(places)
        near = distance <= tracker.spacing_px
        return np.where(near, values[nearest], np.nan).reshape(x.shape)


def _require_found(track: Track, where: str) -> None:
    """Refuse a frame whose markers cannot be trusted.

    Raises:
        CheckFailedError: Fewer than half of them were found.
    """
    if np.mean(track.found) < MIN_FOUND:
        raise CheckFailedError(
            f"{where}: {int(track.found.sum())} of {len(track.found)} markers found, fewer than half"
        )
