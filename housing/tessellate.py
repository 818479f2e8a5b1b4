"""Meshes of fixtures from the CAD kernel: planar, cylindrical and conical faces only, never a textured one."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tacbench_cad.geometry.mesh import Mesh
from tacbench_cad.geometry.triangulation import triangulate
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.types import Floats, Indices

if TYPE_CHECKING:
    from OCP.TopoDS import TopoDS_Shape


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
    return Mesh(vertices=vertices, triangles=triangles)


def _require_simple(shape: TopoDS_Shape) -> None:
    from OCP.BRepAdaptor import BRepAdaptor_Surface
    from OCP.GeomAbs import GeomAbs_SurfaceType as Kind
    from OCP.TopAbs import TopAbs_ShapeEnum
    from OCP.TopExp import TopExp_Explorer
    from OCP.TopoDS import TopoDS

    explorer = TopExp_Explorer(shape, TopAbs_ShapeEnum.TopAbs_FACE)
    while explorer.More():
        kind = BRepAdaptor_Surface(TopoDS.Face_s(explorer.Current())).GetType()
        explorer.Next()
        if kind not in (Kind.GeomAbs_Plane, Kind.GeomAbs_Cylinder, Kind.GeomAbs_Cone):
            raise InputError("shape", None, "only planes, cylinders and cones are meshed here")


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
