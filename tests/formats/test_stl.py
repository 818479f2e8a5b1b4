"""Writing and reading of binary STL files, and reading of ASCII STL files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.shapes import box_mesh, mesh_part

from tacbench_cad.formats.stl import read_stl, weld, write_stl
from tacbench_cad.geometry.block_part import block_part
from tacbench_cad.geometry.mesh import Mesh
from tacbench_cad.spec.block import Block
from tacbench_cad.util.errors import CheckFailedError


def _sorted_corners(mesh: Mesh) -> np.ndarray:
    """Return the triangles as sorted rows that begin with the lowest corner. Equal meshes give equal rows."""
    corners = mesh.triangle_points
    lowest = np.lexsort(np.moveaxis(corners, 2, 0)[::-1], axis=1)[:, 0]
    turned = np.stack([np.take_along_axis(corners, (lowest[:, None, None] + i) % 3, axis=1)[:, 0] for i in range(3)], 1)
    rows = turned.reshape(-1, 9)
    return rows[np.lexsort(rows.T[::-1])]


@pytest.mark.parametrize("number", [1, 2, 6])
def test_round_trip_keeps_every_triangle_exactly(number: int, tmp_path: Path) -> None:
    part = block_part(Block.of(number))
    write_stl(part, tmp_path / "a.stl")
    back = read_stl(tmp_path / "a.stl")
    assert len(back.vertices) == len(part.mesh[0].vertices)
    np.testing.assert_array_equal(_sorted_corners(back), _sorted_corners(part.mesh[0]))


def test_bytes_follow_the_format(tmp_path: Path) -> None:
    part = mesh_part(box_mesh(), name="box_x1")
    write_stl(part, tmp_path / "a.stl")
    data = (tmp_path / "a.stl").read_bytes()
    assert len(data) == 84 + 50 * 12
    assert data[:80] == b"tacbench-cad box_x1".ljust(80, b"\0")
    assert int.from_bytes(data[80:84], "little") == 12
    assert data[:80].split(b"\0")[0].decode("ascii") == "tacbench-cad box_x1"


def test_normals_point_outwards_and_have_length_one(tmp_path: Path) -> None:
    from stl import mesh as peer

    part = block_part(Block.of(2))
    write_stl(part, tmp_path / "a.stl")
    stored = peer.Mesh.from_file(str(tmp_path / "a.stl"), calculate_normals=False)
    np.testing.assert_allclose(np.linalg.norm(stored.normals, axis=1), 1.0, atol=1e-6)
    exact = np.cross(stored.v1.astype(float) - stored.v0, stored.v2.astype(float) - stored.v0)
    exact /= np.linalg.norm(exact, axis=1)[:, None]
    np.testing.assert_allclose(stored.normals, exact, atol=1e-6)
    volume, _, _ = stored.get_mass_properties()
    assert volume == pytest.approx(part.mesh[1].volume_mm3, rel=1e-4)


def test_reads_ascii(tmp_path: Path) -> None:
    mesh = box_mesh(at=(1.5, -2.0, 1e-3))
    lines = ["solid some box"]
    for corners in mesh.triangle_points:
        lines += ["facet normal 0 0 0", " outer loop", *(f"  vertex {x!r} {y!r} {z!r}" for x, y, z in corners.tolist())]
        lines += [" endloop", "endfacet"]
    (tmp_path / "a.stl").write_text("\n".join([*lines, "endsolid some box"]))
    back = read_stl(tmp_path / "a.stl")
    np.testing.assert_array_equal(_sorted_corners(back), _sorted_corners(mesh))
    (tmp_path / "b.stl").write_text("\n".join(lines))
    with pytest.raises(CheckFailedError, match="incomplete"):
        read_stl(tmp_path / "b.stl")


def test_binary_that_begins_with_solid_is_read_as_binary(tmp_path: Path) -> None:
    write_stl(mesh_part(box_mesh()), tmp_path / "a.stl")
    data = (tmp_path / "a.stl").read_bytes()
    (tmp_path / "a.stl").write_bytes(b"solid thing".ljust(80, b" ") + data[80:])
    assert len(read_stl(tmp_path / "a.stl").faces) == 12


def test_weld_merges_only_equal_corners() -> None:
    rng = np.random.default_rng(3)
    points = rng.integers(-4, 4, (300, 3)).astype(np.float32)
    points[::7] *= np.float32(1.0 + 2.0**-23)  # these differ from other points by one unit in the last place
    points[::11, 0] = -0.0
    vertices, triangles = weld(points)
    np.testing.assert_array_equal(vertices[triangles.ravel()].astype(np.float32), points)
    assert len(vertices) == len(np.unique(points + np.float32(0.0), axis=0))
