"""Writing and reading of 3MF files: strict, exact, in millimetres, and with the parameters."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import numpy as np
import pytest
from helpers.shapes import box_mesh, mesh_part

from tacbench_cad import __version__
from tacbench_cad.formats.threemf import read_3mf, read_parts, write_3mf, write_plate
from tacbench_cad.geometry.block_part import block_part
from tacbench_cad.geometry.mesh import Mesh
from tacbench_cad.spec.block import Block

lib3mf = pytest.importorskip("lib3mf")


@pytest.mark.parametrize("number", [2, 6])
def test_round_trip_is_exact_and_strict(number: int, tmp_path: Path) -> None:
    part = block_part(Block.of(number, key_mm=2.0))
    write_3mf(part, tmp_path / "a.3mf")
    mesh, _ = read_3mf(tmp_path / "a.3mf")
    np.testing.assert_array_equal(mesh.vertices, part.mesh[0].vertices)
    np.testing.assert_array_equal(mesh.faces, part.mesh[0].faces)


def test_every_float32_value_is_preserved(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    values = rng.uniform(-1.0, 1.0, (6000, 3)) * 10.0 ** rng.integers(-30, 5, (6000, 1))
    vertices = values.astype(np.float32).astype(np.float64)
    mesh = Mesh(vertices, np.arange(6000, dtype=np.int32).reshape(-1, 3))
    write_3mf(mesh_part(mesh), tmp_path / "a.3mf")
    np.testing.assert_array_equal(read_3mf(tmp_path / "a.3mf")[0].vertices, vertices)


def test_metadata_contain_the_parameters(tmp_path: Path) -> None:
    block = Block.of(4, scale=0.5, sampling="grid")
    write_3mf(block_part(block), tmp_path / "a.3mf")
    _, entries = read_3mf(tmp_path / "a.3mf")
    assert entries["texture"] == "texture-4"
    assert entries["preset"] == "paper"
    assert json.loads(entries["scale"]) == 0.5
    assert entries["version"] == __version__
    assert entries["name"] == block.name
    assert len(json.loads(entries["waves"])) == 26
    assert json.loads(entries["size_mm"]) == list(block.size_mm)


def test_lib3mf_reads_millimetres_and_the_name(tmp_path: Path) -> None:
    write_3mf(mesh_part(box_mesh(), name="my_box"), tmp_path / "a.3mf")
    model = lib3mf.get_wrapper().CreateModel()
    reader = model.QueryReader("3mf")
    reader.SetStrictModeActive(True)
    reader.ReadFromFile(str(tmp_path / "a.3mf"))
    assert reader.GetWarningCount() == 0
    assert model.GetUnit() == lib3mf.Lib3MF.ModelUnit.MilliMeter
    things = model.GetMeshObjects()
    assert things.MoveNext()
    thing = things.GetCurrentMeshObject()
    assert thing.GetName() == "my_box"
    assert thing.IsManifoldAndOriented()
    assert not things.MoveNext()


def test_other_units_and_transforms_are_converted(tmp_path: Path) -> None:
    write_3mf(mesh_part(box_mesh((1.0, 2.0, 3.0))), tmp_path / "a.3mf")
    with zipfile.ZipFile(tmp_path / "a.3mf") as packed:
        entries = {name: packed.read(name) for name in packed.namelist()}
    model = entries["3D/3dmodel.model"].replace(b'unit="millimeter"', b'unit="inch"')
    turned = model.replace(b"<item ", b'<item transform="0 1 0 -1 0 0 0 0 1 5 0 0" ')
    assert turned != model
    with zipfile.ZipFile(tmp_path / "b.3mf", "w") as packed:
        for name, content in {**entries, "3D/3dmodel.model": turned}.items():
            packed.writestr(name, content)
    mesh, _ = read_3mf(tmp_path / "b.3mf")
    low, high = mesh.bounds_mm
    np.testing.assert_allclose(low, [25.4 * 3.0, 0.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(high, [25.4 * 5.0, 25.4, 25.4 * 3.0], atol=1e-5)


def test_the_positions_on_a_plate_are_exact(tmp_path: Path) -> None:
    part = mesh_part(box_mesh())
    places = [(0.0, 0.0), (59.9144999, 68.80001), (114.0712345, 1.5), (215.123456, 0.0)]
    write_plate([(part, place) for place in places], "plate", tmp_path / "a.3mf")
    corners = [mesh.bounds_mm[0] for _, mesh in read_parts(tmp_path / "a.3mf")[0]]
    np.testing.assert_allclose(corners, [(*place, 0.0) for place in places], atol=2e-5)
