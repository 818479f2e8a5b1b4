"""The shape of a body in a file: its position, its size, whether it is upside down, and dense points of its relief.

The functions do not depend on the winding of the triangles, because the side walls of published block files have an
inconsistent winding.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from tacbench_cad.geometry import kernel, relief
from tacbench_cad.geometry.mesh import Mesh
from tacbench_cad.spec.label import LABEL_DEPTH_MM
from tacbench_cad.util.types import Bools, Floats

if TYPE_CHECKING:
    from OCP.TopoDS import TopoDS_Shape

    from tacbench_cad.checks.solidcheck import MeasuredSolid

#: The largest distance of a point from a plane on which it lies, in mm.
PLANE_MM = 1e-3
#: The smallest area of an underside, as a fraction of the footprint of the bounding box.
UNDERSIDE_FRACTION = 0.3
#: The smallest fraction of the footprint that the relief of a block covers. It is also the largest fraction of level
#: area in the relief; a body with more level area is a fixture.
LEVEL_FRACTION = 0.5


@dataclass(frozen=True, kw_only=True)
class BodyShape:
    """A shape in the frame of its bounding box: the lower corner is at the origin, and the underside is at z = 0.

    Attributes:
        origin_mm: The lower corner of the bounding box in the file, in mm.
        size_mm: The sides of the bounding box, in mm.
        upside_down: Whether the relief faces down in the file. The shape is then turned by 180 degrees about x.
        points: Dense points of the relief in mm, shape (k, 3); no rows if there is no relief.
        other_points: Points of all other faces that are neither walls nor parts of the underside, shape (k, 3). They do
            not help to find the texture, but in a block they lie on the relief, too.
        is_block: Whether the body has a level underside, and a relief over most of its footprint.
        outline: The x and y of the points in the plane of the underside, in mm, shape (n, 2).
        pockets_mm2: The area of pockets of the label's depth in the underside.
        off_sides_mm: Points of walls that are not on the sides of the box, except walls of the label, shape (n, 3).
        volume_mm3: The volume; None if the surface is not closed.
        shells: The number of closed surfaces. A hollow in the body has one of its own.
        holes: The number of through holes; None if the surface is not closed.
        is_solid: Whether the shape is a solid. A solid is compared with the formula, also if its block has a sample
            grid.
    """

    origin_mm: tuple[float, float, float]
    size_mm: tuple[float, float, float]
    upside_down: bool
    points: Floats
    other_points: Floats
    is_block: bool
    outline: Floats
    pockets_mm2: float
    off_sides_mm: Floats
    volume_mm3: float | None
    shells: int
    holes: int | None
    is_solid: bool

    @property
    def engraved(self) -> bool:
        """Whether the underside has pockets of the label's depth."""
        return self.pockets_mm2 > 0.0

    @property
    def covered(self) -> float:
        """The fraction of 20 x 20 cells of the footprint that contain a point of the relief.

        The kernel would need seconds to compute the area of the faces.
        """
        cells = np.clip((self.points[:, :2] / np.maximum(self.size_mm[:2], 1e-300) * 20.0).astype(np.int64), 0, 19)
        return len(np.unique(cells[:, 0] * 20 + cells[:, 1])) / 400.0

    @property
    def cut_corners(self) -> list[tuple[int, int, float]]:
        """The cut corners of the underside: ``(0 or 1 along x, 0 or 1 along y, leg in mm)``.

        The leg is the missing length of a side; if the two sides differ, it is the mean of both lengths.
        """
        corners = []
        x, y = self.outline[:, 0], self.outline[:, 1]
        for i, j in ((0, 0), (1, 0), (1, 1), (0, 1)):
            corner_x, corner_y = i * self.size_mm[0], j * self.size_mm[1]
            if np.min(np.hypot(x - corner_x, y - corner_y), initial=np.inf) <= PLANE_MM:
                continue
            along_x = np.min(np.abs(x - corner_x)[np.abs(y - corner_y) <= PLANE_MM], initial=np.inf)
            along_y = np.min(np.abs(y - corner_y)[np.abs(x - corner_x) <= PLANE_MM], initial=np.inf)
            corners.append((i, j, float(along_x + along_y) / 2.0))
        return corners


def mesh_shape(mesh: Mesh, closed: bool) -> BodyShape:
    """Return the shape of a triangle mesh of one piece.

    Args:
        mesh: The mesh. Its coordinates must be finite.
        closed: Whether every edge has exactly two triangles with a consistent winding.
    """
    low, high = mesh.bounds_mm
    size = high - low
    normals = np.abs(mesh.doubled_normals)
    wall = relief.walls(mesh, normals)
    # Triangles of the top that are hardly wider than the rounding count as walls, but say nothing about the sides.
    upright = wall & (normals[:, 2] <= 0.1 * np.linalg.norm(normals, axis=1))
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
    is_block = covered and max(fractions) >= UNDERSIDE_FRACTION
    textured = rest if is_block else rest & ~level  # the floors of large pockets would hide the texture
    place = _BoxFrame(low, size, upside_down)
    return BodyShape(
        origin_mm=_triple(low),
        size_mm=_triple(size),
        upside_down=upside_down,
        points=place(_points(mesh, textured)),
        other_points=place(_points(mesh, rest & ~textured)),
        is_block=is_block,
        outline=place(mesh.vertices[np.unique(mesh.faces[underside])])[:, :2],
        pockets_mm2=float(normals[pocket, 2].sum()) / 2.0,
        off_sides_mm=_off_sides(place(mesh.vertices[mesh.faces[upright]]), size),
        volume_mm3=mesh.volume_mm3 if closed else None,
        shells=1,
        holes=1 - (len(np.unique(mesh.faces)) - len(mesh.faces) // 2) // 2 if closed else None,
        is_solid=False,
    )


def _points(mesh: Mesh, which: Bools) -> Floats:
    return relief.points_on(mesh, which) if which.any() else np.empty((0, 3))


def _triple(values: Floats) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return (x, y, z)


class _BoxFrame:
    """The transformation from the file to the frame of the box; it turns an upside-down body by 180 degrees about x."""

    def __init__(self, low: Floats, size: Floats, upside_down: bool) -> None:
        self.low, self.size, self.upside_down = low, size, upside_down

    def __call__(self, points: Floats) -> Floats:
        transformed = points - self.low
        if self.upside_down:
            transformed = transformed * [1.0, -1.0, -1.0] + [0.0, self.size[1], self.size[2]]
        return np.asarray(transformed, dtype=np.float64)


def _off_sides(faces: Floats, size: Floats) -> Floats:
    """Return the points of walls that are not on a side of the box, except walls of the label.

    Args:
        faces: The points of each face, shape (m, n, 3).
        size: The sides of the box.
    """
    deep = faces[:, :, 2].max(axis=1) <= LABEL_DEPTH_MM + PLANE_MM
    points = np.unique(faces[~deep].reshape(-1, 3), axis=0)
    gap = np.minimum(np.abs(points[:, :2]), np.abs(size[:2] - points[:, :2])).min(axis=1)
    return np.asarray(points[gap > PLANE_MM])


def solid_shape(solid: TopoDS_Shape, measured: MeasuredSolid, with_relief: bool = True) -> BodyShape:
    """Return the shape of an Open CASCADE solid.

    Args:
        solid: The solid, in mm.
        measured: Its volume and its bounding box.
        with_relief: Whether the points of the relief are needed.
    """
    from tacbench_cad.checks import solidcheck

    low, high = measured.low_mm, measured.high_mm
    size = high - low
    footprint = max(float(size[0] * size[1]), 1e-300)
    levels = solidcheck.level_faces(solid)
    near = 5.0 * PLANE_MM
    planes = (float(low[2]), float(high[2]))
    fractions = [sum(area for z, area in levels if abs(z - plane) <= near) / footprint for plane in planes]
    upside_down = fractions[1] >= UNDERSIDE_FRACTION > fractions[0]
    label_mm = high[2] - LABEL_DEPTH_MM if upside_down else low[2] + LABEL_DEPTH_MM
    place = _BoxFrame(low, size, upside_down)
    vertices = place(solidcheck.vertices(solid))
    textured, rest = solidcheck.curved(solid)
    points = place(solidcheck.points_on(textured if with_relief else []))
    off_sides, others = [np.empty((0, 3))], [np.empty((0, 3))]
    for face in (*rest, *(face for face in textured if not solidcheck.is_rectangle(face))):
        inner, is_wall = solidcheck.inner_points(face)
        inner = place(inner)
        if is_wall:
            off_sides.append(_off_sides(inner[None], size))
        else:
            bottom = np.minimum(np.abs(inner[:, 2]), np.abs(inner[:, 2] - LABEL_DEPTH_MM)) <= near
            others.append(inner[~bottom])
    flat = np.concatenate(others)
    if not textured:  # a solid of plane facets
        points, flat = flat, points
    shape = BodyShape(
        origin_mm=_triple(low),
        size_mm=_triple(size),
        upside_down=upside_down,
        points=points,
        other_points=flat,
        is_block=False,
        outline=vertices[vertices[:, 2] <= near][:, :2],
        pockets_mm2=sum(area for z, area in levels if abs(z - label_mm) <= near),
        off_sides_mm=np.concatenate(off_sides),
        volume_mm3=measured.volume_mm3,
        shells=solidcheck.count(solid, "SHELL"),
        holes=kernel.genus(solid),
        is_solid=True,
    )
    is_block = max(fractions) >= UNDERSIDE_FRACTION and shape.covered > LEVEL_FRACTION
    return replace(shape, is_block=is_block)
