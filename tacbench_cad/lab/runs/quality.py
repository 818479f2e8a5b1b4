"""The quality of a run's frames: brightness, focus, and whether the camera moved.

Each frame is checked by itself and compared with the other frames of its run. The limits follow from measurements on
five public recordings of TacTips, compressed and uncompressed:

* *brightness* 12 %: exposure and lamps changed by up to 10 % within a recording that was not rejected. The authors of
  the paper rejected files that were 18 % darker than the others (117 instead of 143 counts).
* *saturated* 15 % of the sensor's pixels: reflections saturated at most 6 % of them.
* *flicker* 1 %: the means of frames of a sensor at rest differed by at most 0.26 %.
* *drift* 5 % over a run: the brightness drifted by up to 1 % per minute, and by 0.6 % in 100 presses.
* *moved* 5 px: the dome moved by at most 1.8 px within a recording, and a circle fits an elliptical dome to about 2 px.
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

#: The largest difference between a frame's mean brightness and the run's median, as a fraction of the median.
BRIGHTNESS = 0.12
#: The largest fraction of the sensor's pixels that may be saturated.
SATURATION = 0.15
#: The largest standard deviation of the mean brightness of frames without motion, as a fraction of their mean.
FLICKER = 0.01
#: The largest change of the mean brightness from the first quarter of a run to the last, as a fraction.
DRIFT = 0.05
#: The largest distance of the sensor's centre from the run's median centre, in pixels.
MOVED_PX = 5.0
#: The focus is measured without a margin along the edge of the region. The width of the margin is a fraction of the
#: region's radius, with a minimum in pixels.
_MARGIN, _MIN_MARGIN_PX = 0.04, 4
#: The smallest number of frames for a median or a drift.
_MIN_FRAMES = 8
#: The smallest mean brightness, in counts, for a comparison. In darker frames the mean depends on few bright pixels,
#: and changes when they move.
_MIN_MEAN = 20.0


@dataclass(frozen=True, kw_only=True)
class Measured:
    """The measurements of a frame.

    Args:
        quality: The quality of the frame inside the region.
        centre_px: The centre of the dome; None without a region.
    """

    quality: FrameQuality
    centre_px: tuple[float, float] | None


@dataclass(frozen=True, kw_only=True, eq=False)
class Judge:
    """The checks of single frames of a run.

    Args:
        limits: The limits for dark and blurred frames.
        region: The region of the sensor; None for the whole frame.
    """

    limits: FrameLimits
    region: Region | None

    @cached_property
    def _inside(self) -> Bools | None:
        """The region without the margin along its edge. A region that is too narrow for a margin is used completely."""
        import cv2

        if self.region is None:
            return None
        side = 2 * max(_MIN_MARGIN_PX, round(_MARGIN * math.sqrt(self.region.mask.sum() / math.pi))) + 1
        inside = np.asarray(cv2.erode(self.region.mask.astype(np.uint8), np.ones((side, side), np.uint8)) > 0)
        return inside if inside.any() else self.region.mask

    def measure(self, frame: Frame) -> Measured:
        """Measure a frame, which must have the size of the region's mask."""
        quality = frame_quality(frame, self._inside, edges=self.limits.blur_px > 0.0)
        return Measured(quality=quality, centre_px=None if self.region is None else circle_near(frame, self.region))

    def faults(self, measured: Measured) -> Iterator[tuple[str, str]]:
        """Yield the faults of a single frame: the kind, and the text as the end of a sentence."""
        quality, limits = measured.quality, self.limits
        where = "" if self.region is None else " inside the sensor's region"
        if quality.bright < limits.dark_counts:
            text = f"is dark: its bright level{where} is {quality.bright:g} counts"
            yield "dark", f"{text} (limit {limits.dark_counts:g})"
        elif limits.blur_px > 0.0 and quality.contrast <= limits.dark_counts:
            text = f"is blurred: its contrast{where} is {quality.contrast:g} counts"
            yield "blurred", f"{text} (limit {limits.dark_counts:g})"
        elif limits.blur_px > 0.0 and quality.edge_px > limits.blur_px:
            text = f"is blurred: its sharpest edges{where} are {quality.edge_px:.1f} px wide"
            yield "blurred", f"{text} (limit {limits.blur_px:g})"
        if self.region is not None and quality.saturated > SATURATION:
            text = (
                f"is saturated: {100 * quality.saturated:.0f} % of the sensor's pixels have {SATURATED} counts or more"
            )
            yield "saturated", f"{text} (limit {100 * SATURATION:g} %)"


def beside_each_other(
    measured: Mapping[str, Measured], in_time: Sequence[str], still: Mapping[str, Sequence[str]]
) -> Iterator[tuple[str, str, str]]:
    """Compare the frames of a run with each other.

    Args:
        measured: The measurements, by the frame's path.
        in_time: The paths of presses, or of frames without contact, in the order in which they were taken.
        still: The paths of frames without motion, by group.

    Yields:
        The kind of each fault, the frame or group, and the text as the end of a sentence.
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
            text = f"is {off} than the run's median: {mean:.0f} instead of {median:.0f} counts"
            yield "brightness", path, f"{text} (limit {100 * BRIGHTNESS:g} %)"


def _flicker(measured: Mapping[str, Measured], still: Mapping[str, Sequence[str]]) -> Iterator[tuple[str, str, str]]:
    for session, paths in still.items():
        means = np.array([measured[path].quality.mean for path in paths if path in measured])
        if len(means) < 3 or means.mean() < _MIN_MEAN:
            continue
        flicker = float(means.std(ddof=1) / means.mean())
        if flicker > FLICKER:
            text = f"show flickering light: the brightness of {len(means)} frames has a standard deviation of"
            yield "flicker", session, f"{text} {100 * flicker:.1f} % (limit {100 * FLICKER:g} %)"


def _drift(measured: Mapping[str, Measured], in_time: Sequence[str]) -> Iterator[tuple[str, str, str]]:
    means = np.array([measured[path].quality.mean for path in in_time if path in measured])
    if len(means) < _MIN_FRAMES or np.median(means) < _MIN_MEAN:
        return
    quarter = max(2, len(means) // 4)
    first, last = float(np.median(means[:quarter])), float(np.median(means[-quarter:]))
    if abs(last / first - 1.0) > DRIFT:
        text = f"{'fell' if last < first else 'rose'} by {100 * abs(last / first - 1.0):.1f} % during the run"
        text += f", from {first:.0f} to {last:.0f} counts (medians of the first and the last quarter of the frames;"
        yield "drift", "light", f"{text} limit {100 * DRIFT:g} %)"


def _moved(measured: Mapping[str, Measured]) -> Iterator[tuple[str, str, str]]:
    centres = {path: each.centre_px for path, each in measured.items() if each.centre_px is not None}
    if len(centres) < _MIN_FRAMES:
        return
    middle = np.median(list(centres.values()), axis=0)
    for path, centre in centres.items():
        away = float(np.hypot(*(np.array(centre) - middle)))
        if away > MOVED_PX:
            text = f"shows that the camera or the dome moved: the sensor is {away:.1f} px away from its median position"
            yield "moved", path, f"{text} (limit {MOVED_PX:g} px)"
