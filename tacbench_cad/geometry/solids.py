"""Meshes and expected geometry of CAD solids whose faces are planes, cylinders, cones and splines.

Textured faces of blocks are not meshed here, because their meshes are made from the formula.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from tacbench_cad.geometry import kernel
from tacbench_cad.geometry.mesh import ExpectedGeometry, Mesh
from tacbench_cad.geometry.triangulation import triangulate
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.types import Floats, Indices

if TYPE_CHECKING:
    from OCP.TopoDS import TopoDS_Compound, TopoDS_Shape


#: The fraction of a volume by which the kernel's value may differ because of rounding.
KERNEL_FRACTION = 1e-8
#: The fraction by which the kernel's volume of a solid with free curves or surfaces may be wrong.
FREE_FRACTION = 2e-3
#: The largest distance between a circle and its chords, in mm.
DEFLECTION_MM = 0.01
#: The largest angle between neighbouring chords, in radians. It keeps small holes round.
ANGLE_RAD = 0.25
#: Nodes that are closer than this become one vertex, in mm. The nodes of an edge that two faces share differ only by
#: rounding.
WELD_MM = 1e-6
#: The number of decimals to which coordinates in mm are rounded before they become float32. This is much finer than
#: float32.
ROUND_DECIMALS = 9


def tessellate(shape: TopoDS_Shape, deflection_mm: float = DEFLECTION_MM) -> Mesh:
    """Mesh a solid whose faces are planes, cylinders, cones and splines.

    Args:
        shape: An Open CASCADE solid.
        deflection_mm: The largest distance between a circle and its chords.

    Returns:
        A closed mesh. The same solid always gives the same mesh.

    Raises:
        InputError: The deflection is not positive, or a face is of another kind.
        CheckFailedError: The kernel did not mesh a face, or the mesh is not closed.
    """
    if not (np.isfinite(deflection_mm) and deflection_mm > 0.0):
        raise InputError("deflection", deflection_mm, "must be a positive number of mm")
    _require_simple(shape)
    mesh = Mesh(*weld(*triangulate(shape, deflection_mm, ANGLE_RAD)))
    require_closed(mesh)
    return mesh


@dataclass(frozen=True, eq=False)
class SimpleSolid:
    """A solid of planes, cylinders, cones and splines, with its mesh and the expected geometry of its files.

    Args:
        shape: The Open CASCADE solid. The lower corner of its bounding box is at the origin.
        size_mm: The size of its bounding box.
        volume_mm3: Its volume.
        round_mm2: The area of its cylinders, cones and splines, where the mesh differs from the solid.
        is_free: Whether it has a spline face, on which the kernel's volume is less accurate.
    """

    shape: TopoDS_Shape
    size_mm: tuple[float, float, float]
    volume_mm3: float
    round_mm2: float
    is_free: bool = False

    @classmethod
    def of(cls, solid: Any, volume_mm3: float | None = None) -> SimpleSolid:
        """Move a solid of CadQuery, build123d or the kernel to the origin, and measure it.

        Args:
            solid: The solid, in mm.
            volume_mm3: Its volume in closed form; None for the volume that the kernel measures.

        Raises:
            InputError: The object is not a solid, or a face is of another kind.
        """
        shape = kernel.shape_of(solid, "solid")
        round_mm2 = _require_simple(shape)
        low, high = kernel.box_mm(shape)
        x, y, z = np.round(high - low, ROUND_DECIMALS - 3).tolist()
        to_origin = np.eye(4)
        to_origin[:3, 3] = -low
        volume = kernel.volume_mm3(shape) if volume_mm3 is None else volume_mm3
        is_free = any(kernel.surface_kind(face) == "BSplineSurface" for face in kernel.each(shape, "FACE"))
        return cls(shape.Moved(kernel.location(to_origin)), (x, y, z), volume, round_mm2, is_free)

    def mesh(self) -> tuple[Mesh, ExpectedGeometry]:
        """Return the mesh and its expected geometry. The chords reduce the volume by at most deflection times area."""
        chords = self.round_mm2 * DEFLECTION_MM + (FREE_FRACTION * self.volume_mm3 if self.is_free else 0.0)
        expected = ExpectedGeometry(
            volume_mm3=self.volume_mm3,
            volume_slack_mm3=chords + rounding_mm3(self.size_mm),
            size_slack_mm=DEFLECTION_MM if self.round_mm2 else 0.0,
        )
        return tessellate(self.shape), expected

    def solid(self) -> tuple[TopoDS_Shape, ExpectedGeometry]:
        """Return the solid and its expected geometry."""
        fraction = FREE_FRACTION if self.is_free else KERNEL_FRACTION
        return self.shape, ExpectedGeometry(volume_mm3=self.volume_mm3, volume_slack_mm3=fraction * self.volume_mm3)


def rounding_mm3(size_mm: tuple[float, float, float]) -> float:
    """Return how much the rounding of coordinates to float32 (by a fraction of 2^-24) can change a volume.

    The factor of 6 allows for inner faces in addition to the faces of the box.
    """
    x, y, z = size_mm
    return 6.0 * (x * y + y * z + z * x) * max(x, y, z) * 2.0**-24


def compound(placed: Sequence[tuple[TopoDS_Shape, Floats]]) -> TopoDS_Compound:
    """Combine shapes into a compound.

    Args:
        placed: The shapes, each with the matrix that moves it to its position, shape (4, 4), in mm.
    """
    from OCP.BRep import BRep_Builder
    from OCP.TopoDS import TopoDS_Compound

    whole, builder = TopoDS_Compound(), BRep_Builder()
    builder.MakeCompound(whole)
    for shape, matrix in placed:
        builder.Add(whole, shape.Moved(kernel.location(matrix)))
    return whole


def _require_simple(shape: TopoDS_Shape) -> float:
    """Check that all faces are planes, cylinders, cones or splines. Return the area of all but planes in mm^2."""
    curved = []
    for face in kernel.each(shape, "FACE"):
        kind = kernel.surface_kind(face)
        if kind in ("Cylinder", "Cone", "BSplineSurface"):
            curved.append(face)
        elif kind != "Plane":
            raise InputError("shape", None, "has another kind of face; use only planes, cylinders, cones and splines")
    return kernel.area_mm2(curved)


def weld(nodes: Floats, triangles: Indices) -> tuple[Floats, Indices]:
    """Merge nodes at the same position, round them to float32, and drop triangles without area.

    Such triangles occur where a cone or a seam has two nodes at the same position.
    """
    places = np.column_stack([_numbered(column) for column in nodes.T])
    different, group = np.unique(places, axis=0, return_inverse=True)
    group, count = group.reshape(-1), len(different)
    # A group is represented by its lowest node, so that the result does not depend on the order of the faces.
    order = np.lexsort((nodes[:, 2], nodes[:, 1], nodes[:, 0]))
    chosen = np.full(count, -1)
    chosen[group[order[::-1]]] = order[::-1]
    # The first rounding removes the errors of rotated shapes (1e-15 for 0). Adding zero changes -0.0 to 0.0.
    rounded = nodes[chosen].round(ROUND_DECIMALS).astype(np.float32).astype(np.float64) + 0.0
    vertices, index = np.unique(rounded, axis=0, return_inverse=True)
    faces = index.reshape(-1)[group[triangles]].astype(np.int32)
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    # Each triangle begins at its lowest vertex, and the list is sorted, so the order of the faces has no effect.
    start = faces.argmin(axis=1)[:, None]
    faces = np.take_along_axis(faces, (start + np.arange(3)) % 3, axis=1)
    return vertices, np.ascontiguousarray(faces[np.lexsort(faces.T[::-1])])


def welded(body: Any) -> Mesh:
    """Return a body of manifold3d as a mesh of float32 values; see :func:`weld`."""
    raw = body.to_mesh64()
    vertices = np.asarray(raw.vert_properties, dtype=np.float64)[:, :3]
    return Mesh(*weld(vertices, np.asarray(raw.tri_verts, dtype=np.int32)))


def _numbered(values: Floats) -> Indices:
    """Number values in ascending order. Neighbours that are closer than :data:`WELD_MM` have the same number."""
    order = np.argsort(values)
    numbers = np.empty(len(values), dtype=np.int32)
    numbers[order] = np.cumsum(np.diff(values[order], prepend=values[order[:1]]) > WELD_MM)
    return numbers


def open_edges(mesh: Mesh) -> int:
    """Return the number of edges that do not have exactly one triangle in each direction."""
    start, end = mesh.faces.ravel().astype(np.int64), np.roll(mesh.faces, -1, axis=1).ravel().astype(np.int64)
    count = len(mesh.vertices)
    there, back = start * count + end, end * count + start
    _, times = np.unique(there, return_counts=True)
    return int(np.count_nonzero(~np.isin(there, back)) + np.count_nonzero(times > 1))


def require_closed(mesh: Mesh) -> None:
    """Check that a mesh is closed and has no triangle without area.

    Raises:
        CheckFailedError: It is not.
    """
    if np.any(np.linalg.norm(mesh.doubled_normals, axis=1) == 0.0):
        raise CheckFailedError("the mesh of the solid has a triangle without area")
    if open_edges(mesh):
        raise CheckFailedError("the mesh of the solid is not closed")
