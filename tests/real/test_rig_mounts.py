"""The printable mounts of the first rig: the script's own checks, ADMesh and PrusaSlicer accept every file."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.checkout import ROOT
from helpers.outsiders import Run

pytest.importorskip("build123d")
pytestmark = pytest.mark.real

MOUNTS = {
    "bracket-tactip",
    "bracket-pad",
    "spigot-tactip",
    "spigot-pad",
    "camera-ring",
    "cell-base",
    "cell-table",
}


@pytest.fixture(scope="module")
def mounts(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder in which the script wrote all mounts."""
    folder = tmp_path_factory.mktemp("mounts")
    command = [sys.executable, str(ROOT / "examples" / "rigs" / "mounts.py"), str(folder)]
    process = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert process.returncode == 0, process.stderr
    reports = re.findall(r"^(\S+): (passed|failed)", process.stdout, re.MULTILINE)
    assert {(Path(name).name, word) for name, word in reports} == {
        (f"{name}.{ending}", "passed") for name in MOUNTS for ending in ("step", "stl")
    }
    # The ring has no volume in closed form, because its set screws cross a round wall.
    assert process.stdout.count("from the closed form") == 2 * len(MOUNTS)
    return folder


def test_each_mount_has_a_drawing(mounts: Path) -> None:
    drawings = {path.stem: path.read_bytes()[:5] for path in mounts.glob("*.pdf")}
    assert drawings == dict.fromkeys(MOUNTS, b"%PDF-")


@pytest.mark.parametrize("name", sorted(MOUNTS))
def test_admesh_finds_nothing_to_fix(admesh: Run, mounts: Path, name: str) -> None:
    output = admesh([mounts / f"{name}.stl"])
    counts = dict(re.findall(r"(Total disconnected facets|Number of parts|Degenerate facets) +: +(\d+)", output))
    assert counts == {"Total disconnected facets": "0", "Number of parts": "1", "Degenerate facets": "0"}


def test_the_table_carries_the_holder() -> None:
    """The table is printed upside down: its holes for the holder are those of the holder, mirrored."""
    import runpy

    import numpy as np

    from housing import Holder

    names = runpy.run_path(str(ROOT / "examples" / "rigs" / "mounts.py"))
    table = next(part for part, _ in names["parts"] if part.name == "cell-table")
    mesh, _ = table.mesh
    holder = Holder(block=names["BLOCK"])
    x, y, _ = table.size_mm
    holder_x, holder_y, _ = holder.size_mm
    for bore in holder.screws:
        at = np.array([(x - holder_x) / 2.0 + bore.at_mm[0], y - (y - holder_y) / 2.0 - bore.at_mm[1]])
        distance = np.linalg.norm(mesh.vertices[:, :2] - at, axis=1)
        edge = distance[distance < bore.diameter_mm]
        assert len(edge) >= 16
        assert edge == pytest.approx(bore.diameter_mm / 2.0, abs=1e-4)
