"""Textured parts as files: every file is read back, and its distance from the formula is measured."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("cadquery")
pytest.importorskip("lib3mf")

import cadquery as cq

from tacbench_cad import InputError, Part, Texture, check, export, plane_waves, textured_part
from tacbench_cad.geometry.mesh import Mesh

PLATE = cq.Workplane().box(24, 18, 4).faces(">Z").workplane().pushPoints([(-6, 3), (6, -3)]).hole(5)
DRUM = cq.Workplane().circle(6).extrude(8)


def part(shape: cq.Workplane, face: str, texture: Any = 2, **settings: Any) -> Part:
    return textured_part(shape, shape.faces(face), texture, name="part", **settings)


@pytest.mark.parametrize(
    ("shape", "face", "settings"),
    [
        (PLATE, ">Z", {"sunk": True}),
        pytest.param(cq.Workplane().box(24, 18, 4), ">Z", {"fade_mm": 2.0}, marks=pytest.mark.long),
        pytest.param(DRUM, "%Cylinder", {}, marks=pytest.mark.long),
        (DRUM, "%Cylinder", {"sunk": True, "fade_mm": 1.5, "depth_mm": 0.5}),
    ],
)
def test_every_format_is_written_and_near_the_formula(
    shape: cq.Workplane, face: str, settings: dict[str, Any], tmp_path: Path
) -> None:
    textured = part(shape, face, **settings)
    for name, allowed in (("part.stl", 0.01), ("part.3mf", 0.01), ("part.step", 0.001)):
        report = export(textured, tmp_path / name)
        assert report.ok and report.deviation_mm is not None
        assert 0.0 < report.deviation_mm <= allowed
        assert "relief" in [row.name for row in report.checks]
    assert textured.spec["texture"] == "texture-2"


def test_a_wrong_relief_is_found(tmp_path: Path) -> None:
    textured = part(PLATE, ">Z")
    mesh, expected = textured.make_mesh()
    vertices = mesh.vertices.copy()
    highest = int(np.argmax(vertices[:, 2]))
    vertices[highest, 2] -= 0.05
    wrong = replace(textured, make_mesh=lambda: (Mesh(vertices, mesh.faces), expected))
    path = tmp_path / "part.stl"
    from tacbench_cad.formats.stl import write_stl

    write_stl(wrong, path)
    faults = [fault.name for fault in check(path, textured).faults]
    assert "relief" in faults


def test_steep_waves_on_a_plane_have_a_mesh() -> None:
    mesh, expected = part(cq.Workplane().box(12, 12, 4), ">Z", 6).make_mesh()
    assert expected.relief is not None
    assert expected.relief.of_mesh(mesh)[0] <= 0.01
    assert mesh.as_manifold().genus() == 0


def test_bad_input_is_refused() -> None:
    with pytest.raises(InputError, match="must be a part of CadQuery"):
        textured_part("plate", PLATE.faces(">Z"), 2, name="part")
    with pytest.raises(InputError, match="select at least one"):
        textured_part(PLATE, [], 2, name="part")
    with pytest.raises(InputError, match="mesh_tolerance_mm"):
        part(PLATE, ">Z", mesh_tolerance_mm=0.0)
    weave = Texture(name="weave", surface=plane_waves((0.6, 1.0, 0.5), (0.6, 1.0, -0.5)))
    with pytest.raises(InputError, match="slopes of up to"):
        part(DRUM, "%Cylinder", weave, mm_per_unit=(0.3, 0.3)).make_mesh()
