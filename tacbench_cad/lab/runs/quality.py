"""The quality of a run's frames: brightness, focus, noise, colours, and whether the camera moved.

Each frame is compared with the other frames of its run, because a good frame of one kind of sensor looks like a faulty
one of another: a soft gel has no sharp edges, and half of a binary image is saturated. A limit of a comparison is at
least :data:`SCATTER` standard deviations of the run's own frames. The smallest limits follow from measurements on five
public recordings of TacTips, compressed and uncompressed:

* *brightness* 12 %: exposure and lamps changed by up to 10 % within a recording that was not rejected. The authors of
  the paper rejected files that were 18 % darker than the others (117 instead of 143 counts).
* *saturated* 15 % of the sensor's pixels: reflections saturated at most 6 % of them.
* *flicker* 1 %: the means of frames of a sensor at rest differed by at most 0.26 %.
* *drift* 5 % over a run: the brightness drifted by up to 1 % per minute, and by 0.6 % in 100 presses.
* *moved* 3.5 px: the dome moved by at most 1.8 px within a recording.
* *noise* 5 counts above the median: the noise of real frames was 0 to 1.8 counts.
* *blurred* 1.25 of the median width of the sharpest edges, if this width is that of the sensor's own edges: then it
  differs little between frames. The sharpest edges of a soft gel are those of the object. A frame is also blurred if
  its fine details have less than 0.65 of their usual energy. A blur of sigma 2 px left 0.01 to 0.57 of it, and the
  contact 0.71 or more, in frames with markers.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tacbench_cad.lab.rig.frames import SATURATED, FrameLimits, FrameQuality, frame_quality
from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.runs.region import Region
from tacbench_cad.lab.runs.typical_frame import Likeness, TypicalFrame
from tacbench_cad.util.types import Bools

#: The kinds of findings that judge how a frame looks. The file itself is complete.
JUDGED = (
    *("dark", "blurred", "saturated", "brightness", "flicker", "drift"),
    *("moved", "noise", "colour", "orientation"),
)
#: The largest difference between a frame's mean brightness and the run's median, as a fraction of the median.
BRIGHTNESS = 0.12
#: The largest fraction of the sensor's pixels that may be saturated.
SATURATION = 0.15
#: The largest standard deviation of the mean brightness of frames without motion, as a fraction of their mean.
FLICKER = 0.01
#: The largest change of the mean brightness from the first quarter of a run to the last, as a fraction.
DRIFT = 0.05
#: The largest shift of the picture from that of the run's typical frame, in pixels.
MOVED_PX = 3.5
#: The largest noise above the run's median, in counts.
NOISE = 5.0
#: The largest width of the sharpest edges relative to the run's median, and the largest standard deviation of this
#: width relative to the median for which it is compared.
BLUR, _STEADY_EDGES = 1.25, 0.05
#: The smallest energy of the fine details relative to the typical frame, and the largest standard deviation of this
#: energy over the frames for which it is compared.
DETAILS, _STEADY_DETAILS = 0.65, 0.05
#: The smallest limit of each comparison, in standard deviations of the run's frames.
SCATTER = 6.0
#: A frame is mirrored or has other colours if this fraction of the usual effect is exceeded, and if the usual effect on
#: the correlation with the typical frame is at least the second number.
_HALF_EFFECT, _MIN_EFFECT = 0.5, 0.002
#: The smallest standard deviation of the correlation with the typical frame. A frame is mirrored only if it is like the
#: others after the change is undone: markers at rest, among frames with contact, may fit better when mirrored.
_MIN_SCATTER = 0.005
#: The focus is measured without a margin along the edge of the region. The width of the margin is a fraction of the
#: region's radius, with a minimum in pixels.
_MARGIN, _MIN_MARGIN_PX = 0.04, 4
#: The smallest number of frames for a median or a drift.
MIN_FRAMES = 8
#: The smallest mean brightness, in counts, for a comparison. In darker frames the mean depends on few bright pixels,
#: and changes when they move.
_MIN_MEAN = 20.0


@dataclass(frozen=True, kw_only=True)
class MeasuredRun:
    """The measurements of a frame.

    Args:
        quality: The quality of the frame inside the region.
        likeness: The comparison with the typical frame; None if the run has too few frames.
    """

    quality: FrameQuality
    likeness: Likeness | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Judge:
    """The checks of single frames of a run.

    Args:
        limits: The limits for dark and blurred frames.
        region: The region of the sensor; None for the whole frame.
        typical: The typical frame of the run; None if the run has too few frames.
        any_kind: Whether the frames may be of any kind, as those of imported runs. Then frames without sharp edges are
            not blurred by themselves, but only beside sharper frames of the run.
    """

    limits: FrameLimits
    region: Region | None
    typical: TypicalFrame | None = None
    any_kind: bool = False

    @cached_property
    def _inside(self) -> Bools | None:
        """The region without the margin along its edge. A region that is too narrow for a margin is used completely."""
        import cv2

        if self.region is None:
            return None
        side = 2 * max(_MIN_MARGIN_PX, round(_MARGIN * math.sqrt(self.region.mask.sum() / math.pi))) + 1
        inside = np.asarray(cv2.erode(self.region.mask.astype(np.uint8), np.ones((side, side), np.uint8)) > 0)
        return inside if inside.any() else self.region.mask

    def measure(self, frame: Frame) -> MeasuredRun:
        """Measure a frame, which must have the size of the region's mask."""
        quality = frame_quality(frame, self._inside, edges=self.limits.blur_px > 0.0)
        return MeasuredRun(quality=quality, likeness=None if self.typical is None else self.typical.compare(frame))

    def faults(self, measured: MeasuredRun) -> Iterator[tuple[str, str]]:
        """Yield the faults of a single frame: the kind, and the text as the end of a sentence."""
        if self.typical is not None and self.typical.binary:
            return  # a binary image has no brightness and no focus
        quality, limits = measured.quality, self.limits
        sharp_kind = limits.blur_px > 0.0 and not self.any_kind
        where = "" if self.region is None else " inside the sensor's region"
        if quality.bright < limits.dark_counts:
            text = f"is dark: its bright level{where} is {quality.bright:g} counts"
            yield "dark", f"{text} (limit {limits.dark_counts:g})"
        elif sharp_kind and quality.contrast <= limits.dark_counts:
            text = f"is blurred: its contrast{where} is {quality.contrast:g} counts"
            yield "blurred", f"{text} (limit {limits.dark_counts:g})"
        elif sharp_kind and quality.edge_px > limits.blur_px:
            text = f"is blurred: its sharpest edges{where} are {quality.edge_px:.1f} px wide"
            yield "blurred", f"{text} (limit {limits.blur_px:g})"
        if self.region is not None and quality.saturated > SATURATION:
            text = (
                f"is saturated: {100 * quality.saturated:.0f} % of the sensor's pixels have {SATURATED} counts or more"
            )
            yield "saturated", f"{text} (limit {100 * SATURATION:g} %)"


def beside_each_other(
    measured: Mapping[str, MeasuredRun], in_time: Sequence[str], still: Mapping[str, Sequence[str]]
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
    yield from _unlike({path: each for path, each in measured.items() if each.likeness is not None})


def _brightness(measured: Mapping[str, MeasuredRun]) -> Iterator[tuple[str, str, str]]:
    means = {path: each.quality.mean for path, each in measured.items()}
    median = float(np.median(list(means.values()))) if means else 0.0
    if len(means) < MIN_FRAMES or median < _MIN_MEAN:
        return
    limit = max(BRIGHTNESS, SCATTER * _deviation(list(means.values())) / median)
    for path, mean in means.items():
        if abs(mean / median - 1.0) > limit:
            off = f"{100 * abs(mean / median - 1.0):.0f} % {'darker' if mean < median else 'brighter'}"
            text = f"is {off} than the run's median: {mean:.0f} instead of {median:.0f} counts"
            yield "brightness", path, f"{text} (limit {100 * limit:.0f} %)"


def _flicker(measured: Mapping[str, MeasuredRun], still: Mapping[str, Sequence[str]]) -> Iterator[tuple[str, str, str]]:
    for session, paths in still.items():
        means = np.array([measured[path].quality.mean for path in paths if path in measured])
        if len(means) < 3 or means.mean() < _MIN_MEAN:
            continue
        flicker = float(means.std(ddof=1) / means.mean())
        if flicker > FLICKER:
            text = f"show flickering light: the brightness of {len(means)} frames has a standard deviation of"
            yield "flicker", session, f"{text} {100 * flicker:.1f} % (limit {100 * FLICKER:g} %)"


def _drift(measured: Mapping[str, MeasuredRun], in_time: Sequence[str]) -> Iterator[tuple[str, str, str]]:
    means = np.array([measured[path].quality.mean for path in in_time if path in measured])
    if len(means) < MIN_FRAMES or np.median(means) < _MIN_MEAN:
        return
    quarter = max(2, len(means) // 4)
    first, last = float(np.median(means[:quarter])), float(np.median(means[-quarter:]))
    if abs(last / first - 1.0) > DRIFT:
        text = f"{'fell' if last < first else 'rose'} by {100 * abs(last / first - 1.0):.1f} % during the run"
        text += f", from {first:.0f} to {last:.0f} counts (medians of the first and the last quarter of the frames;"
        yield "drift", "light", f"{text} limit {100 * DRIFT:g} %)"


def _deviation(values: Sequence[float]) -> float:
    """Return a standard deviation that few outliers do not change."""
    return 1.4826 * float(np.median(np.abs(np.asarray(values) - np.median(values))))


def _unlike(measured: Mapping[str, MeasuredRun]) -> Iterator[tuple[str, str, str]]:
    """Compare each frame with the typical frame of the run. Only the first fault of a frame is reported."""
    if len(measured) < MIN_FRAMES:
        return
    likeness = {path: each.likeness for path, each in measured.items() if each.likeness is not None}
    binary = float(np.mean([each.binary for each in likeness.values()])) > 0.5
    noises = [each.noise for each in likeness.values()]
    noise = float(np.median(noises)) + max(NOISE, SCATTER * _deviation(noises))
    shifts = [math.hypot(*each.shift_px) for each in likeness.values()]
    shift = max(MOVED_PX, SCATTER * _deviation(shifts))
    edges = [each.quality.edge_px for each in measured.values()]
    edge = float(np.median(edges))
    steady = not binary and 0.0 < edge < math.inf and _deviation(edges) <= _STEADY_EDGES * edge
    blur = max(BLUR * edge, edge + SCATTER * _deviation(edges)) if steady else math.inf
    details = [each.sharpness for each in likeness.values() if each.sharpness is not None]
    alike = not binary and len(details) >= MIN_FRAMES and _deviation(details) <= _STEADY_DETAILS
    effects = {name: [each.gains[name] for each in likeness.values()] for name in next(iter(likeness.values())).gains}
    correlations = [each.correlation for each in likeness.values()]
    alike_from = float(np.median(correlations)) - SCATTER * max(_MIN_SCATTER, _deviation(correlations))
    for (path, each), moved, width in zip(likeness.items(), shifts, edges, strict=True):
        change = max(each.gains, key=lambda name: each.gains[name])
        restored = each.correlation + each.gains[change]
        if restored >= alike_from and _is_changed(each.gains[change], effects[change]):
            yield "orientation" if "colours" not in change else "colour", path, f"is {change}"
        elif binary and not each.binary:
            yield "noise", path, "has grey levels, but the other frames have only the values 0 and 255"
        elif not binary and each.noise > noise:
            text = f"is noisier than the others: {each.noise:.1f} counts, with a median of {np.median(noises):.1f}"
            yield "noise", path, f"{text} (limit {noise:.1f})"
        elif width > blur:
            text = f"is blurred: its sharpest edges are {width:.1f} px wide, with a median of {edge:.1f}"
            yield "blurred", path, f"{text} (limit {blur:.1f})"
        elif moved > shift:
            text = f"shows that the camera or the sensor moved: the picture is shifted by {moved:.1f} px"
            yield "moved", path, f"{text} (limit {shift:.1f} px)"
        elif alike and each.sharpness is not None and each.sharpness < DETAILS:
            text = f"is blurred: its fine details have {100 * each.sharpness:.0f} % of their usual energy"
            yield "blurred", path, f"{text} (limit {100 * DETAILS:.0f} %)"


def _is_changed(gain: float, gains: Sequence[float]) -> bool:
    """Return whether undoing a change makes a frame more like the others, as clearly as it makes the others unlike."""
    usual = -float(np.median(gains))
    return usual >= _MIN_EFFECT and gain > _HALF_EFFECT * usual and gain + usual > SCATTER * _deviation(gains)
