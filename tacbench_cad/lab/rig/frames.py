"""What is wrong with an image of a sensor: dark, blurred, or stuck. Pure functions, no camera needed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from tacbench_cad.util.convert import Bounds, Checked
from tacbench_cad.util.types import Bools, Ints

#: The faults that :func:`frame_faults` can name.
FAULTS = ("dark", "blurred", "stuck")
#: Fraction of the pixels that may be brighter than what is called the bright level: hot pixels, reflections. The pins
#: of a TacTip cover some 3 % of its image, on a background near 0, so the level lies on the pins.
_BRIGHT_FRACTION = 0.005
#: Fraction of the pixels that may be darker than the dark level.
_DARK_FRACTION = 0.01
#: From here on a pixel is saturated; compressed videos clip at 249 to 251.
SATURATED = 250
#: Fraction of the pixels of a frame whose slopes are called the steepest ones.
_STEEP_FRACTION = 0.001
#: A step lies within so many pixels, and is at least so high, as a fraction of the frame's contrast.
_STEP_PX, _MIN_STEP = 25, 0.3
#: A frame with a shorter side is small.
_SMALL_PX = 64
#: The width of an edge that lies between two pixels.
_PIXEL_PX = 0.79


@dataclass(frozen=True, kw_only=True)
class FrameLimits(Checked):
    """From where on a frame is faulty. The defaults suit an image of bright markers, 640 x 480.

    Args:
        dark_counts: A frame is dark if its bright level is below so many counts; 0 switches the check off.
        blur_px: A frame is blurred if its sharpest edges are wider than a step smoothed by a Gaussian of this standard
            deviation, in pixels; 0 switches the check off, for sensors without markers.
    """

    dark_counts: Annotated[float, Bounds(0.0, 255.0)] = 25.0
    blur_px: Annotated[float, Bounds(0.0, 1000.0)] = 3.0


@dataclass(frozen=True, kw_only=True)
class FrameQuality:
    """What is measured of a frame, inside of a region or in all of it.

    Args:
        bright: The bright level, in counts: of the brightest channel, exceeded by 0.5 % of the pixels.
        contrast: The bright level less the dark one, which 1 % of the pixels fall below.
        edge_px: Width of the sharpest edges: the standard deviation of the Gaussian that smooths a step as much; about
            0.8 at best, since a pixel has a size; infinite without structure.
        mean: The mean of the brightest channel, in counts, outside of the region too.
        saturated: Fraction of the pixels at 250 or more.
    """

    bright: float
    contrast: float
    edge_px: float
    mean: float
    saturated: float


def frame_faults(
    image: NDArray[Any], previous: NDArray[Any] | None = None, limits: FrameLimits | None = None
) -> tuple[str, ...]:
    """Name what is wrong with a frame.

    Args:
        image: uint8, shape (height, width) or (height, width, 3), at least 3 pixels a side.
        previous: The frame before it from the same camera, if there is one. Read noise makes any two frames of a
            living camera differ, so an identical one is stuck.
        limits: Where to draw the line; the defaults if None.

    Returns:
        Some of ``dark``, ``blurred``, ``stuck``; empty for a sound frame. A dark frame is not called blurred too.
    """
    chosen = limits or FrameLimits()
    quality = frame_quality(image, edges=chosen.blur_px > 0.0)
    faults = []
    if quality.bright < chosen.dark_counts:
        faults.append("dark")
    elif chosen.blur_px > 0.0 and (quality.contrast <= chosen.dark_counts or quality.edge_px > chosen.blur_px):
        faults.append("blurred")
    if previous is not None and np.array_equal(image, previous):
        faults.append("stuck")
    return tuple(faults)


def frame_quality(image: NDArray[Any], mask: Bools | None = None, *, edges: bool = True) -> FrameQuality:
    """Measure a frame.

    Args:
        image: uint8, shape (height, width) or (height, width, 3).
        mask: The pixels that count, shape (height, width); None for all.
        edges: Whether to measure the edges too; else their width is 0.
    """
    brightest = image if image.ndim == 2 else np.maximum(np.maximum(image[..., 0], image[..., 1]), image[..., 2])
    levels = _counts(brightest if mask is None else brightest[mask])
    bright, dark = _level_above(levels, _BRIGHT_FRACTION), _level_above(levels, 1.0 - _DARK_FRACTION)
    return FrameQuality(
        bright=bright,
        contrast=bright - dark,
        edge_px=_edge_px(brightest, mask, bright - dark) if edges else 0.0,
        mean=float(brightest.mean()),
        saturated=float(levels[SATURATED:].sum() / levels.sum()),
    )


def _edge_px(grey: NDArray[Any], mask: Bools | None, contrast: float) -> float:
    """Width of the sharpest edges.

    A step of height c smoothed by a Gaussian of standard deviation s has the steepest slope c / (s sqrt(2 pi)). The
    height is that of the step itself, the largest difference within some pixels; where it is small, there is only
    noise. The slope comes from central differences of means over 3 x 3 pixels, which noise changes little (of single
    pixels in small frames).
    """
    import cv2

    large = min(grey.shape) >= _SMALL_PX
    smooth = (cv2.blur(grey, (3, 3)) if large else grey).astype(np.int16)
    slope = np.zeros_like(smooth)
    slope[:, 1:-1] = np.abs(smooth[:, 2:] - smooth[:, :-2])
    slope[1:-1] = np.maximum(slope[1:-1], np.abs(smooth[2:] - smooth[:-2]))
    window = np.ones((_STEP_PX, _STEP_PX), dtype=np.uint8)
    height = cv2.subtract(cv2.dilate(grey, window), cv2.erode(grey, window))
    counting = height >= max(1.0, _MIN_STEP * contrast)
    if mask is not None:
        counting &= mask
    slopes, heights = slope[counting], height[counting]
    if not slopes.size:
        return math.inf
    steep = slopes >= max(1, _level_above(_counts(slopes), _STEEP_FRACTION * grey.size / slopes.size))
    if not steep.any():
        return math.inf
    # A central difference spans two pixels; the mean over three widens a step as a variance of about 0.8 does.
    width = float(np.median(heights[steep] / slopes[steep])) * 2.0 / math.sqrt(2.0 * math.pi)
    return math.sqrt(max(width**2 - 0.8, _PIXEL_PX**2)) if large else width


def _counts(values: NDArray[Any]) -> Ints:
    """How often each count from 0 to 255 occurs, shape (256,)."""
    return np.bincount(values.ravel(), minlength=256)


def _level_above(levels: Ints, fraction: float) -> int:
    """The count that at most ``fraction`` of the values exceed."""
    below = np.cumsum(levels)
    return int(np.searchsorted(below, (1.0 - fraction) * below[-1]))
