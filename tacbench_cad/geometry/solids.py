"""Solids of the CAD kernel whose faces are planes, cylinders and cones: their meshes, and what is expected of them.

A textured face is never meshed here: its mesh comes from the formula.
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


#: Fraction of a volume by which the kernel may differ: rounding.
KERNEL_FRACTION = 1e-8
#: Distance by which a circle's chords may miss the circle, in mm.
DEFLECTION_MM = 0.01
#: Largest angle between neighbouring chords, in radians: small holes stay round.
ANGLE_RAD = 0.25
#: Nodes closer than this are one vertex: the faces of a solid place the nodes of a shared edge alike but for rounding.
WELD_MM = 1e-6
#: Decimals of a mm that are kept before coordinates become float32: far below what it resolves.
ROUND_DECIMALS = 9


def tessellate(shape: TopoDS_Shape, deflection_mm: float = DEFLECTION_MM) -> Mesh:
    """Mesh a solid whose faces are planes, cylinders and cones.

    Args:
        shape: An Open CASCADE solid.
        deflection_mm: Distance by which chords may miss their circles.

    Returns:
        A closed mesh. Same solid, same bytes.

    Raises:
        InputError: The deflection is not positive, or a face is of another kind.
        CheckFailedError: The kernel left a face without a mesh, or the mesh is not closed.
    """
    if not (np.isfinite(deflection_mm) and deflection_mm > 0.0):
        raise InputError("deflection", deflection_mm, "must be a positive number of mm")
    _require_simple(shape)
    nodes, triangles = triangulate(shape, deflection_mm, ANGLE_RAD)
    vertices, triangles = _weld(nodes, triangles)
    _require_closed(vertices, triangles)
    return Mesh(vertices=vertices, faces=triangles)


@dataclass(frozen=True, eq=False)
class SimpleSolid:
    """A solid with such faces as a part: its mesh, its solid, and what is expected of their files.

    Args:
        shape: The Open CASCADE solid, the lower corner of its box at the origin.
        size_mm: Its bounding box.
        volume_mm3: Its volume.
        round_mm2: Area of its cylinders and cones, which chords cut short.
    """

    shape: TopoDS_Shape
    size_mm: tuple[float, float, float]
    volume_mm3: float
    round_mm2: float

    @classmethod
    def of(cls, solid: Any, volume_mm3: float | None = None) -> SimpleSolid:
        """Take a solid of CadQuery, build123d or the kernel to the origin and measure it.

        Args:
            solid: The solid, in mm.
            volume_mm3: Its volume in closed form; None for what the kernel measures.

        Raises:
            InputError: It is no solid, or a face is of another kind.
        """
        shape = solid.val() if hasattr(solid, "val") else solid
        shape = getattr(shape, "wrapped", shape)
        if shape is None or not hasattr(shape, "ShapeType"):
            raise InputError("solid", solid, "must be a solid of CadQuery, build123d or Open CASCADE")
        round_mm2 = _require_simple(shape)
        low, high = kernel.box_mm(shape)
        x, y, z = np.round(high - low, ROUND_DECIMALS - 3).tolist()
        to_origin = np.eye(4)
        to_origin[:3, 3] = -low
        volume = kernel.volume_mm3(shape) if volume_mm3 is None else volume_mm3
        return cls(shape.Moved(kernel.location(to_origin)), (x, y, z), volume, round_mm2)

    def mesh(self) -> tuple[Mesh, ExpectedGeometry]:
        """The mesh; its chords take less than their sagitta off every round face."""
        chords = self.round_mm2 * DEFLECTION_MM
        expected = ExpectedGeometry(
            volume_mm3=self.volume_mm3,
            volume_slack_mm3=chords + rounding_mm3(self.size_mm),
            size_slack_mm=DEFLECTION_MM if self.round_mm2 else 0.0,
        )
        return tessellate(self.shape), expected

    def solid(self) -> tuple[TopoDS_Shape, ExpectedGeometry]:
        """The solid itself."""
        return self.shape, ExpectedGeometry(
            volume_mm3=self.volume_mm3, volume_slack_mm3=KERNEL_FRACTION * self.volume_mm3
        )


def rounding_mm3(size_mm: tuple[float, float, float]) -> float:
    """How much rounding to float32 may change a volume: by 2^-24 of a coordinate; inner faces add to the box's own."""
    x, y, z = size_mm
    return 6.0 * (x * y + y * z + z * x) * max(x, y, z) * 2.0**-24


def compound(placed: Sequence[tuple[TopoDS_Shape, Floats]]) -> TopoDS_Compound:
    """Shapes at their places as one compound.

    Args:
        placed: Shapes, each with the matrix (4, 4) that takes it there, in mm.
    """
    from OCP.BRep import BRep_Builder
    from OCP.TopoDS import TopoDS_Compound

    whole, builder = TopoDS_Compound(), BRep_Builder()
    builder.MakeCompound(whole)
    for shape, matrix in placed:
        builder.Add(whole, shape.Moved(kernel.location(matrix)))
    return whole


def _require_simple(shape: TopoDS_Shape) -> float:
    """Area of the round faces, in mm^2, if there are none but planes, cylinders and cones."""
    from OCP.BRepAdaptor import BRepAdaptor_Surface
    from OCP.GeomAbs import GeomAbs_SurfaceType as Kind

    curved = []
    for face in kernel.each(shape, "FACE"):
        kind = BRepAdaptor_Surface(face).GetType()
        if kind in (Kind.GeomAbs_Cylinder, Kind.GeomAbs_Cone):
            curved.append(face)
        elif kind != Kind.GeomAbs_Plane:
            raise InputError("shape", None, "only planes, cylinders and cones are meshed here")
    return kernel.area_mm2(curved)


def _weld(nodes: Floats, triangles: Indices) -> tuple[Floats, Indices]:
    """Join nodes at one place, round to float32, and drop the triangles that a cone's or seam's double nodes leave."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    pairs = cKDTree(nodes).query_pairs(WELD_MM, output_type="ndarray")
    links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(nodes), len(nodes)))
    count, group = connected_components(links, directed=False)
    # The smallest node of a group stands for it, whatever order the faces came in.
    order = np.lexsort((nodes[:, 2], nodes[:, 1], nodes[:, 0]))
    chosen = np.full(count, -1)
    for node in order[::-1]:
        chosen[group[node]] = node
    # Rounding first takes off what turning a shape leaves (1e-15 for 0); adding zero turns -0.0 into 0.0.
    rounded = nodes[chosen].round(ROUND_DECIMALS).astype(np.float32).astype(np.float64) + 0.0
    vertices, index = np.unique(rounded, axis=0, return_inverse=True)
    welded = index.reshape(-1)[group[triangles]].astype(np.int32)
    a, b, c = welded.T
    welded = welded[(a != b) & (b != c) & (c != a)]
    # Each triangle begins at its lowest vertex and the list is sorted: the order of faces leaves no trace.
    start = welded.argmin(axis=1)[:, None]
    welded = np.take_along_axis(welded, (start + np.arange(3)) % 3, axis=1)
    return vertices, np.ascontiguousarray(welded[np.lexsort(welded.T[::-1])])


def _require_closed(vertices: Floats, triangles: Indices) -> None:
    if np.any(np.linalg.norm(Mesh(vertices, triangles).doubled_normals, axis=1) == 0.0):
        raise CheckFailedError("the fixture's mesh has a triangle without area")
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]).astype(np.int64)
    there = edges[:, 0] * len(vertices) + edges[:, 1]
    back = edges[:, 1] * len(vertices) + edges[:, 0]
    if len(np.unique(there)) != len(there) or not np.array_equal(np.sort(there), np.sort(back)):
        raise CheckFailedError("the fixture's mesh is not closed")
