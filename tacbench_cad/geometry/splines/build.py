"""Construction of a block's solid from its spline patches."""

from __future__ import annotations

import math
from collections.abc import Iterator

from OCP.Geom import Geom_BSplineSurface
from OCP.Geom2d import Geom2d_Line
from OCP.gp import gp_Dir2d, gp_Pnt2d
from OCP.TopoDS import TopoDS_Edge, TopoDS_Face, TopoDS_Solid, TopoDS_Vertex, TopoDS_Wire

from tacbench_cad.geometry.splines.exact import SplinePatches
from tacbench_cad.geometry.splines.patches import Patches
from tacbench_cad.geometry.splines.splinegeom import SplineGeometry
from tacbench_cad.geometry.splines.topology import Point, Topology, plane, turned
from tacbench_cad.geometry.splines.underside import underside
from tacbench_cad.spec.block import Block

#: A corner of the patch grid, given by the indices of its lines along x and y.
Corner = tuple[int, int]


class SolidBuilder:
    """Builds the solid of a block. Each vertex and each edge is made once, when it is first needed.

    Args:
        block: The block.
        relief: The patches of the block.
    """

    def __init__(self, block: Block, relief: Patches | SplinePatches) -> None:
        self._block, self._relief = block, relief
        self._top = Topology()
        self._geometry = SplineGeometry(relief)
        self._xs, self._ys = relief.x.lines.tolist(), relief.y.lines.tolist()
        self._nx, self._ny, self._key = relief.x.patches, relief.y.patches, relief.key_patches
        self._vertices: dict[Corner, TopoDS_Vertex] = {}
        self._edges: dict[tuple[Corner, Corner], TopoDS_Edge] = {}
        self._traces_x = [Geom2d_Line(gp_Pnt2d(0.0, y), gp_Dir2d(1.0, 0.0)) for y in self._ys]
        self._traces_y = [Geom2d_Line(gp_Pnt2d(x, 0.0), gp_Dir2d(0.0, 1.0)) for x in self._xs]

    def solid(self) -> TopoDS_Solid:
        """Build the solid of the whole block."""
        faces = list(self._patch_faces())
        faces.extend(self._walls_and_underside())
        return self._top.solid(faces)

    def face(self) -> TopoDS_Face:
        """Build one face for the whole surface. It has the same edges as the outline of the patches."""
        surface = self._geometry.whole_surface()
        wire = self._wire_on(surface, self._outline())
        return self._top.face(surface, [wire], whole=self._key == 0)

    def _wire_on(self, surface: Geom_BSplineSurface, corners: list[Corner]) -> TopoDS_Wire:
        """Make a wire through neighbouring corners, on a surface with parameters x and y."""
        edges = []
        for start, end in zip(corners, corners[1:] + corners[:1], strict=True):
            edge = self._edge(start, end)
            self._top.lay(edge, self._trace(start, end), surface)
            edges.append(edge)
        return self._top.wire(edges)

    def _patch_faces(self) -> Iterator[TopoDS_Face]:
        """Yield the faces of the top: whole patches, and half patches along the key's diagonal."""
        first = self._nx - self._key
        for i in range(self._nx):
            for j in range(self._ny):
                beyond = i - first - j if i >= first and j < self._key else -1
                if beyond > 0:
                    continue
                corners = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]
                if beyond == 0:
                    del corners[1]
                surface = self._geometry.surface(i, j)
                yield self._top.face(surface, [self._wire_on(surface, corners)], whole=beyond < 0)

    def _walls_and_underside(self) -> Iterator[TopoDS_Face]:
        """Yield a wall below each edge of the outline, and the faces of the underside."""
        corners = self._outline()
        points = [(self._xs[i], self._ys[j], 0.0) for i, j in corners]
        feet = [self._top.vertex(point) for point in points]
        posts = [
            self._top.segment(point, self._point(corner), foot, self._vertex(corner))
            for point, corner, foot in zip(points, corners, feet, strict=True)
        ]
        bottom = []
        for k, corner in enumerate(corners):
            after = (k + 1) % len(corners)
            (ax, ay, _), (bx, by, _) = points[k], points[after]
            foot = self._top.segment(points[k], points[after], feet[k], feet[after])
            wall = plane(points[k], (by - ay, ax - bx, 0.0), (bx - ax, by - ay, 0.0))
            upper = turned(self._edge(corner, corners[after]))
            yield self._top.face(wall, [self._top.wire([foot, posts[after], upper, turned(posts[k])])])
            bottom.append(foot)
        outer = self._top.wire([turned(foot) for foot in reversed(bottom)])
        yield from underside(self._top, outer, self._block.engraving)

    def _outline(self) -> list[Corner]:
        """Return the corners of the patch grid along the block's outline, counter-clockwise from the origin."""
        nx, ny, key = self._nx, self._ny, self._key
        corners = [(i, 0) for i in range(nx - key)]
        corners += [(nx - key + k, k) for k in range(key)]
        corners += [(nx, j) for j in range(key, ny)]
        corners += [(i, ny) for i in range(nx, 0, -1)]
        return corners + [(0, j) for j in range(ny, 0, -1)]

    def _point(self, corner: Corner) -> Point:
        return (self._xs[corner[0]], self._ys[corner[1]], self._geometry.corner_height_mm(*corner))

    def _vertex(self, corner: Corner) -> TopoDS_Vertex:
        if corner not in self._vertices:
            self._vertices[corner] = self._top.vertex(self._point(corner))
        return self._vertices[corner]

    def _edge(self, start: Corner, end: Corner) -> TopoDS_Edge:
        """Return the edge of the top from a corner to its neighbour, with this orientation."""
        if start > end:
            return turned(self._edge(end, start))
        if (start, end) not in self._edges:
            (i, j), (k, m) = start, end
            if j == m:
                curve, first, last = self._geometry.curve_x(i, j), self._xs[i], self._xs[k]
            elif i == k:
                curve, first, last = self._geometry.curve_y(i, j), self._ys[j], self._ys[m]
            else:
                curve = self._geometry.curve_diagonal(i, j)
                first, last = math.sqrt(2.0) * self._ys[j], math.sqrt(2.0) * self._ys[m]
            self._edges[start, end] = self._top.edge(curve, first, last, self._vertex(start), self._vertex(end))
        return self._edges[start, end]

    def _trace(self, start: Corner, end: Corner) -> Geom2d_Line:
        """Return the curve of an edge in the plane of x and y. It has the same parameter as the edge."""
        (i, j), (k, m) = min(start, end), max(start, end)
        if j == m:
            return self._traces_x[j]
        if i == k:
            return self._traces_y[i]
        corner = self._xs[self._nx - self._key]
        return Geom2d_Line(gp_Pnt2d(corner, 0.0), gp_Dir2d(1.0, 1.0))
