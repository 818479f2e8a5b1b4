"""The strict reader of lib3mf: no warning, millimetres, the same triangles, and the parameters as metadata."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.outsiders import Written, each_part, part_named

from tacbench_cad import __version__

pytestmark = pytest.mark.real


@each_part
def test_reads_strictly_and_without_warning(written: Written, name: str) -> None:
    lib3mf = pytest.importorskip("lib3mf", reason="lib3mf has no wheel for this machine")
    part = part_named(name)
    mesh, _ = part.mesh
    model = lib3mf.get_wrapper().CreateModel()
    reader = model.QueryReader("3mf")
    reader.SetStrictModeActive(True)
    reader.ReadFromFile(str(written(name, "3mf")))
    assert [reader.GetWarning(i) for i in range(reader.GetWarningCount())] == []
    assert model.GetUnit() == lib3mf.ModelUnit.MilliMeter

    objects = model.GetMeshObjects()
    assert objects.MoveNext()
    mesh_object = objects.GetCurrentMeshObject()
    assert not objects.MoveNext(), "there must be only one object"
    assert mesh_object.IsManifoldAndOriented()
    assert mesh_object.GetName() == part.name
    vertices = np.array([list(v.Coordinates) for v in mesh_object.GetVertices()], dtype=np.float64)
    triangles = np.array([list(t.Indices) for t in mesh_object.GetTriangleIndices()])
    assert np.array_equal(vertices[triangles], mesh.triangle_points)
    assert model.GetBuildItems().Count() == 1

    group = model.GetMetaDataGroup()
    entries = {e.GetName(): e.GetValue() for e in map(group.GetMetaData, range(group.GetMetaDataCount()))}
    assert entries["Title"] == part.title
    assert entries["version"] == __version__
    if part.block is not None:
        assert set(part.spec) <= set(entries)
        assert entries["preset"] == part.block.preset
        assert float(entries["scale"]) == part.block.scale
