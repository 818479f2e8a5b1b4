"""B-spline faces of a solid as arrays: points, volumes, and bounding boxes.

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
#: Two coordinates that differ by less are the same, in mm. A file has twelve decimals.
SAME_MM = 1e-9
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
    def is_graph(self) -> bool:
        """Whether the parameters are x and y, so that z is a function of them."""
        x, y = self.axes[0].greville[:, None], self.axes[1].greville[None, :]
        return bool(max(np.abs(self.poles[..., 0] - x).max(), np.abs(self.poles[..., 1] - y).max()) <= SAME_MM)

    @cached_property
    def is_wall(self) -> bool:
        """Whether the surface is vertical: one of its coordinates x and y is constant, or all normals are level."""
        if min(np.ptp(self.poles[..., axis]) for axis in (0, 1)) <= SAME_MM:
            return True
        if self.is_graph:
            return False
        z = np.abs(self._normals[..., 2])
        return bool(np.all(z <= WALL_FRACTION * np.sqrt(np.einsum("nmc,nmc->nm", self._normals, self._normals))))

    @cached_property
    def volume_mm3(self) -> float:
        """The volume between the face and the plane z = 0, the integral of ``z dx dy``; negative if it faces down."""
        if self.is_graph:
            along_u, along_v = (axis.integrals(*ends) for axis, ends in zip(self.axes, self.bounds, strict=True))
            return self.sign * float(np.einsum("n,nm,m->", along_u, self.poles[..., 2], along_v))
        (u, weight_u), (v, weight_v) = self._places
        z = self._grid(self.poles[..., 2:], u, v)[..., 0]
        return self.sign * float(np.einsum("n,nm,nm,m->", weight_u, z, self._normals[..., 2], weight_v))

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
    def _normals(self) -> Floats:
        """The products of both derivatives at the Gauss points and on the borders, shape (n, m, 3)."""
        (u, _), (v, _) = self._places
        (ax, ay, az), (bx, by, bz) = (np.moveaxis(self(u, v, order), -1, 0) for order in ((1, 0), (0, 1)))
        return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)

    def highest_mm(self, axis: int, sign: float) -> float:
        """Return the largest coordinate x, y or z, or with the sign -1 the largest negative coordinate.

        It is computed at the Gauss points and on the borders, and at fine samples around the best of these points.
        """
        poles = sign * self.poles[..., axis : axis + 1]
        (u, _), (v, _) = self._places
        rough = self._grid(poles, u, v)
        i, j = divmod(int(rough.argmax()), len(v))
        near_u = np.linspace(u[max(i - 1, 0)], u[min(i + 1, len(u) - 1)], FINE)
        near_v = np.linspace(v[max(j - 1, 0)], v[min(j + 1, len(v) - 1)], FINE)
        return float(max(rough.max(), self._grid(poles, near_u, near_v).max()))


def box(patches: Sequence[SplineFace], points: Floats) -> tuple[Floats, Floats]:
    """Return the lowest and the highest x, y and z of some faces and points.

    A spline lies between its lowest and its highest pole. A face is therefore only measured if it has a pole outside of
    the box of everything that was measured before it.
    """
    ends = []
    for sign in (-1.0, 1.0):
        end = (sign * points).max(axis=0)
        outer = np.array([(sign * patch.poles).max(axis=(0, 1)) for patch in patches]).reshape(-1, 3)
        for axis in range(3):
            for place in np.argsort(-outer[:, axis]):
                if outer[place, axis] <= end[axis] + SAME_MM:
                    break
                end[axis] = max(end[axis], patches[place].highest_mm(axis, sign))
        ends.append(sign * end)
    return ends[0], ends[1]


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
