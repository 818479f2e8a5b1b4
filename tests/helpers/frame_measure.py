"""Measure frames of a TacTip: geometry, levels, sharpness, reflections, noise, drift and compression.

``inside`` is less than 0.98 R from the dome's centre, ``outside`` more than 1.02 R; the outline belongs to neither.
The field of pins has three zones: the centre (up to 0.3 of its radius), the middle (0.4 to 0.65) and the rim (0.9 to
1.1).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, gaussian_laplace, label, map_coordinates, maximum_filter, spline_filter
from scipy.optimize import least_squares
from scipy.spatial import cKDTree

Floats = NDArray[np.float64]
ZONES = {"centre": (0.0, 0.3), "middle": (0.4, 0.65), "rim": (0.9, 1.1)}
QUANTILES = (5, 50, 95)
#: The lowest grey level of a reflection, and that of a saturated pixel.
BRIGHT, SATURATED = 240, 250


@dataclass(frozen=True, kw_only=True)
class Dome:
    """The centre and radius of the dome's outline and the standard deviation of its blur, all in px."""

    x: float
    y: float
    radius: float
    blur: float = 0.0


def grey_of(frame: NDArray[Any]) -> NDArray[np.uint8]:
    """Return the BT.601 grey levels in whole counts, as OpenCV computes them."""
    return np.asarray(frame if frame.ndim == 2 else cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY), dtype=np.uint8)


def _edges(profiles: Floats, step: float, reach: float) -> tuple[Floats, float]:
    """Return the edge of each profile, in px, and the blur of their common edge, in px.

    The edge of a profile is where it crosses the mean level of its two ends. For the blur the profiles are aligned at
    their edges. It is half the distance between 16 and 84 % of the step of their median, within ``reach``.
    """
    count = profiles.shape[1]
    low, high = profiles[:, : count // 6].mean(axis=1), profiles[:, -(count // 6) :].mean(axis=1)
    above = profiles > ((low + high) / 2.0)[:, None]
    # The crossing nearest to the middle of the profile.
    crossing = (above[:, 1:] != above[:, :-1]) * (count - np.abs(np.arange(count - 1) - count / 2.0))
    rows, at = np.arange(len(profiles)), np.argmax(crossing, axis=1)
    before, after = profiles[rows, at], profiles[rows, at + 1]
    place = at + ((low + high) / 2.0 - before) / np.where(after == before, np.inf, after - before)
    place[crossing.max(axis=1) == 0] = np.nan
    offsets = np.arange(-reach, reach, 0.05)
    laid = [
        np.interp(offsets / step + middle, np.arange(count), profile)
        for middle, profile in zip(place, profiles, strict=True)
        if np.isfinite(middle)
    ]
    edge = np.median(laid, axis=0)
    rising = np.maximum.accumulate(edge if edge[-1] > edge[0] else -edge)
    levels = np.interp([0.16, 0.84], [0.0, 1.0], rising[[0, -1]])
    first, last = np.interp(levels, rising, offsets)
    return place * step, float(last - first) / 2.0


def find_dome(grey: Floats, near: Dome) -> Dome:
    """Fit a circle to the outline, starting from a circle near it.

    The outline is sampled along 360 rays and fitted three times. After each fit the tenth of the points that is
    farthest from the circle is left out.
    """
    step = 0.25
    radii = np.arange(near.radius - 14.0, near.radius + 14.0, step)
    turn = np.linspace(0.0, 2.0 * np.pi, 360, endpoint=False)
    x, y = near.x + np.outer(np.cos(turn), radii), near.y + np.outer(np.sin(turn), radii)
    inside = np.all((x >= 0) & (y >= 0) & (x <= grey.shape[1] - 1) & (y <= grey.shape[0] - 1), axis=1)
    place, blur = _edges(map_coordinates(grey, [y[inside], x[inside]], order=1), step, 6.0)
    points = np.stack(
        [near.x + np.cos(turn[inside]) * (radii[0] + place), near.y + np.sin(turn[inside]) * (radii[0] + place)]
    )
    points = points[:, np.isfinite(place)]

    def off(circle: Floats) -> Floats:
        return np.asarray(np.hypot(points[0] - circle[0], points[1] - circle[1]) - circle[2])

    circle = np.array([near.x, near.y, near.radius])
    for _ in range(3):
        circle = least_squares(off, circle, loss="soft_l1").x
        away = np.abs(off(circle))
        points = points[:, away <= max(np.quantile(away, 0.9), 0.1)]
    return Dome(x=float(circle[0]), y=float(circle[1]), radius=float(circle[2]), blur=blur)


def find_pins(grey: Floats, dome: Dome, sigma: float, threshold: float) -> Floats:
    """Return columns and rows of the peaks of the Laplacian of a Gaussian inside the dome, shape (n, 2)."""
    response = -(sigma**2) * gaussian_laplace(grey, sigma)
    peaks = (response == maximum_filter(response, size=2 * round(sigma) + 1)) & (response > threshold)
    rows, columns = np.nonzero(peaks)
    points = np.stack([columns, rows], axis=1).astype(np.float64)
    kept = np.hypot(points[:, 0] - dome.x, points[:, 1] - dome.y) < 0.92 * dome.radius
    for axis, (dy, dx) in enumerate(((0, 1), (1, 0))):
        left, right = response[rows - dy, columns - dx], response[rows + dy, columns + dx]
        points[:, axis] += (left - right) / (2.0 * (left + right - 2.0 * response[rows, columns]))
    return np.asarray(points[kept])


def block_ratio(grey: Floats) -> float:
    """Return the mean step between neighbouring pixels across the borders of 8-px blocks over that within blocks."""
    ratios = []
    for image in (grey, grey.T):
        steps = np.abs(np.diff(image, axis=1)).mean(axis=0)
        border = np.arange(steps.size) % 8 == 7
        ratios.append(steps[border].mean() / steps[~border].mean())
    return float(np.mean(ratios))


def frame_statistics(
    frame: NDArray[Any], near: Dome, field: float, log: tuple[float, float], visible: Floats | None = None
) -> dict[str, float]:
    """Return the statistics of a single frame.

    Args:
        frame: The frame, uint8, shape (height, width) or (height, width, 3) in BGR.
        near: A circle near the dome's outline.
        field: The radius of the field of pins, as a fraction of the dome's radius.
        log: Sigma and threshold of the Laplacian of a Gaussian that finds the pins.
        visible: The known positions of the visible pins; None for the pins that the Laplacian finds.

    Raises:
        ValueError: Fewer than 10 pins are visible.
    """
    counts = grey_of(frame)
    grey = counts.astype(np.float64)
    smooth = spline_filter(grey)
    dome = find_dome(grey, near)
    rows, columns = np.indices(grey.shape)
    radius = _radius(grey, dome)
    inside, outside = radius < 0.98, radius > 1.02
    values: dict[str, float] = {
        "dome centre, column": dome.x,
        "dome centre, row": dome.y,
        "dome radius": dome.radius,
        "blur of the dome's edge": dome.blur,
    }
    pins = find_pins(grey, dome, *log)
    values["peaks of the Laplacian"] = len(pins)
    pins = pins if visible is None else visible
    values["pins seen"] = len(pins)
    if len(pins) < 10:
        raise ValueError(f"only {len(pins)} pins were found in the dome")
    nearest, _ = cKDTree(pins).query(np.stack([columns.ravel(), rows.ravel()], axis=1))
    between = nearest.reshape(grey.shape) > 8.0
    place = np.hypot(*(pins - (dome.x, dome.y)).T) / dome.radius / field
    spacing = cKDTree(pins).query(pins, k=2)[0][:, 1]
    bare = gaussian_filter(grey, 0.8)
    for zone, (low, high) in ZONES.items():
        chosen = pins[(place >= low) & (place < high)]
        ring = (radius >= low * field) & (radius < high * field)
        width, blur = _pin_edges(smooth, chosen)
        values[f"pin width, {zone}"] = width
        values[f"pin spacing, {zone}"] = float(np.median(spacing[(place >= low) & (place < high)]))
        values[f"pin peak, {zone}"] = float(np.median(map_coordinates(bare, chosen.T[::-1], order=1)))
        values[f"skin between pins, {zone}"] = float(np.median(grey[ring & between & (radius < field)]))
        values[f"blur of a pin's edge, {zone}"] = blur
    values["skin beyond the pins"] = float(np.median(grey[(radius > field + 8.0 / dome.radius) & (radius < 0.95)]))
    values["grey at 1.02 R"] = float(grey[np.abs(radius - 1.02) < 0.01].mean())
    regions = {"whole frame": np.ones_like(inside), "inside": inside, "outside": outside}
    for name, region in regions.items():
        values[f"saturated, {name}"] = 100.0 * float(np.mean(grey[region] >= SATURATED))
        values[f"mean, {name}"] = float(grey[region].mean())
    for quantile, value in zip(QUANTILES, np.percentile(grey[inside], QUANTILES), strict=True):
        values[f"{quantile} % quantile, inside"] = float(value)
    for name in ("whole frame", "inside"):
        for sigma in (0, 2):
            # The counts are whole numbers; their rounding adds 20 / 12 to the variance.
            blurred = cv2.GaussianBlur(counts, (0, 0), sigma) if sigma else counts
            laplacian = cv2.Laplacian(blurred, cv2.CV_64F)
            values[f"Laplacian after a blur of {sigma}, {name}"] = float(laplacian[regions[name]].var())
    spots = _bright_spots(grey, inside, pins, values["pin width, middle"], values["pin peak, middle"])
    values["bright spots"] = len(spots)
    values["bright spots, largest diameter"] = max(spots, default=0.0)
    values["step ratio of blocks"] = block_ratio(grey)
    if frame.ndim == 3:
        colours = {
            "of the pins": np.median(frame[nearest.reshape(grey.shape) < 2.0], axis=0),
            "of the skin": np.median(frame[between & (radius < field)], axis=0),
        }
        values |= {f"{channel} {where}": bgr[i] for where, bgr in colours.items() for i, channel in enumerate("BGR")}
    return values


def _pin_edges(smooth: Floats, pins: Floats) -> tuple[float, float]:
    """Return the medians of the pins' full width at half maximum and of the blur of their edges, from 12 rays each."""
    step = 0.25
    radii = np.arange(0.0, 10.0, step)
    turn = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    widths, blurs = [], []
    for pin in pins:
        x, y = pin[0] + np.outer(np.cos(turn), radii), pin[1] + np.outer(np.sin(turn), radii)
        profiles = map_coordinates(smooth, [y, x], order=3, prefilter=False, mode="nearest")
        # Each ray ends at its darkest point, because the next pin begins beyond it.
        ends = np.argmin(profiles, axis=1)
        profiles = np.array(
            [np.where(np.arange(radii.size) > end, line[end], line) for line, end in zip(profiles, ends, strict=True)]
        )
        place, blur = _edges(profiles, step, 3.5)
        widths.append(2.0 * float(np.nanmedian(place)))
        blurs.append(blur)
    return float(np.median(widths)), float(np.median(blurs))


def _bright_spots(
    grey: Floats, inside: NDArray[np.bool_], pins: Floats, pin_width: float, pin_peak: float
) -> list[float]:
    """Return the diameters of circles with the same areas as the reflections of 4 px or more inside the dome.

    A bright spot on a pin counts as the pin itself if it is not larger than a pin and the pins are about as bright.
    """
    spots, count = label((grey >= BRIGHT) & inside)
    nearest = cKDTree(pins)
    diameters = []
    for number in range(1, count + 1):
        rows, columns = np.nonzero(spots == number)
        diameter = 2.0 * float(np.sqrt(rows.size / np.pi))
        on_pin = nearest.query((columns.mean(), rows.mean()))[0] < pin_width / 2.0
        if rows.size >= 4 and not (on_pin and diameter <= pin_width and pin_peak > BRIGHT - 15):
            diameters.append(diameter)
    return diameters


def noise_by_level(frames: Sequence[NDArray[Any]], levels: Sequence[tuple[int, int]], near: Dome) -> list[float]:
    """Return the frame-to-frame standard deviation of a pixel for each range of grey levels.

    It comes from the quietest pairs of consecutive frames. Slow changes over the image are light or motion, so a
    Gaussian average of 2 px is subtracted.

    Args:
        frames: At least two frames of one pose; at most the quietest 15 pairs are used.
        levels: The lower and upper end of each range.
        near: The dome; only pixels inside it are used.
    """
    # The fraction of white noise that remains when its Gaussian average is subtracted.
    impulse = np.zeros((33, 33))
    impulse[16, 16] = 1.0
    kept = float(np.sqrt(np.sum((impulse - gaussian_filter(impulse, 2.0)) ** 2)))
    greys = [grey_of(frame).astype(np.float64) for frame in frames]
    inside = _radius(greys[0], near) < 0.98
    pairs = sorted(itertools.pairwise(greys), key=lambda pair: float(np.std((pair[0] - pair[1])[inside])))
    squares: list[list[Floats]] = [[] for _ in levels]
    for first, second in pairs[:15]:
        difference = first - second
        difference = difference - gaussian_filter(difference, 2.0)
        mean = gaussian_filter((first + second) / 2.0, 0.7)
        for i, (low, high) in enumerate(levels):
            squares[i].append(difference[inside & (mean >= low) & (mean < high)] ** 2)
    pixels = [np.concatenate(square) for square in squares]
    return [float(np.sqrt(square.mean() / 2.0)) / kept if square.size else float("nan") for square in pixels]


def light_outside(frames: Sequence[NDArray[Any]], near: Dome) -> Floats:
    """Return the mean grey level outside the dome in each frame, shape (n,)."""
    outside = _radius(frames[0], near) > 1.02
    return np.array([grey_of(frame)[outside].mean() for frame in frames])


def _radius(image: NDArray[Any], dome: Dome) -> Floats:
    """Return the distance of each pixel from the dome's centre, as a fraction of the dome's radius."""
    rows, columns = np.indices(image.shape[:2])
    return np.asarray(np.hypot(columns - dome.x, rows - dome.y) / dome.radius)
