"""The command ``tacbench check-gcode``: table, JSON, pictures and errors."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from helpers.gcode_writer import write_gcode
from helpers.printers import PRINTER, points, write_corrected

from tacbench_cad.cli import main
from tacbench_cad.spec.block import Block

Capture = pytest.CaptureFixture[str]
HALF = ("--texture", "2", "--scale", "0.5")


@pytest.fixture(scope="module")
def gcode(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_gcode(tmp_path_factory.mktemp("gcode") / "two.gcode", Block.of(2, scale=0.5), dialect="cura")


def test_numbers_and_a_picture(gcode: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    image = pytest.importorskip("PIL.Image")
    pytest.importorskip("matplotlib")
    monkeypatch.chdir(tmp_path)
    assert main(["check-gcode", str(gcode), *HALF]) == 0
    out, err = capsys.readouterr()
    for word in ("Cura", "17 of 0.2 mm", "height error, rms", "ideal staircase", "misplaced by 0.1 mm", "of 9"):
        assert word in out
    for word in ("3.5 mm is not a whole number of layers", "with 1.75 mm the beads", "wrote two_as-sliced.png"):
        assert word in err
    assert [path.name for path in tmp_path.iterdir()] == ["two_as-sliced.png"]
    with image.open(tmp_path / "two_as-sliced.png") as picture:
        assert picture.format == "PNG" and min(picture.size) > 1000
        assert len(picture.convert("RGB").getcolors(1 << 24)) > 200


def test_json(gcode: Path, capsys: Capture) -> None:
    assert main(["check-gcode", str(gcode), *HALF, "--json", "--no-picture", "--frame", "90,80"]) == 0
    comparison = json.loads(capsys.readouterr().out)["files"][0]
    assert comparison["frame"]["source"] == "given" and comparison["frame"]["outline_mm"] is None
    assert 0.03 < comparison["height"]["rms_mm"] < 0.1 and comparison["filament_assumed"]
    assert comparison["left_out"] == {"CUSTOM": 1, "SKIRT": 3, "SUPPORT": 17}


def test_the_numbers_are_printed_without_matplotlib(
    gcode: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert main(["check-gcode", str(gcode), *HALF]) == 0
    assert "no picture: pictures need matplotlib" in capsys.readouterr().err
    assert main(["check-gcode", str(gcode), *HALF, "-o", "chosen.png"]) == 2
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("options", "needle"),
    [
        (["--texture", "2"], "is for another part: its outer walls measure"),
        (["--texture", "4", "--scale", "0.5"], "mm from texture-2"),
        ([*HALF, "--frame", "90"], "X,Y,DEGREES"),
        ([*HALF, "--frame", "a,b"], "X,Y,DEGREES"),
        ([*HALF, "--frame", "90,80,45"], "0, 90, 180 or 270"),
        ([*HALF, "--frame", "nan,80"], "finite"),
        ([*HALF, "--frame", "-300,80"], "prints nothing there; slice the plate without moving its blocks"),
        ([*HALF, "--frame", "93,80"], "(PrusaSlicer: --dont-arrange), or name the place"),
        ([*HALF, "--filament", "17.5"], "from 0.5 to 5 mm"),
        ([*HALF, "-o", "picture.gif"], "must end in .png"),
        ([*HALF, "-o", "picture.png", "--no-picture"], "--no-picture"),
        ([], "--texture"),
    ],
)
def test_wrong_input_is_one_line(
    gcode: Path,
    options: list[str],
    needle: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: Capture,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["check-gcode", str(gcode), *options]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.startswith("error: ") and err.count("\n") == 1
    assert needle in err
    assert list(tmp_path.iterdir()) == []


def test_the_g_code_of_a_corrected_file_is_compared_with_the_corrected_formula(tmp_path: Path, capsys: Capture) -> None:
    high = replace(PRINTER, transfer_x=points((1.0, 0.8)), transfer_y=points((1.0, 0.8)))
    path = write_gcode(tmp_path / "two.gcode", write_corrected(tmp_path, Block.of(2, scale=0.5), high).file)

    def rms(texture: str) -> float:
        options = ("--texture", texture, "--scale", "0.5")
        assert main(["check-gcode", str(path), "--json", "--no-picture", "--frame", "90,80", *options]) == 0
        return float(json.loads(capsys.readouterr().out)["files"][0]["height"]["rms_mm"])

    assert 1.3 * rms(str(tmp_path / "texture-2.toml")) < rms("2")
