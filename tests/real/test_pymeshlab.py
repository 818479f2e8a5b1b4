"""pymeshlab: the meshes are closed and two-manifold, with the correct number of holes and no self-intersection."""

from __future__ import annotations

import pytest
from helpers.outsiders import Written, each_part, part_named

pytestmark = pytest.mark.real


@each_part
def test_is_a_closed_manifold(written: Written, name: str) -> None:
    pymeshlab = pytest.importorskip("pymeshlab", reason="pymeshlab is not installed (extra cad)")
    part = part_named(name)
    mesh, _ = part.mesh
    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh(str(written(name, "stl")))
    assert meshes.current_mesh().face_number() == len(mesh.faces)
    meshes.meshing_remove_duplicate_vertices()
    assert meshes.current_mesh().vertex_number() == len(mesh.vertices)
    measures = meshes.get_topological_measures()
    assert measures["is_mesh_two_manifold"] is True
    assert measures["boundary_edges"] == 0
    assert measures["non_two_manifold_edges"] == 0
    assert measures["non_two_manifold_vertices"] == 0
    assert measures["connected_components_number"] == 1
    assert measures["genus"] == part.genus
    meshes.compute_selection_by_self_intersections_per_face()
    assert meshes.current_mesh().selected_face_number() == 0
