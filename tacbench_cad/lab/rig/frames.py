"""What is wrong with an image of a sensor: dark, blurred, or stuck. Pure functions, no camera needed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from tacbench_cad.util.convert import Bounds, Checked
from tacbench_cad.util.types import Ints

#: The faults that :func:`frame_faults` can name.
FAULTS = ("dark", "blurred", "stuck")
#: Fraction of the pixels that may be brighter than what is called the bright level: hot pixels, reflections. The pins
#: of a TacTip cover some 3 % of its image, on a background near 0, so the level lies on the pins.
_BRIGHT_FRACTION = 0.005
#: Fraction of the pixels that may be darker than the dark level.
_DARK_FRACTION = 0.01
#: Fraction of the slopes that may be steeper than what is called the steepest slope.
_STEEP_FRACTION = 0.001


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
    faults = []
    brightest = image if image.ndim == 2 else np.maximum(np.maximum(image[..., 0], image[..., 1]), image[..., 2])
    levels = _counts(brightest)
    bright = _level_above(levels, _BRIGHT_FRACTION)
    if bright < chosen.dark_counts:
        faults.append("dark")
    elif chosen.blur_px > 0.0 and _edge_px(brightest, levels, chosen.dark_counts) > chosen.blur_px:
        faults.append("blurred")
    if previous is not None and np.array_equal(image, previous):
        faults.append("stuck")
    return tuple(faults)


def _edge_px(grey: NDArray[Any], levels: Ints, min_contrast: float) -> float:
    """Width of a frame's sharpest edges, about 0.8 pixels at best since a pixel has a size; infinite without structure.

    A step of height c smoothed by a Gaussian of standard deviation s has the steepest slope c / (s sqrt(2 pi)). The
    height is taken as the contrast between dark and bright level, the slope from central differences.
    """
    contrast = _level_above(levels, _BRIGHT_FRACTION) - _level_above(levels, 1.0 - _DARK_FRACTION)
    if contrast <= min_contrast:
        return math.inf
    wide = grey.astype(np.int16)
    slopes = _counts(np.abs(wide[:, 2:] - wide[:, :-2])) + _counts(np.abs(wide[2:] - wide[:-2]))
    # A central difference spans two pixels.
    steepest = _level_above(slopes, _STEEP_FRACTION) / 2.0
    return contrast / (steepest * math.sqrt(2.0 * math.pi)) if steepest > 0.0 else math.inf


def _counts(values: NDArray[Any]) -> Ints:
    """How often each count from 0 to 255 occurs, shape (256,)."""
    return np.bincount(values.ravel(), minlength=256)


def _level_above(levels: Ints, fraction: float) -> int:
    """The count that at most ``fraction`` of the values exceed."""
    below = np.cumsum(levels)
    return int(np.searchsorted(below, (1.0 - fraction) * below[-1]))
