"""A connected area of a face that gets a texture: its outline in the local coordinates of the face."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import shapely

from tacbench_cad.geometry.textured.frame import Frame
from tacbench_cad.util.types import Bools, Floats

#: Coordinates of an outline that differ by less than this are equal, in mm.
SAME_MM = 1e-6
#: The sine of the smallest angle of a convex corner of an outline.
_CORNER = 0.2


@dataclass(frozen=True, eq=False)
class Area:
    """A connected area of a face. On a cylinder, it is a rectangle or a band around the whole cylinder.

    Args:
        frame: The local coordinates. The lowest s and t of the area are 0.
        polygon: The outline in (s, t), in which chords replace curves, and its holes.
        size_mm: The extents along s and t.
        is_closed: Whether it goes all the way around a cylinder.
        face: The same area as a face of the CAD kernel; None for a mesh and for a cylinder.
    """

    frame: Frame
    polygon: shapely.Polygon
    size_mm: tuple[float, float]
    is_closed: bool = False
    face: Any = None

    @classmethod
    def rectangle(cls, frame: Frame, size_mm: tuple[float, float], is_closed: bool = False) -> Area:
        """Return the rectangle from the origin of a frame."""
        return cls(frame, shapely.box(0.0, 0.0, *size_mm), size_mm, is_closed)

    @cached_property
    def is_rectangle(self) -> bool:
        """Whether it is a rectangle along s and t, or a band around a cylinder."""
        missing = self.size_mm[0] * self.size_mm[1] - self.polygon.area
        return not self.polygon.interiors and missing < SAME_MM * sum(self.size_mm)

    @property
    def rings(self) -> list[Floats]:
        """The outer polygon counter-clockwise, then the holes clockwise, shape (n, 2) each, without repeated ends."""
        turned = shapely.orient_polygons(self.polygon)
        return [np.asarray(ring.coords)[:-1, :2] for ring in (turned.exterior, *turned.interiors)]

    def inside(self, s: Floats, t: Floats) -> Bools:
        """Return which points are inside. The arrays broadcast."""
        shapely.prepare(self.polygon)
        return np.asarray(shapely.contains_xy(self.polygon, *np.broadcast_arrays(s, t)))

    def from_outline(self, s: Floats, t: Floats) -> Floats:
        """Return the distances of points, shape (n,) each, from the outline. A closed band has no outline along t."""
        if self.is_closed:
            return np.minimum(np.abs(t), np.abs(t - self.size_mm[1]))
        return np.asarray(shapely.distance(self.polygon.boundary, shapely.points(s, t)))

    @cached_property
    def _chains(self) -> list[shapely.STRtree]:
        """The sides of the outline, for each part of the outline between two convex corners."""
        trees = []
        for ring in self.rings:
            ways = np.roll(ring, -1, axis=0) - ring
            before = np.roll(ways, 1, axis=0)
            turn = before[:, 0] * ways[:, 1] - before[:, 1] * ways[:, 0]
            corners = np.flatnonzero(turn > _CORNER * np.hypot(*before.T) * np.hypot(*ways.T)).tolist() or [0]
            sides = shapely.linestrings(np.stack([ring, np.roll(ring, -1, axis=0)], axis=1))
            for first, last in zip(corners, [*corners[1:], corners[0] + len(ring)], strict=True):
                trees.append(shapely.STRtree(sides[np.arange(first, last) % len(ring)]))
        return trees

    def near(self, s: Floats, t: Floats, far_mm: float) -> Iterator[tuple[Any, Floats]]:
        """Yield the points near each part of the outline between two convex corners, and their distances from it.

        Args:
            s: The coordinates of the points along s, shape (n,).
            t: The coordinates along t.
            far_mm: The largest distance.
        """
        points = shapely.points(s, t)
        for tree in self._chains:
            (rows, _), distances = tree.query_nearest(
                points, max_distance=far_mm, return_distance=True, all_matches=False
            )
            yield rows, distances

    def prism(self, low_mm: float, high_mm: float, simplify_mm: float = 0.0) -> Any:
        """Return the space above an area of a plane between two heights, as an object of manifold3d in (s, t, h)."""
        import manifold3d

        outline = manifold3d.CrossSection(self.rings, manifold3d.FillRule.EvenOdd).simplify(simplify_mm)
        return outline.extrude(high_mm - low_mm).translate((0.0, 0.0, low_mm))
