"""Triangle meshes of printable parts, and what is expected and proved of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tacbench_cad.util.types import Floats, Indices

#: A mesh that would need more triangles than this is refused.
MAX_TRIANGLES = 20_000_000


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh in millimetres.

    Args:
        vertices: Shape (n, 3). Every coordinate is a float32 value held as float64, so that what is checked in memory
            is what an STL file holds.
        faces: Vertex indices of each triangle, shape (m, 3), counter-clockwise seen from outside.
    """

    vertices: Floats
    faces: Indices

    @classmethod
    def joined(cls, meshes: Sequence[Mesh]) -> Mesh:
        """Some meshes as one, the vertices and the triangles of each after those of the one before."""
        ends = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])[:-1].tolist()
        triangles = [mesh.faces + np.int32(end) for mesh, end in zip(meshes, ends, strict=True)]
        return cls(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(triangles))

    def transformed(self, matrix: Floats) -> Mesh:
        """The mesh at another place. Its coordinates need not be float32 values any more.

        Args:
            matrix: Homogeneous, shape (4, 4), in mm.
        """
        return Mesh(self.vertices @ matrix[:3, :3].T + matrix[:3, 3], self.faces)

    @property
    def triangle_points(self) -> Floats:
        """Corner coordinates of every triangle, shape (m, 3, 3)."""
        return self.vertices[self.faces]

    @property
    def doubled_normals(self) -> Floats:
        """Normals of the triangles, twice their area long; shape (m, 3), in mm^2."""
        a, b, c = np.moveaxis(self.triangle_points, 1, 0)
        return cross(b - a, c - a)

    @property
    def bounds_mm(self) -> tuple[Floats, Floats]:
        """Lowest and highest corner of the bounding box, each (3,), in mm."""
        return self.vertices.min(axis=0), self.vertices.max(axis=0)

    @property
    def volume_mm3(self) -> float:
        """Enclosed volume in mm^3, by the divergence theorem about the box's centre; negative when inside out."""
        low, high = self.bounds_mm
        a, b, c = np.moveaxis(self.triangle_points - (low + high) / 2.0, 1, 0)
        return float(np.einsum("ij,ij->", a, cross(b, c)) / 6.0)

    def as_manifold(self) -> Any:
        """The mesh as a body of manifold3d. Only for finite coordinates: it hangs on infinite ones."""
        import manifold3d

        triangles = np.ascontiguousarray(self.faces, dtype=np.uint32)
        return manifold3d.Manifold(manifold3d.Mesh(self.vertices.astype(np.float32), triangles))


def cross(a: Floats, b: Floats) -> Floats:
    """The cross products of rows; numpy.cross is several times slower.

    Args:
        a: Shape (m, 3).
        b: Shape (m, 3).
    """
    return np.stack(
        [
            a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1],
            a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2],
            a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0],
        ],
        axis=1,
    )


@dataclass(frozen=True, kw_only=True)
class Certificate:
    """What is proved of a surface against the formula, over all of it.

    Args:
        distance_mm: Bound of ``|z - formula| / sqrt(1 + |gradient|^2)``.
        vertical_mm: Bound of ``|z - formula|``.
    """

    distance_mm: float
    vertical_mm: float


@dataclass(frozen=True, kw_only=True)
class ExpectedGeometry:
    """What a file must hold that holds a part's mesh, or its solid.

    Args:
        volume_mm3: Volume in closed form.
        volume_slack_mm3: How far the true volume of this mesh or solid may lie from it.
        size_slack_mm: How far its box may lie within the part's: chords cut round sides short.
        certificate: What is proved of a block's top against its formula; None for other parts.
        datum_mm: z of the formula's zero; None for other parts.
    """

    volume_mm3: float
    volume_slack_mm3: float
    size_slack_mm: float = 0.0
    certificate: Certificate | None = None
    datum_mm: float | None = None
