"""Compare detected markers of the simulated sensor with their true positions."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.cases import mostly_long
from helpers.simulated_markers import detection_rates, simulated_frames

from tacbench_cad.extensions.markers.markers import MarkerFinder
from tacbench_cad.extensions.markers.tracking import MarkerTracker
from tacbench_cad.lab.runs.region import SURE
from tacbench_cad.lab.runs.region_search import find_region

#: The smallest fraction of markers found and the largest fraction of false ones.
LIMITS = {"tactip-bristol": (0.99, 0.005), "tactip-sussex": (0.95, 0.05), "clean": (0.99, 0.0)}


@pytest.mark.parametrize(
    ("look", "presses"),
    mostly_long([(look, presses) for presses in (6, 60) for look in LIMITS], ("tactip-sussex", 6)),
)
def test_markers_of_the_looks_are_found_and_followed(look: str, presses: int) -> None:
    frames = list(simulated_frames(look, presses, seed=3))
    finder = MarkerFinder.learn([frames[0][0]])
    recall, false, error = detection_rates(frames[1:], finder.find)
    assert recall >= LIMITS[look][0]
    assert false <= LIMITS[look][1]
    assert error <= 0.2
    reference = finder.find(frames[0][0]).centres_px
    number = np.argmin(np.hypot(*(reference[:, None] - frames[0][1].centres_px[None]).transpose(2, 0, 1)), axis=1)
    tracker = MarkerTracker(reference_px=reference)
    errors = []
    for frame, truth in frames[1:]:
        track = tracker.follow(finder.find(frame).centres_px)
        displacement = (truth.centres_px - frames[0][1].centres_px)[number]
        errors.append(np.hypot(*(track.displacement_px - displacement).T)[track.found])
        assert np.mean(track.found) > 0.9
        assert np.mean(errors[-1] < 1.0) > 0.9
    assert np.mean(np.concatenate(errors) < 1.0) > 0.985


@pytest.mark.parametrize("look", ["tactip-bristol", "tactip-sussex"])
def test_the_dome_of_the_looks_is_found(look: str) -> None:
    ((frame, _),) = simulated_frames(look, 0)
    region = find_region([frame])
    assert region.text.startswith("circle:")
    assert region.sureness >= SURE
