"""``verify``: correct files pass, and every fault that a test adds to a file is reported."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from helpers.shapes import box_mesh, changed, flip_triangle, inside_out, lower_top_vertex, mesh_part

from tacbench_cad.checks import meshcheck
from tacbench_cad.checks.report import Report
from tacbench_cad.checks.verify import verify
from tacbench_cad.formats import FORMATS
from tacbench_cad.geometry.block_part import block_part
from tacbench_cad.geometry.mesh import Mesh
from tacbench_cad.geometry.part import PrintPart
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.families import plane_waves
from tacbench_cad.spec.sampling import SampleGrid, Tolerance
from tacbench_cad.spec.textures import Texture


@cache
def _part(number: int = 2, preset: str = "paper") -> PrintPart:
    return block_part(Block.of(number, preset))


def _write_as(part: PrintPart, mesh: Mesh, path: Path) -> Path:
    """Write a file for a part, but with another mesh."""
    FORMATS[path.suffix[1:]].write(dataclasses.replace(part, make_mesh=lambda: (mesh, part.mesh[1])), path)
    return path


def _faults(report: Report) -> set[str]:
    return {check.name for check in report.faults}


@pytest.mark.parametrize(
    ("form", "block"),
    [
        ("stl", Block.of(3, scale=0.5)),
        ("3mf", Block.of(5, key_mm=3.0)),
        ("stl", Block.of(Texture(name="weave", surface=plane_waves((0.7, 1.0, 0.5), (0.7, 1.0, -0.5))), key_mm=3.0)),
        ("3mf", Block.of(1, sampling="grid")),
        ("stl", Block.of(1, "released", sampling=Tolerance(mm=0.02))),
        ("3mf", Block.of(2, copy=4, key_mm=2.0, scale=1.5, sampling=Tolerance(mm=0.05))),
    ],
    ids=lambda value: getattr(value, "name", value),
)
def test_files_of_this_package_pass(form: str, block: Block, tmp_path: Path) -> None:
    part = block_part(block)
    path = tmp_path / f"a.{form}"
    FORMATS[form].write(part, path)
    report = verify(part, path)
    assert report.ok, report.faults
    certificate = part.mesh[1].certificate
    assert certificate is not None
    assert report.deviation_mm is not None
    assert 0.2 * certificate.distance_mm < report.deviation_mm <= certificate.distance_mm + 1e-5
    assert report.triangles == len(part.mesh[0].faces)
    np.testing.assert_allclose(report.size_mm, part.size_mm, rtol=1e-6)


def _flat_triangle(mesh: Mesh) -> Mesh:
    """Add a vertex on an edge and a triangle without area. The mesh stays closed, with a consistent winding."""
    along_x = np.ptp(mesh.triangle_points[:, :2], axis=1)[:, 1:].max(axis=1) == 0.0  # then the middle is on the edge
    number = int(np.flatnonzero(along_x)[0])
    a, b, c = mesh.faces[number].tolist()
    middle = ((mesh.vertices[a] + mesh.vertices[b]) / 2.0).astype(np.float32).astype(np.float64)
    n = len(mesh.vertices)
    extra = [[a, n, c], [n, b, c], [a, b, n]]
    return Mesh(
        np.vstack([mesh.vertices, middle]), np.vstack([np.delete(mesh.faces, number, axis=0), extra]).astype(np.int32)
    )


def _just_below(mesh: Mesh) -> Mesh:
    """Cut the highest vertices a little below the height of the block. A resin slicer would leave out a layer."""
    return changed(mesh, lambda vertices: np.minimum(vertices, [np.inf, np.inf, 6.9999]))


@pytest.mark.parametrize(
    ("fault", "name"),
    [
        (lambda mesh: Mesh(mesh.vertices, mesh.faces[1:]), "closed"),
        (flip_triangle, "winding"),
        (inside_out, "volume"),
        (lambda mesh: Mesh(mesh.vertices, np.vstack([mesh.faces, mesh.faces[:1]])), "edges"),
        (_flat_triangle, "triangles"),
        (lower_top_vertex, "relief"),
        (_just_below, "box"),
        (lambda mesh: changed(mesh, lambda vertices: vertices * 1.01), "box"),
        (lambda mesh: changed(mesh, lambda vertices: vertices + np.array([5.0, 0.0, 0.0])), "box"),
        (
            lambda mesh: inside_out(changed(mesh, lambda vertices: vertices * [-1.0, 1.0, 1.0] + [23.3, 0.0, 0.0])),
            "relief",
        ),
        (lambda _: _part(3).mesh[0], "relief"),
    ],
)
def test_every_fault_is_reported(fault: Callable[[Mesh], Mesh], name: str, tmp_path: Path) -> None:
    part = _part()
    report = verify(part, _write_as(part, fault(part.mesh[0]), tmp_path / "a.stl"))
    assert not report.ok
    assert name in _faults(report)


def test_a_moved_sample_of_a_coarse_grid_is_reported(tmp_path: Path) -> None:
    part = block_part(Block.of(4, "released", sampling=SampleGrid(nx=100, ny=101)))
    certificate = part.mesh[1].certificate
    assert certificate is not None
    assert certificate.distance_mm > 0.05  # the check of this distance cannot detect the moved sample
    report = verify(part, _write_as(part, lower_top_vertex(part.mesh[0]), tmp_path / "a.stl"))
    assert "samples" in _faults(report)


def test_zero_thickness_is_reported(tmp_path: Path) -> None:
    flat = changed(box_mesh(), lambda vertices: vertices * [1.0, 1.0, 0.0])
    part = mesh_part(box_mesh())
    report = verify(part, _write_as(part, flat, tmp_path / "a.stl"))
    assert "volume" in _faults(report)


def _ring(segments: int = 12) -> Mesh:
    """Return a ring with a square cross-section. It has one through hole."""
    angle = 2.0 * np.pi * np.arange(segments) / segments
    loops = [(2.0, 0.0), (2.0, 1.0), (1.0, 1.0), (1.0, 0.0)]
    points = [(2.0 + r * np.cos(a), 2.0 + r * np.sin(a), z) for r, z in loops for a in angle]
    triangles = []
    for loop in range(4):
        for i in range(segments):
            a, b = loop * segments + i, loop * segments + (i + 1) % segments
            c, d = (a + segments) % (4 * segments), (b + segments) % (4 * segments)
            triangles += [(a, b, d), (a, d, c)]
    return Mesh(np.array(points).astype(np.float32).astype(np.float64), np.array(triangles, dtype=np.int32))


@pytest.mark.parametrize("count", [0, 1, 2])
def test_through_holes_are_counted(count: int, tmp_path: Path) -> None:
    ring = _ring()
    assert ring.volume_mm3 > 0.0
    part = mesh_part(ring, genus=count)
    report = verify(part, _write_as(part, ring, tmp_path / "a.stl"))
    assert ("genus" in _faults(report)) == (count != 1)
    assert report.ok == (count == 1)


def test_full_finds_triangles_that_cut_each_other(tmp_path: Path) -> None:
    """Only pymeshlab finds that a closed body with a consistent winding cuts itself."""
    pytest.importorskip("pymeshlab")
    ring = _ring()

    def push(vertices: np.ndarray) -> np.ndarray:
        vertices[0] = [1.2, 2.0, 0.5]  # moves a vertex of the outer wall through the inner wall
        return vertices

    mesh = changed(ring, push)
    part = mesh_part(mesh, genus=1)
    path = _write_as(part, mesh, tmp_path / "a.stl")
    assert "self-intersection" not in _faults(verify(part, path))
    assert "self-intersection" in _faults(verify(part, path, full=True))


def test_open_flipped_and_crowded_edges_are_distinguished() -> None:
    mesh = box_mesh()
    assert meshcheck.edges(mesh).ok
    dropped = meshcheck.edges(Mesh(mesh.vertices, mesh.faces[1:]))
    assert (dropped.open, dropped.same_way, dropped.crowded) == (3, 0, 0)
    flipped = meshcheck.edges(flip_triangle(mesh))
    assert (flipped.open, flipped.same_way, flipped.crowded) == (0, 3, 0)
    doubled = meshcheck.edges(Mesh(mesh.vertices, np.vstack([mesh.faces, mesh.faces[:1]])))
    assert (doubled.open, doubled.same_way, doubled.crowded) == (0, 0, 3)
    assert doubled.crowded_at is not None


def test_a_solid_with_another_texture_or_height_is_a_fault(tmp_path: Path) -> None:
    pytest.importorskip("OCP")
    part = block_part(Block.of(1))
    for block, name in (
        (Block.of(5), "relief"),
        (Block.of(1, height_mm=7.1), "box"),
        (Block.of(1, scale=1.01), "box"),
    ):
        FORMATS["step"].write(block_part(block), tmp_path / "a.step")
        report = verify(part, tmp_path / "a.step")
        assert name in _faults(report)
        assert "volume" in _faults(report)


@pytest.mark.parametrize(
    "block",
    [
        Block.of(2),
        Block.of(1, key_mm=2.0, label=True),
        *(pytest.param(block, marks=pytest.mark.long) for block in (Block.of(4), Block.of(2, outline="disc:25"))),
    ],
    ids=lambda block: block.name,
)
def test_the_measured_volume_of_a_block_is_accurate(block: Block) -> None:
    pytest.importorskip("OCP")
    from tacbench_cad.checks import solidcheck
    from tacbench_cad.geometry import kernel

    shape, expected = block_part(block).solid
    measured = solidcheck.measure(shape)
    assert measured.volume_mm3 == pytest.approx(kernel.volume_mm3(shape, 1e-6), rel=2e-6)
    assert measured.volume_mm3 == pytest.approx(expected.volume_mm3, abs=expected.volume_slack_mm3)
    np.testing.assert_allclose(measured.low_mm, np.zeros(3), atol=1e-5)
    assert expected.certificate is not None
    allowed = [1e-5, 1e-5, expected.certificate.vertical_mm]
    assert np.all(np.abs(measured.high_mm - [*block.size_mm, block.height_mm]) <= allowed)
    assert len(solidcheck.points_on(solidcheck.curved(shape)[0])) > 10_000


def test_through_holes_of_solids_are_counted() -> None:
    pytest.importorskip("OCP")
    from OCP.BRepAlgoAPI import BRepAlgoAPI_Cut
    from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox, BRepPrimAPI_MakeCone, BRepPrimAPI_MakeCylinder
    from OCP.gp import gp_Ax2, gp_Dir, gp_Pnt

    from tacbench_cad.geometry import kernel

    shape = BRepPrimAPI_MakeBox(30.0, 10.0, 5.0).Shape()
    assert kernel.genus(shape) == 0
    for holes, x in enumerate((5.0, 15.0, 25.0), start=1):
        axis = gp_Ax2(gp_Pnt(x, 5.0, -1.0), gp_Dir(0.0, 0.0, 1.0))
        shape = BRepAlgoAPI_Cut(shape, BRepPrimAPI_MakeCylinder(axis, 2.0, 7.0).Shape()).Shape()
        assert kernel.genus(shape) == holes
    dent = gp_Ax2(gp_Pnt(10.0, 5.0, 6.0), gp_Dir(0.0, 0.0, -1.0))
    shape = BRepAlgoAPI_Cut(shape, BRepPrimAPI_MakeCone(dent, 1.5, 0.0, 3.0).Shape()).Shape()
    assert kernel.genus(shape) == 3
