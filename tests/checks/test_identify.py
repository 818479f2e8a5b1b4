"""``examine``: it identifies files from any program and names each of their faults."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.cases import mostly_long
from helpers.shapes import (
    box_mesh,
    changed,
    flip_triangle,
    inside_out,
    lower_top_vertex,
    mesh_part,
    published,
    write_soup,
)

from tacbench_cad.checks.identify import examine
from tacbench_cad.checks.report import Check, Report
from tacbench_cad.formats import FORMATS
from tacbench_cad.formats.threemf import write_plate
from tacbench_cad.geometry.block_part import block_part
from tacbench_cad.geometry.mesh import Mesh
from tacbench_cad.geometry.part import PrintPart
from tacbench_cad.making.manifest import write_manifest
from tacbench_cad.spec import texture_files
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.sampling import Tolerance
from tacbench_cad.spec.storage import block_values


@cache
def _part(number: int = 2, preset: str = "paper", **more: Any) -> PrintPart:
    return block_part(Block.of(number, preset, **more))


def _anonymous(mesh: Mesh, path: Path) -> Path:
    """Write a mesh to a file that contains no part name."""
    return write_soup(path, mesh.triangle_points)


def _claim(path: Path, block: Block | None) -> None:
    """Write the manifest of a file that claims to contain a block."""
    assert block is not None
    row = {"file": path.name, "sha256": "", "part": block.name, "block": block_values(block)}
    write_manifest(path.parent, [row])


def _line(report: Report, name: str) -> Check:
    return next(check for check in report.checks if check.name == name)


def _faults(report: Report) -> set[str]:
    return {check.name for check in report.faults}


def _turn(mesh: Mesh, quarters: int, upside_down: bool = False) -> Mesh:
    """Turn a mesh about z by quarter turns, optionally by 180 degrees about x, and move it away from the origin."""
    c, s = round(np.cos(quarters * np.pi / 2)), round(np.sin(quarters * np.pi / 2))
    about_z = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    about_x = np.diag([1.0, -1.0, -1.0]) if upside_down else np.eye(3)
    return changed(mesh, lambda vertices: vertices @ (about_x @ about_z).T + [3.0, -100.0, 12.5])


@pytest.fixture(scope="module", autouse=True)
def three_later_textures() -> Iterator[None]:
    """Compare files with three of the later textures. A test in tests/hostile compares a file with all fourteen."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(texture_files, "LATER_NAMES", ("dunes", "diamond", "coral"))
        yield


@pytest.mark.parametrize(
    ("name", "preset"),
    mostly_long([("dunes", "paper"), ("diamond", "released"), ("coral", "released")], ("diamond", "released")),
)
def test_later_textures_are_identified(name: str, preset: str, tmp_path: Path) -> None:
    mesh = block_part(Block.of(name, preset)).mesh[0]
    report = examine(_anonymous(mesh, tmp_path / "a.stl"), full=False)
    assert report.ok, report.faults
    assert f"{name}, preset {preset}" in _line(report, "relief").detail


@pytest.mark.parametrize("number", range(1, 7))
def test_each_texture_is_identified(number: int, tmp_path: Path) -> None:
    report = examine(_anonymous(_part(number).mesh[0], tmp_path / "a.stl"), full=False)
    assert report.ok, report.faults
    assert f"texture-{number}, preset paper, scale 1:" in _line(report, "relief").detail
    assert report.deviation_mm is not None
    assert 0.005 < report.deviation_mm <= 0.0101


@pytest.mark.parametrize("scale", mostly_long([0.33, 0.5, 2.0], 0.33))
def test_preset_and_scale_are_identified(scale: float, tmp_path: Path) -> None:
    part = block_part(Block.of(3, "released", scale=scale))
    report = examine(_anonymous(part.mesh[0], tmp_path / "a.stl"), full=False)
    assert report.ok, report.faults
    assert f"texture-3, preset released on its sample grid, scale {scale:g}:" in _line(report, "relief").detail
    assert report.deviation_mm is not None
    assert report.deviation_mm < 5e-6


def test_a_surface_on_a_sample_grid_is_identified(tmp_path: Path) -> None:
    part = block_part(Block.of(4, sampling="grid"))
    report = examine(_anonymous(part.mesh[0], tmp_path / "a.stl"), full=False)
    assert report.ok, report.faults
    assert "texture-4, preset paper on its sample grid" in _line(report, "relief").detail


@pytest.mark.parametrize("quarters", mostly_long(range(4), 0, 3))
@pytest.mark.parametrize("number", mostly_long([2, 6], 2))
def test_origin_and_quarter_turns_do_not_matter(number: int, quarters: int, tmp_path: Path) -> None:
    report = examine(_anonymous(_turn(_part(number).mesh[0], quarters), tmp_path / "a.stl"), full=False)
    assert report.ok, report.faults
    assert f"texture-{number}," in _line(report, "relief").detail
    placement = _line(report, "placement").detail
    assert "12.5 mm" in placement
    assert ("turned by" in placement) == (quarters != 0)
    if quarters:
        assert f"turned by {90 * quarters} degrees" in placement


@pytest.mark.parametrize("quarters", [0, 1])
def test_upside_down_is_named(quarters: int, tmp_path: Path) -> None:
    mesh = _turn(block_part(Block.of(2, label=True, key_mm=3.0)).mesh[0], quarters, upside_down=True)
    report = examine(_anonymous(mesh, tmp_path / "a.stl"), full=False)
    assert _faults(report) == {"placement"}
    assert "upside down" in _line(report, "placement").detail
    assert "texture-2, preset paper" in _line(report, "relief").detail
    assert "3 mm at the corner (X, 0)" in _line(report, "key").detail


def test_mirrored_is_named(tmp_path: Path) -> None:
    mesh = changed(_part(3).mesh[0], lambda vertices: vertices * [-1.0, 1.0, 1.0])
    report = examine(_anonymous(inside_out(mesh), tmp_path / "a.stl"), full=False)
    assert _faults(report) == {"placement"}
    assert "mirrored" in _line(report, "placement").detail


def _thicker(mesh: Mesh) -> Mesh:
    return changed(mesh, lambda vertices: vertices + np.array([0.0, 0.0, 0.3]) * (vertices[:, 2:] > 1.0))


@pytest.mark.parametrize(
    ("fault", "name", "words"),
    [
        (lambda mesh: Mesh(mesh.vertices, mesh.faces[1:]), "closed", "3 open edges"),
        (flip_triangle, "winding", "inconsistent winding along 3 edges"),
        (inside_out, "volume", "inside out"),
        (lower_top_vertex, "relief", "the distance from texture-2, preset paper, scale 1 is at most 0.0"),
        (_thicker, "size", "differs in z by +0.3 mm"),
        (_thicker, "relief", "the relief is 0.3 mm too high"),
        (lambda mesh: changed(mesh, lambda v: v * 1.01), "size", "1.01 times as large as expected"),
        (lambda mesh: changed(mesh, lambda v: v * [1.0, 1.02, 1.0]), "size", "differs in y by +0.6 mm"),
        (lambda mesh: changed(mesh, lambda v: v * 25.4), "size", "25.4 times as large as expected"),
    ],
)
def test_every_fault_is_named(fault: Callable[[Mesh], Mesh], name: str, words: str, tmp_path: Path) -> None:
    path = _anonymous(fault(_part().mesh[0]), tmp_path / "a.stl")
    report = examine(path, texture="2", preset="paper", scale=1.0, full=False)
    assert not _line(report, name).ok
    assert words in _line(report, name).detail


@pytest.mark.parametrize(("unit", "length_mm"), [("inches", 25.4), ("centimetres", 10.0), ("metres", 1000.0)])
def test_the_unit_of_a_small_file_is_named(unit: str, length_mm: float, tmp_path: Path) -> None:
    mesh = _part(2).mesh[0]
    path = _anonymous(Mesh(mesh.vertices / length_mm, mesh.faces), tmp_path / "part.stl")
    detail = _line(examine(path, full=False), "texture").detail
    assert detail.endswith(f"mm, so the file is probably in {unit} (multiply it by {length_mm:g})")


def test_a_texture_other_than_the_expected_texture_is_named(tmp_path: Path) -> None:
    report = examine(_anonymous(_part(3).mesh[0], tmp_path / "a.stl"), texture="2", full=False)
    assert _faults(report) == {"relief"}
    assert "the nearest known block is texture-3, preset paper, scale 1" in _line(report, "relief").detail


def test_a_file_of_this_package_must_agree_with_its_claim(tmp_path: Path) -> None:
    """The same mesh passes with the right block in the manifest, and fails with any other block."""
    right = Block.of(2, size_mm=(40.0, 35.0), height_mm=8.0, key_mm=2.5, sampling=Tolerance(mm=0.05))
    path = tmp_path / "a.stl"
    FORMATS["stl"].write(block_part(right), path)
    for claim, fault in (
        (right, None),
        (replace(right, texture=Block.of(3).texture), "relief"),
        (replace(right, nominal_height_mm=8.5), "size"),
        (replace(right, key_mm=3.0), "key"),
        (replace(right, key_mm=None), "key"),
        (replace(right, sampling=Tolerance()), "relief"),
    ):
        _claim(path, claim)
        faults = _faults(examine(path, full=False))
        assert fault in faults if fault else not faults, claim.name


@pytest.mark.parametrize("form", ["3mf", "step"])
def test_a_wrong_claim_in_the_file_itself_is_found(form: str, tmp_path: Path) -> None:
    if FORMATS[form].why_missing() is not None:
        pytest.skip(f"the packages for {form} files are not installed")
    path = tmp_path / f"texture-2_paper_x1.{form}"
    FORMATS[form].write(replace(_part(2), block=Block.of(3)), path)
    assert "relief" in _faults(examine(path, full=False))


@pytest.mark.parametrize("form", ["stl", "3mf", "step"])
def test_a_key_a_label_and_another_height_are_no_faults(form: str, tmp_path: Path) -> None:
    if FORMATS[form].why_missing() is not None:
        pytest.skip(f"the packages for {form} files are not installed")
    part = block_part(Block.of(1, height_mm=8.0, key_mm=3.0, copy=7))
    path = tmp_path / f"a.{form}"
    FORMATS[form].write(part, path)
    if form == "stl":
        _claim(path, part.block)
    report = examine(path, full=False)
    assert report.ok, report.faults
    assert "3 mm at the corner (X, 0)" in _line(report, "key").detail
    assert "0.4 mm" in _line(report, "label").detail


@pytest.mark.parametrize("number", [4, *(pytest.param(n, marks=pytest.mark.long) for n in (1, 2, 3, 5, 6))])
@pytest.mark.parametrize(
    "given", ["", *(pytest.param(words, marks=pytest.mark.long) for words in ("preset", "texture and preset"))]
)
def test_the_published_files_match_to_single_precision(number: int, given: str, tmp_path: Path) -> None:
    corners = published(number)
    assert len(corners) == 353_972
    path = write_soup(tmp_path / "z.stl", corners)
    options = {"preset": "released"} if "preset" in given else {}
    report = examine(path, full=False, texture=str(number) if "texture" in given else None, **options)
    assert _faults(report) == {"winding"}
    assert f"texture-{number}, preset released on its sample grid" in _line(report, "relief").detail
    assert report.deviation_mm is not None
    assert report.deviation_mm < 2e-6


def test_a_part_without_relief_has_no_texture(tmp_path: Path) -> None:
    path = tmp_path / "a.stl"
    FORMATS["stl"].write(mesh_part(box_mesh((30.0, 40.0, 5.0)), name="holder_x1"), path)
    report = examine(path, full=False)
    assert report.ok, report.faults
    assert "none: a part of 30 x 40 x 5 mm" in _line(report, "texture").detail
    assert not examine(path, texture="1", full=False).ok


def test_several_bodies_without_names_are_a_fault(tmp_path: Path) -> None:
    both = np.concatenate([box_mesh().triangle_points, box_mesh(at=(10.0, 0.0, 0.0)).triangle_points])
    report = examine(write_soup(tmp_path / "a.stl", both), full=False)
    assert "2 separate bodies" in _line(report, "bodies").detail
    assert not report.ok


def test_each_body_of_a_plate_is_checked_under_its_name(tmp_path: Path) -> None:
    pytest.importorskip("lib3mf")
    parts = [block_part(Block.of(number, copy=1)) for number in (1, 2)]
    foot = mesh_part(box_mesh((20.0, 30.0, 5.0)), name="foot")
    placed = [(part, (30.0 * i, 1.0)) for i, part in enumerate((*parts, foot))]
    write_plate(placed, "plate", tmp_path / "a.3mf")
    report = examine(tmp_path / "a.3mf", full=False)
    assert report.ok, report.faults
    assert _line(report, "bodies").detail == "3, 2 of them with a relief; each is checked separately"
    assert "0 through holes" in _line(report, "manifold").detail
    for part in parts:
        assert part.name.split("_")[0] in _line(report, f"{part.name}: relief").detail
    # An expected texture applies to all blocks of the file.
    assert _faults(examine(tmp_path / "a.3mf", texture="2", full=False)) == {f"{parts[0].name}: relief"}
    wrong = [(replace(parts[0], name=parts[1].name, block=parts[1].block), (0.0, 0.0)), (foot, (30.0, 0.0))]
    write_plate(wrong, "plate", tmp_path / "b.3mf")
    assert _faults(examine(tmp_path / "b.3mf", full=False)) == {f"{parts[1].name}: relief"}
    write_plate([(foot, (0.0, 0.0)), (replace(foot, name="head"), (30.0, 0.0))], "plate", tmp_path / "c.3mf")
    assert examine(tmp_path / "c.3mf", full=False).ok
    assert _faults(examine(tmp_path / "c.3mf", texture="2", full=False)) == {"bodies"}


def test_the_expected_texture_can_come_from_a_file(tmp_path: Path) -> None:
    from tacbench_cad.spec.texture_files import read_texture

    toml = tmp_path / "hex.toml"
    waves = [(0.5, 1.0, 0.0), (0.5, -0.5, 0.866), (0.5, -0.5, -0.866)]
    tables = "".join(f"[[wave]]\namplitude = {a}\nf = {f}\ng = {g}\n" for a, f, g in waves)
    toml.write_text(f'[texture]\nname = "hex"\nfamily = "plane-waves"\n{tables}')
    part = block_part(Block.of(read_texture(toml)))
    FORMATS["stl"].write(part, tmp_path / "a.stl")
    report = examine(tmp_path / "a.stl", texture=str(toml), full=False)
    assert report.ok, report.faults
    assert "hex, preset paper" in _line(report, "relief").detail
    assert not examine(tmp_path / "a.stl", full=False).ok  # without the file, the texture is unknown


def test_a_step_file_from_the_kernel_is_identified(tmp_path: Path) -> None:
    pytest.importorskip("OCP")
    from OCP.BRepBuilderAPI import BRepBuilderAPI_Transform
    from OCP.gp import gp_Ax1, gp_Dir, gp_Pnt, gp_Trsf, gp_Vec
    from OCP.STEPControl import STEPControl_StepModelType, STEPControl_Writer

    shape, _ = _part(2).solid
    turn, move = gp_Trsf(), gp_Trsf()
    turn.SetRotation(gp_Ax1(gp_Pnt(0.0, 0.0, 0.0), gp_Dir(0.0, 0.0, 1.0)), np.pi / 2)
    move.SetTranslation(gp_Vec(4.0, 5.0, 6.0))
    transformed = BRepBuilderAPI_Transform(shape, move.Multiplied(turn), True).Shape()
    writer = STEPControl_Writer()
    writer.Transfer(transformed, STEPControl_StepModelType.STEPControl_AsIs)
    writer.Write(str(tmp_path / "a.step"))
    report = examine(tmp_path / "a.step")
    assert report.ok, report.faults
    assert "texture-2, preset paper, scale 1" in _line(report, "relief").detail
    assert "turned by 90 degrees" in _line(report, "placement").detail
    assert not examine(tmp_path / "a.step", texture="3").ok
