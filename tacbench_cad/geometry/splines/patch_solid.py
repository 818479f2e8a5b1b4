"""The solid between spline patches and a constant height, over a rectangle of a plane or a part of a cylinder."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Protocol

import numpy as np
from OCP.Geom import Geom_Circle, Geom_CylindricalSurface
from OCP.Geom2d import Geom2d_Line
from OCP.gp import gp_Ax2, gp_Ax3, gp_Dir, gp_Dir2d, gp_Pnt, gp_Pnt2d
from OCP.TopoDS import TopoDS, TopoDS_Edge, TopoDS_Face, TopoDS_Solid

from tacbench_cad.geometry.splines import kernelsplines
from tacbench_cad.geometry.splines.topology import Point, Topology, plane, turned
from tacbench_cad.geometry.textured.frame import Frame
from tacbench_cad.util.types import Floats


class PatchAxis(Protocol):
    """One axis of a grid of patches."""

    @property
    def lines(self) -> Floats:
        """The ends of the patches in mm, ascending."""
        ...

    @property
    def patches(self) -> int:
        """The number of patches."""
        ...

    @property
    def degree(self) -> int:
        """The polynomial degree."""
        ...

    def knots_of(self, patch: int, /) -> kernelsplines.Knots:
        """Return the different knots of a patch in mm, and the number of copies of each."""
        ...


def solid_between(
    poles: Mapping[tuple[int, int], Floats],
    axes: tuple[PatchAxis, PatchAxis],
    frame: Frame,
    other_mm: float,
    *,
    is_above: bool,
    is_closed: bool = False,
) -> TopoDS_Solid:
    """Return the solid between patches over a rectangle and a constant height.

    Args:
        poles: The poles of each patch (i, j) in the coordinates of the solid, shape (n, m, 3). Neighbours have the same
            poles on their common edge.
        axes: The axes along s and t. Their coordinates are the parameters of the patches.
        frame: The local coordinates.
        other_mm: The constant height.
        is_above: Whether the patches are above this height; otherwise they are below it.
        is_closed: Whether the patches go all the way around a cylinder.
    """
    body = _Builder(poles, axes, frame, other_mm, 1.0 if is_above else -1.0, is_closed)
    solid = body.top.solid([*body.patch_faces(), *body.walls(), *body.bottom()])
    return solid if is_above else TopoDS.Solid_s(solid.Reversed())


class _Builder:
    """Builds the faces of a body. Each vertex and each edge is made once.

    The lines between patches are numbered by i along s and by j along t. The faces point out of a body above the
    constant height, and into a body below it.
    """

    def __init__(
        self,
        poles: Mapping[tuple[int, int], Floats],
        axes: tuple[PatchAxis, PatchAxis],
        frame: Frame,
        other_mm: float,
        out: float,
        is_closed: bool,
    ) -> None:
        self.top, self._poles, self._frame, self._other_mm, self._out = Topology(), poles, frame, other_mm, out
        self._s, self._t = s, t = axes
        self._n, self._m = n, m = s.patches, t.patches
        self._lines = n if is_closed else n + 1
        crossings = [(i, j) for i in range(self._lines) for j in range(m + 1)]
        self._vertices = {at: self.top.vertex(self._corner(*at)) for at in crossings}
        self._along_s: dict[tuple[int, int], TopoDS_Edge] = {}
        self._along_t: dict[tuple[int, int], TopoDS_Edge] = {}
        for i, j in crossings:
            if i < n:
                curve = kernelsplines.curve(poles[i, min(j, m - 1)][:, -(j == m)], s.knots_of(i), s.degree)
                ends = self._vertices[i, j], self._vertices[self._right(i), j]
                self._along_s[i, j] = self.top.edge(curve, float(s.lines[i]), float(s.lines[i + 1]), *ends)
            if j < m:
                curve = kernelsplines.curve(poles[min(i, n - 1), j][-(i == n)], t.knots_of(j), t.degree)
                ends = self._vertices[i, j], self._vertices[i, j + 1]
                self._along_t[i, j] = self.top.edge(curve, float(t.lines[j]), float(t.lines[j + 1]), *ends)
        self._feet = {(i, j): self.top.vertex(self._foot(i, j)) for i in range(self._lines) for j in (0, m)}
        self._posts = {
            at: self.top.segment(self._foot(*at), self._corner(*at), foot, self._vertices[at])
            for at, foot in self._feet.items()
        }
        self._low_s = {(i, j): self._arc(i, j) for i in range(n) for j in (0, m)}
        self._low_t = {
            i: self.top.segment(self._foot(i, 0), self._foot(i, m), self._feet[i, 0], self._feet[i, m])
            for i in (range(self._lines) if frame.radius_mm else (0, n))
        }

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
            surface = kernelsplines.surface(poles, knots, (self._s.degree, self._t.degree))
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
        outwards = self._out * normal
        surface = plane(self._foot(*at), tuple(outwards.tolist()), tuple(up.tolist()))
        return self.top.face(surface, [self.top.wire(edges)])

    def bottom(self) -> Iterator[TopoDS_Face]:
        """Yield the face at the constant height; on a cylinder, one face below each column of patches."""
        n, m, frame = self._n, self._m, self._frame
        if frame.radius_mm is None:
            down, first = (tuple(axis.tolist()) for axis in (-frame.axes[2], frame.axes[0]))
            low, high = ([self._low_s[i, j] for i in range(n)] for j in (0, m))
            wire = [self._low_t[0], *high, turned(self._low_t[n]), *_backwards(low)]
            yield self.top.face(plane(self._foot(0, 0), down, first), [self.top.wire(wire)])
            return
        radius, side = frame.radius_mm, frame.side
        for i in range(n):
            left, right = self._low_t[i], self._low_t[self._right(i)]
            cylinder = Geom_CylindricalSurface(gp_Ax3(*self._axes(frame.origin)), radius + side * self._other_mm)
            for j in (0, m):
                trace = Geom2d_Line(gp_Pnt2d(0.0, side * self._t.lines[j]), gp_Dir2d(1.0, 0.0))
                self.top.lay(self._low_s[i, j], trace, cylinder)
            for edge, s in ((left, self._s.lines[i]), (right, self._s.lines[i + 1])):
                self.top.lay(edge, Geom2d_Line(gp_Pnt2d(s / radius, 0.0), gp_Dir2d(0.0, side)), cylinder)
            wire = [left, self._low_s[i, m], turned(right), turned(self._low_s[i, 0])]
            if side < 0.0:  # the normal of the kernel's cylinder points away from the axis
                yield self.top.face(cylinder, [self.top.wire(wire)])
            else:
                yield TopoDS.Face_s(self.top.face(cylinder, [self.top.wire(_backwards(wire))]).Reversed())


def _backwards(edges: list[TopoDS_Edge]) -> list[TopoDS_Edge]:
    """Return a closed path in the opposite direction."""
    return [turned(edge) for edge in reversed(edges)]
