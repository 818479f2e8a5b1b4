"""A small software renderer: shaded pictures of meshes from arrays alone, with the same pixels on every run.

It has an orthographic camera, a depth buffer, one lamp and a sky; hollows and edges are darkened from the depth buffer.
Triangles are cut into pixel rows, and rows into pixels, by array arithmetic. The time therefore depends on the number
of pixels and not on the shapes of the triangles.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacbench_cad.geometry.mesh import Mesh, cross
from tacbench_cad.geometry.relief import upward
from tacbench_cad.util.types import Bools, Bytes, Floats, Indices, Ints

Colour = tuple[float, float, float]
Relief = Callable[[Floats, Floats], tuple[Floats, Floats, Floats]]

#: Linear colour of a body under full light, where nothing else is said.
MATERIAL: Colour = (0.57, 0.64, 0.71)
#: Exponent between sRGB and linear colours.
_GAMMA = 2.2
#: Samples along each side of a finished pixel.
_SAMPLES = 2
#: Strength of the lamp, of the sky, and of the light that comes from everywhere.
_LAMP, _SKY, _AMBIENT = 0.80, 0.34, 0.04
#: Sizes of the neighbourhoods whose mean depth decides whether a sample lies in a hollow, as fractions of the picture's
#: height, and how strongly each darkens.
_HOLLOWS = ((0.006, 0.55), (0.016, 1.1), (0.035, 0.45))
#: Free pixels along the picture's border.
_BORDER = 1


@dataclass(frozen=True, kw_only=True)
class Camera:
    """Where the picture is taken from.

    Args:
        azimuth_deg: Direction of the camera about z, from +x; -60 looks along +y, from a little to the right.
        elevation_deg: Height above the horizon; negative looks at the underside.
    """

    azimuth_deg: float = -62.0
    elevation_deg: float = 38.0

    @property
    def axes(self) -> Floats:
        """Rows: right, up and towards the camera, in the part's frame; shape (3, 3)."""
        a, e = math.radians(self.azimuth_deg), math.radians(self.elevation_deg)
        towards = (math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e))
        right = (-math.sin(a), math.cos(a), 0.0)
        up = (-math.sin(e) * math.cos(a), -math.sin(e) * math.sin(a), math.cos(e))
        return np.array([right, up, towards])


#: From the front and a little from the right.
ABOVE = Camera()
#: As after turning the part over about x: x runs to the right, y down, so that labels and the jig's marks can be read.
BELOW = Camera(azimuth_deg=-90.0, elevation_deg=-78.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Body:
    """Something that is rendered.

    Args:
        mesh: Its surface, in its own frame.
        colour: Linear colour under full light.
        matrix: Homogeneous matrix from its frame to the picture's world, shape (4, 4): a rotation and a translation.
        relief: Height z of its upward side, and slopes along x and y, at points x and y of its own frame. The picture
            then shows this surface, and not the triangles that follow it. None shows all triangles as they are.
    """

    mesh: Mesh
    colour: Colour = MATERIAL
    matrix: Floats = field(default_factory=lambda: np.eye(4))
    relief: Relief | None = None


def extent_mm(bodies: Sequence[Body], camera: Camera = ABOVE) -> tuple[float, float]:
    """Width and height of some bodies as the camera sees them, in mm."""
    low, high = _box(bodies, camera.axes)
    return float(high[0] - low[0]), float(high[1] - low[1])


def pixels_across(length_mm: float, pixels_per_mm: float) -> int:
    """Pixels that a picture needs for a length and its border."""
    return math.ceil(length_mm * pixels_per_mm) + 2 * _BORDER


def linear(colour: Colour) -> Colour:
    """The linear colour of a body from its sRGB colour, red, green and blue from 0 to 1."""
    red, green, blue = (channel**_GAMMA for channel in colour)
    return red, green, blue


def render(
    bodies: Sequence[Body], width: int, height: int, camera: Camera = ABOVE, pixels_per_mm: float | None = None
) -> Bytes:
    """A shaded picture of some bodies on a white ground, in the middle of the picture.

    Args:
        bodies: The bodies; triangles that face away from the camera are left out.
        width: Width of the picture in pixels.
        height: Height of the picture in pixels.
        camera: The camera.
        pixels_per_mm: The picture's scale; None for the largest at which everything fits.

    Returns:
        RGB image, shape (height, width, 3).
    """
    w, h = width * _SAMPLES, height * _SAMPLES
    axes = camera.axes
    low, high = _box(bodies, axes)
    if pixels_per_mm is None:
        sides = np.maximum(high[:2] - low[:2], 1e-9)
        samples_per_mm = float(((np.array([w, h]) - 2.0 * _BORDER * _SAMPLES) / sides).min())
    else:
        samples_per_mm = pixels_per_mm * _SAMPLES
    view = _View(axes, (low + high) / 2.0, samples_per_mm, w, h)
    whole = Mesh.joined([body.mesh.transformed(body.matrix) for body in bodies])
    depth, owner = _raster(view.points(whole.vertices), whole.faces, w, h)
    light, cover = _light(depth, owner, whole, bodies, view), _averaged((owner >= 0).astype(np.float64))
    if len(bodies) == 1:
        image = _averaged(light)[:, :, None] * np.array(bodies[0].colour)
    else:
        # Where nothing is, the light is 0 and the colour of the last triangle does not matter.
        colours = np.concatenate([np.tile(np.array(body.colour), (len(body.mesh.faces), 1)) for body in bodies])
        image = np.stack([_averaged(light * channel[owner]) for channel in colours.T], axis=2)
    image += 1.0 - cover[:, :, None]
    return np.asarray(np.rint(255.0 * np.clip(image, 0.0, 1.0) ** (1.0 / _GAMMA)), dtype=np.uint8)


def _box(bodies: Sequence[Body], axes: Floats) -> tuple[Floats, Floats]:
    """Lowest and highest coordinates to the right, up and towards the camera, each (3,), in mm."""
    ends = []
    for body in bodies:
        seen = body.mesh.vertices @ (axes @ body.matrix[:3, :3]).T + axes @ body.matrix[:3, 3]
        ends += [seen.min(axis=0), seen.max(axis=0)]
    return np.min(ends, axis=0), np.max(ends, axis=0)


@dataclass(frozen=True)
class _View:
    """How the world is seen: where its points lie in the picture, and where its light comes from.

    Args:
        axes: Rows: right, up and towards the camera, shape (3, 3).
        centre: The point in the middle of the picture, in the axes' coordinates.
        samples_per_mm: The scale.
        width: Samples across.
        height: Samples down.
    """

    axes: Floats
    centre: Floats
    samples_per_mm: float
    width: int
    height: int

    @property
    def lamp(self) -> Floats:
        """Unit direction towards the lamp."""
        direction = np.array([-0.55, 0.65, 0.55]) @ self.axes
        return np.asarray(direction / np.linalg.norm(direction))

    @property
    def sky(self) -> Floats:
        """Unit direction towards the brightest part of the sky."""
        return np.asarray(0.6 * self.axes[1] + 0.8 * self.axes[2])

    def points(self, world: Floats) -> Floats:
        """Points of the world in samples: x to the right, y down, z towards the camera; shape (n, 3)."""
        middle = np.array([self.width / 2.0, self.height / 2.0, 0.0])
        flip = np.array([1.0, -1.0, 1.0])
        return np.asarray((world @ self.axes.T - self.centre) * self.samples_per_mm * flip + middle)


def _averaged(samples: Floats) -> Floats:
    """Mean over the samples of each pixel; (h, w) of samples to (height, width)."""
    parts = [samples[i::_SAMPLES, j::_SAMPLES] for i in range(_SAMPLES) for j in range(_SAMPLES)]
    return np.asarray(sum(parts[1:], start=parts[0]) / len(parts))


def _raster(points: Floats, triangles: Indices, w: int, h: int) -> tuple[Floats, Ints]:
    """Depth buffer (h, w), -inf where nothing is, and the triangle seen at each pixel, -1 where none is.

    Args:
        points: Vertices in pixels, x to the right, y down, z towards the camera; shape (n, 3).
        triangles: Vertex indices, shape (m, 3).
        w: Pixels across.
        h: Pixels down.
    """
    x, y, z = (points[:, i][triangles] for i in range(3))
    # y runs down, so a triangle that faces the camera is clockwise in these coordinates: its area comes out negative.
    area = (x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0]) - (x[:, 2] - x[:, 0]) * (y[:, 1] - y[:, 0])
    first = np.maximum(np.ceil(y.min(axis=1) - 0.5), 0).astype(np.int64)
    last = np.minimum(np.floor(y.max(axis=1) - 0.5), h - 1).astype(np.int64)
    used = np.flatnonzero((area < -1e-12) & (last >= first))
    x, y, z, area, first, last = (part[used] for part in (x, y, z, area, first, last))
    slope_x = ((z[:, 1] - z[:, 0]) * (y[:, 2] - y[:, 0]) - (z[:, 2] - z[:, 0]) * (y[:, 1] - y[:, 0])) / area
    slope_y = ((x[:, 1] - x[:, 0]) * (z[:, 2] - z[:, 0]) - (x[:, 2] - x[:, 0]) * (z[:, 1] - z[:, 0])) / area

    span, row = _expand(first, last)
    left, right = np.full(len(span), -np.inf), np.full(len(span), np.inf)
    for i, j in ((0, 1), (1, 2), (2, 0)):
        rise = (y[:, j] - y[:, i])[span]
        with np.errstate(divide="ignore", invalid="ignore"):
            at = x[span, i] + (row + 0.5 - y[span, i]) * ((x[:, j] - x[:, i])[span] / rise)
        np.maximum(left, at, out=left, where=rise > 0.0)
        np.minimum(right, at, out=right, where=rise < 0.0)
    start = np.maximum(np.ceil(left - 0.5), 0).astype(np.int64)
    end = np.minimum(np.ceil(right - 0.5) - 1, w - 1).astype(np.int64)
    filled = np.flatnonzero(end >= start)
    span, row = span[filled], row[filled]
    at_zero = z[span, 0] + slope_y[span] * (row + 0.5 - y[span, 0]) + slope_x[span] * (0.5 - x[span, 0])

    piece, column = _expand(start[filled], end[filled])
    place = row[piece] * w + column
    fragment = at_zero[piece] + slope_x[span][piece] * column
    depth = np.full(w * h, -np.inf)
    np.maximum.at(depth, place, fragment)
    owner = np.full(w * h, -1, dtype=np.int64)
    nearest = np.flatnonzero(fragment == depth[place])[::-1]
    owner[place[nearest]] = used[span[piece[nearest]]]
    return depth.reshape(h, w), owner.reshape(h, w)


def _expand(first: NDArray[Any], last: NDArray[Any]) -> tuple[Ints, Ints]:
    """All whole numbers of many ranges: which range each belongs to, and the number itself."""
    counts = last - first + 1
    which = np.repeat(np.arange(len(first)), counts)
    ends = np.cumsum(counts)
    return which, np.arange(len(which)) - (ends - counts)[which] + first[which]


def _light(depth: Floats, owner: Ints, whole: Mesh, bodies: Sequence[Body], view: _View) -> Floats:
    """Light that each sample sends back, linear, 0 where nothing is; shape (h, w).

    The depth of samples on a body's relief is moved from the triangles onto the relief.
    """
    solid = owner >= 0
    light = _light_of_triangles(owner[solid], whole, view)
    first = 0
    for body in bodies:
        if body.relief is not None:
            smooth = np.zeros(len(whole.faces), dtype=bool)
            smooth[first : first + len(body.mesh.faces)] = upward(body.mesh, body.mesh.doubled_normals)
            on_relief = smooth[owner[solid]]
            where, depths = np.flatnonzero(solid)[on_relief], depth.reshape(-1)
            light[on_relief], depths[where] = _light_of_relief(where, depths[where], body, view)
        first += len(body.mesh.faces)
    ground = depth[solid].min(initial=0.0)
    filled = np.where(solid, depth, ground)
    sizes = [max(3, int(reach * depth.shape[0]) * 2 + 1) for reach, _ in _HOLLOWS]
    sums = zip(_window_sums(np.where(solid, filled, 0.0), sizes), _window_sums(solid, sizes), strict=True)
    for (_, strength), size, (total, count) in zip(_HOLLOWS, sizes, sums, strict=True):
        mean = total[solid] / count[solid]
        light *= np.clip(1.0 - strength * (mean - filled[solid]) / size, 0.45, 1.12)
    light *= 1.0 - 0.55 * _edges(filled, solid)[solid]
    image = np.zeros(depth.shape)
    image[solid] = light
    return image


def _window_sums(values: NDArray[Any], sizes: Sequence[int]) -> Iterator[Floats]:
    """Yield the sums of an image over a square window around each pixel, for each odd size of the window.

    Outside of the image, the values are 0.
    """
    most = max(sizes) // 2
    table = np.pad(values.astype(np.float64), ((most + 1, most), (most + 1, most)))
    for axis in (0, 1):
        np.cumsum(table, axis=axis, out=table)
    rows, columns = values.shape
    for size in sizes:
        low = most - size // 2
        columns_of = table[low + size : low + size + rows] - table[low : low + rows]
        yield columns_of[:, low + size : low + size + columns] - columns_of[:, low : low + columns]


def _light_of_triangles(triangles: Ints, whole: Mesh, view: _View) -> Floats:
    """Light that samples on these triangles send back; shape (n,)."""
    seen = np.zeros(len(whole.faces), dtype=bool)
    seen[triangles] = True
    a, b, c = np.moveaxis(whole.vertices[whole.faces[seen]], 1, 0)
    normals = cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    light = _lit(normals @ view.lamp, normals @ view.sky)
    return np.asarray(light[(np.cumsum(seen) - 1)[triangles]])


def _light_of_relief(where: Ints, depth: Floats, body: Body, view: _View) -> tuple[Floats, Floats]:
    """Light that samples on a body's relief send back, and their depths, each (n,).

    Args:
        where: Places of the samples in the picture, row by row.
        depth: Their depths on the triangles.
        body: The body.
        view: The view.
    """
    assert body.relief is not None
    rows, columns = np.divmod(where, view.width)
    offsets = columns + 0.5 - view.width / 2.0, view.height / 2.0 - rows - 0.5, depth
    right, up, towards = (offset / view.samples_per_mm + at for offset, at in zip(offsets, view.centre, strict=True))
    turn = body.matrix[:3, :3]
    own, shift = view.axes @ turn, body.matrix[:3, 3] @ turn
    x, y, z = (right * own[0, i] + up * own[1, i] + towards * own[2, i] - shift[i] for i in range(3))
    height, slope_x, slope_y = body.relief(x, y)
    steepness = np.sqrt(1.0 + slope_x**2 + slope_y**2)

    def along(direction: Floats) -> Floats:
        """Component of the normals along a direction of the world."""
        dx, dy, dz = direction @ turn
        return np.asarray((dz - dx * slope_x - dy * slope_y) / steepness)

    # One step of Newton's method along the line of sight, short where the surface is seen from its edge.
    facing = np.maximum(along(view.axes[2]), 0.25)
    light = _lit(along(view.lamp), along(view.sky))
    return light, depth + view.samples_per_mm * (height - z) / steepness / facing


def _lit(lamp: Floats, sky: Floats) -> Floats:
    """Light that surfaces send back whose unit normals have these components towards the lamp and the sky."""
    return np.asarray(_LAMP * np.clip(lamp, 0.0, None) + _SKY * (0.5 + 0.5 * sky) + _AMBIENT)


def _edges(depth: NDArray[Any], solid: Bools) -> Floats:
    """1 along outlines and steps in depth, 0 elsewhere, soft between; shape (h, w)."""
    bend = np.zeros(depth.shape)
    for axis in (0, 1):
        second = np.abs(np.diff(depth, 2, axis=axis))
        part = [slice(1, -1) if i == axis else slice(None) for i in (0, 1)]
        bend[tuple(part)] = np.maximum(bend[tuple(part)], second)
    soft = np.clip((bend - 1.5) / 5.0, 0.0, 1.0)
    return np.asarray(np.where(solid, soft, 0.0), dtype=np.float64)
