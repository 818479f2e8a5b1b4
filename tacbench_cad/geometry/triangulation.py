"""Triangulation of shapes by the CAD kernel, face by face. It is used for fixtures and for pictures."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tacbench_cad.geometry.kernel import each
from tacbench_cad.util.errors import CheckFailedError
from tacbench_cad.util.types import Floats, Indices

if TYPE_CHECKING:
    from OCP.TopoDS import TopoDS_Shape


def triangulate(shape: TopoDS_Shape, deflection_mm: float, angle_rad: float) -> tuple[Floats, Indices]:
    """Return the nodes and triangles of all faces. Faces do not share nodes.

    Args:
        shape: An Open CASCADE shape. It is not changed.
        deflection_mm: The largest distance between a curve and its chords. The kernel can exceed it on complex faces.
        angle_rad: The largest angle between neighbouring chords.

    Returns:
        The nodes in mm, shape (n, 3), and the node indices of each triangle, counter-clockwise seen from outside, shape
        (m, 3).

    Raises:
        CheckFailedError: The kernel did not mesh a face.
    """
    from OCP.BRep import BRep_Tool
    from OCP.BRepBuilderAPI import BRepBuilderAPI_Copy
    from OCP.BRepMesh import BRepMesh_IncrementalMesh
    from OCP.TopAbs import TopAbs_Orientation
    from OCP.TopLoc import TopLoc_Location

    # The kernel stores a mesh in the shape and would return it again, so a copy without earlier meshes is used.
    own = BRepBuilderAPI_Copy(shape, True, False).Shape()
    BRepMesh_IncrementalMesh(own, deflection_mm, False, angle_rad, False)
    nodes: list[tuple[float, float, float]] = []
    triangles: list[tuple[int, int, int]] = []
    for face in each(own, "FACE"):
        place = TopLoc_Location()
        mesh = BRep_Tool.Triangulation_s(face, place)
        if mesh is None:
            raise CheckFailedError("the CAD kernel did not mesh a face")
        first, move = len(nodes), place.Transformation()
        for i in range(1, mesh.NbNodes() + 1):
            point = mesh.Node(i).Transformed(move)
            nodes.append((point.X(), point.Y(), point.Z()))
        reverse = face.Orientation() == TopAbs_Orientation.TopAbs_REVERSED
        for i in range(1, mesh.NbTriangles() + 1):
            a, b, c = (first + k - 1 for k in mesh.Triangle(i).Get())
            triangles.append((a, c, b) if reverse else (a, b, c))
    return np.array(nodes, dtype=np.float64).reshape(-1, 3), np.array(triangles, dtype=np.int32).reshape(-1, 3)
