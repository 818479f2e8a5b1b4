"""What can be wrong with a solid read from STEP, asked of the kernel, and points on its textured faces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tacbench_cad.checks.report import Check
from tacbench_cad.geometry import kernel
from tacbench_cad.util.types import Floats

if TYPE_CHECKING:
    from OCP.TopoDS import TopoDS_Face, TopoDS_Shape

#: About so many points are taken on the faces of a top.
POINTS = 80_000
#: A face is a wall where its normal has a smaller vertical fraction than this.
WALL_FRACTION = 1e-4


@dataclass(frozen=True, kw_only=True)
class Measured:
    """The kernel's default answers on a shape.

    Attributes:
        volume_mm3: Volume; negative where the solid is inside out.
        low_mm: Lower corner of the bounding box.
        high_mm: Upper corner.
    """

    volume_mm3: float
    low_mm: Floats
    high_mm: Floats

    @property
    def size_mm(self) -> tuple[float, float, float]:
        """Sides of the bounding box in mm."""
        x, y, z = (self.high_mm - self.low_mm).tolist()
        return (x, y, z)


def count(shape: TopoDS_Shape, kind: str) -> int:
    """Number of different sub-shapes of a kind: ``SOLID``, ``SHELL``, ``FACE`` ..."""
    return len(kernel.distinct(shape, kind))


def solid_checks(shape: TopoDS_Shape) -> list[Check]:
    """One solid and nothing beside it, valid, closed."""
    from OCP.BRep import BRep_Tool
    from OCP.BRepCheck import BRepCheck_Analyzer

    solids, loose = count(shape, "SOLID"), len(list(kernel.each(shape, "FACE", outside_of="SOLID")))
    one = solids == 1 and loose == 0
    detail = "one solid" if one else f"{solids} solids and {loose} faces outside of them, instead of one solid"
    checks = [Check(name="one solid", ok=one, detail=detail)]
    valid = BRepCheck_Analyzer(shape).IsValid()
    checks.append(Check(name="valid", ok=valid, detail="BRepCheck finds it valid" if valid else "BRepCheck: not valid"))
    is_closed = [BRep_Tool.IsClosed_s(shell) for shell in kernel.each(shape, "SHELL")]
    closed = bool(is_closed) and all(is_closed)
    number_open = f"{is_closed.count(False)} of {len(is_closed)} shells are open"
    return [*checks, Check(name="closed", ok=closed, detail="closed" if closed else number_open)]


def genus(shape: TopoDS_Shape) -> int:
    """Through holes of one closed solid, by Euler and Poincare: ``V - E + F - (wires - F) = 2 (shells - genus)``.

    Edges without length (a cone's tip) are no edges here; a seam counts once.
    """
    from OCP.BRep import BRep_Tool

    edges = sum(not BRep_Tool.Degenerated_s(edge) for edge in kernel.distinct(shape, "EDGE"))
    faces = count(shape, "FACE")
    euler = count(shape, "VERTEX") - edges + 2 * faces - count(shape, "WIRE")
    return count(shape, "SHELL") - euler // 2


def measure(shape: TopoDS_Shape) -> Measured:
    """The default volume and bounding box: what a user of the kernel, CadQuery or build123d asks first."""
    low, high = kernel.box_mm(shape)
    return Measured(volume_mm3=kernel.volume_mm3(shape), low_mm=low, high_mm=high)


def curved(shape: TopoDS_Shape) -> list[TopoDS_Face]:
    """The faces that are neither plane nor wall: the textured top, whichever way up."""
    from OCP.BRepAdaptor import BRepAdaptor_Surface
    from OCP.GeomAbs import GeomAbs_SurfaceType
    from OCP.gp import gp_Pnt, gp_Vec

    chosen = []
    for face in kernel.distinct(shape, "FACE"):
        surface = BRepAdaptor_Surface(face, True)
        if surface.GetType() == GeomAbs_SurfaceType.GeomAbs_Plane:
            continue
        u0, u1, v0, v1 = _bounds(face)
        vertical = 0.0
        for s, t in ((0.37, 0.41), (0.71, 0.13), (0.19, 0.83)):
            point, du, dv = gp_Pnt(), gp_Vec(), gp_Vec()
            surface.D1(u0 + s * (u1 - u0), v0 + t * (v1 - v0), point, du, dv)
            normal = du.Crossed(dv)
            if normal.Magnitude() > 0.0:
                vertical = max(vertical, abs(normal.Z()) / normal.Magnitude())
        if vertical > WALL_FRACTION:
            chosen.append(face)
    return chosen


def _bounds(face: TopoDS_Face) -> tuple[float, float, float, float]:
    from OCP.BRepTools import BRepTools

    u0, u1, v0, v1 = BRepTools.UVBounds_s(face)
    return u0, u1, v0, v1


def lattice_side(patches: int, points: int = POINTS) -> int:
    """Points along each side of a face, for so many faces to carry about so many points."""
    return max(8, round(float(np.sqrt(points / max(patches, 1)))))


def points_on(chosen: list[TopoDS_Face], points: int = POINTS) -> Floats:
    """Dense points on faces, their borders included.

    A face cut off within its parameter rectangle (a key) is asked point by point what belongs to it.

    Args:
        chosen: The faces.
        points: About how many are wanted.

    Returns:
        Points, shape (k, 3), in mm.
    """
    from OCP.BRepAdaptor import BRepAdaptor_Surface
    from OCP.BRepTopAdaptor import BRepTopAdaptor_FClass2d
    from OCP.gp import gp_Pnt, gp_Pnt2d
    from OCP.TopAbs import TopAbs_State

    side = lattice_side(len(chosen), points)
    found: list[tuple[float, float, float]] = []
    point = gp_Pnt()
    for face in chosen:
        surface = BRepAdaptor_Surface(face, True)
        u0, u1, v0, v1 = _bounds(face)
        whole = is_rectangle(face)
        classifier = None if whole else BRepTopAdaptor_FClass2d(face, 1e-7)
        for u in np.linspace(u0, u1, side).tolist():
            for v in np.linspace(v0, v1, side).tolist():
                if classifier is not None and classifier.Perform(gp_Pnt2d(u, v)) == TopAbs_State.TopAbs_OUT:
                    continue
                surface.D0(u, v, point)
                found.append((point.X(), point.Y(), point.Z()))
    return np.array(found, dtype=np.float64).reshape(-1, 3)


def is_rectangle(face: TopoDS_Face) -> bool:
    """Whether a face fills its parameter rectangle: four edges, and a corner of the rectangle at every vertex."""
    from OCP.BRep import BRep_Tool

    if count(face, "EDGE") != 4:
        return False
    u0, u1, v0, v1 = _bounds(face)
    near_u, near_v = 1e-6 * (u1 - u0), 1e-6 * (v1 - v0)
    for vertex in kernel.distinct(face, "VERTEX"):
        at = BRep_Tool.Parameters_s(vertex, face)
        if min(abs(at.X() - u0), abs(at.X() - u1)) > near_u or min(abs(at.Y() - v0), abs(at.Y() - v1)) > near_v:
            return False
    return True


def level_faces(shape: TopoDS_Shape) -> list[tuple[float, float]]:
    """Height and area of every plane face that is level."""
    from OCP.BRepAdaptor import BRepAdaptor_Surface
    from OCP.GeomAbs import GeomAbs_SurfaceType

    found = []
    for face in kernel.distinct(shape, "FACE"):
        surface = BRepAdaptor_Surface(face, False)
        if surface.GetType() == GeomAbs_SurfaceType.GeomAbs_Plane:
            plane = surface.Plane()
            if abs(plane.Axis().Direction().Z()) > 1.0 - 1e-9:
                found.append((plane.Location().Z(), kernel.area_mm2([face])))
    return found


def vertices(shape: TopoDS_Shape) -> Floats:
    """All vertices, each once; shape (n, 3), in mm."""
    from OCP.BRep import BRep_Tool

    points = [BRep_Tool.Pnt_s(vertex) for vertex in kernel.distinct(shape, "VERTEX")]
    return np.array([(p.X(), p.Y(), p.Z()) for p in points], dtype=np.float64).reshape(-1, 3)
