"""Spline patches of a block that an outline cuts: their volumes, their points and their highest points.

The parameters of such a patch are x and y. By Green's theorem, the volume below it is an integral along its border:
that of ``Z(x, y) dy``, where Z is the antiderivative of the height along x.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.interpolate import BSpline

from tacbench_cad.checks.splineface import SplineFace
from tacbench_cad.util.types import Bools, Floats

if TYPE_CHECKING:
    from OCP.TopoDS import TopoDS_Edge, TopoDS_Face

#: The number of Gauss points on each piece of a border.
_GAUSS_POINTS = 8
#: The smallest number of pieces of a border that is not a straight line.
_PIECES = 24
#: Two coordinates that differ by less are the same, in mm.
_SAME_MM = 1e-6
#: The number of samples along each side of the square around the highest point of a patch, and the number of squares.
_FINE, _ROUNDS = 17, 4


@dataclass(frozen=True, eq=False)
class TrimmedFace:
    """A patch of a block that fills a part of its parameter rectangle.

    Args:
        patch: The patch. Its parameters are x and y.
        border: Gauss points u, v on the border and their weights of dv, shape (3, k).
        loops: Points around each loop of the border in their order, shape (n, 2) each.
    """

    patch: SplineFace
    border: Floats
    loops: tuple[Floats, ...]

    @cached_property
    def volume_mm3(self) -> float:
        """The volume between the patch and the plane z = 0; negative if the patch faces down."""
        u, v, weight = self.border
        low = self.patch.bounds[0][0]
        knots, degree = self.patch.axes[0].knots, self.patch.axes[0].degree
        inner = np.clip(u, knots[degree], knots[-degree - 1])
        rising = BSpline(knots, np.eye(self.patch.poles.shape[0]), degree).antiderivative()
        along_u = rising(inner) - rising(low)
        along_v = self._basis(1, v)
        heights = np.einsum("ki,ij,kj->k", along_u, self.patch.poles[:, :, 2], along_v)
        return self.patch.sign * float(weight @ heights)

    def _basis(self, axis: int, at: Floats) -> Floats:
        knots, degree = self.patch.axes[axis].knots, self.patch.axes[axis].degree
        inner = np.clip(at, knots[degree], knots[-degree - 1])
        return np.asarray(BSpline(knots, np.eye(self.patch.poles.shape[axis]), degree)(inner))

    def inside(self, u: Floats, v: Floats) -> Bools:
        """Return which points of a grid (n,) by (m,) are inside of the border, by the even-odd rule, shape (n, m)."""
        crossings = np.zeros((len(u), len(v)), dtype=np.int64)
        for loop in self.loops:
            a, b = loop, np.roll(loop, -1, axis=0)
            for k, at in enumerate(v.tolist()):
                spans = (a[:, 1] > at) != (b[:, 1] > at)
                p, q = a[spans], b[spans]
                crossed = p[:, 0] + (at - p[:, 1]) / (q[:, 1] - p[:, 1]) * (q[:, 0] - p[:, 0])
                crossings[:, k] += (crossed[None, :] > u[:, None]).sum(axis=1)
        return np.asarray(crossings % 2 == 1)

    def points(self, side: int) -> Floats:
        """Return points inside of the border and on it, shape (k, 3)."""
        (u0, u1), (v0, v1) = self.patch.bounds
        u, v = np.linspace(u0, u1, side), np.linspace(v0, v1, side)
        inner = self.patch(u, v)[self.inside(u, v)]
        return np.concatenate([inner, self._border_points])

    @cached_property
    def _border_points(self) -> Floats:
        u, v = np.concatenate(self.loops).T
        return np.asarray(np.einsum("ki,ijc,kj->kc", self._basis(0, u), self.patch.poles, self._basis(1, v)))

    def highest_mm(self, side: int) -> float:
        """Return the height of the highest point, from ever smaller squares around the highest of some points."""
        points = self.points(side)
        best = points[int(points[:, 2].argmax())]
        highest = float(best[2])
        half = [(high - low) / (side - 1) for low, high in self.patch.bounds]
        for _ in range(_ROUNDS):
            axes = [
                np.linspace(max(at - width, low), min(at + width, high), _FINE)
                for at, width, (low, high) in zip(best[:2], half, self.patch.bounds, strict=True)
            ]
            grid = self.patch(axes[0], axes[1])
            grid = grid[self.inside(*axes)]
            if len(grid):
                here = grid[int(grid[:, 2].argmax())]
                if here[2] > highest:
                    best, highest = here, float(here[2])
            half = [2.0 * width / (_FINE - 1) for width in half]
        return highest


def trimmed_face(face: TopoDS_Face, patch: SplineFace) -> TrimmedFace:
    """Read the border of a face.

    Args:
        face: The face.
        patch: Its surface.
    """
    from OCP.BRepTools import BRepTools_WireExplorer
    from OCP.TopAbs import TopAbs_Orientation
    from OCP.TopoDS import TopoDS

    from tacbench_cad.geometry import kernel

    forward = TopoDS.Face_s(face.Oriented(TopAbs_Orientation.TopAbs_FORWARD))
    rows, loops = [], []
    for wire in kernel.each(forward, "WIRE"):
        explorer, run = BRepTools_WireExplorer(wire, forward), []
        while explorer.More():
            points, border = _edge(explorer.Current(), forward, (patch.axes[0].knots, patch.axes[1].knots))
            run.append(points[:-1])
            rows.append(border)
            explorer.Next()
        loops.append(np.concatenate(run))
    return TrimmedFace(patch, np.concatenate(rows, axis=1), tuple(loops))


def _edge(edge: TopoDS_Edge, face: TopoDS_Face, knots: tuple[Floats, Floats]) -> tuple[Floats, Floats]:
    """Return points along an edge in its direction, shape (n, 2), and its Gauss points u, v and weights of dv."""
    from OCP.BRepAdaptor import BRepAdaptor_Curve2d
    from OCP.GeomAbs import GeomAbs_CurveType
    from OCP.gp import gp_Pnt2d, gp_Vec2d
    from OCP.TopAbs import TopAbs_Orientation

    curve = BRepAdaptor_Curve2d(edge, face)
    first, last = curve.FirstParameter(), curve.LastParameter()
    point, way = gp_Pnt2d(), gp_Vec2d()

    def place(at: Any) -> tuple[float, float, float]:
        curve.D1(at, point, way)
        return point.X(), point.Y(), way.Y()

    straight = curve.GetType() == GeomAbs_CurveType.GeomAbs_Line
    if straight:
        (u0, v0, rise), (u1, v1, _) = place(first), place(last)
        breaks = [np.array([0.0, 1.0])]
        for axis, (low, high) in enumerate(((u0, u1), (v0, v1))):
            if abs(high - low) > _SAME_MM:
                breaks.append((knots[axis] - low) / (high - low))
        fractions = np.unique(np.clip(np.concatenate(breaks), 0.0, 1.0))
        parameters = first + (last - first) * fractions
    else:
        own = list(curve.BSpline().Knots()) if _is_spline(curve) else []
        parameters = np.unique(np.clip([*np.linspace(first, last, _PIECES + 1), *own], first, last))
    gauss, share = np.polynomial.legendre.leggauss(_GAUSS_POINTS)
    half = np.diff(parameters) / 2.0
    at = (parameters[:-1, None] + half[:, None] * (1.0 + gauss)).ravel()
    weights = (half[:, None] * share).ravel()
    if straight:
        along = (at - first) / (last - first)
        u, v = u0 + along * (u1 - u0), v0 + along * (v1 - v0)
        slopes = np.full(len(at), rise)
        points = np.array([[u0, v0], [u1, v1]])
    else:
        u, v, slopes = np.array([place(value) for value in at.tolist()]).T
        points = np.array([place(value)[:2] for value in (first, *at.tolist(), last)])
    sign = -1.0 if edge.Orientation() == TopAbs_Orientation.TopAbs_REVERSED else 1.0
    if sign < 0.0:
        points = points[::-1]
    return points, np.stack([u, v, sign * slopes * weights])


def _is_spline(curve: Any) -> bool:
    from OCP.GeomAbs import GeomAbs_CurveType

    return bool(curve.GetType() == GeomAbs_CurveType.GeomAbs_BSplineCurve)
