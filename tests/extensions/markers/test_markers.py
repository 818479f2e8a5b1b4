"""Find markers in frames like those of five public recordings and in a gel, without tuning."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from helpers.cases import mostly_long
from helpers.lookalikes import LOOKS, Shot, draw, gel
from scipy.spatial import cKDTree

from tacbench_cad.extensions.markers.markers import MarkerFinder, Markers, MarkerSettings
from tacbench_cad.util.errors import InputError

#: The smallest fraction of visible markers found, the largest fraction of false ones, and the largest rms error in px.
LIMITS = {
    "A": (0.99, 0.005, 0.2),
    "B": (0.99, 0.005, 0.2),
    "C": (0.95, 0.05, 0.2),
    "D": (0.95, 0.05, 0.25),
    "E": (0.95, 0.05, 0.2),
}


def detection_rates(shots: list[Shot], finder: MarkerFinder) -> tuple[float, float, float]:
    """Return the fraction of visible markers found, the fraction of false ones, and the rms error in pixels."""
    visible = false = 0
    errors: list[float] = []
    for shot in shots:
        centres = finder.find(shot.image).centres_px
        distance = cKDTree(centres).query(shot.markers[shot.visible])[0]
        errors += distance[distance < 3.0].tolist()
        visible += len(distance)
        false += int(np.sum(cKDTree(shot.markers).query(centres)[0] > 3.0))
    return len(errors) / visible, false / visible, float(np.sqrt(np.mean(np.square(errors))))


@pytest.mark.parametrize("name", mostly_long(LOOKS, "A", "D"))
def test_markers_of_every_public_look_are_found(name: str) -> None:
    finder = MarkerFinder.learn([draw(LOOKS[name], 100).image])
    recall, false, error = detection_rates(
        [draw(LOOKS[name], 1), draw(LOOKS[name], 2, 12.0), draw(LOOKS[name], 3, 23.0)], finder
    )
    min_recall, max_false, max_rms = LIMITS[name]
    assert recall >= min_recall
    assert false <= max_false
    assert error <= max_rms


def test_dark_markers_of_a_gel_are_found() -> None:
    finder = MarkerFinder.learn([gel(1).image])
    assert finder.dark
    assert detection_rates([gel(2), gel(3, 15.0)], finder) == (1.0, 0.0, pytest.approx(0.05, abs=0.05))


def test_any_number_of_markers_is_found_at_another_scale() -> None:
    look = replace(LOOKS["A"], rings=((1, 0.0), (6, 30.0), (12, 60.0), (18, 90.0)), pin_width=(16.0, 16.0, 16.0))
    finder = MarkerFinder.learn([draw(look, 1).image])
    assert len(finder.find(draw(look, 2).image)) == 37
    small = MarkerFinder.learn(
        [cv2.resize(draw(LOOKS["B"], 1).image, None, fx=0.6, fy=0.6, interpolation=cv2.INTER_AREA)]
    )
    assert 1.5 < small.sigma_px < 3.0


def test_markers_are_found_in_darker_and_noisier_frames() -> None:
    finder = MarkerFinder.learn([draw(LOOKS["A"], 1).image])
    assert detection_rates([draw(LOOKS["A"], 2, 6.0, light=0.6)], finder)[0] > 0.99
    shot = draw(LOOKS["A"], 3)
    noisy = shot.image + np.random.default_rng(0).normal(0.0, 6.0, shot.image.shape)
    noisy_shot = replace(shot, image=np.clip(noisy, 0, 255).astype(np.uint8))
    recall, false, _ = detection_rates([noisy_shot], MarkerFinder.learn([noisy_shot.image]))
    assert recall > 0.99
    assert false < 0.005


def test_given_values_are_not_estimated_and_a_mask_is_used() -> None:
    shot = draw(LOOKS["B"], 1)
    finder = MarkerFinder.learn([shot.image], MarkerSettings(sigma_px=4.0, threshold=70.0, dark=False))
    assert (finder.sigma_px, finder.threshold, finder.dark) == (4.0, 70.0, False)
    left = np.zeros(shot.image.shape[:2], dtype=bool)
    left[:, :301] = True
    markers = MarkerFinder.learn([shot.image], mask=left).find(shot.image)
    assert isinstance(markers, Markers)
    assert markers.centres_px[:, 0].max() < 302
    assert len(markers) == pytest.approx(165, abs=8)
    with pytest.raises(InputError, match="the shape of the region"):
        MarkerFinder.learn([shot.image], mask=left).find(shot.image[:100])


def test_images_without_markers_are_refused() -> None:
    noise = np.random.default_rng(0).integers(100, 102, (64, 64), dtype=np.uint8)
    with pytest.raises(InputError, match="no markers in these frames: there are fewer than 12"):
        MarkerFinder.learn([noise])
    with pytest.raises(InputError, match="at least one"):
        MarkerFinder.learn([])
    with pytest.raises(InputError, match="must be an image"):
        MarkerFinder.learn([np.zeros((4, 4))])
    with pytest.raises(InputError, match="sigma_px"):
        MarkerSettings(sigma_px=0.2)
    with pytest.raises(InputError, match="threshold"):
        MarkerSettings(threshold=0.0)
