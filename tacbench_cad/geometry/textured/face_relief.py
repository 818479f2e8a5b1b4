"""The distance of meshes and points from the formula on textured faces. It does not use the patches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacbench_cad.geometry import relief
from tacbench_cad.geometry.mesh import Mesh
from tacbench_cad.geometry.textured.field import Height
from tacbench_cad.geometry.textured.region import OutlineEdge, Region, distance
from tacbench_cad.util.types import Bools, Floats

#: The largest height of a point above the highest and below the lowest point of the texture, in mm.
_NEAR_MM = 0.3
#: The smallest cosine between the normals of a triangle of the texture and of the face.
_MIN_COSINE = 1e-3
#: A triangle with a smaller cosine belongs to a wall if its corners are on the outline, that is, nearer than this.
_STEEP, _OUTLINE_MM = 0.3, 2e-3
#: The points along each curved edge of the outline.
_OUTLINE_POINTS = 65
#: The step of the derivatives, in mm.
_STEP_MM = 1e-4
#: The number of points in one array operation.
_AT_A_TIME = 20_000


@dataclass(frozen=True, eq=False)
class FaceRelief:
    """The textured regions of a part, for the check of its files.

    Args:
        regions: The regions with their heights.
        shift_mm: The vector from the coordinates of the formula to the coordinates of the file, shape (3,).
        allowed_mm: The largest allowed distance from the formula.
    """

    regions: Sequence[tuple[Region, Height]]
    shift_mm: Floats
    allowed_mm: float

    def of_mesh(self, mesh: Mesh) -> tuple[float, int]:
        """Return the largest distance of a mesh from the formula in mm, and the number of its points."""
        corners = mesh.triangle_points - self.shift_mm
        normals = mesh.doubled_normals
        lengths = np.linalg.norm(normals, axis=1)
        normals = normals / np.where(lengths > 0.0, lengths, 1.0)[:, None]
        worst, count = 0.0, 0
        for region, height in self.regions:
            cosine = np.einsum("ij,ij->i", normals, _normals(region, corners.mean(axis=1)))
            up = np.flatnonzero(cosine > _MIN_COSINE)
            up = up[_on_texture(region, height, corners[up].mean(axis=1))]
            steep = up[cosine[up] < _STEEP]
            walls = steep[_on_outline(region, corners[steep])]
            own = np.zeros(len(corners), dtype=np.bool_)
            own[np.setdiff1d(up, walls)] = True
            points = relief.points_on(mesh, own) - self.shift_mm
            worst = max(worst, _largest(region, height, points))
            count += len(points)
        return worst, count

    def of_points(self, points: Floats) -> tuple[float, int]:
        """Return the same for points, shape (n, 3). Points that are not on a textured face do not count."""
        worst, count = 0.0, 0
        for region, height in self.regions:
            own = points - self.shift_mm
            own = own[_on_texture(region, height, own)]
            worst = max(worst, _largest(region, height, own))
            count += len(own)
        return worst, count


def _coordinates(region: Region, points: Floats) -> tuple[Floats, Floats, Floats]:
    """Return s, t and the height above the face of points."""
    frame = region.frame
    s, t = frame.local(points).T
    own = (points - frame.origin) @ frame.axes.T
    if frame.radius_mm is None:
        return s, t, own[:, 2]
    return s, t, frame.side * (np.hypot(own[:, 0], own[:, 1]) - frame.radius_mm)


def _normals(region: Region, points: Floats) -> Floats:
    frame = region.frame
    if frame.radius_mm is None:
        return np.broadcast_to(frame.axes[2], points.shape)
    own = (points - frame.origin) @ frame.axes.T
    own[:, 2] = 0.0
    out = own / np.linalg.norm(own, axis=1)[:, None]
    return np.asarray(frame.side * out @ frame.axes)


@dataclass(frozen=True)
class _Formula:
    """The height above a face in its local coordinates, with slopes from differences."""

    height: Height

    def __call__(self, s: Floats, t: Floats) -> Floats:
        return self.height.at(s, t)

    def gradient(self, s: Floats, t: Floats) -> tuple[Floats, Floats]:
        at = self.height.at
        return (
            (at(s + _STEP_MM, t) - at(s - _STEP_MM, t)) / (2.0 * _STEP_MM),
            (at(s, t + _STEP_MM) - at(s, t - _STEP_MM)) / (2.0 * _STEP_MM),
        )


def _largest(region: Region, height: Height, points: Floats) -> float:
    """Return the largest distance of points from the formula. On a cylinder, both are unrolled."""
    if len(points) == 0:
        return 0.0
    s, t, h = _coordinates(region, points)
    if region.frame.around_mm is not None:  # a point just below s = 0 has the largest s
        s = np.where(s > (region.size_mm[0] + region.frame.around_mm) / 2.0, s - region.frame.around_mm, s)
    return relief.distance(np.stack([s, t, h], axis=1), _Formula(height), 0.0).largest_mm


def _on_texture(region: Region, height: Height, points: Floats) -> Bools:
    """Return which points are above the region and near the heights of the texture."""
    s, t, h = _coordinates(region, points)
    low, high = height.range_mm
    # The face itself, with height 0, is never part of the texture.
    near = (h > max(low - _NEAR_MM, low / 2.0)) if low > 0.0 else (h > low - _NEAR_MM)
    near &= (h < high + _NEAR_MM) if high > 0.0 else (h < min(high + _NEAR_MM, high / 2.0))
    if region.is_closed:
        return np.asarray(near & (t > 0.0) & (t < region.size_mm[1]))
    chosen = np.flatnonzero(near & (s > 0.0) & (s < region.size_mm[0]) & (t > 0.0) & (t < region.size_mm[1]))
    result = np.zeros(len(points), dtype=np.bool_)
    outline = [_polyline(edge) for loop in region.loops for edge in loop]
    for start in range(0, len(chosen), _AT_A_TIME):
        part = chosen[start : start + _AT_A_TIME]
        inside = np.zeros(len(part), dtype=np.bool_)
        for line in outline:
            for (s0, t0), (s1, t1) in zip(line[:-1].tolist(), line[1:].tolist(), strict=True):
                if t0 != t1:
                    between = (t[part] > min(t0, t1)) & (t[part] <= max(t0, t1))
                    inside ^= between & (s[part] > s0 + (t[part] - t0) / (t1 - t0) * (s1 - s0))
        result[part] = inside
    return result


def _on_outline(region: Region, corners: Floats) -> Bools:
    """Return which triangles, shape (n, 3, 3), have all their corners on the outline."""
    if len(corners) == 0:
        return np.zeros(0, dtype=np.bool_)
    s, t, _ = _coordinates(region, corners.reshape(-1, 3))
    if region.is_closed:
        away = np.minimum(np.abs(t), np.abs(t - region.size_mm[1]))
    else:
        points = np.stack([s, t], axis=1)
        away = np.min([distance(edge, points, 1.0) for loop in region.loops for edge in loop], axis=0)
    return np.asarray((away < _OUTLINE_MM).reshape(-1, 3).all(axis=1))


def _polyline(edge: OutlineEdge) -> Floats:
    return edge.at(np.linspace(edge.first, edge.last, 2 if edge.kind == "line" else _OUTLINE_POINTS))
