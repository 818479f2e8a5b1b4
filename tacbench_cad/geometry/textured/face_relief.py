"""The distance of meshes and points from the formula on textured faces. It does not use the patches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacbench_cad.geometry import relief
from tacbench_cad.geometry.mesh import Mesh
from tacbench_cad.geometry.textured.height import Height
from tacbench_cad.util.types import Bools, Floats

#: The largest height of a point above the highest and below the lowest point of the texture, in mm.
_NEAR_MM = 0.3
#: The smallest cosine between the normals of a triangle of the texture and of the face.
_MIN_COSINE = 1e-3
#: A triangle with a smaller cosine belongs to a wall if its corners are on the outline, that is, nearer than this.
_STEEP, _OUTLINE_MM = 0.3, 2e-3


@dataclass(frozen=True, eq=False)
class FaceRelief:
    """The textured areas of a part, for the check of its files.

    Args:
        heights: The heights above the areas.
        allowed_mm: The largest allowed distance from the formula.
    """

    heights: Sequence[Height]
    allowed_mm: float

    def of_mesh(self, mesh: Mesh) -> tuple[float, int]:
        """Return the largest distance of a mesh from the formula in mm, and the number of its points."""
        corners = mesh.triangle_points
        normals = mesh.doubled_normals
        lengths = np.linalg.norm(normals, axis=1)
        normals = normals / np.where(lengths > 0.0, lengths, 1.0)[:, None]
        worst, count = 0.0, 0
        for height in self.heights:
            frame, middles = height.area.frame, corners.mean(axis=1)
            cosine = np.einsum("ij,ij->i", normals, frame.normal(frame.coordinates(middles)[0]))
            up = np.flatnonzero(cosine > _MIN_COSINE)
            up = up[_on_texture(height, middles[up])]
            steep = up[cosine[up] < _STEEP]
            s, t, _ = frame.coordinates(corners[steep].reshape(-1, 3))
            walls = steep[(height.area.from_outline(s, t) < _OUTLINE_MM).reshape(-1, 3).all(axis=1)]
            own = np.isin(np.arange(len(corners)), np.setdiff1d(up, walls))
            points = relief.points_on(mesh, own)
            worst = max(worst, _largest(height, points))
            count += len(points)
        return worst, count

    def of_points(self, points: Floats) -> tuple[float, int]:
        """Return the same for points, shape (n, 3). Points that are not on a textured face do not count."""
        worst, count = 0.0, 0
        for height in self.heights:
            own = points[_on_texture(height, points)]
            worst = max(worst, _largest(height, own))
            count += len(own)
        return worst, count


def _largest(height: Height, points: Floats) -> float:
    """Return the largest distance of points from the formula. On a cylinder, both are unrolled."""
    if len(points) == 0:
        return 0.0
    s, t, h = height.area.frame.coordinates(points)
    if (around := height.area.frame.around_mm) is not None:  # a point just below s = 0 has the largest s
        s = np.where(s > (height.area.size_mm[0] + around) / 2.0, s - around, s)
    return relief.distance(np.stack([s, t, h], axis=1), height, 0.0).largest_mm


def _on_texture(height: Height, points: Floats) -> Bools:
    """Return which points are above the area and near the heights of the texture."""
    s, t, h = height.area.frame.coordinates(points)
    low, high = height.range_mm
    # The face itself, with height 0, is never part of the texture.
    near = (h > max(low - _NEAR_MM, low / 2.0)) if low > 0.0 else (h > low - _NEAR_MM)
    near &= (h < high + _NEAR_MM) if high > 0.0 else (h < min(high + _NEAR_MM, high / 2.0))
    if height.area.is_closed:
        return np.asarray(near & (t > 0.0) & (t < height.area.size_mm[1]))
    near[near] = height.area.inside(s[near], t[near])
    return np.asarray(near)
