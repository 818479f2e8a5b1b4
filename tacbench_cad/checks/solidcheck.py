"""Checks of a solid from a STEP file by the CAD kernel (validity, volume, bounding box), and points on its faces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tacbench_cad.checks.report import Check
from tacbench_cad.geometry import kernel
from tacbench_cad.util.types import Floats

if TYPE_CHECKING:
    from OCP.TopoDS import TopoDS_Face, TopoDS_Shape

#: The approximate number of points on the textured faces.
POINTS = 80_000
#: The largest distance and angle between the triangles of a face and the face, in mm and in radians. They only decide
#: how many points are tested.
CHORD_MM, CHORD_RADIANS = 0.1, 0.5
#: The largest vertical component of the unit normal of a wall.
WALL_FRACTION = 1e-4
#: The accuracy of the adaptive volume of a solid with spline faces.
ACCURACY = 1e-3
#: The side of the lattices in which the highest point of a cut face is searched, and the number of lattices.
SIDE, ROUNDS = 17, 5


@dataclass(frozen=True, kw_only=True)
class MeasuredSolid:
    """The volume and the bounding box of a shape.

    Attributes:
        volume_mm3: The volume; negative if the solid is inside out.
        low_mm: The lower corner of the bounding box.
        high_mm: The upper corner of the bounding box.
    """

    volume_mm3: float
    low_mm: Floats
    high_mm: Floats

    @property
    def size_mm(self) -> tuple[float, float, float]:
        """The sides of the bounding box, in mm."""
        x, y, z = (self.high_mm - self.low_mm).tolist()
        return (x, y, z)


def count(shape: TopoDS_Shape, kind: str) -> int:
    """Return the number of different sub-shapes of a kind, such as ``SOLID``, ``SHELL`` or ``FACE``."""
    return len(kernel.distinct(shape, kind))


def solid_checks(shape: TopoDS_Shape) -> list[Check]:
    """Check that a shape is exactly one solid, valid and closed."""
    from OCP.BRep import BRep_Tool
    from OCP.BRepCheck import BRepCheck_Analyzer

    solids, loose = count(shape, "SOLID"), len(list(kernel.each(shape, "FACE", outside_of="SOLID")))
    single = solids == 1 and loose == 0
    detail = "one solid" if single else f"{solids} solids and {loose} faces outside of them, instead of one solid"
    checks = [Check(name="one solid", ok=single, detail=detail)]
    valid = BRepCheck_Analyzer(shape).IsValid()
    checks.append(Check(name="valid", ok=valid, detail=f"{'valid' if valid else 'not valid'} according to BRepCheck"))
    is_closed = [BRep_Tool.IsClosed_s(shell) for shell in kernel.each(shape, "SHELL")]
    closed = bool(is_closed) and all(is_closed)
    number_open = f"{is_closed.count(False)} of {len(is_closed)} shells are open"
    return [*checks, Check(name="closed", ok=closed, detail="closed" if closed else number_open)]


def measure(shape: TopoDS_Shape) -> MeasuredSolid:
    """Return the volume and the bounding box.

    A solid with spline faces needs the adaptive volume. The kernel's box can be too small where a spline face is cut,
    so the lowest and the highest points of these faces are added.
    """
    splines = spline_faces(shape)
    volume = kernel.volume_mm3(shape, ACCURACY if splines else None)
    low, high = kernel.box_mm(shape)
    points = np.array([low, high, *(point for face in splines if not is_rectangle(face) for point in _ends_of_z(face))])
    return MeasuredSolid(volume_mm3=volume, low_mm=points.min(axis=0), high_mm=points.max(axis=0))


def _ends_of_z(face: TopoDS_Face) -> list[tuple[float, float, float]]:
    """Return the lowest and the highest point of a face, from ever smaller lattices around the best point."""
    from OCP.BRepAdaptor import BRepAdaptor_Surface
    from OCP.BRepTopAdaptor import BRepTopAdaptor_FClass2d
    from OCP.gp import gp_Pnt2d
    from OCP.TopAbs import TopAbs_State

    surface, classifier = BRepAdaptor_Surface(face, True), BRepTopAdaptor_FClass2d(face, 1e-7)
    u0, u1, v0, v1 = _bounds(face)
    ends = []
    for sign in (-1.0, 1.0):
        best, at, half = None, ((u0 + u1) / 2.0, (v0 + v1) / 2.0), ((u1 - u0) / 2.0, (v1 - v0) / 2.0)
        for _ in range(ROUNDS):
            for u in np.linspace(max(at[0] - half[0], u0), min(at[0] + half[0], u1), SIDE).tolist():
                for v in np.linspace(max(at[1] - half[1], v0), min(at[1] + half[1], v1), SIDE).tolist():
                    point = surface.Value(u, v).Coord()
                    if best is not None and sign * point[2] <= sign * best[2]:
                        continue
                    if classifier.Perform(gp_Pnt2d(u, v)) != TopAbs_State.TopAbs_OUT:
                        best, highest_at = point, (u, v)
            if best is None:
                break
            at, half = highest_at, (4.0 * half[0] / SIDE, 4.0 * half[1] / SIDE)
        ends += [] if best is None else [best]
    return ends


def curved(shape: TopoDS_Shape) -> tuple[list[TopoDS_Face], list[TopoDS_Face]]:
    """Return the faces that are neither plane nor walls, and all others.

    The first ones are the textured faces, also if they face down.
    """
    textured: list[TopoDS_Face] = []
    others: list[TopoDS_Face] = []
    for face in kernel.distinct(shape, "FACE"):
        is_textured = kernel.surface_kind(face) != "Plane" and not _is_wall(face)
        (textured if is_textured else others).append(face)
    return textured, others


def _is_wall(face: TopoDS_Face) -> bool:
    """Check whether the normals of a face are level."""
    from OCP.BRepAdaptor import BRepAdaptor_Surface
    from OCP.gp import gp_Pnt, gp_Vec

    surface = BRepAdaptor_Surface(face, True)
    u0, u1, v0, v1 = _bounds(face)
    vertical = 0.0
    for s, t in ((0.37, 0.41), (0.71, 0.13), (0.19, 0.83)):
        point, du, dv = gp_Pnt(), gp_Vec(), gp_Vec()
        surface.D1(u0 + s * (u1 - u0), v0 + t * (v1 - v0), point, du, dv)
        normal = du.Crossed(dv)
        if normal.Magnitude() > 0.0:
            vertical = max(vertical, abs(normal.Z()) / normal.Magnitude())
    return vertical <= WALL_FRACTION


def inner_points(face: TopoDS_Face) -> tuple[Floats, bool]:
    """Return points inside a face, at least one however small it is, and whether it is a wall.

    They are the middles and the middles of the sides of the triangles into which the kernel divides the face.
    """
    from OCP.BRep import BRep_Tool
    from OCP.BRepAdaptor import BRepAdaptor_Surface
    from OCP.BRepMesh import BRepMesh_IncrementalMesh
    from OCP.TopLoc import TopLoc_Location

    BRepMesh_IncrementalMesh(face, CHORD_MM, False, CHORD_RADIANS)
    mesh = BRep_Tool.Triangulation_s(face, TopLoc_Location())
    if mesh is None:
        return vertices(face), _is_wall(face)
    corners = [mesh.Triangle(i + 1).Get() for i in range(mesh.NbTriangles())]
    places = np.array([(at.X(), at.Y()) for at in (mesh.UVNode(i + 1) for i in range(mesh.NbNodes()))])
    triangles = places[np.array(corners) - 1]
    sides = (triangles + np.roll(triangles, 1, axis=1)) / 2.0
    middles = np.concatenate([triangles.mean(axis=1), sides.reshape(-1, 2)])
    surface = BRepAdaptor_Surface(face, True)
    points = [surface.Value(u, v).Coord() for u, v in middles.tolist()]
    return np.array(points).reshape(-1, 3), _is_wall(face)


def spline_faces(shape: TopoDS_Shape) -> list[TopoDS_Face]:
    """Return the faces that are B-spline surfaces."""
    return [face for face in kernel.distinct(shape, "FACE") if kernel.surface_kind(face) == "BSplineSurface"]


def _bounds(face: TopoDS_Face) -> tuple[float, float, float, float]:
    from OCP.BRepTools import BRepTools

    u0, u1, v0, v1 = BRepTools.UVBounds_s(face)
    return u0, u1, v0, v1


def lattice_side(patches: int, points: int = POINTS) -> int:
    """Return the number of points along each side of a face, so that all faces together have about ``points``."""
    return max(8, round(float(np.sqrt(points / max(patches, 1)))))


def points_on(chosen: list[TopoDS_Face], points: int = POINTS) -> Floats:
    """Compute dense points on faces and on their borders.

    If a face does not fill its parameter rectangle (because of a key), each point is tested and left out if it is
    outside of the face.

    Args:
        chosen: The faces.
        points: The approximate number of points.

    Returns:
        The points in mm, shape (k, 3).
    """
    from OCP.BRepAdaptor import BRepAdaptor_Surface
    from OCP.BRepTopAdaptor import BRepTopAdaptor_FClass2d
    from OCP.gp import gp_Pnt, gp_Pnt2d
    from OCP.TopAbs import TopAbs_State

    side = lattice_side(len(chosen), points)
    coordinates: list[tuple[float, float, float]] = []
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
                coordinates.append((point.X(), point.Y(), point.Z()))
    return np.array(coordinates, dtype=np.float64).reshape(-1, 3)


def is_rectangle(face: TopoDS_Face) -> bool:
    """Check whether a face fills its parameter rectangle: it has four edges, and each vertex is at a corner."""
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
    """Return the height in mm and the area in mm^2 of every horizontal plane face."""
    from OCP.BRepAdaptor import BRepAdaptor_Surface
    from OCP.GeomAbs import GeomAbs_SurfaceType

    levels = []
    for face in kernel.distinct(shape, "FACE"):
        surface = BRepAdaptor_Surface(face, False)
        if surface.GetType() == GeomAbs_SurfaceType.GeomAbs_Plane:
            plane = surface.Plane()
            if abs(plane.Axis().Direction().Z()) > 1.0 - 1e-9:
                levels.append((plane.Location().Z(), kernel.area_mm2([face])))
    return levels


def vertices(shape: TopoDS_Shape) -> Floats:
    """Return all different vertices in mm, shape (n, 3)."""
    from OCP.BRep import BRep_Tool

    points = [BRep_Tool.Pnt_s(vertex) for vertex in kernel.distinct(shape, "VERTEX")]
    return np.array([(p.X(), p.Y(), p.Z()) for p in points], dtype=np.float64).reshape(-1, 3)
