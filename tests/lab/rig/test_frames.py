"""Test the check of frames: dark, blurred and stuck frames are reported, good frames are not."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest

from tacbench_cad.lab.rig.frames import FrameLimits, frame_faults
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Bytes


def pins(blur_px: float = 1.0, light: float = 200.0, seed: int = 0, noise: float = 1.4) -> Bytes:
    """Return bright discs of 10 px on a dark background, like a TacTip's pins, shape (480, 640)."""
    picture = np.full((480, 640), 4.0, dtype=np.float32)
    for i in range(133):
        centre = (110 + 40 * (i % 11), 20 + 36 * (i // 11))
        cv2.circle(picture, centre, 5, light, thickness=-1, lineType=cv2.LINE_AA)
    picture = np.asarray(cv2.GaussianBlur(picture, (0, 0), blur_px), dtype=np.float32)
    noisy = picture + np.random.default_rng(seed).normal(0.0, noise, picture.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def colour(grey: Bytes) -> Bytes:
    return np.repeat(grey[..., None], 3, axis=2)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("light", [60.0, 120.0, 255.0])
@pytest.mark.parametrize("blur_px", [0.5, 1.0, 2.0])
def test_a_good_frame_has_no_fault(blur_px: float, light: float, seed: int) -> None:
    image = pins(blur_px, light, seed)
    other = pins(blur_px, light, seed + 100)
    assert frame_faults(image, other) == ()
    assert frame_faults(colour(image), colour(other)) == ()


def test_light_in_a_single_channel_is_light() -> None:
    image = np.zeros((480, 640, 3), dtype=np.uint8)
    image[..., 2] = pins()
    assert frame_faults(image) == ()


@pytest.mark.parametrize("light", [4.0, 10.0, 20.0])
def test_a_dark_frame_is_reported_once(light: float) -> None:
    assert frame_faults(pins(light=light)) == ("dark",)


def test_hot_pixels_do_not_make_a_dark_frame_bright() -> None:
    image = pins(light=4.0)
    image[::40, ::40] = 255
    assert frame_faults(image) == ("dark",)


@pytest.mark.parametrize("blur_px", [5.0, 6.5, 8.0])
@pytest.mark.parametrize("seed", range(3))
def test_a_blurred_frame_is_reported(blur_px: float, seed: int) -> None:
    assert frame_faults(pins(blur_px, light=255.0, seed=seed)) == ("blurred",)


def test_a_frame_without_structure_is_blurred() -> None:
    flat = np.random.default_rng(1).normal(120.0, 1.4, (480, 640)).astype(np.uint8)
    assert frame_faults(flat) == ("blurred",)
    assert frame_faults(np.full((480, 640), 255, dtype=np.uint8)) == ("blurred",)


def test_an_identical_frame_is_always_stuck() -> None:
    image = pins()
    assert frame_faults(image, image.copy()) == ("stuck",)
    black = np.zeros((480, 640, 3), dtype=np.uint8)
    assert frame_faults(black, black.copy()) == ("dark", "stuck")


def test_the_width_of_an_edge_is_measured() -> None:
    def between(image: Any, low_px: float, high_px: float) -> bool:
        sharper, duller = (frame_faults(image, limits=FrameLimits(blur_px=px)) for px in (low_px, high_px))
        return (sharper, duller) == (("blurred",), ())

    step = np.full((200, 200), 20.0, dtype=np.float32)
    step[:, 100:] = 220.0
    for sigma in (2.0, 3.0, 6.0):
        smooth = np.rint(cv2.GaussianBlur(step, (0, 0), sigma)).astype(np.uint8)
        assert between(smooth, 0.9 * sigma, 1.1 * sigma)
    assert between(step.astype(np.uint8), 0.75, 0.85)


def test_checks_can_be_switched_off() -> None:
    off = FrameLimits(dark_counts=0.0, blur_px=0.0)
    assert frame_faults(np.zeros((48, 64), dtype=np.uint8), limits=off) == ()
    assert frame_faults(pins(9.0), limits=off) == ()


def test_invalid_limits_are_refused() -> None:
    with pytest.raises(InputError, match=r"blur_px = -1.0: must be at least 0"):
        FrameLimits(blur_px=-1.0)
    with pytest.raises(InputError, match="dark_counts"):
        FrameLimits(dark_counts=float("nan"))
