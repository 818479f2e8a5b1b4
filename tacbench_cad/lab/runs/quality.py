"""The quality of a run's frames, by themselves and beside each other: light, focus, and whether the camera moved.

Limits and their reasons (measured on five public recordings of TacTips, compressed and not):

* *brightness* 12 %: exposure and lamps changed by up to 10 % within a recording that nobody rejected; the authors of
  the paper rejected files that were 18 % darker than the others (117 against 143 counts).
* *saturated* 15 % of the sensor's pixels: at most 6 % were, by reflections.
* *flicker* 1 %: frames of a sensor at rest differed by at most 0.26 % in their mean.
* *drift* 5 % over a run: light drifted by up to 1 % a minute, by 0.6 % in 100 presses.
* *moved* 5 px: the dome moved by at most 1.8 px within a recording; a circle fits an elliptical dome to about 2 px.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tacbench_cad.lab.rig.frames import SATURATED, FrameLimits, FrameQuality, frame_quality
from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.vision.region import Region, circle_near
from tacbench_cad.util.types import Bools

#: A frame's mean brightness may differ from the run's median by so much, as a fraction.
BRIGHTNESS = 0.12
#: Fraction of the sensor's pixels that may be saturated.
SATURATION = 0.15
#: Standard deviation of the mean brightness of frames without motion, as a fraction of it.
FLICKER = 0.01
#: Change of the mean brightness from a run's first quarter to its last, as a fraction.
DRIFT = 0.05
#: How far the sensor may be from where most frames of a run show it, in pixels.
MOVED_PX = 5.0
#: The edge of the region does not count for the focus: a margin, as a fraction of the region's radius, and at least.
_MARGIN, _MIN_MARGIN_PX = 0.04, 4
#: Fewer frames have no median, and no drift.
_MIN_FRAMES = 8
#: Below this mean brightness, in counts, few bright pixels decide it, and their motion is no change of light.
_MIN_MEAN = 20.0


@dataclass(frozen=True, kw_only=True)
class Measured:
    """What was measured of a frame of a run.

    Args:
        quality: The frame inside of the region.
        centre_px: Where the dome's centre is, None where no dome is looked at.
    """

    quality: FrameQuality
    centre_px: tuple[float, float] | None


@dataclass(frozen=True, kw_only=True, eq=False)
class Judge:
    """Measures and judges the frames of a run.

    Args:
        limits: When a frame is dark or blurred.
        region: Where the sensor is, None for the whole frame.
    """

    limits: FrameLimits
    region: Region | None

    @cached_property
    def _inside(self) -> Bools | None:
        """The region without a margin along its edge; all of one that is too narrow for a margin."""
        import cv2

        if self.region is None:
            return None
        side = 2 * max(_MIN_MARGIN_PX, round(_MARGIN * math.sqrt(self.region.mask.sum() / math.pi))) + 1
        inside = np.asarray(cv2.erode(self.region.mask.astype(np.uint8), np.ones((side, side), np.uint8)) > 0)
        return inside if inside.any() else self.region.mask

    def measure(self, frame: Frame) -> Measured:
        """Measure a frame of the region's size."""
        quality = frame_quality(frame, self._inside, edges=self.limits.blur_px > 0.0)
        return Measured(quality=quality, centre_px=None if self.region is None else circle_near(frame, self.region))

    def faults(self, measured: Measured) -> Iterator[tuple[str, str]]:
        """What is wrong with a frame by itself: kinds, and the ends of sentences."""
        quality, limits = measured.quality, self.limits
        where = "" if self.region is None else " inside of the sensor"
        if quality.bright < limits.dark_counts:
            text = f"is dark: its bright level{where} is {quality.bright:g} counts"
            yield "dark", f"{text}, the limit is {limits.dark_counts:g}"
        elif limits.blur_px > 0.0 and quality.contrast <= limits.dark_counts:
            text = f"is blurred: it shows nothing{where}, its contrast is {quality.contrast:g} counts"
            yield "blurred", f"{text}, the limit is {limits.dark_counts:g}"
        elif limits.blur_px > 0.0 and quality.edge_px > limits.blur_px:
            text = f"is blurred: its sharpest edges{where} are {quality.edge_px:.1f} px wide"
            yield "blurred", f"{text}, the limit is {limits.blur_px:g}"
        if self.region is not None and quality.saturated > SATURATION:
            text = f"has {100 * quality.saturated:.0f} % of the sensor's pixels at {SATURATED} counts or more"
            yield "saturated", f"{text}, the limit is {100 * SATURATION:g} %"


def beside_each_other(
    measured: Mapping[str, Measured], in_time: Sequence[str], still: Mapping[str, Sequence[str]]
) -> Iterator[tuple[str, str, str]]:
    """What is wrong with frames beside the others of their run: kinds, where, and the ends of sentences.

    Args:
        measured: What was measured, by the frame's path.
        in_time: The paths of presses, or of frames without contact, in the order in which they were taken.
        still: The paths of frames without motion, by the session that they belong to.
    """
    yield from _brightness(measured)
    yield from _flicker(measured, still)
    yield from _drift(measured, in_time)
    yield from _moved(measured)


def _brightness(measured: Mapping[str, Measured]) -> Iterator[tuple[str, str, str]]:
    means = {path: each.quality.mean for path, each in measured.items()}
    median = float(np.median(list(means.values()))) if means else 0.0
    if len(means) < _MIN_FRAMES or median < _MIN_MEAN:
        return
    for path, mean in means.items():
        if abs(mean / median - 1.0) > BRIGHTNESS:
            off = f"{100 * abs(mean / median - 1.0):.0f} % {'darker' if mean < median else 'brighter'}"
            text = f"is {off} than the run's median: {mean:.0f} against {median:.0f} counts"
            yield "brightness", path, f"{text}, the limit is {100 * BRIGHTNESS:g} %"


def _flicker(measured: Mapping[str, Measured], still: Mapping[str, Sequence[str]]) -> Iterator[tuple[str, str, str]]:
    for session, paths in still.items():
        means = np.array([measured[path].quality.mean for path in paths if path in measured])
        if len(means) < 3 or means.mean() < _MIN_MEAN:
            continue
        flicker = float(means.std(ddof=1) / means.mean())
        if flicker > FLICKER:
            text = f"the light flickers: {len(means)} frames without motion differ by {100 * flicker:.1f} % in light"
            yield "flicker", session, f"{text} (standard deviation), the limit is {100 * FLICKER:g} %"


def _drift(measured: Mapping[str, Measured], in_time: Sequence[str]) -> Iterator[tuple[str, str, str]]:
    means = np.array([measured[path].quality.mean for path in in_time if path in measured])
    if len(means) < _MIN_FRAMES or np.median(means) < _MIN_MEAN:
        return
    quarter = max(2, len(means) // 4)
    first, last = float(np.median(means[:quarter])), float(np.median(means[-quarter:]))
    if abs(last / first - 1.0) > DRIFT:
        text = f"{'fell' if last < first else 'rose'} by {100 * abs(last / first - 1.0):.1f} % during the run"
        text += f", from {first:.0f} to {last:.0f} counts (medians of the first and the last quarter of the frames)"
        yield "drift", "light", f"{text}, the limit is {100 * DRIFT:g} %"


def _moved(measured: Mapping[str, Measured]) -> Iterator[tuple[str, str, str]]:
    centres = {path: each.centre_px for path, each in measured.items() if each.centre_px is not None}
    if len(centres) < _MIN_FRAMES:
        return
    middle = np.median(list(centres.values()), axis=0)
    for path, centre in centres.items():
        away = float(np.hypot(*(np.array(centre) - middle)))
        if away > MOVED_PX:
            text = f"shows the sensor {away:.1f} px from where most frames show it: the camera or the dome moved"
            yield "moved", path, f"{text}; the limit is {MOVED_PX:g} px"
