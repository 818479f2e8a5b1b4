"""Triangle meshes of printable parts, their expected geometry, and proved bounds of their error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np

from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats, Indices

#: The largest allowed number of triangles of a mesh.
MAX_TRIANGLES = 20_000_000


def refuse_too_many(field: str, value: object, needed: float, advice: str) -> None:
    """Check that a mesh has at most :data:`MAX_TRIANGLES` triangles.

    Args:
        field: The option that decides the number of triangles, for the error message.
        value: The value of the option.
        needed: The number of triangles.
        advice: What the user can do, for the error message.

    Raises:
        InputError: The mesh has too many triangles. The message states the number.
    """
    if needed > MAX_TRIANGLES:
        raise InputError(
            field, value, f"the mesh would need {needed:.4g} triangles, but {MAX_TRIANGLES:,} is the maximum; {advice}"
        )


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh in millimetres.

    Args:
        vertices: The coordinates, shape (n, 3). They are float32 values stored as float64, so that a mesh in memory is
            equal to the mesh in an STL file.
        faces: The vertex indices of each triangle, counter-clockwise seen from outside, shape (m, 3).
    """

    vertices: Floats
    faces: Indices

    @classmethod
    def joined(cls, meshes: Sequence[Mesh]) -> Mesh:
        """Join meshes into one mesh. The vertices and triangles are in the order of the meshes."""
        ends = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])[:-1].tolist()
        triangles = [mesh.faces + np.int32(end) for mesh, end in zip(meshes, ends, strict=True)]
        return cls(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(triangles))

    def transformed(self, matrix: Floats) -> Mesh:
        """Return a transformed copy of the mesh. In general, its coordinates are no longer float32 values.

        Args:
            matrix: The homogeneous matrix, shape (4, 4), in mm.
        """
        return Mesh(self.vertices @ matrix[:3, :3].T + matrix[:3, 3], self.faces)

    @property
    def triangle_points(self) -> Floats:
        """The corner coordinates of every triangle, shape (m, 3, 3), in mm."""
        return self.vertices[self.faces]

    @property
    def doubled_normals(self) -> Floats:
        """The normals of the triangles, shape (m, 3). The length of a normal is twice the area, in mm^2."""
        a, b, c = np.moveaxis(self.triangle_points, 1, 0)
        return cross(b - a, c - a)

    @property
    def bounds_mm(self) -> tuple[Floats, Floats]:
        """The lower and the upper corner of the bounding box, shape (3,) each, in mm."""
        return self.vertices.min(axis=0), self.vertices.max(axis=0)

    @property
    def volume_mm3(self) -> float:
        """The enclosed volume in mm^3, by the divergence theorem. It is negative if the mesh is inside out."""
        low, high = self.bounds_mm
        a, b, c = np.moveaxis(self.triangle_points - (low + high) / 2.0, 1, 0)
        return float(np.einsum("ij,ij->", a, cross(b, c)) / 6.0)

    def as_manifold(self) -> Any:
        """Convert the mesh to an object of manifold3d. All coordinates must be finite, otherwise manifold3d hangs."""
        import manifold3d

        triangles = np.ascontiguousarray(self.faces, dtype=np.uint32)
        return manifold3d.Manifold(manifold3d.Mesh(self.vertices.astype(np.float32), triangles))


def manifold_of(vertices: Floats, faces: Indices) -> Any:
    """Return vertices and triangles as a ``manifold3d.Manifold`` in double precision."""
    import manifold3d

    points = np.ascontiguousarray(vertices, dtype=np.float64)
    return manifold3d.Manifold(manifold3d.Mesh64(points, np.ascontiguousarray(faces, dtype=np.uint64)))


def cross(a: Floats, b: Floats) -> Floats:
    """Return the cross products of the rows of two arrays. This is several times faster than numpy.cross.

    Args:
        a: The left factors, shape (m, 3).
        b: The right factors, shape (m, 3).
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
    """Bounds for the difference between a surface and the formula. They hold for the whole surface.

    Args:
        distance_mm: The bound of the distance of each point of the surface from the nearest point of the formula's
            surface over the rectangle around the block.
        vertical_mm: The bound of ``|z - formula|``.
        outline_mm: The largest distance of the outline of a mesh from that of the block, because chords replace its
            circles. It is 0 for straight sides and for solids.
        evidence: ``proved``, or ``measured`` if the formula is a spline whose own error is only measured.
    """

    distance_mm: float
    vertical_mm: float
    evidence: Literal["proved", "measured"] = "proved"
    outline_mm: float = 0.0

    def plus(self, error_mm: float, evidence: Literal["proved", "measured"]) -> Certificate:
        """Return the bounds for the source of the formula, from which the formula has an error of its own."""
        return Certificate(
            distance_mm=self.distance_mm + error_mm,
            vertical_mm=self.vertical_mm + error_mm,
            evidence=evidence,
            outline_mm=self.outline_mm,
        )


class MeasuredRelief(Protocol):
    """The textured faces of a part that is not a block. They measure the distance of a file from the formula."""

    @property
    def allowed_mm(self) -> float:
        """The largest allowed distance from the formula."""
        ...

    def of_mesh(self, mesh: Mesh) -> tuple[float, int]:
        """Return the largest distance of a mesh from the formula in mm, and the number of its points."""
        ...

    def of_points(self, points: Floats) -> tuple[float, int]:
        """Return the same for points, shape (n, 3). Points that are not on a textured face do not count."""
        ...


@dataclass(frozen=True, kw_only=True)
class ExpectedGeometry:
    """The expected contents of a file with the mesh or the solid of a part.

    Args:
        volume_mm3: The volume in closed form.
        volume_slack_mm3: The allowed difference between this volume and the volume of the mesh or solid.
        size_slack_mm: The allowed distance by which the bounding box is smaller than the part's, because the chords of
            a round side lie inside it.
        certificate: The proved bounds for the top of a block; None for other parts.
        datum_mm: The z of the formula's zero; None for parts that are not blocks.
        relief: The textured faces of a part that is not a block; None for other parts.
    """

    volume_mm3: float
    volume_slack_mm3: float
    size_slack_mm: float = 0.0
    certificate: Certificate | None = None
    datum_mm: float | None = None
    relief: MeasuredRelief | None = None
