"""The process that makes shapes for FreeCAD, and what FreeCAD's addon manager reads; FreeCAD itself is not needed."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import pytest

from tacbench_cad import Texture, __version__
from tacbench_cad.spec.block import Block

ROOT = Path(__file__).parents[2]
ADDON = ROOT / "freecad" / "tacbench"

BLOCK = {
    "texture": "texture-2",
    "file": None,
    "preset": "paper",
    "scale": 1.0,
    "outline": None,
    "size_mm": [None, None],
    "height_mm": None,
    "key_mm": None,
    "label": False,
    "copy": None,
    "step_tolerance_mm": 0.001,
}


def answers(*requests: dict[str, Any]) -> list[dict[str, Any]]:
    """What the worker answers to the requests, and that it ends when its input ends."""
    done = subprocess.run(
        [sys.executable, "-P", str(ADDON / "worker.py")],
        input="".join(json.dumps(request) + "\n" for request in requests),
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])},
        capture_output=True,
        text=True,
        timeout=100,
        check=True,
    )
    return [json.loads(line) for line in done.stdout.splitlines()]


def test_each_request_gets_an_answer(tmp_path: Path) -> None:
    """A shape, one of a file with one side given, a refusal, a fault of the request, and the choices."""
    pytest.importorskip("OCP")
    own = tmp_path / "own.toml"
    own.write_text(
        '[texture]\nname = "own"\nfamily = "plane-waves"\n[[wave]]\namplitude = 1.0\nf = 1.0\ng = 0.5\n'
        "[block]\nsize_mm = [20.0, 24.0]\n",
        encoding="utf-8",
    )
    first, second, refused, fault, choices = answers(
        {"action": "shape", "block": BLOCK, "brep": str(tmp_path / "a.brep")},
        {
            "action": "shape",
            "block": BLOCK | {"file": str(own), "size_mm": [None, 26.0]},
            "brep": str(tmp_path / "b.brep"),
        },
        {"action": "shape", "block": BLOCK | {"scale": 500.0}, "brep": str(tmp_path / "c.brep")},
        {"action": "shape"},
        {"action": "catalogue"},
    )
    block = Block.of(2)
    assert first["volume_mm3"] == block.volume_mm3(block.solid_datum_mm)
    assert first["error_mm"] <= 0.001
    # Version 1 of the format is what the oldest kernels read, too.
    assert (tmp_path / "a.brep").read_text(encoding="utf-8").split("\n")[2].startswith("CASCADE Topology V1")
    assert second["name"].startswith("own_paper_x1_20x26x")
    assert refused == {"error": "scale = 500.0: must be from 0.01 to 100"}
    assert fault == {"error": "KeyError: 'block'"}
    assert choices["textures"][:6] == [texture.name for texture in Texture.catalogue()]
    assert "dunes" in choices["textures"]


def test_the_addon_states_this_version() -> None:
    space = {"": "https://wiki.freecad.org/Package_Metadata"}
    root = ElementTree.parse(ROOT / "package.xml").getroot()
    assert root.findtext("version", namespaces=space) == __version__
    icons = [icon.text for icon in root.iterfind(".//icon", space)]
    assert len(icons) == 2
    assert all((ROOT / str(icon)).is_file() for icon in icons)
