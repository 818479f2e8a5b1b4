"""The body of a texture above or below an area of a face, as a mesh. It is added to the mesh of a part, or cut from it.

On a plane without a fade, its upper side is the mesh of a block, which has few triangles. On a cylinder and with a
fade, it is a grid of lines on which triangles interpolate the formula.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from tacbench_cad.geometry.block_mesh import mesh_block
from tacbench_cad.geometry.mesh import Certificate, manifold_of, refuse_too_many
from tacbench_cad.geometry.meshing.top import Top, textured_top
from tacbench_cad.geometry.textured.area import Area
from tacbench_cad.geometry.textured.frame import Frame
from tacbench_cad.geometry.textured.height import Height
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.sampling import Tolerance
from tacbench_cad.util.types import Floats

#: The height of a block below its texture, in mm. It is cut off.
_BLOCK_BASE_MM = 2.0
#: The largest distance between the outline of a texture and its chords in a mesh, in mm.
_OUTLINE_MM = 1e-3
#: The fraction of the tolerance for a texture before it is wound around a cylinder.
_FRACTION = 0.35
#: The largest angle of a chord around a cylinder in a space without a texture.
_SPACE_DEG = 0.5
#: The strips for each of the finest waves and for a fade, on which the derivatives are bounded to choose lines. There
#: are at least and at most so many.
_PER_WAVE, _MIN_STRIPS, _MAX_STRIPS = 12.0, 64, 2000
#: The largest first and second derivative of the window ``(1 - cos(pi x)) / 2``.
_WINDOW = (math.pi / 2.0, math.pi**2 / 2.0)
#: The steps of the error test inside a cell, along each axis.
_TEST_STEPS = 6


@dataclass(frozen=True, eq=False)
class TextureBody:
    """The body of a texture.

    Args:
        body: The body as an object of manifold3d, in the coordinates of the part.
        certificate: The bounds of the distance between its triangles and the formula. They are measured on a grid that
            is six times finer if the texture fades out towards an outline that is not a rectangle.
    """

    body: Any
    certificate: Certificate


def texture_body(height: Height, other_mm: float, tolerance_mm: float) -> TextureBody:
    """Return the body between a texture and a constant height.

    Args:
        height: The height of the texture above its area.
        other_mm: The constant height: below a raised texture, and above a sunk one.
        tolerance_mm: The largest distance between the triangles and the formula.

    Raises:
        InputError: The tolerance needs too many triangles.
    """
    (low, high), area = height.range_mm, height.area
    sunk = height.texturing.sunk
    if area.frame.radius_mm is None and not height.fade_mm:
        block = _block(height, _BLOCK_BASE_MM + high - min(low, other_mm), tolerance_mm)
        mesh, certificate = mesh_block(block)
        below = manifold_of(mesh.vertices + np.array([0.0, 0.0, high - block.height_mm]), mesh.faces)
        ends = (low - 1.0, other_mm) if sunk else (other_mm, high + 1.0)
        space = area.prism(*ends, min(tolerance_mm, _OUTLINE_MM))
        return TextureBody(placed(area, space - below if sunk else space ^ below), certificate)
    if area.frame.radius_mm is not None and not height.fade_mm and height.surface.is_separable:
        s, t, heights, error = _wound(height, min(low, other_mm), tolerance_mm)
    else:
        s, t, error = _grid(height, tolerance_mm)
        heights = height.grid(s, t)
    if area.is_closed:
        heights[-1] = heights[0]
    other = np.full((1, 1), other_mm)
    lower, upper = (heights, other) if sunk else (other, heights)
    if area.is_rectangle:
        body = body_between(area.frame, s, t, lower, upper, area.is_closed)
    else:
        space = area.prism(float(lower.min()) - 1.0, float(upper.max()) + 1.0, min(tolerance_mm, _OUTLINE_MM))
        body = placed(area, body_between(Frame(np.zeros(3), np.eye(3)), s, t, lower, upper, False) ^ space)
    evidence = "measured" if height.fading is None else height.surface.evidence
    certificate = Certificate(distance_mm=error, vertical_mm=error).plus(height.own_error_mm, evidence)
    return TextureBody(body, certificate)


def placed(area: Area, body: Any) -> Any:
    """Move a body from the local coordinates of a plane into the part."""
    return body.transform(np.column_stack([area.frame.axes.T, area.frame.origin]))


def segments_of(area: Area) -> int:
    """Return the number of chords around a cylinder in :func:`space_between`."""
    return max(3, math.ceil(math.degrees(area.size_mm[0] / (area.frame.radius_mm or math.inf)) / _SPACE_DEG))


def space_between(area: Area, low_mm: float, high_mm: float) -> Any:
    """Return the space above an area between two heights as an object of manifold3d. On a cylinder it has facets."""
    if area.frame.radius_mm is None:
        return placed(area, area.prism(low_mm, high_mm))
    s, t = np.linspace(0.0, area.size_mm[0], segments_of(area) + 1), np.array([0.0, area.size_mm[1]])
    return body_between(area.frame, s, t, np.full((1, 1), low_mm), np.full((1, 1), high_mm), area.is_closed)


def _block(height: Height, block_height_mm: float, tolerance_mm: float) -> Block:
    """Return a block with the texture over the rectangle around an area."""
    own_mm = height.own_error_mm
    return Block(
        texture=height.texturing.texture,
        preset="paper",
        nominal_size_mm=height.area.size_mm,
        nominal_mm_per_unit=(*height.mm_per_unit, height.factor),
        nominal_height_mm=block_height_mm,
        origin_uv=height.texturing.origin_uv,
        sampling=Tolerance(mm=max(tolerance_mm, own_mm) + own_mm),
    )


def _wound(height: Height, bottom_mm: float, tolerance_mm: float) -> tuple[Floats, Floats, Floats, float]:
    """Wind the top of a separable block around a cylinder, with more lines along the axis.

    The top is within its certificate of the formula before it is wound, and winding stretches this distance at most by
    the ratio of the radii. On a facet with the slopes g along s and t, the wound surface P has the second derivatives
    ``|P_ss| = |2 i g_s / R - (R + h) / R**2|``, ``|P_st| = |g_t| / R`` and ``P_tt = 0``. With the sides a and b of a
    cell, its triangles are therefore at most ``(a**2 |P_ss| + 2 a b |P_st|) / 8`` from it.

    Returns:
        The lines along s and t, the heights at their crossings, and the largest distance.
    """
    (low, high), area, radius = height.range_mm, height.area, height.area.frame.radius_mm
    block = _block(height, _BLOCK_BASE_MM + high - bottom_mm, _FRACTION * tolerance_mm)
    top = textured_top(block)
    assert isinstance(top, Top) and top.profiles is not None and radius is not None
    s, t = (lines * (size / lines[-1]) for lines, size in zip((top.x, top.y), area.size_mm, strict=True))
    along_s, along_t = top.profiles.a, top.profiles.b
    jump = abs(float(along_s[-1] - along_s[0])) / 2.0 if area.is_closed else 0.0
    reach = radius + max(abs(low), abs(high))
    fit_mm = (top.certificate.distance_mm + jump) * reach / radius
    gap = np.diff(s)
    bend = np.hypot(2.0 * np.diff(along_s) / gap / radius, reach / radius**2)
    turn = float(np.abs(np.diff(along_t)).max()) / (4.0 * radius)
    step = (np.sqrt(turn**2 + bend * max(tolerance_mm - fit_mm, 0.1 * tolerance_mm) / 2.0) - turn) * 4.0 / bend
    counts = np.maximum(1, np.ceil(gap / step)).astype(int)
    chord_mm = float(((gap / counts) ** 2 * bend / 8.0 + gap / counts * turn).max())
    runs = [np.linspace(a, b, n, endpoint=False) for a, b, n in zip(s[:-1], s[1:], counts, strict=True)]
    lines = np.append(np.concatenate(runs), s[-1])
    if area.is_closed:
        along_s[[0, -1]] = (along_s[0] + along_s[-1]) / 2.0
    start = block.formula_datum_mm + high - block.height_mm
    return lines, t, start + np.interp(lines, s, along_s)[:, None] + along_t[None, :], fit_mm + chord_mm


def _grid(height: Height, tolerance_mm: float) -> tuple[Floats, Floats, float]:
    """Place lines so that triangles between points of the formula are within a tolerance of it.

    On a triangle with the legs a and b along s and t, the distance of an interpolation from the surface P is at most
    ``(a**2 |P_ss| + 2 a b |P_st| + b**2 |P_tt|) / 8``. The derivatives are bounded on each cell. On a cylinder, P is
    the point in space, so this bound includes the error of the chords.

    Returns:
        The lines along s and t, and the largest distance, which is only measured if the texture fades out towards an
        outline that is not a rectangle.
    """
    creases = height.surface.creases
    breaks = [_merged(np.append(height.breaks(axis), creases[axis]), height.area.size_mm[axis]) for axis in (0, 1)]
    strips = [_strips(height, axis, breaks[axis]) for axis in (0, 1)]
    if height.fading is None:
        bends = _second_differences(height, strips[0], strips[1])
    else:  # the mixed term is at most a**2 |P_st| + b**2 |P_st|
        ss, across_s, _ = _second_derivatives(height, strips[0], breaks[1])
        _, across_t, tt = _second_derivatives(height, breaks[0], strips[1])
        bends = (ss + across_s).max(axis=1), (across_t + tt).max(axis=0)
    aim, tried = tolerance_mm, 0
    while True:
        s, t = (
            _lines(strip, np.sqrt(bend / (4.0 * aim)), inner)
            for strip, bend, inner in zip(strips, bends, breaks, strict=True)
        )
        refuse_too_many("tolerance_mm", tolerance_mm, 4.0 * len(s) * len(t), "use a coarser tolerance")
        error = _measured(height, s, t) if height.fading is None else _bound(height, s, t)
        tried += 1
        if error <= tolerance_mm and (tried > 1 or error > 0.9 * tolerance_mm):
            return s, t, error
        aim *= min(max(0.97 * tolerance_mm / max(error, 1e-12), 0.3), 12.0) if tried == 1 else 0.93


def _merged(places: Floats, size: float) -> Floats:
    """Return places from 0 to a size in ascending order, without those that are nearly equal."""
    places = np.unique(places[(places >= 0.0) & (places <= size)])
    kept = places[np.append(True, np.diff(places) > 1e-9 * size)]
    return np.append(kept[kept < (1.0 - 1e-9) * size], size)


def _strips(height: Height, axis: int, breaks: Floats) -> Floats:
    """Return lines between which the derivatives are bounded to choose the density of the grid."""
    size = height.area.size_mm[axis]
    waves = max(size * height.surface.highest_frequency[axis] / math.tau, size / (height.fade_mm or size))
    count = int(np.clip(math.ceil(_PER_WAVE * waves), _MIN_STRIPS, _MAX_STRIPS))
    return np.unique(np.concatenate([breaks, np.linspace(0.0, size, count + 1)]))


def _second_differences(height: Height, s: Floats, t: Floats) -> tuple[Floats, Floats]:
    """Return the largest second differences along s for each strip of s, and along t for each strip of t."""
    z = np.where(height.area.inside(s[:, None], t[None, :]), height.grid(s, t), np.nan)
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


def _second_derivatives(height: Height, s: Floats, t: Floats) -> tuple[Floats, Floats, Floats]:
    """Return bounds of |P_ss|, |P_st| and |P_tt| on each cell of a grid, shape (n - 1, m - 1) each."""
    depth_mm, frame = height.depth_mm, height.area.frame
    orders = ((1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
    h_s, h_t, h_ss, h_st, h_tt = (abs(height.factor) * height.surface.cell_bounds(s, t, order) for order in orders)
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


def _window(height: Height, axis: int, lines: Floats) -> tuple[Floats, Floats]:
    """Return bounds of the first two derivatives of the fade along one axis, between neighbouring lines."""
    middle, breaks = (lines[:-1] + lines[1:]) / 2.0, height.breaks(axis)
    if len(breaks) == 2:
        return np.zeros(len(middle)), np.zeros(len(middle))
    active = (middle < breaks[1]) | (middle > breaks[-2])
    first, second = (np.where(active, most / height.fade_mm**k, 0.0) for k, most in enumerate(_WINDOW, start=1))
    return first, second


def _bound(height: Height, s: Floats, t: Floats) -> float:
    ss, st, tt = _second_derivatives(height, s, t)
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
        inside = height.area.inside(at_s[:, None], at_t[None, :])
        error = max(error, float(off[inside].max(initial=0.0)))
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
