"""Blocks from which something was cut by CadQuery (STEP) or manifold3d (meshes): every cut is a fault that is named."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.cases import mostly_long
from helpers.shapes import mesh_part, write_soup

from tacbench_cad.checks.check import check
from tacbench_cad.checks.identify import examine
from tacbench_cad.checks.report import Report
from tacbench_cad.formats import FORMATS
from tacbench_cad.geometry.block_part import block_part
from tacbench_cad.geometry.mesh import Mesh, manifold_of
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.sampling import Tolerance

#: What is cut out: a box with its lower corner and its sides, or a cylinder along z with its foot, diameter and height.
#: And the words of the fault.
CUTS: dict[str, tuple[tuple[float, ...], str]] = {
    "through hole": (
        (10.0, 10.0, -1.0, 3.0, 20.0),
        "the volume is 46[.0-9]* mm.3 too small.*1 through hole instead of 0",
    ),
    "hole of 0.02 mm": ((10.0, 10.0, -1.0, 0.02, 20.0), "1 through hole instead of 0"),
    "pocket in the texture": ((10.0, 10.0, 3.0, 2.0, 20.0), "too small|from texture-2"),
    "pocket of 0.05 mm in the texture": ((10.0, 10.0, 3.0, 0.05, 20.0), "not on a side|from texture-2"),
    "pocket in the underside": ((10.0, 10.0, -1.0, 3.0, 3.0), "the volume is 14[.0-9]* mm.3 too small"),
    "pocket of 0.1 mm in the underside": ((10.0, 10.0, -1.0, 0.1, 1.1), "not on a side|from texture-2"),
    "pocket as deep as a label": ((10.0, 10.0, -1.0, 2.0, 2.0, 1.4), "4 mm.2 of pockets in the underside"),
    "notch in a side": ((-1.0, 10.0, 2.0, 2.0, 2.0, 2.0), "not on a side|from texture-2"),
    "cut off edge": ((-1.0, -1.0, -1.0, 1.5, 40.0, 1.5), "not on a side|from texture-2"),
    "hollow": ((10.0, 10.0, 2.0, 2.0, 2.0, 1.0), "hollow"),
    "large pocket in the underside": ((1.0, 1.0, -1.0, 21.0, 28.0, 2.0), "the volume is 588 mm.3 too small"),
}


def _faults(report: Report) -> str:
    return "; ".join(f"{check.name}: {check.detail}" for check in report.faults)


@pytest.fixture(scope="module")
def solid(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Return the block of texture 2 as CadQuery reads it from our STEP file."""
    cadquery = pytest.importorskip("cadquery")
    path = tmp_path_factory.mktemp("plain") / "a.step"
    FORMATS["step"].write(block_part(Block.of(2)), path)
    return cadquery.importers.importStep(str(path))


def _tool(numbers: tuple[float, ...]) -> Any:
    import cadquery

    if len(numbers) == 6:
        return cadquery.Workplane().box(*numbers[3:], centered=False).translate(numbers[:3])
    return cadquery.Workplane().circle(numbers[3] / 2.0).extrude(numbers[4]).translate(numbers[:3])


@pytest.mark.parametrize("name", mostly_long(CUTS, "through hole", "hollow"))
def test_a_cut_solid_is_a_fault(name: str, solid: Any, tmp_path: Path) -> None:
    import cadquery

    numbers, words = CUTS[name]
    cut = solid.cut(_tool(numbers))
    assert cut.val().isValid() and cut.val().Volume() < solid.val().Volume()
    cadquery.exporters.export(cut, str(tmp_path / "a.step"))
    report = examine(tmp_path / "a.step")
    assert not report.ok and re.search(words, _faults(report)), _faults(report)
    assert not check(tmp_path / "a.step", Block.of(2)).ok, "the check of a known part must find it, too"


def test_a_solid_that_another_program_wrote_again_is_no_fault(solid: Any, tmp_path: Path) -> None:
    import cadquery

    moved = solid.val().rotate((0, 0, 0), (0, 0, 1), 90).translate((200.0, -7.0, 3.0))
    cadquery.exporters.export(cadquery.Workplane(moved), str(tmp_path / "a.step"))
    report = examine(tmp_path / "a.step")
    assert report.ok, _faults(report)


@pytest.mark.parametrize(
    "settings",
    mostly_long(
        [
            {"key_mm": 3.0, "copy": 12},
            {"outline": "disc:25"},
            {"outline": "ring:30,12"},
            {"outline": "ring:40,8", "copy": 12},
            {"outline": "hexagon:30", "label": True},
        ],
        {"outline": "hexagon:30", "label": True},
    ),
)
def test_keys_labels_and_outlines_in_a_solid_without_a_name_are_no_faults(
    settings: dict[str, Any], tmp_path: Path
) -> None:
    cadquery = pytest.importorskip("cadquery")
    block = Block.of(1, **settings)
    FORMATS["step"].write(block_part(block), tmp_path / "a.step")
    part = cadquery.importers.importStep(str(tmp_path / "a.step"))
    cadquery.exporters.export(part, str(tmp_path / "b.step"))
    report = examine(tmp_path / "b.step")
    assert report.ok, _faults(report)
    cadquery.exporters.export(part.cut(_tool((8.0, 12.0, -1.0, 0.05, 20.0))), str(tmp_path / "c.step"))
    holes = 1 if block.outline is None else len(block.outline.loops)
    assert f"{holes} through hole" in _faults(examine(tmp_path / "c.step"))


@pytest.fixture(scope="module")
def mesh() -> Mesh:
    """Return the mesh of texture 2."""
    return block_part(Block.of(2, sampling=Tolerance(mm=0.05))).mesh[0]


def _cut_mesh(mesh: Mesh, numbers: tuple[float, ...]) -> Mesh:
    manifold3d = pytest.importorskip("manifold3d")
    if len(numbers) == 6:
        tool = manifold3d.Manifold.cube(numbers[3:]).translate(numbers[:3])
    else:
        tool = manifold3d.Manifold.cylinder(numbers[4], numbers[3] / 2.0, circular_segments=24).translate(numbers[:3])
    raw = (manifold_of(mesh.vertices, mesh.faces) - tool).to_mesh64()
    points = np.array(raw.vert_properties)[:, :3].astype(np.float32).astype(np.float64)
    return Mesh(points, np.array(raw.tri_verts, dtype=np.int32))


@pytest.mark.parametrize(
    ("name", "form"),
    mostly_long(
        [(name, form) for name in CUTS for form in ("stl", "3mf")],
        *((name, "3mf") for name in ("hole of 0.02 mm", "pocket of 0.05 mm in the texture", "notch in a side")),
        ("hollow", "stl"),
    ),
)
def test_a_cut_mesh_is_a_fault(name: str, form: str, mesh: Mesh, tmp_path: Path) -> None:
    cut, path = _cut_mesh(mesh, CUTS[name][0]), tmp_path / f"a.{form}"
    write: dict[str, Callable[[], object]] = {
        "stl": lambda: write_soup(path, cut.triangle_points),
        "3mf": lambda: FORMATS["3mf"].write(mesh_part(cut, name="texture-2_paper_x1_tol0.05"), path),
    }
    write[form]()
    report = examine(path, full=False)
    assert not report.ok
    assert not {check.name for check in report.faults} & {"closed", "winding", "edges"}, "the cut mesh is closed"
    if "hole" in name:
        assert "1 through hole instead of 0" in _faults(report)
    if name == "hollow":
        assert "1 of them inside out: the body has a hollow" in _faults(report)
