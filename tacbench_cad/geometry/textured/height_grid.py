"""A grid of lines on which triangles follow a texture within a tolerance, and the bodies between two such sheets."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from tacbench_cad.geometry.mesh import MAX_TRIANGLES, manifold_of
from tacbench_cad.geometry.textured.field import Height
from tacbench_cad.geometry.textured.frame import Frame
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats

#: The strips for each of the finest waves and for a fade, on which the derivatives are bounded to choose lines. There
#: are at least and at most so many.
_PER_WAVE, _MIN_STRIPS, _MAX_STRIPS = 12.0, 64, 2000
#: The largest first and second derivative of the window ``(1 - cos(pi x)) / 2``.
_WINDOW = (math.pi / 2.0, math.pi**2 / 2.0)
#: The steps of the error test inside a cell, along each axis.
_TEST_STEPS = 3


@dataclass(frozen=True, eq=False)
class HeightGrid:
    """The lines of a grid on which triangles interpolate a texture.

    Args:
        s: The lines along s, ascending.
        t: The lines along t, ascending.
        error_mm: The largest distance between the triangles and the formula.
        evidence: Whether this distance is proved from the derivatives, or measured on a grid that is three times finer.
    """

    s: Floats
    t: Floats
    error_mm: float
    evidence: Literal["proved", "measured"]


def height_grid(height: Height, frame: Frame, tolerance_mm: float) -> HeightGrid:
    """Place lines so that triangles between points of the formula are within a tolerance of it.

    On a triangle with the legs a and b along s and t, the distance of an interpolation from the surface P is at most
    ``(a**2 |P_ss| + 2 a b |P_st| + b**2 |P_tt|) / 8``. The derivatives are bounded on each cell. On a cylinder, P is
    the point in space, so this bound includes the error of the chords.

    Args:
        height: The height above the region.
        frame: The local coordinates.
        tolerance_mm: The largest distance of the triangles from the formula.

    Raises:
        InputError: The tolerance needs too many triangles.
    """
    is_proved = not height.fade.length_mm or height.fade.sides is not None
    breaks = [_breaks(height, axis) for axis in (0, 1)]
    strips = [_strips(height, axis, breaks[axis]) for axis in (0, 1)]
    if is_proved:
        # The mixed term is at most a**2 |P_st| + b**2 |P_st|.
        ss, st, _ = _second_derivatives(height, frame, strips[0], breaks[1])
        along_s = (ss + st).max(axis=1)
        _, st, tt = _second_derivatives(height, frame, breaks[0], strips[1])
        along_t = (st + tt).max(axis=0)
    else:
        along_s, along_t = _second_differences(height, strips[0], strips[1])
    bends = along_s, along_t
    aim, tried = tolerance_mm, 0
    while True:
        s, t = (
            _lines(strip, np.sqrt(bend / (4.0 * aim)), inner)
            for strip, bend, inner in zip(strips, bends, breaks, strict=True)
        )
        if (count := 4 * len(s) * len(t)) > MAX_TRIANGLES:
            raise InputError(
                "tolerance_mm",
                tolerance_mm,
                f"needs {count / 1e6:.3g} million triangles, but {MAX_TRIANGLES / 1e6:g} million are the maximum; use "
                "a coarser tolerance",
            )
        error = _bound(height, frame, s, t) if is_proved else _measured(height, s, t)
        tried += 1
        if error <= tolerance_mm and (tried > 1 or error > 0.9 * tolerance_mm):
            return HeightGrid(s, t, error, "proved" if is_proved else "measured")
        aim *= min(max(0.97 * tolerance_mm / max(error, 1e-12), 0.3), 12.0) if tried == 1 else 0.93


def _breaks(height: Height, axis: int) -> Floats:
    """Return the ends of the region, and the lines along which a second derivative changes suddenly."""
    size, fade = height.size_mm[axis], height.fade
    inner = np.asarray(height.surface.creases[axis], dtype=np.float64)
    if fade.length_mm and fade.sides is not None and fade.sides[axis]:
        inner = np.append(inner, [fade.length_mm, size - fade.length_mm])
    inner = np.unique(inner)
    inner = inner[(inner > 1e-9 * size) & (inner < (1.0 - 1e-9) * size)]
    return np.concatenate([[0.0], inner[np.append(True, np.diff(inner) > 1e-9 * size)[: len(inner)]], [size]])


def _strips(height: Height, axis: int, breaks: Floats) -> Floats:
    """Return lines between which the derivatives are bounded to choose the density of the grid."""
    size = height.size_mm[axis]
    waves = max(size * height.surface.highest_frequency[axis] / math.tau, size / (height.fade.length_mm or size))
    count = int(np.clip(math.ceil(_PER_WAVE * waves), _MIN_STRIPS, _MAX_STRIPS))
    return np.unique(np.concatenate([breaks, np.linspace(0.0, size, count + 1)]))


def _second_differences(height: Height, s: Floats, t: Floats) -> tuple[Floats, Floats]:
    """Return the largest second differences along s for each strip of s, and along t for each strip of t."""
    z = height.grid(s, t)
    if height.fade.inside is not None:
        z = np.where(height.fade.inside(s, t), z, np.nan)
    result: list[Floats] = []
    for own, lines in ((z, s), (z.T, t)):
        slope = np.diff(own, axis=0) / np.diff(lines)[:, None]
        bend = np.abs(np.diff(slope, axis=0)) / ((lines[2:] - lines[:-2]) / 2.0)[:, None]
        most = np.pad(np.nan_to_num(bend).max(axis=1), 1, mode="edge")
        result.append(np.maximum(most[:-1], most[1:]))
    return result[0], result[1]


def _lines(strips: Floats, density: Floats, breaks: Floats) -> Floats:
    """Return lines with a density for each strip, and lines at the breaks."""
    total = np.append(0.0, np.cumsum(np.maximum(density, 1e-9) * np.diff(strips)))
    ends = np.interp(breaks, strips, total).tolist()
    runs = [np.linspace(low, high, math.ceil(high - low) + 1) for low, high in itertools.pairwise(ends)]
    inner = [np.interp(run[1:-1], total, strips) for run in runs]
    return np.unique(np.concatenate([breaks, *inner]))


def _window(height: Height, axis: int, lines: Floats) -> tuple[Floats, Floats]:
    """Return bounds of the first two derivatives of the window along one axis, between neighbouring lines."""
    fade, count = height.fade, len(lines) - 1
    if not fade.length_mm or fade.sides is None or not fade.sides[axis]:
        return np.zeros(count), np.zeros(count)
    first, second = _WINDOW
    middle = (lines[:-1] + lines[1:]) / 2.0
    active = np.minimum(middle, height.size_mm[axis] - middle) < fade.length_mm
    return np.where(active, first / fade.length_mm, 0.0), np.where(active, second / fade.length_mm**2, 0.0)


def _second_derivatives(height: Height, frame: Frame, s: Floats, t: Floats) -> tuple[Floats, Floats, Floats]:
    """Return bounds of |P_ss|, |P_st| and |P_tt| on each cell of a grid, shape (n - 1, m - 1) each."""
    surface, factor, depth_mm = height.surface, abs(height.factor), height.depth_mm

    def bound(*order: int) -> Floats:
        return factor * surface.cell_bounds(s, t, (order[0], order[1]))

    h_s, h_t, h_ss, h_st, h_tt = bound(1, 0), bound(0, 1), bound(2, 0), bound(1, 1), bound(0, 2)
    a, aa = (part[:, None] for part in _window(height, 0, s))
    b, bb = (part[None, :] for part in _window(height, 1, t))
    h_ss = h_ss + 2.0 * h_s * a + depth_mm * aa
    h_st = h_st + h_s * b + h_t * a + depth_mm * a * b
    h_tt = h_tt + 2.0 * h_t * b + depth_mm * bb
    radius = frame.radius_mm
    if radius is None:
        return h_ss, h_st, h_tt
    h_s, h_t = h_s + depth_mm * a, h_t + depth_mm * b
    reach = radius + abs(height.start_mm) + depth_mm
    return np.hypot(h_ss + reach / radius**2, 2.0 * h_s / radius), np.hypot(h_st, h_t / radius), h_tt


def _bound(height: Height, frame: Frame, s: Floats, t: Floats) -> float:
    ss, st, tt = _second_derivatives(height, frame, s, t)
    a, b = np.diff(s)[:, None], np.diff(t)[None, :]
    return float(((a * a * ss + 2.0 * a * b * st + b * b * tt) / 8.0).max())


def _measured(height: Height, s: Floats, t: Floats) -> float:
    """Return the largest distance at points between the lines, inside of the outline. It is used on planes only."""
    z = height.grid(s, t)
    corner, right, above, far = z[:-1, :-1], z[1:, :-1], z[:-1, 1:], z[1:, 1:]
    error = 0.0
    for i, j in itertools.product(range(_TEST_STEPS), repeat=2):
        x, y = i / _TEST_STEPS, j / _TEST_STEPS
        at_s, at_t = s[:-1] + x * np.diff(s), t[:-1] + y * np.diff(t)
        flat = (right - corner) * x + (far - right) * y if x >= y else (above - corner) * y + (far - above) * x
        off = np.abs(height.grid(at_s, at_t) - corner - flat)
        if height.fade.inside is not None:
            off = off[height.fade.inside(at_s, at_t)]
        error = max(error, float(off.max(initial=0.0)))
    return error


def body_between(frame: Frame, s: Floats, t: Floats, lower: Floats, upper: Floats, is_closed: bool) -> Any:
    """Return the body between two sheets over a grid of lines as an object of manifold3d, in the part's coordinates.

    Args:
        frame: The local coordinates.
        s: The lines along s. On a closed cylinder, the last line is the first line again.
        t: The lines along t.
        lower: The heights of the lower sheet, shape (n, m) or broadcast to it.
        upper: The heights of the upper sheet.
        is_closed: Whether the body goes all the way around a cylinder.
    """
    n, m = len(s) - is_closed, len(t)
    shape = (len(s), m)
    points = [
        frame.point(s[:n, None], t[None, :], np.broadcast_to(h, shape)[:n]).reshape(-1, 3) for h in (lower, upper)
    ]
    number = np.arange(n * m).reshape(n, m)
    around = np.concatenate([number, number[:1]]) if is_closed else number
    a, b, c, d = around[:-1, :-1], around[1:, :-1], around[1:, 1:], around[:-1, 1:]
    sheet = np.concatenate([np.stack(corners, axis=-1).reshape(-1, 3) for corners in ((a, b, c), (a, c, d))])
    rims = [around[:, 0], around[::-1, -1]]
    if not is_closed:
        rims = [np.concatenate([around[:-1, 0], around[-1, :-1], around[:0:-1, -1], around[0, ::-1]])]
    walls = []
    for rim in rims:
        start, end = rim[:-1], rim[1:]
        walls += [np.stack([start, end, end + n * m], axis=1), np.stack([start, end + n * m, start + n * m], axis=1)]
    faces = np.concatenate([sheet[:, ::-1], sheet + n * m, *walls])
    return manifold_of(np.concatenate(points), faces)
