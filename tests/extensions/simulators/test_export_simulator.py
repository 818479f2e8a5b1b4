"""The command ``tacbench export-simulator``: folders for simulators. Bad input gives exit code 2 and writes no file."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tacbench_cad.cli import main

Capture = pytest.CaptureFixture[str]


def test_a_table_names_the_folders(tmp_path: Path, capsys: Capture) -> None:
    assert main(["export-simulator", "--to", "obj,npy", "--texture", "1,5", "--out", str(tmp_path / "sim")]) == 0
    out, _ = capsys.readouterr()
    assert "texture-1" in out and "texture-5" in out
    names = sorted(path.name for path in (tmp_path / "sim" / "texture-5").iterdir())
    assert names == ["README.md", "texture-5.npy", "texture-5.obj", "texture.json"]


def test_json_and_a_texture_file_at_a_scale(tmp_path: Path, capsys: Capture) -> None:
    file = tmp_path / "wavy.toml"
    file.write_text('[texture]\nname = "wavy"\nfamily = "series"\nlaw = "square"\nN = 5\naxes = "x"\n')
    argv = ["export-simulator", "--to", "npy", "--texture", str(file), "--scale", "2", "--out", str(tmp_path), "--json"]
    assert main(argv) == 0
    (row,) = json.loads(capsys.readouterr().out)["folders"]
    assert row["texture"] == "wavy" and list(row["files"]) == ["wavy.npy"]
    record = json.loads((tmp_path / "wavy" / "texture.json").read_text(encoding="utf-8"))
    assert record["block"]["scale"] == 2.0


@pytest.mark.parametrize(
    ("options", "needles"),
    [
        (["--to", "gazebo"], ["to", "gazebo", "allowed: mjcf, urdf"]),
        (["--to", "usda"], ["to", "usda", 'did you mean "usd"?']),
        (["--to", "obj", "--texture", "7"], ["texture", "7"]),
        (["--to", "obj", "--scale", "big"], ["scale", "big", "number"]),
    ],
)
def test_bad_input(options: list[str], needles: list[str], tmp_path: Path, capsys: Capture) -> None:
    assert main(["export-simulator", *options, "--out", str(tmp_path / "out")]) == 2
    out, err = capsys.readouterr()
    assert out == "" and len(err.splitlines()) == 1 and err.startswith("error: ")
    assert all(needle in err for needle in needles), err
    assert not (tmp_path / "out").exists()
