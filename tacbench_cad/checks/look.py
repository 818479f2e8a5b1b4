"""A file's shape as an examiner sees it: where it lies, which way up it is, and dense points of its relief.

Nothing here trusts the winding: published block files exist whose side walls are wound inconsistently, and their
relief shall be compared all the same.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tacbench_cad.geometry import relief
from tacbench_cad.geometry.mesh import Mesh
from tacbench_cad.spec.label import LABEL_DEPTH_MM
from tacbench_cad.util.types import Floats, Indices

if TYPE_CHECKING:
    from OCP.TopoDS import TopoDS_Shape

#: Points nearer than this to a plane lie on it, in mm.
PLANE_MM = 1e-3
#: A plane that holds this fraction of the box's footprint is an underside.
UNDERSIDE_FRACTION = 0.3
#: With more than this fraction of level area above the underside, the shape is a fixture and no block.
LEVEL_FRACTION = 0.5


@dataclass(frozen=True, kw_only=True)
class Look:
    """A shape in its own box frame, right way up: lower corner at the origin, underside at z = 0.

    Attributes:
        origin_mm: Where the box's lower corner lay in the file.
        size_mm: Sides of the box.
        upside_down: Whether it lay with the relief below (then it is turned about x here).
        points: Dense points of the relief, shape (k, 3); none where there is no relief.
        is_block: Whether it has a level underside and a relief over most of its footprint.
        outline: Points of the underside's plane, shape (n, 2).
        engraved: Whether the underside has pockets of the label's depth.
        off_sides_mm: Where walls stand away from the box's sides: points x, y, shape (n, 2).
        is_solid: Whether it came from a CAD kernel: it then follows the formula, and not a sample grid.
    """

    origin_mm: tuple[float, float, float]
    size_mm: tuple[float, float, float]
    upside_down: bool
    points: Floats
    is_block: bool
    outline: Floats
    engraved: bool
    off_sides_mm: Floats
    is_solid: bool

    @property
    def cut_corners(self) -> list[tuple[int, int, float]]:
        """Corners that the underside lacks: ``(0 or 1 along x, 0 or 1 along y, leg in mm)``.

        The leg is the length missing along the side; where the two differ, their mean.
        """
        found = []
        x, y = self.outline[:, 0], self.outline[:, 1]
        for i, j in ((0, 0), (1, 0), (1, 1), (0, 1)):
            corner_x, corner_y = i * self.size_mm[0], j * self.size_mm[1]
            if np.min(np.hypot(x - corner_x, y - corner_y), initial=np.inf) <= PLANE_MM:
                continue
            along_x = np.min(np.abs(x - corner_x)[np.abs(y - corner_y) <= PLANE_MM], initial=np.inf)
            along_y = np.min(np.abs(y - corner_y)[np.abs(x - corner_x) <= PLANE_MM], initial=np.inf)
            found.append((i, j, float(along_x + along_y) / 2.0))
        return found


def look_at_mesh(mesh: Mesh) -> Look:
    """See a triangle mesh; its coordinates must be finite."""
    low, high = mesh.bounds_mm
    size = high - low
    normals = np.abs(mesh.doubled_normals)
    length = np.linalg.norm(normals, axis=1)
    wall = normals[:, 2] <= relief.WALL_FRACTION * length
    height = (mesh.vertices[:, 2] - low[2])[mesh.faces]
    bottom = ~wall & (height.max(axis=1) <= PLANE_MM)
    top = ~wall & (height.min(axis=1) >= size[2] - PLANE_MM)
    footprint = max(float(size[0] * size[1]), 1e-300)
    fractions = [float(normals[which, 2].sum()) / 2.0 / footprint for which in (bottom, top)]
    upside_down = fractions[1] >= UNDERSIDE_FRACTION > fractions[0]
    underside = top if upside_down else bottom
    depth = size[2] - height if upside_down else height
    pocket = ~wall & (np.abs(depth - LABEL_DEPTH_MM).max(axis=1) <= PLANE_MM)
    rest = ~wall & ~underside & ~pocket
    level = rest & (np.ptp(height, axis=1) <= PLANE_MM * 1e-3)
    area, level_area = float(normals[rest, 2].sum()), float(normals[level, 2].sum())
    covered = area / 2.0 / footprint > LEVEL_FRACTION and level_area <= LEVEL_FRACTION * area
    place = _Upright(low, size, upside_down)
    return Look(
        origin_mm=_triple(low),
        size_mm=_triple(size),
        upside_down=upside_down,
        points=place(relief.points_on(mesh, rest)),
        is_block=covered and max(fractions) >= UNDERSIDE_FRACTION,
        outline=place(mesh.vertices[np.unique(mesh.faces[underside])])[:, :2],
        engraved=bool(pocket.any()),
        off_sides_mm=_off_sides(place(mesh.vertices), mesh.faces[wall], size),
        is_solid=False,
    )


def _triple(values: Floats) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return (x, y, z)


class _Upright:
    """Moves file coordinates into the box frame; what lay upside down is turned by half a turn about x."""

    def __init__(self, low: Floats, size: Floats, upside_down: bool) -> None:
        self.low, self.size, self.upside_down = low, size, upside_down

    def __call__(self, points: Floats) -> Floats:
        moved = points - self.low
        if self.upside_down:
            moved = moved * [1.0, -1.0, -1.0] + [0.0, self.size[1], self.size[2]]
        return np.asarray(moved, dtype=np.float64)


def _off_sides(vertices: Floats, walls: Indices, size: Floats) -> Floats:
    """Corners of walls that stand neither on a side of the box nor on the cut of a key nor in the label."""
    corners = vertices[walls]
    deep = corners[:, :, 2].max(axis=1) <= LABEL_DEPTH_MM + PLANE_MM
    points = vertices[np.unique(walls[~deep])][:, :2]
    gap = np.minimum(np.abs(points), np.abs(size[:2] - points)).min(axis=1)
    return np.asarray(points[gap > PLANE_MM])


def look_at_solid(shape: TopoDS_Shape, low: Floats, high: Floats) -> Look:
    """See a kernel's shape.

    Args:
        shape: The shape, in mm.
        low: Lower corner of its bounding box.
        high: Upper corner.
    """
    from tacbench_cad.checks import solidcheck

    size = high - low
    footprint = max(float(size[0] * size[1]), 1e-300)
    levels = solidcheck.level_faces(shape)
    near = 5.0 * PLANE_MM
    planes = (float(low[2]), float(high[2]))
    fractions = [sum(area for z, area in levels if abs(z - plane) <= near) / footprint for plane in planes]
    upside_down = fractions[1] >= UNDERSIDE_FRACTION > fractions[0]
    place = _Upright(low, size, upside_down)
    vertices, points = place(solidcheck.vertices(shape)), place(solidcheck.points_on(solidcheck.curved(shape)))
    return Look(
        origin_mm=_triple(low),
        size_mm=_triple(size),
        upside_down=upside_down,
        points=points,
        is_block=max(fractions) >= UNDERSIDE_FRACTION and _covered(points, size) > LEVEL_FRACTION,
        outline=vertices[vertices[:, 2] <= near][:, :2],
        engraved=any(abs(abs(z - (high[2] if upside_down else low[2])) - LABEL_DEPTH_MM) <= near for z, _ in levels),
        off_sides_mm=np.empty((0, 2)),
        is_solid=True,
    )


def _covered(points: Floats, size: Floats) -> float:
    """Fraction of a 20 x 20 raster of the footprint that has a point; the kernel's own areas take it seconds."""
    cells = np.clip((points[:, :2] / size[:2] * 20.0).astype(np.int64), 0, 19)
    return len(np.unique(cells[:, 0] * 20 + cells[:, 1])) / 400.0
