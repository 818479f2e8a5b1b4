"""Checks of a sensor's image: dark, blurred or stuck. These are pure functions that need no camera."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from tacbench_cad.lab.rig.errors import RigError
from tacbench_cad.util.convert import Checked
from tacbench_cad.util.types import Bools, Ints

#: The faults that :func:`frame_faults` can name.
FAULTS = ("dark", "blurred", "stuck")
#: The fraction of pixels that may exceed the bright level, such as hot pixels and reflections. The pins of a TacTip
#: cover about 3 % of its image, on a background near 0, so the bright level is the brightness of the pins.
_BRIGHT_FRACTION = 0.005
#: The fraction of pixels that may be below the dark level.
_DARK_FRACTION = 0.01
#: The lowest count of a saturated pixel; compressed videos clip at 249 to 251.
SATURATED = 250
#: The fraction of a frame's pixels that count as those with the steepest slopes.
_STEEP_FRACTION = 0.001
#: The window in which a step of brightness is measured, in pixels, and its lowest height as a fraction of the contrast.
_STEP_PX, _MIN_STEP = 25, 0.3
#: The shorter side of a frame, in pixels, below which single pixels are used instead of means over 3 x 3.
_SMALL_PX = 64
#: The width of an edge between two pixels, in pixels.
_PIXEL_PX = 0.79


@dataclass(frozen=True, kw_only=True)
class FrameLimits(Checked):
    """The limits beyond which a frame is faulty. The defaults suit an image of bright markers, 640 x 480.

    Args:
        dark_counts: A frame is dark if its bright level is below this count; 0 switches the check off.
        blur_px: A frame is blurred if its sharpest edges are wider than a step smoothed by a Gaussian with this
            standard deviation, in pixels; 0 switches the check off, for sensors without markers.
    """

    dark_counts: Annotated[float, Interval(ge=0.0, le=255.0)] = 25.0
    blur_px: Annotated[float, Interval(ge=0.0, le=1000.0)] = 3.0


@dataclass(frozen=True, kw_only=True)
class FrameQuality:
    """Measurements of a frame, within a region or over the whole frame.

    Args:
        bright: The bright level in counts. 0.5 % of the pixels exceed it in their brightest channel.
        contrast: The bright level minus the dark level. 1 % of the pixels are below the dark level.
        edge_px: The width of the sharpest edges: the standard deviation, in pixels, of the Gaussian that would smooth
            a step equally. It is about 0.8 at best, because of the pixel size, and infinite for a uniform image.
        mean: The mean of the brightest channel, in counts, over the whole frame.
        saturated: The fraction of pixels with 250 counts or more.
    """

    bright: float
    contrast: float
    edge_px: float
    mean: float
    saturated: float


def frame_faults(
    image: NDArray[Any], previous: NDArray[Any] | None = None, limits: FrameLimits | None = None
) -> tuple[str, ...]:
    """Return the names of a frame's faults.

    Args:
        image: uint8, shape (height, width) or (height, width, 3), at least 3 pixels a side.
        previous: The previous frame of the same camera, if there is one. Read noise makes any two frames of a working
            camera differ, so an identical frame is stuck.
        limits: The limits; None for the defaults.

    Returns:
        Some of ``dark``, ``blurred``, ``stuck``; empty for a good frame. A dark frame is not also called blurred.
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


def require_good_frame(name: str, image: NDArray[Any], previous: NDArray[Any] | None, limits: FrameLimits) -> None:
    """Check that a frame has no fault.

    Args:
        name: The camera, for the message.
        image: Same as for :func:`frame_faults`, like the other two.
        previous: The previous frame.
        limits: The limits.

    Raises:
        RigError: The frame is dark, blurred or stuck.
    """
    faults = frame_faults(image, previous, limits)
    if faults:
        raise RigError(f"{name}: a frame is {' and '.join(faults)}; check the light, the exposure, the lens")


def frame_quality(image: NDArray[Any], mask: Bools | None = None, *, edges: bool = True) -> FrameQuality:
    """Measure the brightness and sharpness of a frame.

    Args:
        image: uint8, shape (height, width) or (height, width, 3).
        mask: The pixels to measure, shape (height, width); None for all.
        edges: Whether to measure the edges; otherwise their width is 0.
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
    """Return the width of the sharpest edges in pixels.

    A step of height c that is smoothed by a Gaussian with standard deviation s has the steepest slope
    c / (s sqrt(2 pi)). The height is that of the step itself: the largest difference within a small window. Windows
    with a small height contain only noise. The slope is the central difference of means over 3 x 3 pixels, which
    reduces noise; small frames use single pixels.
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
    # A central difference spans two pixels. The mean over three pixels adds a variance of about 0.8 to a step.
    width = float(np.median(heights[steep] / slopes[steep])) * 2.0 / math.sqrt(2.0 * math.pi)
    return math.sqrt(max(width**2 - 0.8, _PIXEL_PX**2)) if large else width


def _counts(values: NDArray[Any]) -> Ints:
    """Return how often each count from 0 to 255 occurs, shape (256,)."""
    return np.bincount(values.ravel(), minlength=256)


def _level_above(levels: Ints, fraction: float) -> int:
    """Return the count that at most ``fraction`` of the values exceed."""
    below = np.cumsum(levels)
    return int(np.searchsorted(below, (1.0 - fraction) * below[-1]))
