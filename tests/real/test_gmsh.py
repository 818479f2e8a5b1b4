"""gmsh: each STEP file is one closed volume of the correct size, and texture 4 is meshed within a minute and 2 GB."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from helpers.cases import mostly_long
from helpers.outsiders import PATIENCE_S, Written, part_named

pytestmark = pytest.mark.real

#: The parts whose STEP files are opened.
STEPS = [
    *(f"paper-{number}" for number in range(1, 7)),
    *("released-2", "released-5", "keyed-4", "holder", "disc-2", "hexagon-2", "ring-2"),
]

#: A program for a separate process, because gmsh contains its own Open CASCADE and because its memory is measured.
SCRIPT = """
import json, pathlib, resource, sys, time
import gmsh
path, size = sys.argv[1], float(sys.argv[2])
gmsh.initialize(interruptible=False)
gmsh.option.setNumber("General.Terminal", 0)
shapes = gmsh.model.occ.importShapes(path)
gmsh.model.occ.synchronize()
report = {"shapes": shapes, "mass": [gmsh.model.occ.getMass(*shape) for shape in shapes if shape[0] == 3]}
volumes = gmsh.model.getEntities(3)
walls = gmsh.model.getBoundary(volumes, combined=True, oriented=False)
edges = gmsh.model.getBoundary(walls, combined=True, oriented=False)
report.update(volumes=len(volumes), faces=len(walls), open_edges=len(edges))
if size:
    gmsh.option.setNumber("Mesh.MeshSizeMax", size)
    start = time.process_time()
    gmsh.model.mesh.generate(2)
    report["seconds"] = time.process_time() - start
    places = gmsh.model.mesh.getNodes()[1].reshape(-1, 3)
    triangles = gmsh.model.mesh.getElementsByType(2)[1].reshape(-1, 3)
    ids = {int(tag): i for i, tag in enumerate(gmsh.model.mesh.getNodes()[0])}
    corners = places[[[ids[int(tag)] for tag in row] for row in triangles]]
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    report["nodes"] = len(places)
    report["area"] = float(((((b - a)[:, [1, 2, 0]] * (c - a)[:, [2, 0, 1]]
                              - (b - a)[:, [2, 0, 1]] * (c - a)[:, [1, 2, 0]]) ** 2).sum(1) ** 0.5).sum() / 2)
# On Linux, getrusage of a child starts with the parent's peak memory. The child's own counter starts at zero.
status = pathlib.Path("/proc/self/status")
lines = status.read_text().splitlines() if status.exists() else []
own = [line.split()[1] for line in lines if line.startswith("VmHWM")]
report["gigabytes"] = (int(own[0]) if own else resource.getrusage(resource.RUSAGE_SELF).ru_maxrss) / 1e6
print(json.dumps(report))
"""


def examine(path: Path, mesh_size_mm: float = 0.0) -> dict[str, Any]:
    """Return gmsh's report on a STEP file; with a size, gmsh also meshes the faces."""
    pytest.importorskip("gmsh", reason="gmsh is not installed: pip install gmsh")
    process = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(path), str(mesh_size_mm)],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert process.returncode == 0, process.stderr[-2000:]
    report: dict[str, Any] = json.loads(process.stdout.splitlines()[-1])
    return report


@pytest.mark.parametrize("name", mostly_long(STEPS, "paper-4", "keyed-4", "holder", "ring-2"))
def test_step_is_one_closed_volume(written: Written, name: str) -> None:
    report = examine(written(name, "step"))
    assert [shape[0] for shape in report["shapes"]] == [3]
    assert (report["volumes"], report["open_edges"]) == (1, 0)
    _, body = part_named(name).solid
    assert report["mass"] == [pytest.approx(body.volume_mm3, rel=1e-4)]


@pytest.mark.parametrize("size_mm", [1.5, pytest.param(0.3, marks=pytest.mark.long)])
def test_texture_4_is_meshed(written: Written, size_mm: float) -> None:
    report = examine(written("paper-4", "step"), size_mm)
    assert report["nodes"] > 3000
    assert report["gigabytes"] < 2.0
    # the finest waves are 0.3 mm long; triangles of these sizes flatten them, which reduces the area by this fraction
    assert report["area"] == pytest.approx(2921.2, rel=0.2 if size_mm > 1.0 else 0.12)
