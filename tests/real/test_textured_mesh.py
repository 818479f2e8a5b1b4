"""Other programs accept meshes of other programs after these got a texture."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from helpers.outsiders import Run, Written

from tacbench_cad import export
from tacbench_cad import textured as textured_part

pytestmark = pytest.mark.real
trimesh = pytest.importorskip("trimesh")

#: For each mesh: a point, the number of the texture, and settings.
CASES: dict[str, tuple[tuple[float, float, float], int, dict[str, Any]]] = {
    "box": ((0, 0, 5), 2, {"fade_mm": 2.0}),
    "cylinder": ((0, -10, 3), 3, {}),
    "tube": ((0, 8, 3), 2, {"sunk": True, "depth_mm": 0.5}),
    "capsule": ((8, 0, 15), 4, {"mesh_tolerance_mm": 0.1}),
    "holder": ((0.0, 0.0, 0.0), 2, {"depth_mm": 0.4, "margin_mm": 0.5}),
}


@pytest.fixture(scope="module", params=CASES)
def textured(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, written: Written) -> Path:
    """Write a mesh of another program, put a texture on it, and return the new file."""
    at, number, settings = CASES[request.param]
    path = tmp_path_factory.mktemp("textured") / f"{request.param}.stl"
    creation = trimesh.creation
    if request.param == "holder":
        path = written("holder", "stl")
        mesh = trimesh.load(path)
        own = mesh.triangles_center[(mesh.face_normals @ [0, -1, 0] > 0.99) & (mesh.triangles_center[:, 1] < 1e-3)]
        at = tuple(own[0].tolist())
    else:
        meshes = {
            "box": lambda: creation.box((40, 30, 10)),
            "cylinder": lambda: creation.cylinder(10, 40, sections=96),
            "tube": lambda: creation.annulus(8, 12, 20, sections=96),
            "capsule": lambda: creation.capsule(30, 8, count=(64, 64)),
        }
        meshes[request.param]().export(path)
    result = textured_part(path, at, number, **{"mesh_tolerance_mm": 0.03, **settings})
    out = tmp_path_factory.mktemp("result") / f"{request.param}.stl"
    assert export(result, out).ok
    return out


def test_admesh_finds_nothing_to_fix(admesh: Run, textured: Path) -> None:
    output = admesh([textured])
    rows = dict(re.findall(r"([A-Z][A-Za-z0-9 ]*?) +: +([\d.]+)", output))
    for name in ("Degenerate facets", "Edges fixed", "Facets removed", "Facets reversed", "Normals fixed"):
        assert rows[name] == "0"
    assert rows["Number of parts"] == "1"


def test_prusaslicer_reads_it_as_manifold(prusa_slicer: Run, textured: Path) -> None:
    info = prusa_slicer(["--info", textured])
    assert re.search(r"manifold = yes", info)
    assert re.search(r"number_of_parts = +1", info)
    for word in ("open_edges", "facets_reversed", "backwards_edges", "degenerate"):
        assert word not in info


def test_pymeshlab_finds_no_self_intersection(textured: Path) -> None:
    pymeshlab = pytest.importorskip("pymeshlab", reason="pymeshlab is not installed (extra cad)")
    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh(str(textured))
    meshes.meshing_remove_duplicate_vertices()
    measures = meshes.get_topological_measures()
    assert measures["is_mesh_two_manifold"] is True
    assert (measures["boundary_edges"], measures["connected_components_number"]) == (0, 1)
    meshes.compute_selection_by_self_intersections_per_face()
    assert meshes.current_mesh().selected_face_number() == 0
