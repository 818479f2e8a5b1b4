"""Fast measurement of a block's solid, patch by patch: volume, bounding box and dense points of its top.

A block of this package has two kinds of faces: planes, and B-spline patches that fill their parameter rectangles. For
these faces the divergence theorem gives the volume up to rounding. If a solid has any other face (the cut patches of a
key, the cylinders of a holder), the slower functions of the kernel measure it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tacbench_cad.checks import solidcheck
from tacbench_cad.checks.solidcheck import Measured
from tacbench_cad.checks.splineface import Bases, SplineFace, box, spline_face
from tacbench_cad.geometry import kernel
from tacbench_cad.util.types import Floats

if TYPE_CHECKING:
    from OCP.TopoDS import TopoDS_Face, TopoDS_Shape


@dataclass(frozen=True, kw_only=True)
class Survey:
    """The measurements of a solid.

    Attributes:
        measured: The volume and the bounding box.
        points: Dense points of the top in mm, shape (k, 3); no rows if all curved faces are walls.
        exact: Whether the volume is exact up to rounding. The kernel's default volume, which is used otherwise, has a
            relative error of up to 1e-4 on the solids of this package.
    """

    measured: Measured
    points: Floats
    exact: bool


def survey(shape: TopoDS_Shape, outlined: bool = False, points: bool = True) -> Survey:
    """Measure a solid.

    Args:
        shape: The solid, in mm.
        outlined: Whether it is expected to be a block whose outline is not a rectangle.
        points: Whether the points of its top are needed. They are slow for faces that are cut off.
    """
    if outlined and (result := _survey_outlined(shape)) is not None:
        return result
    faces = kernel.distinct(shape, "FACE")
    bases: Bases = {}
    planes, patches = [], []
    for face in faces:
        if kernel.surface_kind(face) == "Plane":
            planes.append(face)
            continue
        patch = spline_face(face, bases) if solidcheck.is_rectangle(face) else None
        if patch is None:
            on_top = solidcheck.points_on(solidcheck.curved(shape)[0]) if points else np.empty((0, 3))
            return Survey(measured=solidcheck.measure(shape), points=on_top, exact=False)
        patches.append(patch)
    volume = sum(_below(face) for face in planes) + sum(patch.volume_mm3 for patch in patches)
    return Survey(measured=_measured(shape, volume, patches), points=_points(patches), exact=True)


def _survey_outlined(shape: TopoDS_Shape) -> Survey | None:
    """Measure a block with patches that are cut by upright walls; return None if it has other faces.

    Upright walls do not contribute to the integral of ``z dx dy``.
    """
    from tacbench_cad.checks.trimmedface import trimmed_face

    bases: Bases = {}
    volume, tops = 0.0, []
    for face in kernel.distinct(shape, "FACE"):
        if kernel.surface_kind(face) == "Plane":
            volume += _below(face)
        elif not _is_upright_cylinder(face):
            patch = spline_face(face, bases)
            if patch is None or not patch.is_graph:
                return None
            tops.append(trimmed_face(face, patch))
    if not tops:
        return None
    side = solidcheck.lattice_side(len(tops))
    points = np.concatenate([top.points(side) for top in tops])
    corners = np.concatenate([solidcheck.vertices(shape), points])
    high = corners.max(axis=0)
    likely = [top for top in tops if top.patch.poles[..., 2].max() >= high[2]]
    high[2] = max([float(high[2]), *(top.highest_mm(side) for top in likely)])
    volume += sum(top.volume_mm3 for top in tops)
    return Survey(
        measured=Measured(volume_mm3=volume, low_mm=corners.min(axis=0), high_mm=high), points=points, exact=True
    )


def _is_upright_cylinder(face: TopoDS_Face) -> bool:
    from OCP.BRepAdaptor import BRepAdaptor_Surface
    from OCP.GeomAbs import GeomAbs_SurfaceType

    surface = BRepAdaptor_Surface(face, False)
    if surface.GetType() != GeomAbs_SurfaceType.GeomAbs_Cylinder:
        return False
    return bool(abs(surface.Cylinder().Axis().Direction().Z()) > 1.0 - 1e-12)


def _measured(shape: TopoDS_Shape, volume: float, patches: list[SplineFace]) -> Measured:
    """Return the volume with the bounding box of all vertices and patches.

    This box also contains the plane faces, because their edges are straight lines or borders of patches.
    """
    low, high = box(patches, solidcheck.vertices(shape))
    return Measured(volume_mm3=volume, low_mm=low, high_mm=high)


def _points(patches: list[SplineFace]) -> Floats:
    tops = [patch for patch in patches if not patch.is_wall]
    if not tops:
        return np.empty((0, 3))
    side = solidcheck.lattice_side(len(tops))
    return np.concatenate([patch.lattice(side) for patch in tops])


def _below(face: TopoDS_Face) -> float:
    """Return the volume between a plane face and the plane z = 0; negative if the face looks down."""
    from OCP.BRepAdaptor import BRepAdaptor_Surface
    from OCP.BRepGProp import BRepGProp
    from OCP.GProp import GProp_GProps
    from OCP.TopAbs import TopAbs_Orientation

    position = BRepAdaptor_Surface(face, False).Plane().Position()
    up = position.XDirection().Crossed(position.YDirection()).Z()
    if abs(up) < 1e-9:
        return 0.0
    sign = -1.0 if face.Orientation() == TopAbs_Orientation.TopAbs_REVERSED else 1.0
    properties = GProp_GProps()
    BRepGProp.SurfaceProperties_s(face, properties)
    return float(sign * up * properties.Mass() * properties.CentreOfMass().Z())
