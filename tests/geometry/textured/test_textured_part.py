"""Textured parts as files: every file is read back, and its distance from the formula is measured."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("cadquery")
pytest.importorskip("lib3mf")

import cadquery as cq
from helpers.own_formulas import largest_distance, points_of, top_of, waves

from tacbench_cad import InputError, PrintPart, Texture, check, export, textured
from tacbench_cad.checks.meshcheck import read_mesh
from tacbench_cad.cli import main
from tacbench_cad.geometry.mesh import Mesh

PLATE = cq.Workplane().box(24, 18, 4).faces(">Z").workplane().pushPoints([(-6, 3), (6, -3)]).hole(5)
DRUM = cq.Workplane().circle(6).extrude(8)


def part(shape: cq.Workplane, face: str, texture: Any = 2, **settings: Any) -> PrintPart:
    return textured(shape, shape.faces(face), texture, name="part", **settings).part()


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
    own = part(shape, face, **settings)
    for name, allowed in (("part.stl", 0.01), ("part.3mf", 0.01), ("part.step", 0.001)):
        report = export(own, tmp_path / name)
        assert report.ok and report.deviation_mm is not None
        assert 0.0 < report.deviation_mm <= allowed
        assert "relief" in [row.name for row in report.checks]
    assert own.spec["texture"] == "texture-2"


def test_the_measured_distance_is_that_of_an_own_formula(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The wide triangles of a coarse mesh cut deep into the narrow waves of texture 4, between few points."""
    cq.exporters.export(cq.Workplane().box(10, 12, 6), str(tmp_path / "box.step"))
    command = ["texture-part", str(tmp_path / "box.step"), "--at", "0,0,3", "--texture", "4", "--tolerance", "0.15"]
    assert main([*command, "--out", str(tmp_path / "out.stl"), "--json"]) == 0
    measured = json.loads(capsys.readouterr().out)["deviation_mm"]
    square = waves([(4.0 / np.pi / i, f * i, (1 - f) * i, 0.0) for i in range(1, 26, 2) for f in (0, 1)])
    triangles = top_of(read_mesh(tmp_path / "out.stl").triangle_points)
    # the texture begins 1 mm from the sides of the box and 0.2 mm above it, and is 1 mm high
    points = points_of(triangles[triangles[:, :, 2].min(axis=1) > 3.1]) + np.array([4.0, 5.0, -3.7])
    largest, at = largest_distance(
        points, lambda x, y: square(x / 1.2041620021916806, y / 1.4962924923325467) / 4.717892682761404, (8, 10), 0.1
    )
    assert measured == pytest.approx(largest, rel=0.02), f"{largest} mm at {at}"


def test_a_wrong_relief_is_found(tmp_path: Path) -> None:
    own = part(PLATE, ">Z")
    mesh, expected = own.make_mesh()
    vertices = mesh.vertices.copy()
    highest = int(np.argmax(vertices[:, 2]))
    vertices[highest, 2] -= 0.05
    wrong = replace(own, make_mesh=lambda: (Mesh(vertices, mesh.faces), expected))
    path = tmp_path / "part.stl"
    from tacbench_cad.formats.stl import write_stl

    write_stl(wrong, path)
    faults = [fault.name for fault in check(path, own).faults]
    assert "relief" in faults


def test_steep_waves_on_a_plane_have_a_mesh() -> None:
    mesh, expected = part(cq.Workplane().box(12, 12, 4), ">Z", 6).make_mesh()
    assert expected.relief is not None
    assert expected.relief.of_mesh(mesh)[0] <= 0.01
    assert mesh.as_manifold().genus() == 0


def test_steep_oblique_waves_around_a_cylinder_have_a_mesh() -> None:
    weave = Texture.plane_waves((0.6, 1.0, 0.5), (0.6, 1.0, -0.5), name="weave")
    made = part(DRUM, "%Cylinder", weave, mm_per_unit=(0.3, 0.3), mesh_tolerance_mm=0.03)
    mesh, expected = made.make_mesh()
    assert expected.relief is not None
    assert expected.relief.of_mesh(mesh)[0] <= 0.03
    assert mesh.as_manifold().genus() == made.genus


def test_bad_input_is_refused() -> None:
    with pytest.raises(InputError, match="must end in"):
        textured("plate", PLATE.faces(">Z"), 2, name="part")
    with pytest.raises(InputError, match="select at least one"):
        textured(PLATE, [], 2, name="part")
    with pytest.raises(InputError, match="mesh_tolerance_mm"):
        part(PLATE, ">Z", mesh_tolerance_mm=0.0)
