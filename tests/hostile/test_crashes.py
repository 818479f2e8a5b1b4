"""Files that made a library crash or hang: the command reports this in one line and continues with the next file."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from helpers.shapes import box_mesh, write_soup

from tacbench_cad.checks import meshcheck
from tacbench_cad.checks.identify import examine
from tacbench_cad.checks.meshcheck import oriented
from tacbench_cad.cli import main
from tacbench_cad.formats.stl import read_stl, write_stl
from tacbench_cad.geometry.block_part import block_part
from tacbench_cad.geometry.mesh import Mesh
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.families import plane_waves
from tacbench_cad.spec.sampling import SampleGrid
from tacbench_cad.spec.textures import Texture
from tacbench_cad.util.errors import InputError


@pytest.fixture(scope="module")
def step_text(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return a STEP file of a box."""
    pytest.importorskip("OCP")
    from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox

    from tacbench_cad.formats.step import write_shape

    path = tmp_path_factory.mktemp("step") / "box.step"
    write_shape(BRepPrimAPI_MakeBox(10.0, 20.0, 5.0).Shape(), "box", "A box", path)
    return path.read_text()


def _without(text: str, entity: str) -> str:
    assert entity in text
    return re.sub(rf"(?m)^#\d+ ?= ?{entity}\([^;]*;\n", "", text, count=1)


def _self_referencing(text: str, entity: str) -> str:
    assert entity in text
    return re.sub(rf"(?m)^#(\d+) ?= ?{entity}\(([^;#]*)#\d+", rf"#\1={entity}(\2#\1", text, count=1)


CRASHING = {
    "a missing VECTOR": lambda text: _without(text, "VECTOR"),
    "an edge of itself": lambda text: _self_referencing(text, "ORIENTED_EDGE"),
    "a curve of itself": lambda text: _self_referencing(text, "SURFACE_CURVE"),
}


def test_a_step_file_that_crashes_the_kernel_is_refused_and_the_next_is_examined(
    step_text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bad, last = tmp_path / "bad.step", tmp_path / "whole.step"
    bad.write_text(CRASHING["an edge of itself"](step_text))
    last.write_text(step_text)
    code = main(["check-part", str(bad), str(last), "--json"])
    document = json.loads(capsys.readouterr().out)
    assert [report["file"] for report in document["files"]] == ["whole.step"]
    assert [refusal["file"] for refusal in document["refused"]] == ["bad.step"]
    assert all("crashes the CAD kernel" in refusal["reason"] for refusal in document["refused"])
    assert code == 2


@pytest.mark.long
@pytest.mark.parametrize("name", CRASHING)
def test_a_crash_of_the_kernel_counts_as_bad_input(name: str, step_text: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.step"
    path.write_text(CRASHING[name](step_text))
    assert path.read_text() != step_text
    with pytest.raises(InputError, match=r"bad\.step.*crashes the CAD kernel") as caught:
        examine(path)
    assert caught.value.exit_code == 2


def _random(tmp_path: Path) -> Path:
    return write_soup(tmp_path / "random.stl", np.random.default_rng(0).random((20_000, 3, 3)) * 50.0)


def _fan(tmp_path: Path) -> Path:
    points = np.zeros((20_000, 3, 3))
    points[:, 1, 2] = 10.0
    points[:, 2] = np.random.default_rng(0).random((20_000, 3)) * 50.0
    return write_soup(tmp_path / "fan.stl", points)


@pytest.mark.parametrize("make", [_fan, pytest.param(_random, marks=pytest.mark.long)])
def test_a_mesh_of_overlapping_triangles_is_not_tested_for_self_intersections(
    make: Callable[[Path], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("pymeshlab")
    monkeypatch.setattr(meshcheck, "MAX_SECONDS", 1.0)
    begin = time.monotonic()
    report = examine(make(tmp_path))
    assert time.monotonic() - begin < 20.0
    finding = next(check for check in report.checks if check.name == "self-intersection")
    assert finding.detail.startswith("not tested: pymeshlab would need more than")
    assert not report.ok and report.volume_mm3 is None


def test_huge_coordinates_are_refused(tmp_path: Path) -> None:
    mesh = box_mesh()
    path = write_soup(tmp_path / "huge.stl", mesh.triangle_points * 1e30)
    report = examine(path)
    assert not report.ok and "10 km" in report.checks[0].detail


def test_inconsistent_winding_does_not_change_the_volume(tmp_path: Path) -> None:
    mesh = block_part(Block.of(5, sampling=SampleGrid(nx=40, ny=41))).mesh[0]
    consistent = examine(write_soup(tmp_path / "consistent.stl", mesh.triangle_points), full=False)
    low = mesh.bounds_mm[0]
    walls = (mesh.triangle_points[:, :, 0] == low[0]).all(axis=1)
    flipped = np.where(walls[:, None], mesh.faces[:, ::-1], mesh.faces)
    report = examine(write_soup(tmp_path / "walls.stl", mesh.vertices[flipped]), full=False)
    assert {check.name for check in report.faults} - {check.name for check in consistent.faults} == {"winding"}
    assert report.volume_mm3 == pytest.approx(consistent.volume_mm3, rel=1e-9)
    assert abs(Mesh(mesh.vertices, flipped).volume_mm3 - consistent.volume_mm3) > 1.0


def test_a_mesh_is_oriented_whichever_triangles_are_flipped() -> None:
    box = box_mesh((2.0, 3.0, 4.0))
    for seed in range(20):
        flip = np.random.default_rng(seed).random(12) < 0.5
        mesh = oriented(Mesh(box.vertices, np.where(flip[:, None], box.faces[:, ::-1], box.faces)))
        assert mesh is not None and mesh.volume_mm3 == pytest.approx(24.0)
    boxes = Mesh.joined([box, box_mesh(at=(10.0, 0.0, 0.0))])
    assert oriented(boxes) is None


def test_a_texture_other_than_the_six_is_reported(tmp_path: Path) -> None:
    texture = Texture(name="other", surface=plane_waves((0.7, 1.3, 2.1), (0.4, 3.1, -0.6), (0.5, 0.0, 5.3)))
    block = Block.of(texture, size_mm=(12.0, 16.0), height_mm=9.0, sampling=SampleGrid(nx=30, ny=40))
    path = tmp_path / "other.stl"
    write_stl(block_part(block), path)
    unnamed = write_soup(tmp_path / "foreign.stl", read_stl(path).triangle_points)
    report = examine(unnamed, full=False)
    assert [check.name for check in report.faults] == ["texture"]
    assert "not one of the known textures; the nearest is texture-" in report.faults[0].detail
