"""The open surface that becomes the top of a mesh."""

from __future__ import annotations

from dataclasses import dataclass

from tacbench_cad.util.types import Floats, Indices


@dataclass(frozen=True, eq=False)
class Sheet:
    """An open triangulated surface over a convex outline.

    Args:
        vertices: The coordinates, float32 values in mm, shape (n, 3).
        faces: The vertex indices of each triangle, counter-clockwise seen from above, shape (m, 3).
        sides: The outline in counter-clockwise order: the vertex indices along each straight side, including both ends.
    """

    vertices: Floats
    faces: Indices
    sides: tuple[Indices, ...]
