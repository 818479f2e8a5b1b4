"""Tell markers from other spots in frames like those of public sources, and find small pins."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from helpers.cases import mostly_long
from helpers.frame_kinds import KINDS, WITH_MARKERS, WITHOUT, digit, frames_of
from helpers.lookalikes import LOOKS, draw, lattice
from scipy.spatial import cKDTree

from tacbench_cad.extensions.markers.markers import MarkerFinder, MarkerSettings
from tacbench_cad.extensions.markers.pattern import (
    MAX_COST,
    MAX_IRREGULARITY,
    MIN_CONTRAST,
    change,
    circle_around,
    expected_count,
    irregularity,
)
from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.runs.region_search import find_region
from tacbench_cad.util.errors import InputError

#: The smallest fraction of the visible markers that is found in five frames in contact.
FOUND = {"tactip": 0.99, "tactip_binary": 0.95, "tactip_127": 0.975, "tactip_glare": 0.9, "gelsight_dots": 0.99}


@pytest.mark.parametrize("kind", mostly_long(WITH_MARKERS, "tactip_binary"))
def test_markers_are_found_with_a_margin_to_the_limits_of_a_pattern(kind: str) -> None:
    shots = frames_of(kind, 4, seed=1)
    finder = MarkerFinder.learn([shot.image for shot in shots])
    spots = [finder.find(shot.image).centres_px for shot in shots]
    near = 1.5 if kind == "tactip_binary" else 3.0
    of_shots = zip(spots, shots, strict=True)
    seen = np.concatenate([cKDTree(each).query(shot.markers[shot.visible])[0] < near for each, shot in of_shots])
    assert seen.mean() >= FOUND[kind]
    assert sum(map(len, spots)) <= 4.02 * WITH_MARKERS[kind]
    assert finder.contrast > 3.0 * MIN_CONTRAST
    assert max(map(irregularity, spots)) < 0.5 * MAX_IRREGULARITY
    assert change(spots) < 0.5 * MAX_COST
    assert expected_count(spots[0]) == pytest.approx(WITH_MARKERS[kind], rel=0.1)


def test_pins_of_128_pixels_are_narrower_than_1_5_pixels() -> None:
    finder = MarkerFinder.learn([KINDS["tactip_binary"](0, 0.0).image])
    assert 0.7 < finder.sigma_px < 1.5


@pytest.mark.parametrize("kind", WITHOUT)
def test_sensors_without_markers_have_none(kind: str) -> None:
    with pytest.raises(InputError, match=r"there are no markers in these frames: .*--features pixels"):
        MarkerFinder.learn([shot.image for shot in frames_of(kind, 5, seed=2)])


def weave(seed: int) -> Frame:
    """Return a soft image with the strong print of a fabric: regular spots at a random place and angle."""
    rng, image = np.random.default_rng(seed), digit(seed, 0.0).image.astype(np.float64)
    y, x = np.mgrid[:320, :240]
    angle, places = rng.uniform(0.0, np.pi), rng.uniform(0.0, 20.0, 2)
    u, v = (x + places[0]) * np.cos(angle) + y * np.sin(angle), (y + places[1]) * np.cos(angle) - x * np.sin(angle)
    bumps = np.maximum(np.cos(np.pi * u / 12.0) * np.cos(np.pi * v / 12.0), 0.0) ** 3
    middle = rng.uniform((100, 130), (140, 190))
    print_ = np.exp(-((x - middle[0]) ** 2 + (y - middle[1]) ** 2) / (2.0 * 60.0**2))
    return np.clip(image + 90.0 * (bumps * print_)[..., None], 0, 255).astype(np.uint8)


def test_a_fabric_and_fixed_dust_are_no_markers() -> None:
    with pytest.raises(InputError, match="no markers in these frames: the spots are at other places in each frame"):
        MarkerFinder.learn([weave(seed) for seed in range(5)])
    places = np.random.default_rng(0).uniform(15, (225, 305), (20, 2))
    y, x = np.mgrid[:320, :240]
    dust = sum(60.0 * np.exp(-((x - a) ** 2 + (y - b) ** 2) / 12.0) for a, b in places)
    dusty = [np.clip(digit(seed, 0.0).image - np.asarray(dust)[..., None], 0, 255).astype(np.uint8) for seed in (1, 2)]
    with pytest.raises(InputError, match="no markers in these frames: the distances between the spots vary by"):
        MarkerFinder.learn(dusty)


@pytest.mark.parametrize(("missing", "allowed"), [(0.0, 0.02), (0.12, 0.06), (0.34, 0.12)])
def test_the_expected_number_follows_from_the_spacing(missing: float, allowed: float) -> None:
    rng, places = np.random.default_rng(3), lattice(LOOKS["A"])
    seen = (places + rng.normal(0.0, 0.5, places.shape))[rng.permutation(331)[round(331 * missing) :]]
    assert expected_count(seen) == pytest.approx(331, rel=allowed)
    assert expected_count(places[:5]) == 5


def test_a_known_size_is_taken_as_it_is() -> None:
    image = draw(LOOKS["A"], 1).image
    few = np.full_like(image, 30)
    few[:, :80] = image[:, 264:344]
    assert MarkerFinder.learn([few], MarkerSettings(sigma_px=3.7)).sigma_px == 3.7


def dots() -> Frame:
    """Return bright pins on a black background without an outline."""
    image = np.full((480, 640), 2, dtype=np.uint8)
    for radius in (0, 40, 80, 120):
        for angle in np.arange(0.0, 2.0 * np.pi, 2.0 * np.pi / max(1, radius // 5)):
            place = (320 + radius * np.cos(angle), 240 + radius * np.sin(angle))
            cv2.circle(image, tuple(round(coordinate) for coordinate in place), 6, 200, -1)  # type: ignore[arg-type]
    return image


def test_the_circle_around_the_markers_shows_a_sensor_without_an_outline() -> None:
    with pytest.raises(InputError, match="found no dome or gel"):
        find_region([dots()])
    circle = circle_around(MarkerFinder.learn([dots()]).find(dots()).centres_px)
    numbers = [float(number) for number in circle.removeprefix("circle:").split(",")]
    assert numbers == pytest.approx([320.0, 240.0, 145.0], abs=12.0)
