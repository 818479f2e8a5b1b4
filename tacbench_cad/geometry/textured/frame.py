"""The local coordinates of a face: s and t in mm along the face, and h in mm out of the material."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Complexes, Floats

if TYPE_CHECKING:
    from OCP.TopoDS import TopoDS_Face

#: The directions that can be named by a word.
DIRECTIONS = {
    sign + axis: np.eye(3)[k] * (1.0 if sign == "+" else -1.0) for k, axis in enumerate("XYZ") for sign in "+-"
}
#: The kinds of faces that are refused, as people say them.
_KINDS = {
    "Cone": "conical",
    "Sphere": "spherical",
    "Torus": "toroidal",
    "BezierSurface": "a Bezier surface",
    "BSplineSurface": "a B-spline surface",
    "SurfaceOfRevolution": "a surface of revolution",
    "SurfaceOfExtrusion": "an extruded curve",
    "OffsetSurface": "an offset surface",
    "OtherSurface": "of an unknown kind",
}
#: The sine of the smallest angle between ``up`` and the normal of a plane, or the axis of a cylinder.
_MIN_SINE = 1e-3


@dataclass(frozen=True, eq=False)
class Frame:
    """The local coordinates of a plane or a cylinder.

    On a plane, s and t run along the first two axes, and the third axis is the normal out of the material. On a
    cylinder, t runs along the third axis and s around it: the angle is ``side * s / radius_mm`` from the first axis.

    Args:
        origin: The point of the plane with s = t = 0, or a point on the axis of the cylinder; shape (3,).
        axes: Three orthonormal directions as rows, right-handed, shape (3, 3).
        radius_mm: The radius of the cylinder; None for a plane.
        side: 1 if the material lies inside of the cylinder, -1 if it lies outside.
    """

    origin: Floats
    axes: Floats
    radius_mm: float | None = None
    side: float = 1.0

    @property
    def around_mm(self) -> float | None:
        """The circumference of the cylinder; None for a plane."""
        return None if self.radius_mm is None else 2.0 * math.pi * self.radius_mm

    def section(self, s: Floats, h: Floats | float) -> Complexes:
        """Return the points of a cylinder's cross-section as complex numbers. All arrays broadcast."""
        assert self.radius_mm is not None
        return np.asarray((self.radius_mm + self.side * h) * np.exp(1j * self.side / self.radius_mm * s))

    def world(self, across: Floats | Complexes, t: Floats, height: Floats | None = None) -> Floats:
        """Return points in the coordinates of the part, shape (..., 3).

        Args:
            across: On a plane s; on a cylinder the complex point of the cross-section.
            t: The coordinate t.
            height: On a plane h; None on a cylinder.
        """
        parts = (np.real(across), np.imag(across), t) if height is None else (np.real(across), t, height)
        a, b, c = np.broadcast_arrays(*parts)
        return np.asarray(self.origin + np.stack([a, b, c], axis=-1) @ self.axes, dtype=np.float64)

    def point(self, s: Floats, t: Floats, h: Floats | float) -> Floats:
        """Return the points with the local coordinates (s, t, h), shape (..., 3)."""
        if self.radius_mm is None:
            return self.world(s, t, np.asarray(h, dtype=np.float64))
        return self.world(self.section(s, h), t)

    def coordinates(self, points: Floats) -> Floats:
        """Return the coordinates s, t and h of points, shape (3, ...). On a cylinder, s begins at 0."""
        x, y, z = np.moveaxis((points - self.origin) @ self.axes.T, -1, 0)
        if self.radius_mm is None:
            return np.stack([x, y, z])
        angle = np.mod(self.side * np.arctan2(y, x), 2.0 * math.pi)
        return np.stack([angle * self.radius_mm, z, self.side * (np.hypot(x, y) - self.radius_mm)])

    def local(self, points: Floats) -> Floats:
        """Return the coordinates (s, t) of points on the face, shape (..., 2)."""
        return np.moveaxis(self.coordinates(points)[:2], 0, -1)

    def normal(self, s: Floats | float) -> Floats:
        """Return the direction of h at coordinates s, shape (..., 3)."""
        if self.radius_mm is None:
            return np.broadcast_to(self.axes[2], (*np.shape(s), 3))
        angle = self.side * np.asarray(s)[..., None] / self.radius_mm
        return np.asarray(self.side * (np.cos(angle) * self.axes[0] + np.sin(angle) * self.axes[1]))

    def moved(self, s: float, t: float) -> Frame:
        """Return the frame whose point (0, 0) is the point (s, t) of this frame."""
        if self.radius_mm is None:
            return replace(self, origin=self.origin + s * self.axes[0] + t * self.axes[1])
        angle = self.side * s / self.radius_mm
        c, d = math.cos(angle), math.sin(angle)
        turned = np.array([[c, d, 0.0], [-d, c, 0.0], [0.0, 0.0, 1.0]]) @ self.axes
        return replace(self, origin=self.origin + t * self.axes[2], axes=turned)


def frame_of(face: TopoDS_Face, up: str | tuple[float, float, float] | None) -> Frame:
    """Return the local coordinates of a planar or cylindrical face of a solid.

    Args:
        face: The face, with its orientation in the solid.
        up: The direction of s on a plane, or of s = 0 on a cylinder, seen from the axis: ``+X`` to ``-Z`` or a vector.
            Only its part across the normal or the axis counts. None chooses ``+X``, or ``+Y`` where X is not possible.

    Raises:
        InputError: The face is of another kind, or the direction is not allowed.
    """
    from OCP.BRepAdaptor import BRepAdaptor_Surface
    from OCP.TopAbs import TopAbs_Orientation

    surface = BRepAdaptor_Surface(face)
    kind = str(surface.GetType()).rpartition("_")[2]
    outside = -1.0 if face.Orientation() == TopAbs_Orientation.TopAbs_REVERSED else 1.0
    if kind == "Plane":
        place = surface.Plane().Position()
        normal = outside * np.cross(_array(place.XDirection()), _array(place.YDirection()))
        return Frame(_array(place.Location()), axes_of(normal, up, "the normal of the face"))
    if kind != "Cylinder":
        what = _KINDS.get(kind, kind)
        raise InputError("face", None, f"is {what}; only planes and cylinders can get a texture")
    cylinder = surface.Cylinder()
    place = cylinder.Position()
    side = outside if place.Direct() else -outside
    axis = _array(place.Direction())
    return Frame(_array(place.Location()), axes_of(axis, up, "the axis of the cylinder"), cylinder.Radius(), side)


def axes_of(third: Floats, up: str | tuple[float, float, float] | None, what: str) -> Floats:
    """Return right-handed axes with this third axis. The first axis is as near to ``up`` as possible."""
    third = third / np.linalg.norm(third)
    if up is None:
        first = DIRECTIONS["+X"] if abs(third[0]) < 0.999 else DIRECTIONS["+Y"]
    elif isinstance(up, str):
        word = up.strip().upper()
        word = word if word[:1] in ("+", "-") else f"+{word}"
        if word not in DIRECTIONS:
            raise InputError("up", up, f"must be one of {', '.join(DIRECTIONS)} or a vector")
        first = DIRECTIONS[word]
    else:
        first = np.array(up, dtype=np.float64)
        if first.shape != (3,) or not np.all(np.isfinite(first)) or not np.any(first):
            raise InputError("up", up, "must be a direction of three finite numbers that are not all zero")
        first = first / np.linalg.norm(first)
    across = first - (first @ third) * third
    if np.linalg.norm(across) < _MIN_SINE:
        raise InputError("up", up, f"is parallel to {what}; choose another direction")
    across = across / np.linalg.norm(across)
    across = np.where(np.abs(across) < 1e-15, 0.0, across)
    return np.stack([across, np.cross(third, across), third])


def _array(vector: object) -> Floats:
    return np.array([vector.X(), vector.Y(), vector.Z()])  # type: ignore[attr-defined]
