"""The body between spline patches and a constant height above a face, as a solid of the CAD kernel."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeFace, BRepBuilderAPI_MakePolygon
from OCP.BRepPrimAPI import BRepPrimAPI_MakeRevol
from OCP.Geom import Geom_Circle, Geom_CylindricalSurface
from OCP.Geom2d import Geom2d_Line
from OCP.gp import gp_Ax1, gp_Ax2, gp_Ax3, gp_Dir, gp_Dir2d, gp_Pnt, gp_Pnt2d
from OCP.TopoDS import TopoDS, TopoDS_Edge, TopoDS_Face, TopoDS_Shape, TopoDS_Solid, TopoDS_Vertex

from tacbench_cad.geometry.splines import kernelsplines
from tacbench_cad.geometry.splines.patches import DEGREE
from tacbench_cad.geometry.splines.topology import Point, Topology, plane, turned
from tacbench_cad.geometry.textured.area import Area
from tacbench_cad.geometry.textured.patches import PatchGrid
from tacbench_cad.util.types import Floats


def body_between(area: Area, low_mm: float, high_mm: float) -> TopoDS_Shape:
    """Return the space above a rectangle or a band of a cylinder between two heights."""
    frame, polygon = area.frame, BRepBuilderAPI_MakePolygon()
    assert frame.radius_mm is not None
    for t, h in ((0.0, low_mm), (area.size_mm[1], low_mm), (area.size_mm[1], high_mm), (0.0, high_mm)):
        polygon.Add(gp_Pnt(*frame.point(np.array(0.0), np.array(t), h).tolist()))
    polygon.Close()
    profile = BRepBuilderAPI_MakeFace(polygon.Wire(), True).Face()
    axis = gp_Ax1(gp_Pnt(*frame.origin.tolist()), gp_Dir(*(frame.side * frame.axes[2]).tolist()))
    angle = 2.0 * math.pi if area.is_closed else area.size_mm[0] / frame.radius_mm
    return BRepPrimAPI_MakeRevol(profile, axis, angle).Shape()


def body_above(patches: PatchGrid, other_mm: float) -> TopoDS_Solid:
    """Return the body between patches over a rectangle and a constant height below or above all of them."""
    body = _Body(patches, other_mm)
    solid = body.top.solid([*body.patch_faces(), *body.walls(), *body.bottom()])
    return solid if body.out > 0.0 else TopoDS.Solid_s(solid.Reversed())


class _Body:
    """Builds the faces of a body. Each vertex and each edge is made once.

    The lines between patches are numbered by i along s and by j along t. The faces point out of a body above the
    constant height, and into a body below it.
    """

    def __init__(self, patches: PatchGrid, other_mm: float) -> None:
        self.top, self.out = Topology(), 1.0 if other_mm < patches.height.range_mm[0] else -1.0
        self._frame, self._s, self._t, self._other_mm = patches.height.area.frame, patches.s, patches.t, other_mm
        self._n, self._m = n, m = patches.s.patches, patches.t.patches
        self._lines = n if patches.height.area.is_closed else n + 1
        self._poles = {(i, j): patches.poles(i, j) for i in range(n) for j in range(m)}
        self._vertices: dict[tuple[int, int], TopoDS_Vertex] = {}
        self._along_s: dict[tuple[int, int], TopoDS_Edge] = {}
        self._along_t: dict[tuple[int, int], TopoDS_Edge] = {}
        for i in range(self._lines):
            for j in range(m + 1):
                self._vertices[i, j] = self.top.vertex(self._corner(i, j))
        for i, j in self._vertices:
            if i < n:
                curve = kernelsplines.curve(self._poles[i, min(j, m - 1)][:, -(j == m)], self._s.knots_of(i), DEGREE)
                ends = self._vertices[i, j], self._vertices[self._right(i), j]
                self._along_s[i, j] = self.top.edge(curve, float(self._s.lines[i]), float(self._s.lines[i + 1]), *ends)
            if j < m:
                curve = kernelsplines.curve(self._poles[min(i, n - 1), j][-(i == n)], self._t.knots_of(j), DEGREE)
                ends = self._vertices[i, j], self._vertices[i, j + 1]
                self._along_t[i, j] = self.top.edge(curve, float(self._t.lines[j]), float(self._t.lines[j + 1]), *ends)
        self._feet = {(i, j): self.top.vertex(self._foot(i, j)) for i in range(self._lines) for j in (0, m)}
        self._posts = {
            at: self.top.segment(self._foot(*at), self._corner(*at), foot, self._vertices[at])
            for at, foot in self._feet.items()
        }
        self._low_s = {(i, j): self._arc(i, j) for i in range(n) for j in (0, m)}
        self._low_t = [
            self.top.segment(self._foot(i, 0), self._foot(i, m), self._feet[i, 0], self._feet[i, m])
            for i in range(self._lines)
        ]

    def _right(self, i: int) -> int:
        return (i + 1) % self._lines

    def _corner(self, i: int, j: int) -> Point:
        x, y, z = self._poles[min(i, self._n - 1), min(j, self._m - 1)][-(i == self._n), -(j == self._m)].tolist()
        return x, y, z

    def _foot(self, i: int, j: int) -> Point:
        x, y, z = self._frame.point(self._s.lines[i], self._t.lines[j], self._other_mm).tolist()
        return x, y, z

    def _arc(self, i: int, j: int) -> TopoDS_Edge:
        """Return the edge along s from a foot to the next one. Around a cylinder, its parameter is the angle."""
        ends, radius = (self._feet[i, j], self._feet[self._right(i), j]), self._frame.radius_mm
        if radius is None:
            return self.top.segment(self._foot(i, j), self._foot(i + 1, j), *ends)
        centre = self._frame.origin + self._t.lines[j] * self._frame.axes[2]
        circle = Geom_Circle(gp_Ax2(*self._axes(centre)), radius + self._frame.side * self._other_mm)
        return self.top.edge(circle, float(self._s.lines[i]) / radius, float(self._s.lines[i + 1]) / radius, *ends)

    def _axes(self, origin: Floats) -> tuple[gp_Pnt, gp_Dir, gp_Dir]:
        """Return the coordinates around the axis of a cylinder in which the angle grows with s."""
        up, first = self._frame.side * self._frame.axes[2], self._frame.axes[0]
        return gp_Pnt(*origin.tolist()), gp_Dir(*up.tolist()), gp_Dir(*first.tolist())

    def patch_faces(self) -> Iterator[TopoDS_Face]:
        """Yield the textured faces."""
        for (i, j), poles in self._poles.items():
            knots, right = (self._s.knots_of(i), self._t.knots_of(j)), self._right(i)
            surface = kernelsplines.surface(poles, knots, (DEGREE, DEGREE))
            low, high, left, far = (
                self._along_s[i, j],
                self._along_s[i, j + 1],
                self._along_t[i, j],
                self._along_t[right, j],
            )
            for edge, t in ((low, self._t.lines[j]), (high, self._t.lines[j + 1])):
                self.top.lay(edge, Geom2d_Line(gp_Pnt2d(0.0, t), gp_Dir2d(1.0, 0.0)), surface)
            for edge, s in ((left, self._s.lines[i]), (far, self._s.lines[i + 1])):
                self.top.lay(edge, Geom2d_Line(gp_Pnt2d(s, 0.0), gp_Dir2d(0.0, 1.0)), surface)
            yield self.top.face(surface, [self.top.wire([low, far, turned(high), turned(left)])], whole=True)

    def walls(self) -> Iterator[TopoDS_Face]:
        """Yield the faces between the patches and the constant height."""
        n, m, posts = self._n, self._m, self._posts
        along = self._frame.axes[1 if self._frame.radius_mm is None else 2]
        for i in range(n):
            right, up = self._right(i), self._frame.normal(float(self._s.lines[i]))
            for j, sign in ((0, -1.0), (m, 1.0)):
                wire = [self._low_s[i, j], posts[right, j], turned(self._along_s[i, j]), turned(posts[i, j])]
                yield self._wall((i, j), sign * along, up, wire if j == 0 else _backwards(wire))
        for i, sign in () if self._lines == n else ((0, -1.0), (n, 1.0)):
            up = self._frame.normal(float(self._s.lines[i]))
            upper = [turned(self._along_t[i, j]) for j in reversed(range(m))]
            wire = [self._low_t[i], posts[i, m], *upper, turned(posts[i, 0])]
            yield self._wall((i, 0), sign * np.cross(along, up), up, wire if i == n else _backwards(wire))

    def _wall(self, at: tuple[int, int], normal: Floats, up: Floats, edges: list[TopoDS_Edge]) -> TopoDS_Face:
        outwards = self.out * normal
        surface = plane(self._foot(*at), tuple(outwards.tolist()), tuple(up.tolist()))
        return self.top.face(surface, [self.top.wire(edges)])

    def bottom(self) -> Iterator[TopoDS_Face]:
        """Yield the faces at the constant height, one below each column of patches."""
        frame, m, side = self._frame, self._m, self._frame.side
        for i in range(self._n):
            left, right = self._low_t[i], self._low_t[self._right(i)]
            wire = [left, self._low_s[i, m], turned(right), turned(self._low_s[i, 0])]
            if frame.radius_mm is None:
                down, first = -frame.axes[2], frame.axes[0]
                surface = plane(self._foot(i, 0), tuple(down.tolist()), tuple(first.tolist()))
                yield self.top.face(surface, [self.top.wire(wire)])
                continue
            cylinder = Geom_CylindricalSurface(
                gp_Ax3(*self._axes(frame.origin)), frame.radius_mm + side * self._other_mm
            )
            for j in (0, m):
                trace = Geom2d_Line(gp_Pnt2d(0.0, side * self._t.lines[j]), gp_Dir2d(1.0, 0.0))
                self.top.lay(self._low_s[i, j], trace, cylinder)
            for edge, s in ((left, self._s.lines[i]), (right, self._s.lines[i + 1])):
                self.top.lay(edge, Geom2d_Line(gp_Pnt2d(s / frame.radius_mm, 0.0), gp_Dir2d(0.0, side)), cylinder)
            if side < 0.0:  # the normal of the kernel's cylinder points away from the axis
                yield self.top.face(cylinder, [self.top.wire(wire)])
            else:
                yield TopoDS.Face_s(self.top.face(cylinder, [self.top.wire(_backwards(wire))]).Reversed())


def _backwards(edges: list[TopoDS_Edge]) -> list[TopoDS_Edge]:
    """Return a closed path in the opposite direction."""
    return [turned(edge) for edge in reversed(edges)]
