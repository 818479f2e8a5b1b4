"""The command ``tacbench textures``: the numbers of the catalogue."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from tacbench_cad.cli import main

Capture = pytest.CaptureFixture[str]


def catalogue(capsys: Capture, *options: str) -> list[dict[str, object]]:
    assert main(["textures", "--json", *options]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    rows = json.loads(out)["textures"]
    assert isinstance(rows, list)
    return rows


def test_a_turned_wave_is_reported(capsys: Capture) -> None:
    assert main(["textures", "--texture", "hexagons"]) == 0
    lines = " ".join(capsys.readouterr().out.split())
    assert "a wave at 60 degrees in the formula lies at 54 degrees on the block" in lines
    assert main(["textures", "--texture", "hexagons", "--preset", "released"]) == 0
    assert "degrees on the block" not in capsys.readouterr().out


def test_a_single_texture_shows_its_spectrum(capsys: Capture) -> None:
    (row,) = catalogue(capsys, "--texture", "diamond")
    assert row["waves"] is None
    assert row["printable_fraction"] == pytest.approx(0.98, abs=0.02)
    bands = row["spectrum"]
    assert isinstance(bands, list)
    assert sum(band["fraction"] for band in bands) == pytest.approx(1.0, abs=0.01)
    assert main(["textures", "--texture", "1"]) == 0
    assert "spectrum" in capsys.readouterr().out


def test_the_relief_of_the_released_files(capsys: Capture) -> None:
    rows = catalogue(capsys, "--preset", "released")
    # The relief of the published files, valley to peak. With N = 101, the formula's overshoot lies between samples.
    published = [2.000, 4.000, 3.937, None, 1.969, None]
    for row, relief in zip(rows, published, strict=True):
        if relief is not None:
            assert row["relief_mm"] == pytest.approx(relief, abs=1e-3)
        assert row["relief_mm"] + row["base_mm"] == pytest.approx(7.0)  # type: ignore[operator]


def test_a_texture_file_is_described(capsys: Capture, tmp_path: Path) -> None:
    file = tmp_path / "hex.toml"
    file.write_text(
        '[texture]\nname = "hex"\nfamily = "plane-waves"\n[[wave]]\namplitude = 0.5\nf = 3.0\ng = 4.0\n'
        "[block]\nsize_mm = [20.0, 20.0]\nmm_per_unit = [1.0, 1.0, 1.0]\n"
    )
    (row,) = catalogue(capsys, "--texture", str(file))
    assert row["texture"] == "hex"
    assert row["finest_ridge_mm"] == pytest.approx(math.pi / 5)
    assert row["relief_mm"] == pytest.approx(1.0)


def test_the_table_has_one_line_for_each_texture(capsys: Capture) -> None:
    assert main(["textures"]) == 0
    out = capsys.readouterr().out
    for number in range(1, 7):
        assert f"texture-{number}" in out
    assert "sin u + sin(v + pi/2)" in out
    assert out.splitlines()[-2].endswith('"tacbench check-gcode" judges the sliced file')
