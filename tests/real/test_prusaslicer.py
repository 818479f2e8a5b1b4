"""PrusaSlicer reads every file correctly, repairs nothing, and slices it.

It calls an empty file manifold and slices almost any file. The tests therefore check the numbers: triangles, box,
volume, and the volume of plastic for a solid print.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from helpers.cases import mostly_long
from helpers.outsiders import Run, Written, each_part, part_named

pytestmark = pytest.mark.real


def _info(output: str) -> dict[str, str]:
    return dict(line.split(" = ", 1) for line in output.splitlines() if " = " in line)


@pytest.mark.parametrize("form", mostly_long(["stl", "3mf"], "stl"))
@each_part
def test_reads_it_as_manifold(prusa_slicer: Run, written: Written, name: str, form: str) -> None:
    part = part_named(name)
    mesh, body = part.mesh
    output = prusa_slicer(["--info", written(name, form)])
    info = _info(output)
    assert info["manifold"].strip() == "yes"
    assert int(info["number_of_facets"]) == len(mesh.faces) > 0
    assert int(info["number_of_parts"]) == 1
    for axis, side in zip("xyz", part.size_mm, strict=True):
        assert float(info[f"size_{axis}"]) == pytest.approx(side, abs=2e-5)
        if form == "stl":  # a 3MF is placed on the bed
            assert float(info[f"min_{axis}"]) == pytest.approx(0.0, abs=1e-6)
    # PrusaSlicer computes the sum in single precision, so the relative error is up to 1e-5.
    slack = body.volume_slack_mm3 + 2e-5 * body.volume_mm3
    assert float(info["volume"]) == pytest.approx(body.volume_mm3, abs=slack)
    for word in ("open_edges", "facets_reversed", "backwards_edges", "repaired", "degenerate"):
        assert word not in info, f"{word} = {info[word]}"
    assert "error" not in output.lower()


def _slice(prusa_slicer: Run, model: Path, target: Path) -> dict[str, str]:
    """Slice a solid print with layers of 0.2 mm and a 0.4 mm nozzle; return the summary in the G-code."""
    output = prusa_slicer(
        [
            *("--export-gcode", "--layer-height", "0.2", "--first-layer-height", "0.2", "--nozzle-diameter", "0.4"),
            *("--fill-density", "100%", "--fill-pattern", "rectilinear", "--skirts", "0", "--brim-width", "0"),
            *("--filament-diameter", "1.75", "--support-material=0", "--gcode-comments=0", "--output", target, model),
        ]
    )
    for word in ("error", "manifold", "repair", "empty", "could not", "unsupported"):
        assert word not in output.lower(), output
    text = target.read_text()
    summary = dict(re.findall(r"^; ([a-z][a-z0-9 \[\]_]*) = (.*)$", text, flags=re.MULTILINE))
    summary["heights"] = " ".join(re.findall(r"^;Z:([\d.]+)$", text, flags=re.MULTILINE))
    return summary


@each_part
def test_the_part_is_sliced_completely(prusa_slicer: Run, written: Written, name: str, tmp_path: Path) -> None:
    """The G-code has all layers up to the height of the part, and needs its volume of plastic for a solid print."""
    part = part_named(name)
    _, body = part.mesh
    summary = _slice(prusa_slicer, written(name, "stl"), tmp_path / "part.gcode")
    heights = [float(text) for text in summary["heights"].split()]
    assert heights[0] == pytest.approx(0.2)
    # Details thinner than the nozzle are left out: up to two layers at the crests of the ripples of textures 4 and 6.
    min_height = part.size_mm[2] - (0.401 if name.endswith(("-4", "-6")) else 0.201)
    assert min_height <= max(heights) <= part.size_mm[2] + 0.001
    assert len(set(heights)) == round(max(heights) / 0.2), "a layer is missing"
    plastic = 1000.0 * float(summary["filament used [cm3]"])
    assert plastic == pytest.approx(body.volume_mm3, rel=0.03)
