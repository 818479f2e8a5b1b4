"""Meshes and parts for the tests of files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tacbench_cad.geometry.mesh import ExpectedGeometry, Mesh
from tacbench_cad.geometry.part import PrintPart
from tacbench_cad.spec.block import Block
from tacbench_cad.util.types import Floats


def box_mesh(
    size: tuple[float, float, float] = (2.0, 3.0, 4.0), at: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> Mesh:
    """Return a box of 12 triangles."""
    corners = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * size + at
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return Mesh(corners.astype(np.float32).astype(np.float64), np.array(triangles, dtype=np.int32))


def mesh_part(mesh: Mesh, name: str = "thing", **more: Any) -> PrintPart:
    """Return a part with a mesh and no solid."""
    low, high = mesh.bounds_mm
    size = tuple((high - low).tolist())
    expected = ExpectedGeometry(volume_mm3=mesh.volume_mm3, volume_slack_mm3=0.0)
    fields: dict[str, Any] = {"kind": "coupon", "title": "A thing", "genus": 0, "make_solid": None, **more}
    return PrintPart(name=name, size_mm=size, make_mesh=lambda: (mesh, expected), **fields)


def write_soup(
    path: Path, triangle_points: Floats, header: bytes = b"made elsewhere", count: int | None = None
) -> Path:
    """Write triangles (m, 3, 3) as a binary STL file without names and normals, as another program may do."""
    facets = np.zeros(len(triangle_points), dtype=[("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])
    facets["v"] = triangle_points
    written = len(triangle_points) if count is None else count
    path.write_bytes(header.ljust(80, b"\0") + np.uint32(written).tobytes() + facets.tobytes())
    return path


def published(number: int, flipped_walls: bool = True) -> Floats:
    """Return a block like those in the authors' files, in which two of the four walls have the wrong orientation.

    Returns:
        The triangles, shape (353972, 3, 3).
    """
    block = Block.of(number, "released")
    nx, ny = 294, 301
    x, y = 0.1 * np.arange(nx), 0.1 * np.arange(ny)
    z = block.datum_mm + block.surface.grid(x, y)
    xx, yy = np.meshgrid(x, y, indexing="ij")
    top, bottom = np.stack([xx, yy, z], axis=2), np.stack([xx, yy, np.zeros_like(z)], axis=2)

    def strip(a: Floats, b: Floats, flip: bool) -> Floats:
        """Return the triangles between two rows of points."""
        first = np.stack([a[..., :-1, :], b[..., :-1, :], b[..., 1:, :]], axis=-2)
        second = np.stack([a[..., :-1, :], b[..., 1:, :], a[..., 1:, :]], axis=-2)
        triangles = np.concatenate([first.reshape(-1, 3, 3), second.reshape(-1, 3, 3)])
        return triangles[:, ::-1] if flip else triangles

    sheets = [strip(top[:-1], top[1:], False), strip(bottom[:-1], bottom[1:], True)]
    walls = [
        strip(top[:, 0], bottom[:, 0], False),
        strip(top[:, -1], bottom[:, -1], not flipped_walls),
        strip(top[0], bottom[0], True),
        strip(top[-1], bottom[-1], flipped_walls),
    ]
    return np.concatenate([*sheets, *walls]).astype(np.float32).astype(np.float64)


def changed(mesh: Mesh, change: Callable[[Floats], Floats]) -> Mesh:
    """Return the mesh with changed vertices, rounded to float32."""
    vertices = change(mesh.vertices.copy()).astype(np.float32).astype(np.float64)
    return Mesh(vertices, mesh.faces)


def flip_triangle(mesh: Mesh) -> Mesh:
    triangles = mesh.faces.copy()
    triangles[11] = triangles[11][::-1]
    return Mesh(mesh.vertices, triangles)


def inside_out(mesh: Mesh) -> Mesh:
    return Mesh(mesh.vertices, np.ascontiguousarray(mesh.faces[:, ::-1]))


def lower_top_vertex(mesh: Mesh) -> Mesh:
    """Lower one vertex of the top, away from the outline, by 0.05 mm."""

    def move(vertices: Floats) -> Floats:
        inner = np.all((vertices[:, :2] > 5.0) & (vertices[:, :2] < 20.0), axis=1) & (vertices[:, 2] > 1.0)
        vertices[np.nonzero(inner)[0][0], 2] -= 0.05
        return vertices

    return changed(mesh, move)
