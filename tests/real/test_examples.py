"""Each example runs in its own process and makes one valid solid with the volume that follows from the formula."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from math import sin
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("OCP")

from tacbench_cad.checks.meshcheck import read_mesh
from tacbench_cad.spec.block import Block

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))

#: The examples whose result is a mesh.
MESHES = ("drum", "strip")
#: Expressions in the names of each example: the closed form of the volume, and conditions that must be true. The
#: example for CQGI hosts has its own test.
EXPECTED: dict[str, dict[str, str]] = {
    "custom_texture": {
        "volume": "block.volume_mm3(block.solid_datum_mm)",
        "is the product": f"abs(waffle.surface(0.7, 1.9) - {sin(0.7) * sin(1.9) + 0.2 * sin(2.8)!r}) < 1e-12",
        "files are written": "all(report.ok and report.path.is_file() for report in reports) and len(reports) == 2",
    },
    "hexagonal": {
        "volume": "block.volume_mm3(block.solid_datum_mm)",
        "bumps repeat along the hexagons": "abs(bumps.surface(0.4, 0.9) - bumps.surface(0.4, 0.9 + 4 * pi / 3**0.5)) "
        "< 1e-9",
    },
    "own_housing": {
        # Above the block, the window only cuts the roof, because the space below the roof is already open.
        "volume": "(width * depth - sum(pi * bore.diameter_mm**2 / 4 for bore in holder.screws)) "
        "* (GUIDE_MM + holder.rim_height_mm) - pocket.area_mm2 * (holder.rim_height_mm + 0.3) "
        "- (x1 - x0 + PAD_MM[0] + room) * (y1 - y0 + PAD_MM[1] + room) * (GUIDE_MM - 0.3)",
        "clears the block": "not (guide & Pos(*place.origin_mm) * Box(*block.size_mm, block.height_mm, align=low))",
        "rests on the rim": "abs(guide.bounding_box().min.Z - rim) < 1e-6",
    },
    "staircase": {
        "volume": "result.solids().size() * (STRIP_MM[0] + 2 * GAP_MM) * (len(strips) * pitch + GAP_MM) * PLATE_MM "
        "+ sum(strip.volume_mm3(strip.solid_datum_mm) - strip.footprint_mm2 * PLATE_MM / 2 for strip in strips)",
        "ends at 0.7 mm": "abs(WAVELENGTHS_MM[-1] - 0.7071067811865476) < 1e-9",
        "shows whole waves": "all(strip.size_mm[0] / length >= 5 for strip, length in zip(strips, WAVELENGTHS_MM))",
    },
    "texture_on_part": {
        "volume": "wedge.volume - (x + 2 * FREE_MM) * (y + 2 * FREE_MM) * depth_mm "
        "+ block.volume_mm3(block.solid_datum_mm) - block.footprint_mm2 * (block.height_mm - depth_mm)",
        "crests are flush": "abs(max(v.Z for v in [on_face.to_local_coords(p) for p in result.vertices()])) < 1e-6",
    },
    "tray_of_scales": {
        "volume": "plate.volume + sum(b.volume_mm3(b.solid_datum_mm) - b.footprint_mm2 * PLATE_MM / 2 for b in blocks)",
        "nine": "[b.scale for b in blocks] == [0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.3, 1.4]",
    },
}


def run(path: Path, cwd: Path, expressions: dict[str, str], **host: dict[str, Any]) -> dict[str, Any]:
    """Run an example in a child process and return the values of the expressions in its names."""
    command = [
        sys.executable,
        str(ROOT / "tests" / "helpers" / "run_example.py"),
        str(path),
        json.dumps({"ask": expressions, **host}),
    ]
    process = subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=300)
    assert process.returncode == 0, process.stderr
    answer: dict[str, Any] = json.loads(process.stdout.splitlines()[-1])
    return answer


@pytest.mark.parametrize("path", [path for path in EXAMPLES if path.stem in EXPECTED], ids=lambda path: path.stem)
def test_an_example_makes_one_valid_solid(path: Path, tmp_path: Path) -> None:
    answer = run(path, tmp_path, EXPECTED[path.stem])
    assert answer["faults"] == []
    values = answer["values"]
    assert answer["volume"] == pytest.approx(values.pop("volume"), rel=2e-6)
    assert values == dict.fromkeys(values, True)


def test_cqgi_parameters_change_the_block(tmp_path: Path) -> None:
    """Only the constants are parameters. The block gets the values of the host, and a bad value is named."""
    parameters = {"texture": 1.0, "scale": 1.5, "height_mm": 6.0, "key_mm": 0.0, "label": True}
    path = ROOT / "examples" / "cqgi_block.py"
    answer = run(path, tmp_path, {"name": "block.name"}, parameters=parameters, refused={"texture": 2.7})
    assert answer["refused"] == "InputError: texture = 2.7: must be a whole number from 1 to 6"
    assert answer["parameters"] == list(parameters)
    assert answer["faults"] == []
    block = Block.of(1, scale=1.5, height_mm=6.0, label=True)
    assert answer["values"]["name"] == block.name
    assert answer["shown"] == [block.name]
    assert answer["volume"] == pytest.approx(block.volume_mm3(block.solid_datum_mm), rel=2e-6)


@pytest.mark.parametrize("name", MESHES)
def test_an_example_writes_a_closed_mesh(name: str, tmp_path: Path) -> None:
    command = [sys.executable, str(ROOT / "examples" / f"{name}.py")]
    process = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert process.returncode == 0, process.stderr
    mesh = read_mesh(tmp_path / f"{name}.stl")
    body = mesh.as_manifold()
    assert (body.status().name, len(body.decompose()), body.genus()) == ("NoError", 1, 1 if name == "drum" else 2)
    low, high = mesh.bounds_mm
    # The textures are 0.2 mm above the side at their lowest, and their highest point is 0.8 mm higher.
    reach = {"drum": (42.0, 42.0, 24.0), "strip": (164.0, 20.0, 5.0)}[name]
    assert (high - low).tolist() == pytest.approx(reach, abs=0.6 if name == "drum" else 0.05)


def test_the_dome_in_mujoco_rests_at_the_height_of_the_formula(tmp_path: Path) -> None:
    pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install mujoco")
    command = [sys.executable, str(ROOT / "examples" / "mujoco_press.py")]
    process = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert process.returncode == 0, process.stderr
    (depth,) = re.findall(r"lies (\S+) mm below the highest point", process.stdout)
    block = Block.of(2)
    x, y = (side / 2 + np.linspace(-8.0, 8.0, 1601) for side in block.size_mm)
    over = 20.0**2 - (x[:, None] - block.size_mm[0] / 2) ** 2 - (y[None, :] - block.size_mm[1] / 2) ** 2
    centre_mm = float((block.datum_mm + block.surface.grid(x, y) + np.sqrt(over)).max())
    assert block.height_mm + 20.0 - centre_mm == pytest.approx(0.441, abs=5e-4), "the manual states this depth"
    assert float(depth) == pytest.approx(block.height_mm + 20.0 - centre_mm, abs=0.01)
