"""The region of interest: the part of a frame that shows the sensor. The user gives it, or the program finds it.

The dome of a TacTip is a disc in its frame, and a gel is mostly a rectangle. The surroundings do not depend on the
contact. :func:`find_region` searches the outline along which the brightness changes everywhere in the same direction.
For a circle, it compares the brightness just outside and just inside along rays; for a rectangle, across the sides. An
outline is judged by its weakest quarter, because pins, lamps and reflections are strong only in places.
"""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np

from tacbench_cad.extensions.markers.markers import MarkerFinder, grey
from tacbench_cad.extensions.markers.tracking import MarkerTracker
from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.runs.pictures import MAX_MEGAPIXELS, decoded, write_png
from tacbench_cad.util import door
from tacbench_cad.util.convert import Bounds, read_json
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.files import refusing, write_json
from tacbench_cad.util.types import Bools, Floats, Floats32

#: The allowed values of ``--roi``.
SYNTAX = "auto, circle:X,Y,R, rect:X0,Y0,X1,Y1 (pixels from the top left) or a PNG file, white where the sensor is"
#: The file of a run's region, and the picture of a region that was given as a picture.
REGION_FILE, MASK_FILE = "roi.json", "roi.png"
#: The certainty from which a region that was found may be used without asking.
SURE = 0.8
#: The smallest allowed number of pixels of a region.
MIN_PIXELS = 100
#: What is said if there is no outline.
NONE_FOUND = "found no dome or gel in these frames; leave it out to use the whole frame, or give a circle or a rect"
_NUMBER = r"(-?\d+(?:\.\d+)?)"
_CIRCLE = re.compile(rf"circle[: ]{_NUMBER},{_NUMBER},{_NUMBER}")
_RECTANGLE = re.compile(rf"rect[: ]{_NUMBER},{_NUMBER},{_NUMBER},{_NUMBER}")
#: The width of the reduced image in which outlines are searched first, and the number of rays of a circle.
_COARSE_PX, _RAYS = 160, 72
#: The step of brightness from which an outline is certain, in counts, and the quantile of the steps that is compared.
_SURE_STEP, _WEAKEST = 12.0, 0.25
#: The radii of circles and the smallest side of rectangles that are tried, as fractions of the frame's shorter side.
_RADII, _MIN_SIDE = (0.18, 0.62), 0.4
#: Two distances from an outline, in pixels, and the smallest ratio of the steps across them. It was 0.56 or more at
#: domes and gels, and 0.33 to 0.36 at patches of light, whose brightness changes gradually.
_SHARP_PX, _MIN_SHARP = (4.0, 12.0), 0.45
#: The number of frames in which markers are searched, and the smallest fraction of the frame's pixels that a circle
#: around them leaves out.
_MARKER_FRAMES, _MIN_OUTSIDE = 3, 0.05
#: The fraction of a circle that must lie in the frame.
_IN_FRAME = 0.7


@dataclass(frozen=True, kw_only=True, eq=False)
class Region:
    """A region of interest.

    Args:
        text: The region as a value of ``--roi``: ``circle:304,248,210``.
        mask: True for the pixels in the region, shape (height, width).
        sureness: The certainty that this region shows the sensor, from 0 to 1; 1 for a region that a user gave.
    """

    text: str
    mask: Bools
    sureness: float = 1.0

    @property
    def outside(self) -> float:
        """The fraction of the frame's pixels outside the region."""
        return 1.0 - float(np.mean(self.mask))

    @property
    def digest(self) -> str:
        """A hash of the mask."""
        return hashlib.sha256(f"{self.mask.shape}".encode() + np.packbits(self.mask).tobytes()).hexdigest()[:16]

    def scaled(self, height: int, width: int) -> Bools:
        """Return the mask at another resolution, with the pixels that are at least half in the region."""
        import cv2

        if self.mask.shape == (height, width):
            return self.mask
        small = cv2.resize(self.mask.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA)
        return np.asarray(small >= 0.5)

    def drawn(self, frame: Frame) -> Frame:
        """Draw the region's outline in a frame in red, and darken the pixels outside.

        Raises:
            InputError: The frame has another size.
        """
        import cv2

        require_size(self.mask, frame)
        picture = frame.copy() if frame.ndim == 3 else cv2.cvtColor(frame, cv2.COLOR_GRAY2BGR)
        picture[~self.mask] //= 2
        outline = cv2.findContours(self.mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
        cv2.drawContours(picture, outline, -1, (0, 0, 255), max(1, round(frame.shape[1] / 320)))
        return np.asarray(picture)


def require_size(mask: Bools, frame: Frame) -> None:
    """Check that a frame has the size of a mask.

    Raises:
        InputError: The frame has another size.
    """
    if frame.shape[:2] != mask.shape:
        size = " x ".join(map(str, mask.shape[::-1]))
        raise InputError(
            "region of interest", size, f"is for frames of that size; this one has {frame.shape[1]} x {frame.shape[0]}"
        )


def parse_region(text: str, height: int, width: int) -> Region:
    """Make a region from a text or a file.

    Args:
        text: ``circle:X,Y,R``, ``rect:X0,Y0,X1,Y1`` or the path of a PNG.
        height: The height of the frames.
        width: The width of the frames.

    Raises:
        InputError: The text has another form, the region has too few pixels in the frame, or the picture has another
            size.
    """
    y, x = np.mgrid[:height, :width].astype(np.float64)
    if match := _CIRCLE.fullmatch(text):
        column, row, radius = map(float, match.groups())
        mask = (x - column) ** 2 + (y - row) ** 2 <= radius**2
    elif match := _RECTANGLE.fullmatch(text):
        left, top, right, bottom = map(float, match.groups())
        mask = (x >= left) & (x <= right) & (y >= top) & (y <= bottom)
    elif text.lower().endswith(".png"):
        mask = _mask_of(Path(text), height, width)
    else:
        raise InputError("roi", text, f"must be {SYNTAX}")
    if mask.sum() < MIN_PIXELS:
        raise InputError("roi", text, f"has {int(mask.sum())} pixels in a frame of {width} x {height}; at least 100")
    return Region(text=text.replace(" ", ":", 1) if match else text, mask=mask)


def _mask_of(path: Path, height: int, width: int, within: Path | None = None) -> Bools:
    """Read a picture, and return its pixels that are brighter than half of the largest value."""
    try:
        picture = decoded(door.read_bytes(path, "roi", "image", within=within), str(path))
    except CheckFailedError as error:
        raise InputError("roi", str(path), str(error)) from None
    if picture.shape[:2] != (height, width):
        size = f"{picture.shape[1]} x {picture.shape[0]}"
        raise InputError("roi", str(path), f"is {size} pixels; the frames are {width} x {height}")
    grey_picture = picture if picture.ndim == 2 else picture[..., :3].max(axis=2)
    return np.asarray(grey_picture > np.iinfo(picture.dtype).max // 2)


def find_region(frames: Sequence[Frame]) -> Region:
    """Find the dome or the gel in frames, preferably frames without contact.

    Args:
        frames: The frames, whose median is examined.

    Raises:
        InputError: There is no frame, a frame is not an image, or no outline can be found.
    """
    import cv2

    if not frames:
        raise InputError("frames", 0, "must be at least one frame that shows the sensor")
    image = np.median([grey(frame) for frame in frames], axis=0).astype(np.float32)
    height, width = image.shape
    scale = max(1.0, width / _COARSE_PX)
    size = (round(width / scale), round(height / scale))
    small = cv2.GaussianBlur(cv2.resize(image, size, interpolation=cv2.INTER_AREA), (0, 0), 1.0)
    smooth = cv2.GaussianBlur(image, (0, 0), max(1.0, 0.4 * scale))
    candidates = [_circle(small, smooth, scale), _rectangle(small, smooth, scale)]
    step, agreeing, text = max(candidates, key=lambda each: each[0] * each[1] ** 2)
    sureness = round(agreeing * min(1.0, step / _SURE_STEP), 3)
    if sureness >= _OF_MARKERS and _is_sharp(smooth, text):
        return replace(parse_region(text, height, width), sureness=sureness)
    try:
        region = replace(parse_region(_around_markers(frames), height, width), sureness=_OF_MARKERS)
    except InputError:
        region = None
    if region is None or region.outside < _MIN_OUTSIDE:
        raise InputError("roi", "auto", NONE_FOUND)
    return region


def _is_sharp(smooth: Floats32, text: str) -> bool:
    """Return whether the brightness changes suddenly at an outline."""
    kind, _, numbers = text.partition(":")
    place = [float(number) for number in numbers.split(",")]
    if kind == "circle":
        column, row, radius = place
        x, y = column + radius * _RAY[0], row + radius * _RAY[1]
        steps = [_steps(smooth, x, y, _RAY, reach) for reach in _SHARP_PX]
    else:
        steps = [_box_steps(smooth, place, reach) for reach in _SHARP_PX]
    known = np.isfinite(steps).all(axis=0)
    near, far = (abs(float(np.median(step[known]))) if known.any() else 0.0 for step in steps)
    return near >= _MIN_SHARP * far > 0.0


def _around_markers(frames: Sequence[Frame]) -> str:
    """Return the circle around the markers, enlarged by a spacing, for domes whose surroundings are equally dark.

    Raises:
        InputError: There are no markers.
    """
    import cv2

    some = frames[:: math.ceil(len(frames) / _MARKER_FRAMES)]
    finder = MarkerFinder.learn(some)
    centres = max((finder.find(frame).centres_px for frame in some), key=len)
    (x, y), radius = cv2.minEnclosingCircle(centres.astype(np.float32))
    return f"circle:{x:.1f},{y:.1f},{radius + MarkerTracker(reference_px=centres).spacing_px:.1f}"


#: The directions of the rays, shape (2, rays); and the number of circles of the reduced image that are refined.
_RAY = np.stack([f(np.arange(_RAYS) * 2.0 * np.pi / _RAYS) for f in (np.cos, np.sin)])
_CIRCLES = 4
#: The certainty of a circle around the markers, if no outline is visible.
_OF_MARKERS = 0.5
#: The weakest step of an outline in counts, the fraction of the outline that agrees with it, and the outline as text.
_Candidate = tuple[float, float, str]


def _circle(small: Floats32, smooth: Floats32, scale: float) -> _Candidate:
    """Return the circle with the largest step on all sides."""
    height, width = small.shape
    column, row = (each.ravel() for each in np.meshgrid(*(np.arange(0.2 * n, 0.8 * n, 3.0) for n in (width, height))))
    best: list[tuple[float, float, float, float]] = []
    for radius in np.arange(_RADII[0] * height, _RADII[1] * height, 1.5):
        step = _steps(small, column[:, None] + radius * _RAY[0], row[:, None] + radius * _RAY[1], _RAY, 2.0)
        value = _weakest(step)
        at = int(np.argmax(value))
        best.append((float(value[at]), column[at], row[at], radius))
    peaks = [
        each
        for before, each, after in zip([(0.0,), *best], best, [*best[1:], (0.0,)], strict=False)
        if each[0] > 1.0 and each[0] >= max(before[0], after[0])
    ]
    refined = (_refined(smooth, place, scale) for _, *place in sorted(peaks, reverse=True)[:_CIRCLES])
    return max(refined, key=lambda each: each[0] * each[1] ** 2, default=(0.0, 0.0, ""))


def _refined(smooth: Floats32, place: Sequence[float], scale: float) -> _Candidate:
    """Refine a circle of the reduced image at full resolution, by three fits through the steepest place of each ray."""
    x, y, r = (scale * (each + half) - half for each, half in zip(place, (0.5, 0.5, 0.0), strict=True))
    for reach in (3.0 * scale, 1.5 * scale, 1.5 * scale):
        x, y, r = _through_edges(smooth, (x, y, r), reach)
    step = _steps(smooth, x + r * _RAY[0], y + r * _RAY[1], _RAY, 2.0 * scale)
    return (*_judged(step), f"circle:{x:.1f},{y:.1f},{r:.1f}")


def _through_edges(image: Floats32, circle: tuple[float, float, float], reach: float) -> tuple[float, float, float]:
    """Fit a circle through the steepest place of each ray, within a certain distance of the given circle."""
    x, y, r = circle
    offset = np.arange(-reach, reach + 0.25, 0.5)
    radii = r + offset[:, None]
    step = _steps(image, x + radii * _RAY[0], y + radii * _RAY[1], _RAY, 1.5)
    sign = 1.0 if np.nanmedian(step[len(offset) // 2]) >= 0.0 else -1.0
    there: Bools = np.asarray(np.isfinite(step).all(axis=0))
    ends = r + offset[np.argmax(np.where(np.isfinite(step), sign * step, -np.inf), axis=0)]
    return _fitted(x + ends * _RAY[0], y + ends * _RAY[1], there, circle)


def _fitted(x: Floats, y: Floats, there: Bools, start: tuple[float, float, float]) -> tuple[float, float, float]:
    """Fit a circle through points, without the third of the points that is farthest from it."""
    use = there.copy()
    solution = np.array(start)
    for _ in range(3):
        if use.sum() < 8:
            return start
        design = np.column_stack([2.0 * x[use], 2.0 * y[use], np.ones(int(use.sum()))])
        a, b, c = np.linalg.lstsq(design, x[use] ** 2 + y[use] ** 2, rcond=None)[0]
        solution = np.array([a, b, np.sqrt(max(c + a**2 + b**2, 1.0))])
        away = np.abs(np.hypot(x - a, y - b) - solution[2])
        use = there & (away <= max(1.0, float(np.quantile(away[there], 0.67))))
    return float(solution[0]), float(solution[1]), float(solution[2])


def _rectangle(small: Floats32, smooth: Floats32, scale: float) -> _Candidate:
    """Return the upright rectangle with the largest step across its sides. A side at the frame's edge has no step."""
    sides = [_side_places(small), _side_places(small.T)]
    least = _MIN_SIDE * min(small.shape)
    best: tuple[float, float, list[float]] = (0.0, 0.0, [0.0] * 4)
    for left, right in ((a, b) for a in sides[0] for b in sides[0] if b - a >= least):
        for top, bottom in ((a, b) for a in sides[1] for b in sides[1] if b - a >= least):
            box = [scale * (each + 0.5) - 0.5 for each in (left, top, right, bottom)]
            step, agreeing = _judged(_box_steps(smooth, box, 2.0 * scale))
            if step * agreeing**2 > best[0] * best[1] ** 2:
                best = step, agreeing, box
    for side in range(4):  # move each side to the steepest step
        moved = [[*best[2][:side], best[2][side] + by, *best[2][side + 1 :]] for by in np.arange(-scale, scale, 0.5)]
        best = (*best[:2], max(moved, key=lambda box: _judged(_box_steps(smooth, box, 1.0))[0]))
    last = np.array([smooth.shape[1] - 1.0, smooth.shape[0] - 1.0] * 2)
    return (*best[:2], "rect:" + ",".join(f"{each:.1f}" for each in np.clip(best[2], 0.0, last)))


def _side_places(small: Floats32) -> list[float]:
    """Return the columns in which the brightness of many rows changes strongly, and the two edges of the frame."""
    change = np.abs(small[:, 2:] - small[:, :-2])
    strength = np.quantile(change, 0.6, axis=0)
    order = [int(at) for at in np.argsort(-strength) if strength[at] > 1.0]
    places: list[float] = []
    for at in order:
        if len(places) < 6 and all(abs(at + 1 - other) > 3 for other in places):
            places.append(at + 1.0)
    return sorted([-0.5, *places, small.shape[1] - 0.5])


def _box_steps(image: Floats32, box: Sequence[float], reach: float) -> Floats:
    """Return the steps across a box's sides from inside to outside, shape (1, points); NaN outside the frame."""
    left, top, right, bottom = box
    part = np.linspace(0.06, 0.94, _RAYS // 4)
    across, down = left + part * (right - left), top + part * (bottom - top)
    x = np.concatenate([across, across, np.full_like(down, left), np.full_like(down, right)])
    y = np.concatenate([np.full_like(across, top), np.full_like(across, bottom), down, down])
    outward = np.repeat([[0.0, 0.0, -1.0, 1.0], [-1.0, 1.0, 0.0, 0.0]], len(part), axis=1)
    return _steps(image, x[None], y[None], outward, reach)


def _steps(image: Floats32, x: Floats, y: Floats, outward: Floats, reach: float) -> Floats:
    """Return the brightness outside minus inside at places; NaN if either lies beyond the frame."""
    height, width = image.shape

    def at(sign: float) -> Floats:
        column, row = np.rint(x + sign * reach * outward[0]), np.rint(y + sign * reach * outward[1])
        there = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        column, row = np.clip(column, 0, width - 1).astype(np.int64), np.clip(row, 0, height - 1).astype(np.int64)
        return np.where(there, image[row, column], np.nan)

    return at(1.0) - at(-1.0)


def _weakest(step: Floats) -> Floats:
    """Return the step that at least three quarters of a row reach in the same direction; 0 if too few are known."""
    ordered = np.sort(step, axis=1)  # NaN comes last
    count = np.sum(np.isfinite(step), axis=1)
    enough = count >= _IN_FRAME * step.shape[1]
    low = np.take_along_axis(ordered, (_WEAKEST * count).astype(np.int64)[:, None], axis=1)[:, 0]
    high = np.take_along_axis(ordered, np.maximum(((1.0 - _WEAKEST) * count).astype(np.int64) - 1, 0)[:, None], axis=1)
    return np.where(enough, np.maximum(np.nan_to_num(low), -np.nan_to_num(high[:, 0])), 0.0)


def _judged(step: Floats) -> tuple[float, float]:
    """Return the lower quartile of an outline's steps, and the fraction of steps of at least a third of the median."""
    known = step[np.isfinite(step)]
    if known.size < step.size / 2:
        return 0.0, 0.0
    usual = float(np.median(known))
    agreeing = np.sum(np.sign(usual) * known >= abs(usual) / 3.0) / step.size
    return max(0.0, float(np.quantile(np.sign(usual) * known, _WEAKEST))), float(agreeing)


def store_region(folder: Path, region: Region) -> None:
    """Store a region with a run, in ``roi.json``, and in ``roi.png`` if it was given as a picture.

    Raises:
        InputError: The folder cannot be written.
    """
    text = region.text
    if text.lower().endswith(".png"):
        text = MASK_FILE
        write_png(folder / MASK_FILE, region.mask.astype(np.uint8) * 255)
    height, width = region.mask.shape
    write_json(folder / REGION_FILE, {"roi": text, "width": width, "height": height, "sureness": region.sureness})


def remove_region(folder: Path) -> None:
    """Remove the region that is stored with a run.

    Raises:
        InputError: The folder cannot be written.
    """
    with refusing(folder):
        for name in (REGION_FILE, MASK_FILE):
            (folder / name).unlink(missing_ok=True)


def stored_region(folder: Path) -> Region | None:
    """Read the region that is stored with a run; None if there is none.

    Raises:
        InputError: ``roi.json`` or its picture is damaged.
    """
    path = folder / REGION_FILE
    if not path.exists():
        return None
    kept = read_json(path, _Kept, "region of interest", within=folder)
    door.require_within("width", kept.width * kept.height / 1e6, MAX_MEGAPIXELS, "megapixels", str(path))
    if kept.roi == MASK_FILE:
        mask = _mask_of(folder / MASK_FILE, kept.height, kept.width, within=folder)
        return Region(text=str(folder / MASK_FILE), mask=mask, sureness=kept.sureness)
    if kept.roi.lower().endswith(".png"):
        raise InputError(f"{path} roi", kept.roi, f"must be a circle, a rect or {MASK_FILE}")
    return replace(parse_region(kept.roi, kept.height, kept.width), sureness=kept.sureness)


@dataclass(frozen=True, kw_only=True)
class _Kept:
    """The contents of ``roi.json``."""

    roi: str
    width: Annotated[int, Bounds(1, 100_000)]
    height: Annotated[int, Bounds(1, 100_000)]
    sureness: Annotated[float, Bounds(0.0, 1.0)] = 1.0
