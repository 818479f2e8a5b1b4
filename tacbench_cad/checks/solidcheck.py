"""What can be wrong with a solid read from STEP, asked of the kernel, and points on its textured faces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tacbench_cad.checks.report import Check
from tacbench_cad.util.types import Floats

if TYPE_CHECKING:
    from OCP.TopoDS import TopoDS_Face, TopoDS_Shape

#: About so many points are taken on the faces of a top.
POINTS = 80_000
#: A face is a wall where its normal has a smaller vertical share than this.
WALL_SHARE = 1e-4


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
    from OCP.TopAbs import TopAbs_ShapeEnum
    from OCP.TopExp import TopExp
    from OCP.TopTools import TopTools_IndexedMapOfShape

    found = TopTools_IndexedMapOfShape()
    TopExp.MapShapes_s(shape, getattr(TopAbs_ShapeEnum, f"TopAbs_{kind}"), found)
    return int(found.Size())


def solid_checks(shape: TopoDS_Shape) -> list[Check]:
    """One solid and nothing beside it, valid, closed."""
    from OCP.BRep import BRep_Tool
    from OCP.BRepCheck import BRepCheck_Analyzer
    from OCP.TopAbs import TopAbs_ShapeEnum
    from OCP.TopExp import TopExp_Explorer

    solids = count(shape, "SOLID")
    loose = 0
    explorer = TopExp_Explorer(shape, TopAbs_ShapeEnum.TopAbs_FACE, TopAbs_ShapeEnum.TopAbs_SOLID)
    while explorer.More():
        loose += 1
        explorer.Next()
    one = solids == 1 and loose == 0
    detail = "one solid" if one else f"{solids} solids and {loose} faces that belong to none; one solid is wanted"
    checks = [Check(name="one solid", ok=one, detail=detail)]
    valid = BRepCheck_Analyzer(shape).IsValid()
    checks.append(Check(name="valid", ok=valid, detail="BRepCheck finds it valid" if valid else "BRepCheck: not valid"))
    shells, open_shells = 0, 0
    explorer = TopExp_Explorer(shape, TopAbs_ShapeEnum.TopAbs_SHELL)
    while explorer.More():
        shells += 1
        open_shells += not BRep_Tool.IsClosed_s(explorer.Current())
        explorer.Next()
    closed = shells > 0 and open_shells == 0
    checks.append(
        Check(name="closed", ok=closed, detail="closed" if closed else f"{open_shells} of {shells} shells are open")
    )
    return checks


def genus(shape: TopoDS_Shape) -> int:
    """Through holes of one closed solid, by Euler and Poincare: ``V - E + F - (wires - F) = 2 (shells - genus)``.

    Edges without length (a cone's tip) are no edges here; a seam counts once.
    """
    from OCP.BRep import BRep_Tool
    from OCP.TopAbs import TopAbs_ShapeEnum
    from OCP.TopExp import TopExp
    from OCP.TopoDS import TopoDS
    from OCP.TopTools import TopTools_IndexedMapOfShape

    found = TopTools_IndexedMapOfShape()
    TopExp.MapShapes_s(shape, TopAbs_ShapeEnum.TopAbs_EDGE, found)
    edges = sum(not BRep_Tool.Degenerated_s(TopoDS.Edge_s(found.FindKey(i))) for i in range(1, found.Size() + 1))
    faces = count(shape, "FACE")
    euler = count(shape, "VERTEX") - edges + 2 * faces - count(shape, "WIRE")
    return count(shape, "SHELL") - euler // 2


def measure(shape: TopoDS_Shape) -> Measured:
    """The default volume and bounding box: what a user of the kernel, CadQuery or build123d asks first."""
    from OCP.Bnd import Bnd_Box
    from OCP.BRepBndLib import BRepBndLib
    from OCP.BRepGProp import BRepGProp
    from OCP.GProp import GProp_GProps

    props = GProp_GProps()
    BRepGProp.VolumeProperties_s(shape, props)
    box = Bnd_Box()
    BRepBndLib.AddOptimal_s(shape, box, False, False)
    if box.IsVoid():
        return Measured(volume_mm3=0.0, low_mm=np.zeros(3), high_mm=np.zeros(3))
    x0, y0, z0, x1, y1, z1 = box.Get()
    return Measured(volume_mm3=props.Mass(), low_mm=np.array([x0, y0, z0]), high_mm=np.array([x1, y1, z1]))


def faces(shape: TopoDS_Shape) -> list[TopoDS_Face]:
    """All faces, each once."""
    from OCP.TopAbs import TopAbs_ShapeEnum
    from OCP.TopExp import TopExp
    from OCP.TopoDS import TopoDS
    from OCP.TopTools import TopTools_IndexedMapOfShape

    found = TopTools_IndexedMapOfShape()
    TopExp.MapShapes_s(shape, TopAbs_ShapeEnum.TopAbs_FACE, found)
    return [TopoDS.Face_s(found.FindKey(i)) for i in range(1, found.Size() + 1)]


def curved(shape: TopoDS_Shape) -> list[TopoDS_Face]:
    """The faces that are neither plane nor wall: the textured top, whichever way up."""
    from OCP.BRepAdaptor import BRepAdaptor_Surface
    from OCP.GeomAbs import GeomAbs_SurfaceType
    from OCP.gp import gp_Pnt, gp_Vec

    chosen = []
    for face in faces(shape):
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
        if vertical > WALL_SHARE:
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
    from OCP.TopAbs import TopAbs_ShapeEnum
    from OCP.TopExp import TopExp
    from OCP.TopoDS import TopoDS
    from OCP.TopTools import TopTools_IndexedMapOfShape

    if count(face, "EDGE") != 4:
        return False
    u0, u1, v0, v1 = _bounds(face)
    near_u, near_v = 1e-6 * (u1 - u0), 1e-6 * (v1 - v0)
    found = TopTools_IndexedMapOfShape()
    TopExp.MapShapes_s(face, TopAbs_ShapeEnum.TopAbs_VERTEX, found)
    for i in range(1, found.Size() + 1):
        at = BRep_Tool.Parameters_s(TopoDS.Vertex_s(found.FindKey(i)), face)
        if min(abs(at.X() - u0), abs(at.X() - u1)) > near_u or min(abs(at.Y() - v0), abs(at.Y() - v1)) > near_v:
            return False
    return True


def area(chosen: list[TopoDS_Face]) -> float:
    """Area of faces together, in mm^2."""
    from OCP.BRepGProp import BRepGProp
    from OCP.GProp import GProp_GProps

    total = 0.0
    for face in chosen:
        props = GProp_GProps()
        BRepGProp.SurfaceProperties_s(face, props)
        total += props.Mass()
    return total


def level_faces(shape: TopoDS_Shape) -> list[tuple[float, float]]:
    """Height and area of every plane face that is level."""
    from OCP.BRepAdaptor import BRepAdaptor_Surface
    from OCP.GeomAbs import GeomAbs_SurfaceType

    found = []
    for face in faces(shape):
        surface = BRepAdaptor_Surface(face, False)
        if surface.GetType() == GeomAbs_SurfaceType.GeomAbs_Plane:
            plane = surface.Plane()
            if abs(plane.Axis().Direction().Z()) > 1.0 - 1e-9:
                found.append((plane.Location().Z(), area([face])))
    return found


def vertices(shape: TopoDS_Shape) -> Floats:
    """All vertices, each once; shape (n, 3), in mm."""
    from OCP.BRep import BRep_Tool
    from OCP.TopAbs import TopAbs_ShapeEnum
    from OCP.TopExp import TopExp
    from OCP.TopoDS import TopoDS
    from OCP.TopTools import TopTools_IndexedMapOfShape

    found = TopTools_IndexedMapOfShape()
    TopExp.MapShapes_s(shape, TopAbs_ShapeEnum.TopAbs_VERTEX, found)
    points = [BRep_Tool.Pnt_s(TopoDS.Vertex_s(found.FindKey(i))) for i in range(1, found.Size() + 1)]
    return np.array([(p.X(), p.Y(), p.Z()) for p in points], dtype=np.float64).reshape(-1, 3)
