"""The command ``tacbench texture-part``: meshes and solids of other programs, the written file, and messages."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from helpers.shapes import box_mesh, mesh_part

from tacbench_cad.checks.meshcheck import read_mesh
from tacbench_cad.cli import main
from tacbench_cad.formats.step import read_step
from tacbench_cad.formats.stl import write_stl
from tacbench_cad.formats.threemf import write_3mf
from tacbench_cad.geometry import kernel

Capture = pytest.CaptureFixture[str]


@pytest.fixture
def pad(tmp_path: Path) -> Path:
    """Return an STL file of a plate of 30 x 20 x 5 mm."""
    write_stl(mesh_part(box_mesh((30.0, 20.0, 5.0))), tmp_path / "my pad (2).stl")
    return tmp_path / "my pad (2).stl"


def test_the_new_file_has_the_texture_and_the_coordinates_of_the_part(pad: Path, capsys: Capture) -> None:
    before = read_mesh(pad)
    assert main(["texture-part", str(pad), "--at", "15,10,5", "--texture", "2", "--depth", "0.5", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    after = read_mesh(Path(document["file"]))
    assert Path(document["file"]).name == "my pad (2)_textured.stl"
    assert (document["region"], document["size_mm"], document["bodies"]) == ("plane", [28.0, 18.0], 1)
    assert document["evidence"] == "proved" and document["error_mm"] <= 0.0101
    assert after.volume_mm3 == pytest.approx(document["expected_volume_mm3"], rel=1e-3)
    assert after.bounds_mm[0].tolist() == before.bounds_mm[0].tolist()
    assert after.bounds_mm[1][2] == pytest.approx(5.7, abs=0.01)


def test_a_3mf_file_is_written_for_a_3mf_name(pad: Path, tmp_path: Path, capsys: Capture) -> None:
    pytest.importorskip("lib3mf")
    write_3mf(mesh_part(box_mesh((30.0, 20.0, 5.0))), tmp_path / "pad.3mf")
    out = tmp_path / "new.3mf"
    words = ["--texture", "3", "--sunk", "--tolerance", "0.05", "--out", str(out)]
    assert main(["texture-part", str(tmp_path / "pad.3mf"), "--at", "15,10,5", *words]) == 0
    assert "texture-3 on a plane, 28 x 18 mm" in capsys.readouterr().out
    assert read_mesh(out).volume_mm3 < 30.0 * 20.0 * 5.0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--at", "99,0,0", "--texture", "2"], "mm from the mesh; the nearest triangle is at"),
        (["--at", "1,2", "--texture", "2"], "must be X,Y,Z"),
        (["--at", "15,10,5", "--texture", "wood"], "texture = 'wood'"),
        (["--at", "15,10,5", "--texture", "all"], "texture = 'all': means several textures; name one: 1 to 6"),
        (["--at", "15,10,5", "--texture", "later"], "texture = 'later': means several textures; name one: 1 to 6"),
        (["--at", "15,10,5", "--texture", "2", "--scale", "1000"], "is probably not the millimetre"),
        (["--at", "15,10,5", "--texture", "2", "--out", "pad.step"], "must end in .stl or .3mf"),
        (["--face", ">Z", "--texture", "2"], "needs a STEP file; name the region of a mesh by --at"),
    ],
)
def test_bad_input_ends_in_one_line(pad: Path, words: list[str], message: str, capsys: Capture) -> None:
    assert main(["texture-part", str(pad), *words]) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and error.count("\n") == 1
    assert message in error


@pytest.fixture
def step_file(tmp_path: Path) -> Path:
    """Return a STEP file of a plate with a countersunk hole, away from the origin."""
    cq = pytest.importorskip("cadquery")
    plate = cq.Workplane().box(20, 16, 4).faces(">Z").workplane().center(5, 3).cskHole(3, 5, 82)
    plate = plate.translate((100, -50, 7))
    path = tmp_path / "plate.step"
    cq.exporters.export(plate, str(path))
    return path


@pytest.mark.parametrize(
    ("words", "name", "allowed"),
    [
        (["--face", ">Z"], "plate_textured.step", 0.001),
        (["--at", "98,-50,9.3", "--sunk", "--tolerance", "0.02"], "plate_textured.stl", 0.02),
    ],
)
def test_a_step_file_keeps_its_coordinates(
    step_file: Path, words: list[str], name: str, allowed: float, capsys: Capture
) -> None:
    words = [*words, "--texture", "2", "--depth", "0.5", "--out", str(step_file.with_name(name)), "--json"]
    assert main(["texture-part", str(step_file), *words]) == 0
    document = json.loads(capsys.readouterr().out)
    assert (document["region"], document["evidence"], document["bodies"]) == ("plane", "proved", 1)
    assert 0.0 < document["deviation_mm"] <= allowed
    assert document["volume_mm3"] == pytest.approx(document["expected_volume_mm3"], rel=1e-3)
    file = Path(document["file"])
    low = kernel.box_mm(read_step(file))[0] if file.suffix == ".step" else read_mesh(file).bounds_mm[0]
    assert low.tolist() == pytest.approx([90.0, -58.0, 5.0], abs=0.03)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "--at, --face: must be given one at a time"),
        (["--face", ">>>"], "selects no face; use a selector of CadQuery"),
        (["--face", "%Cone"], "is conical; only planes and cylinders"),
        (["--at", "100,-50,30"], "mm from the part"),
        (["--at", "110,-50,9"], "equally near to two faces"),
        (["--face", ">Z", "--scale", "2"], "must be 1 for a STEP file"),
        (["--face", ">Z", "--out", "plate.obj"], "must end in .stl, .3mf, .step"),
    ],
)
def test_bad_input_for_a_step_file_ends_in_one_line(
    step_file: Path, words: list[str], message: str, capsys: Capture
) -> None:
    assert main(["texture-part", str(step_file), "--texture", "2", *words]) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and error.count("\n") == 1
    assert message in error


@pytest.mark.parametrize(
    ("content", "suffix"),
    [
        (b"a shopping list\n", ".stl"),
        (b"PK\x03\x04" + b"\0" * 90, ".3mf"),
        (b"ISO-10303-21;\nEND-ISO-10303-21;\n", ".step"),
    ],
)
def test_a_file_that_cannot_be_read_ends_with_2_as_in_other_commands(
    content: bytes, suffix: str, tmp_path: Path, capsys: Capture
) -> None:
    pytest.importorskip({".stl": "numpy", ".3mf": "lib3mf", ".step": "OCP"}[suffix])
    path = tmp_path / f"part{suffix}"
    path.write_bytes(content)
    words = ["--at", "0,0,1", "--texture", "2", "--out", str(tmp_path / "out.stl")]
    assert main(["texture-part", str(path), *words]) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and str(path) in error and error.count("\n") == 1
    assert not (tmp_path / "out.stl").exists()
