"""A small software renderer: shaded pictures of meshes from arrays alone, the same pixels on every run.

Orthographic camera, depth buffer, one lamp and a sky; hollows and edges are darkened from the depth buffer. Triangles
are cut into pixel rows and rows into pixels by array arithmetic, so the cost follows the pixels drawn, whatever the
triangles' shapes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacbench_cad.geometry.mesh import Mesh, cross
from tacbench_cad.util.types import Bools, Bytes, Floats, Indices, Ints

Colour = tuple[float, float, float]

#: Pixels across each side of a finished pixel.
_SAMPLES = 2
#: Linear colour of the material under full light.
_MATERIAL: Colour = (0.57, 0.64, 0.71)
#: Fractions of the lamp, of the sky and of light from everywhere.
_LAMP, _SKY, _FLOOR = 0.80, 0.34, 0.04
#: Depth, in fractions of the picture's height, over which hollows are felt, and how much they darken.
_HOLLOWS = ((0.006, 0.55), (0.016, 1.1), (0.035, 0.45))


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


def render(mesh: Mesh, width: int, height: int, camera: Camera = ABOVE, materials: Floats | None = None) -> Bytes:
    """A shaded picture of a mesh on a white ground, as large as it fits.

    Args:
        mesh: The mesh; triangles that face away are left out.
        width: Pixels across.
        height: Pixels down.
        camera: Where it is seen from.
        materials: Linear colour of each triangle under full light, shape (m, 3); None for one material.

    Returns:
        RGB image, shape (height, width, 3).
    """
    w, h = width * _SAMPLES, height * _SAMPLES
    axes = camera.axes
    seen = mesh.vertices @ axes.T
    low, high = seen.min(axis=0), seen.max(axis=0)
    pixels_per_mm = min((w - 4.0) / max(high[0] - low[0], 1e-9), (h - 4.0) / max(high[1] - low[1], 1e-9))
    centre = (low + high) / 2.0
    points = (seen - centre) * pixels_per_mm * np.array([1.0, -1.0, 1.0]) + np.array([w / 2.0, h / 2.0, 0.0])
    depth, owner = _raster(points, mesh.faces, w, h)
    light, cover = _light(depth, owner, mesh, axes), _averaged((owner >= 0).astype(np.float64))
    if materials is None:
        image = _averaged(light)[:, :, None] * np.array(_MATERIAL)
    else:
        # Where nothing is, the light is 0 and the last triangle's colour does not matter.
        image = np.stack([_averaged(light * channel[owner]) for channel in materials.T], axis=2)
    image += 1.0 - cover[:, :, None]
    return np.asarray(np.rint(255.0 * np.clip(image, 0.0, 1.0) ** (1.0 / 2.2)), dtype=np.uint8)


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


def _light(depth: Floats, owner: Ints, mesh: Mesh, axes: Floats) -> Floats:
    """Light that each sample sends back, linear, 0 where nothing is; shape (h, w)."""
    from scipy.ndimage import uniform_filter

    solid = owner >= 0
    seen = np.zeros(len(mesh.faces), dtype=bool)
    seen[owner[solid]] = True
    visible, inverse = np.flatnonzero(seen), (np.cumsum(seen) - 1)[owner[solid]]
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces[visible]], 1, 0)
    normals = cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    lamp = np.array([-0.55, 0.65, 0.55]) @ axes
    lamp /= np.linalg.norm(lamp)
    sky = 0.5 + 0.5 * (normals @ (0.6 * axes[1] + 0.8 * axes[2]))
    light = (_LAMP * np.clip(normals @ lamp, 0.0, None) + _SKY * sky + _FLOOR)[inverse]

    ground = depth[solid].min(initial=0.0)
    filled = np.where(solid, depth, ground)
    fraction = solid.astype(np.float64)
    for reach, strength in _HOLLOWS:
        size = max(3, int(reach * depth.shape[0]) * 2 + 1)
        mean = uniform_filter(filled * fraction, size) / np.maximum(uniform_filter(fraction, size), 1e-9)
        light *= np.clip(1.0 - strength * (mean[solid] - filled[solid]) / size, 0.45, 1.12)
    light *= 1.0 - 0.55 * _edges(filled, solid)[solid]
    image = np.zeros(depth.shape)
    image[solid] = light
    return image


def _edges(depth: Floats, solid: Bools) -> Floats:
    """1 along outlines and steps in depth, 0 elsewhere, soft between; shape (h, w)."""
    bend = np.zeros(depth.shape)
    for axis in (0, 1):
        second = np.abs(np.diff(depth, 2, axis=axis))
        part = [slice(1, -1) if i == axis else slice(None) for i in (0, 1)]
        bend[tuple(part)] = np.maximum(bend[tuple(part)], second)
    soft = np.clip((bend - 1.5) / 5.0, 0.0, 1.0)
    return np.asarray(np.where(solid, soft, 0.0), dtype=np.float64)
