"""``tacbench correct``: what it makes and says about a correction, and blocks with outlines."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import manifold3d
import numpy as np
import pytest
from helpers.cases import mostly_long
from helpers.fixture_measure import manifold
from helpers.printers import PRINTER, write_corrected

from tacbench_cad.cli import main
from tacbench_cad.extensions.printer_models.model import write_printer_model
from tacbench_cad.formats.stl import read_stl
from tacbench_cad.spec.block import Block


@pytest.mark.parametrize(
    ("word", "genus"),
    mostly_long(
        [("disc:18", 0), ("ring:18,7", 1), ("hexagon:20", 0), ("polygon:0,0,20,8,0,16,5,8", 0)], ("ring:18,7", 1)
    ),
)
def test_a_block_with_an_outline_is_made_and_checked(
    word: str, genus: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_printer_model(PRINTER, tmp_path / "a.toml")
    made = ["correct", str(tmp_path / "a.toml"), "--texture", "3", "--outline", word, "--formats", "stl"]
    assert main([*made, "--parts", "blocks", "--out", str(tmp_path)]) == 0
    assert "print of this file" in capsys.readouterr().out
    row = json.loads((tmp_path / "manifest.json").read_text())["files"][0]
    assert row["certificate"]["evidence"] == "proved" and row["certificate"]["distance_mm"] <= 0.01
    assert row["spec"]["corrected_for"] == PRINTER.fingerprint
    assert row["spec"]["outline"] != row["spec"]["print"]["outline"]
    mesh = read_stl(tmp_path / row["file"])
    solid = manifold(mesh)
    assert (solid.status(), solid.genus()) == (manifold3d.Error.NoError, genus)
    sides = np.ptp(mesh.vertices, axis=0)[:2] * (0.996, 0.995) + 0.1
    if not word.startswith("polygon"):  # the offset moves the tip of a pointed corner further
        assert sides == pytest.approx(row["spec"]["print"]["size_mm"], abs=0.02)
    assert main(["check-part", str(tmp_path / row["file"]), "--texture", str(tmp_path / "texture-3.toml")]) == 0


def test_blocks_holder_and_jig_are_made_with_the_texture_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("OCP")
    write_printer_model(PRINTER, tmp_path / "a.toml")
    words = ["correct", str(tmp_path / "a.toml"), "--texture", "3", "--key", "--formats", "stl", "--copies", "2"]
    assert main([*words, "--out", str(tmp_path / "made"), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    kinds = [row["kind"] for row in document["files"]]
    assert sorted(kinds) == ["block", "block", "holder", "jig"] and document["texture_files"] == ["texture-3.toml"]
    assert document["expected_prints"][0]["corrected"]["rms_mm"] < document["expected_prints"][0]["plain"]["rms_mm"]
    block = next(row for row in document["files"] if row["kind"] == "block")
    path = str(tmp_path / "made" / block["file"])
    texture = tmp_path / "made" / "texture-3.toml"
    assert main(["check-part", path]) == 0  # by the manifest beside it
    assert "t3-corr, preset paper" in capsys.readouterr().out
    assert main(["check-part", path, "--texture", str(texture)]) == 0
    assert "t3-corr, preset paper" in capsys.readouterr().out
    write_corrected(tmp_path / "other", Block.of(3, key_mm=3.0), replace(PRINTER, transfer_x=()))
    assert main(["check-part", path, "--texture", str(tmp_path / "other" / "texture-3.toml")]) == 1
    assert main(["check-part", path, "--texture", "3"]) == 1
