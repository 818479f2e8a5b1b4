"""Search for the sensor, a dome or a gel, in frames and in runs: their region of interest.

The dome of a TacTip is a disc in its frame, and a gel is mostly a rectangle. The surroundings do not depend on the
contact. The search finds the outline along which the brightness changes everywhere in the same direction. For a circle,
it compares the brightness just outside and just inside along rays; for a rectangle, across the sides. An outline is
judged by its weakest quarter, because pins, lamps and reflections are strong only in places.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.runs.frame_files import grey
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.lab.runs.region import SURE, Region, parse_region, stored_region
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Bools, Floats, Floats32

#: What is said if there is no outline.
NONE_FOUND = "found no dome or gel in these frames; leave it out to use the whole frame, or give a circle or a rect"
#: The width of the reduced image in which outlines are searched first, and the number of rays of a circle.
_COARSE_PX, _RAYS = 160, 72
#: The step of brightness from which an outline is certain, in counts, and the quantile of the steps that is compared.
_SURE_STEP, _WEAKEST = 12.0, 0.25
#: The radii of circles and the smallest side of rectangles that are tried, as fractions of the frame's shorter side.
_RADII, _MIN_SIDE = (0.18, 0.62), 0.4
#: Two distances from an outline, in pixels, and the smallest ratio of the steps across them. It was 0.56 or more at
#: domes and gels, and 0.33 to 0.36 at patches of light, whose brightness changes gradually.
_SHARP_PX, _MIN_SHARP = (4.0, 12.0), 0.45
#: The fraction of a circle that must lie in the frame.
_IN_FRAME = 0.7
#: The value of ``--roi`` for no region. A region that is stored with the runs is then not used either.
NO_REGION = "none"
#: The number of runs, and of frames of each run, in which a region is searched.
_RUNS, _FRAMES = 6, 3
#: The smallest certainty of an outline.
_MIN_SURENESS = 0.5
#: The directions of the rays, shape (2, rays); and the number of circles of the reduced image that are refined.
_RAY = np.stack([f(np.arange(_RAYS) * 2.0 * np.pi / _RAYS) for f in (np.cos, np.sin)])
_CIRCLES = 4
#: The weakest step of an outline in counts, the fraction of the outline that agrees with it, and the outline as text.
_Candidate = tuple[float, float, str]


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
    if sureness >= _MIN_SURENESS and _is_sharp(smooth, text):
        return replace(parse_region(text, height, width), sureness=sureness)
    raise InputError("roi", "auto", NONE_FOUND)


def region_of(runs: Sequence[Run], roi: str | None = None) -> Region | None:
    """Return the region of interest of some runs.

    Args:
        runs: Runs of the same sensor.
        roi: A value of ``--roi``; ``none`` for no region; None for the regions that are stored with the runs. If all
            runs have a region, the result is then the intersection of these regions.

    Raises:
        InputError: The value or a stored region is not allowed, or no region can be found.
    """
    if roi == NO_REGION:
        return None
    if roi == "auto":
        region = found_region(runs)
        if region.sureness < SURE:
            sure = f"found {region.text}, but the certainty is only {100 * region.sureness:.0f} %"
            advice = "look at it with tacbench roi RUNS -o DIR, and give the region yourself"
            raise InputError("roi", "auto", f"{sure}; {advice}")
        return region
    if roi is not None:
        shape = runs[0].info.frame_shape or ()
        if len(shape) < 2:
            raise InputError("roi", roi, "is only for sensors whose frames are images")
        return parse_region(roi, shape[0], shape[1])
    stored = [stored_region(run.folder) for run in runs]
    regions = [region for region in stored if region is not None]
    if len(regions) < len(stored):
        return None
    texts = list(dict.fromkeys(region.text for region in regions))
    if any(region.mask.shape != regions[0].mask.shape for region in regions):
        raise InputError("roi", ", ".join(texts), "are stored with the runs, but are for frames of different sizes")
    mask = np.all([region.mask for region in regions], axis=0)
    text = texts[0] if len(texts) == 1 else f"the intersection of {len(runs)} runs' regions"
    return Region(text=text, mask=mask, sureness=min(region.sureness for region in regions))


def found_region(runs: Sequence[Run]) -> Region:
    """Find the dome or the gel in the frames of some runs without contact.

    Raises:
        InputError: The runs have no images, or no region can be found in them.
    """
    chosen = [runs[at] for at in np.unique(np.linspace(0, len(runs) - 1, _RUNS).astype(int))]
    frames = [frame for run in chosen for frame in run.resting_frames(_FRAMES)]
    if not frames:
        raise InputError("roi", "auto", f"is only for images, but {runs[0].folder} has no readable image")
    return find_region(frames)


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
