"""B-spline faces of a solid as arrays: points, contributions to the volume, and bounding boxes.

For a block of 156 patches, the kernel needs about four seconds to compute its default volume, bounding box and points.
This module needs less than half a second. It does not import SciPy, which would take as long, and it does not use BLAS:
in the worker processes of ``make``, a BLAS with several threads waits much longer for cores than it multiplies.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import numpy as np

from tacbench_cad.geometry.relief import WALL_FRACTION
from tacbench_cad.spec.spline import SplineAxis
from tacbench_cad.util.types import Floats, Ints

if TYPE_CHECKING:
    from OCP.TopoDS import TopoDS_Face

#: The number of Gauss points in each knot span. The integral of a polynomial up to degree 9 is then exact. For the
#: patches of this package, the relative error of the volume is below 1e-9.
GAUSS_POINTS = 5
#: The number of samples along u and along v around the highest and the lowest sample of a patch. They give the extreme
#: heights more accurately.
FINE = 33
#: Basis functions at some places: the knots, the degree and the places as bytes, and the values.
Bases = dict[tuple[bytes, int, bytes], tuple[Ints, Floats]]


@dataclass(frozen=True, eq=False)
class SplineFace:
    """A non-rational B-spline surface over a rectangle of its parameters.

    Args:
        poles: The control points in mm, shape (nu, nv, 3).
        axes: The knots and degrees along u and v.
        bounds: The parameter rectangle of the face, ``((u low, u high), (v low, v high))``.
        sign: 1 if the surface's own normal points out of the solid, -1 if the face is reversed.
    """

    poles: Floats
    axes: tuple[SplineAxis, SplineAxis]
    bounds: tuple[tuple[float, float], tuple[float, float]]
    sign: float
    _bases: Bases = field(default_factory=dict)

    def __call__(self, u: Floats, v: Floats, order: tuple[int, int] = (0, 0)) -> Floats:
        """Return points or first partial derivatives on the grid of ``u`` (n,) and ``v`` (m,), shape (n, m, 3)."""
        return self._grid(self.poles, u, v, order)

    def _grid(self, poles: Floats, u: Floats, v: Floats, order: tuple[int, int] = (0, 0)) -> Floats:
        for at, axis, times in zip((u, v), self.axes, order, strict=True):
            if times:
                axis, poles = axis.derived(poles)
            key = (axis.knots.tobytes(), axis.degree, at.tobytes())
            if key not in self._bases:
                self._bases[key] = axis.local(at)
            first, values = self._bases[key]
            points = values[0][:, None, None] * poles[first]
            for k in range(1, axis.degree + 1):
                points += values[k][:, None, None] * poles[first + k]
            poles = points.swapaxes(0, 1)
        return poles

    def lattice(self, side: int) -> Floats:
        """Return the points at ``side`` x ``side`` equally spaced parameters, with the borders, shape (k, 3)."""
        (u0, u1), (v0, v1) = self.bounds
        return self(np.linspace(u0, u1, side), np.linspace(v0, v1, side)).reshape(-1, 3)

    @cached_property
    def _places(self) -> tuple[tuple[Floats, Floats], tuple[Floats, Floats]]:
        """Along u and along v, the Gauss points of all knot spans between the two ends, with weights of 0 there."""
        places = []
        at, weight = _gauss_rule()
        for axis, (low, high) in zip(self.axes, self.bounds, strict=True):
            inner = axis.breaks
            breaks = np.concatenate([[low], inner[(inner > low) & (inner < high)], [high]])
            half, middle = np.diff(breaks)[:, None] / 2.0, (breaks[1:] + breaks[:-1])[:, None] / 2.0
            points = np.concatenate([[low], (middle + half * at).ravel(), [high]])
            places.append((points, np.concatenate([[0.0], (half * weight).ravel(), [0.0]])))
        return places[0], places[1]

    @cached_property
    def _points(self) -> Floats:
        """The points at the Gauss points and on the borders, shape (n, m, 3)."""
        (u, _), (v, _) = self._places
        return self(u, v)

    @cached_property
    def _normals(self) -> Floats:
        """The products of both derivatives at the same places, not of unit length, shape (n, m, 3)."""
        (u, _), (v, _) = self._places
        (ax, ay, az), (bx, by, bz) = (np.moveaxis(self(u, v, order), -1, 0) for order in ((1, 0), (0, 1)))
        return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)

    @property
    def is_wall(self) -> bool:
        """Whether the surface is vertical at all Gauss points."""
        z = np.abs(self._normals[..., 2])
        return bool(np.all(z <= WALL_FRACTION * np.sqrt(np.einsum("nmc,nmc->nm", self._normals, self._normals))))

    @property
    def volume_mm3(self) -> float:
        """The contribution of the face to the volume about the origin, ``1/3 integral of P . (P_u x P_v)``."""
        (_, weight_u), (_, weight_v) = self._places
        triple = np.einsum("nmc,nmc->nm", self._points, self._normals)
        return self.sign * float(np.einsum("n,nm,m->", weight_u, triple, weight_v)) / 3.0

    @cached_property
    def rough_box(self) -> tuple[Floats, Floats]:
        """The lowest and the highest x, y and z of the Gauss points and the borders."""
        points = self._points.reshape(-1, 3)
        return points.min(axis=0), points.max(axis=0)

    def extreme_z(self, highest: bool) -> float:
        """Return the highest or the lowest z, from fine samples around the extreme one of the Gauss points."""
        (u, _), (v, _) = self._places
        z = self._points[..., 2]
        i, j = divmod(int(z.argmax() if highest else z.argmin()), len(v))
        near_u = np.linspace(u[max(i - 1, 0)], u[min(i + 1, len(u) - 1)], FINE)
        near_v = np.linspace(v[max(j - 1, 0)], v[min(j + 1, len(v) - 1)], FINE)
        fine = self._grid(self.poles[..., 2:], near_u, near_v)
        return float(max(z.max(), fine.max()) if highest else min(z.min(), fine.min()))


def box(patches: Sequence[SplineFace]) -> tuple[Floats, Floats]:
    """Return the lowest and the highest x, y and z of some faces.

    A spline lies between its lowest and its highest pole. Fine samples are therefore only needed on the faces with a
    pole beyond the extreme z that is known.
    """
    low = np.min([patch.rough_box[0] for patch in patches], axis=0)
    high = np.max([patch.rough_box[1] for patch in patches], axis=0)
    for patch in sorted(patches, key=lambda patch: -float(patch.rough_box[1][2])):
        if patch.poles[..., 2].max() > high[2]:
            high[2] = max(high[2], patch.extreme_z(highest=True))
    for patch in sorted(patches, key=lambda patch: float(patch.rough_box[0][2])):
        if patch.poles[..., 2].min() < low[2]:
            low[2] = min(low[2], patch.extreme_z(highest=False))
    return low, high


@lru_cache(maxsize=1)
def _gauss_rule() -> tuple[Floats, Floats]:
    return np.polynomial.legendre.leggauss(GAUSS_POINTS)


def spline_face(face: TopoDS_Face, bases: Bases) -> SplineFace | None:
    """Convert a face to arrays; return None if it is rational, periodic or not a B-spline.

    Args:
        face: The face. It must fill its parameter rectangle.
        bases: A cache of basis functions, for all patches with the same knots.
    """
    from OCP.BRepAdaptor import BRepAdaptor_Surface
    from OCP.BRepTools import BRepTools
    from OCP.GeomAbs import GeomAbs_SurfaceType
    from OCP.TopAbs import TopAbs_Orientation

    surface = BRepAdaptor_Surface(face, True)
    if surface.GetType() != GeomAbs_SurfaceType.GeomAbs_BSplineSurface:
        return None
    spline = surface.BSpline()
    if spline.IsURational() or spline.IsVRational() or spline.IsUPeriodic() or spline.IsVPeriodic():
        return None
    table = spline.Poles()
    rows, columns = range(1, spline.NbUPoles() + 1), range(1, spline.NbVPoles() + 1)
    poles = np.array([[table.Value(i, j).Coord() for j in columns] for i in rows])
    u = SplineAxis(np.array(list(spline.UKnotSequence())), spline.UDegree())
    v = SplineAxis(np.array(list(spline.VKnotSequence())), spline.VDegree())
    u0, u1, v0, v1 = BRepTools.UVBounds_s(face)
    reversed_ = face.Orientation() == TopAbs_Orientation.TopAbs_REVERSED
    return SplineFace(poles, (u, v), ((u0, u1), (v0, v1)), -1.0 if reversed_ else 1.0, bases)
