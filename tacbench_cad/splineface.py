"""B-spline faces of a solid as arrays: points, volume share and box by matrix products.

The kernel's own default volume, box and point evaluation of a block of 156 patches take it about four seconds; these
take a quarter of one, and the volume is exact but for rounding: on every knot span the integrand is a polynomial, which
Gauss-Legendre points integrate exactly.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.interpolate import BSpline

from tacbench_cad.mesh import Floats

if TYPE_CHECKING:
    from OCP.TopoDS import TopoDS_Face

#: Samples along each side around a patch's highest and lowest sample, to find the true extreme.
FINE = 33


@dataclass(frozen=True, eq=False)
class SplineFace:
    """A non-rational B-spline surface over a rectangle of its parameters.

    Args:
        poles: Shape (nu, nv, 3), in mm.
        knots: The full knot vectors along u and v.
        degrees: Degrees along u and v.
        bounds: The face's parameter rectangle, ``((u low, u high), (v low, v high))``.
        sign: 1 where the solid lies below the surface's own normal, -1 where the face is reversed.
    """

    poles: Floats
    knots: tuple[Floats, Floats]
    degrees: tuple[int, int]
    bounds: tuple[tuple[float, float], tuple[float, float]]
    sign: float
    _bases: dict[Any, Floats] = field(default_factory=dict)

    def _basis(self, axis: int, at: Floats, order: int) -> Floats:
        """Basis functions (or their first derivatives) along one axis at parameters, shape (len(at), n)."""
        key = (self.knots[axis].tobytes(), self.degrees[axis], order, at.tobytes())
        if key not in self._bases:
            n = self.poles.shape[axis]
            self._bases[key] = BSpline(self.knots[axis], np.eye(n), self.degrees[axis])(at, nu=order)
        return self._bases[key]

    def __call__(self, u: Floats, v: Floats, order: tuple[int, int] = (0, 0)) -> Floats:
        """Points, or partial derivatives, on the grid of ``u`` (n,) and ``v`` (m,); shape (n, m, 3)."""
        along_u, along_v = self._basis(0, u, order[0]), self._basis(1, v, order[1])
        return np.asarray(np.moveaxis(along_u @ np.moveaxis(self.poles, 2, 0) @ along_v.T, 0, 2))

    def lattice(self, side: int) -> Floats:
        """Points at ``side`` x ``side`` equally spaced parameters, the borders included; shape (k, 3)."""
        (u0, u1), (v0, v1) = self.bounds
        return self(np.linspace(u0, u1, side), np.linspace(v0, v1, side)).reshape(-1, 3)

    def _gauss(self, axis: int) -> tuple[Floats, Floats]:
        """Gauss-Legendre points and weights on every knot span, enough for the volume's polynomial to be exact."""
        low, high = self.bounds[axis]
        inner = np.unique(self.knots[axis])
        breaks = np.concatenate([[low], inner[(inner > low) & (inner < high)], [high]])
        at, weight = np.polynomial.legendre.leggauss((3 * self.degrees[axis] + 1) // 2)
        half, middle = np.diff(breaks) / 2.0, (breaks[1:] + breaks[:-1]) / 2.0
        return (middle[:, None] + half[:, None] * at).ravel(), (half[:, None] * weight).ravel()

    @cached_property
    def volume_mm3(self) -> float:
        """The face's share of the volume by the divergence theorem, ``1/3 integral of P . (P_u x P_v)``."""
        (u, weight_u), (v, weight_v) = self._gauss(0), self._gauss(1)
        point, along_u, along_v = self(u, v), self(u, v, (1, 0)), self(u, v, (0, 1))
        triple = (
            point[..., 0] * (along_u[..., 1] * along_v[..., 2] - along_u[..., 2] * along_v[..., 1])
            + point[..., 1] * (along_u[..., 2] * along_v[..., 0] - along_u[..., 0] * along_v[..., 2])
            + point[..., 2] * (along_u[..., 0] * along_v[..., 1] - along_u[..., 1] * along_v[..., 0])
        )
        return self.sign * float(weight_u @ triple @ weight_v) / 3.0

    def box(self) -> tuple[Floats, Floats]:
        """Lowest and highest x, y and z: from the Gauss points and the borders, refined around the extremes of z."""
        grids = []
        for axis in (0, 1):
            low, high = self.bounds[axis]
            grids.append(np.concatenate([[low], self._gauss(axis)[0], [high]]))
        u, v = grids
        points = self(u, v)
        low_mm, high_mm = points.reshape(-1, 3).min(axis=0), points.reshape(-1, 3).max(axis=0)
        for flat in (int(points[..., 2].argmin()), int(points[..., 2].argmax())):
            i, j = np.unravel_index(flat, points.shape[:2])
            near_u = np.linspace(u[max(i - 1, 0)], u[min(i + 1, len(u) - 1)], FINE)
            near_v = np.linspace(v[max(j - 1, 0)], v[min(j + 1, len(v) - 1)], FINE)
            z = SplineFace(self.poles[..., 2:], self.knots, self.degrees, self.bounds, self.sign)(near_u, near_v)
            low_mm[2], high_mm[2] = min(low_mm[2], float(z.min())), max(high_mm[2], float(z.max()))
        return low_mm, high_mm


def spline_face(face: TopoDS_Face, bases: dict[Any, Floats]) -> SplineFace | None:
    """A face as arrays, or None where it is no plain B-spline; it must fill its parameter rectangle.

    Args:
        face: The face.
        bases: Where basis functions are kept, shared by patches with the same knots.
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
    poles = np.array([[(p.X(), p.Y(), p.Z()) for p in (table.Value(i, j) for j in columns)] for i in rows])
    along_u, along_v = spline.UKnotSequence(), spline.VKnotSequence()
    u0, u1, v0, v1 = BRepTools.UVBounds_s(face)
    reversed_ = face.Orientation() == TopAbs_Orientation.TopAbs_REVERSED
    return SplineFace(
        poles,
        (np.array(list(along_u)), np.array(list(along_v))),
        (spline.UDegree(), spline.VDegree()),
        ((u0, u1), (v0, v1)),
        -1.0 if reversed_ else 1.0,
        bases,
    )
