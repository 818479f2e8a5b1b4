"""gmsh and FreeCAD: STEP files of one texture file, made in five ways, agree with a formula in mm of the test."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from helpers.cases import mostly_long
from helpers.millimetres import KNOWN, PLATE_MM, REGION_MM, off_mm
from helpers.outsiders import PATIENCE_S

pytest.importorskip("gmsh", reason="gmsh is not installed: pip install gmsh")
cq = pytest.importorskip("cadquery", reason="solids need the extra cad")
bd = pytest.importorskip("build123d", reason="solids need the extra cad")

from tacbench_cad import Block, export, textured
from tacbench_cad.bd import textured as bd_textured
from tacbench_cad.cli import main
from tacbench_cad.cq import textured as cq_textured
from tacbench_cad.util.types import Floats

pytestmark = pytest.mark.real

#: A program for a separate process, because gmsh contains its own Open CASCADE. The nodes of its mesh of the faces lie
#: on the faces.
SCRIPT = """
import json, sys
import gmsh
gmsh.initialize(interruptible=False)
gmsh.option.setNumber("General.Terminal", 0)
gmsh.option.setNumber("Mesh.MeshSizeMax", 0.4)
gmsh.model.occ.importShapes(sys.argv[1])
gmsh.model.occ.synchronize()
gmsh.model.mesh.generate(2)
print(json.dumps(gmsh.model.mesh.getNodes()[1].tolist()))
"""


def nodes(path: Path) -> Floats:
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(path)], capture_output=True, text=True, timeout=PATIENCE_S, check=True
    )
    return np.array(json.loads(done.stdout.splitlines()[-1])).reshape(-1, 3)


def commanded(file: Path, out: Path) -> None:
    plain = out.with_name("plain.step")
    cq.exporters.export(cq.Workplane().box(*PLATE_MM, centered=False), str(plain))
    assert main(["texture-part", str(plain), "--face", ">Z", "--texture", str(file), "--out", str(out)]) == 0


def with_cq(file: Path, out: Path) -> None:
    cq.exporters.export(cq_textured(cq.Workplane().box(*PLATE_MM, centered=False), ">Z", str(file)), str(out))


def with_bd(file: Path, out: Path) -> None:
    box = bd.Box(*PLATE_MM, align=(bd.Align.MIN,) * 3)
    bd.export_step(bd_textured(box, box.faces().sort_by(bd.Axis.Z)[-1], file), str(out))


def as_part(file: Path, out: Path) -> None:
    box = cq.Workplane().box(*PLATE_MM, centered=False)
    export(textured(box, box.faces(">Z"), file, name="part"), out)


@pytest.mark.parametrize(
    ("way", "name"),
    mostly_long(
        product([commanded, with_cq, with_bd, as_part], ["wavelength_mm", "height map", "table"]),
        *[(commanded, "table"), (with_cq, "wavelength_mm"), (with_bd, "height map"), (as_part, "table")],
    ),
)
def test_gmsh_measures_the_millimetres_of_the_file_on_a_part(
    way: Callable[[Path, Path], None], name: str, tmp_path: Path
) -> None:
    known = KNOWN[name]
    way(known.write(tmp_path), tmp_path / "part.step")
    corner = np.array([1.0, 1.0, PLATE_MM[2] + 0.1])
    assert off_mm(nodes(tmp_path / "part.step"), known.pattern, REGION_MM, corner) < 0.0015 + known.error_mm


@pytest.mark.parametrize("name", mostly_long(KNOWN, "table"))
def test_gmsh_measures_the_millimetres_of_the_file_on_a_block(name: str, tmp_path: Path) -> None:
    known, block = KNOWN[name], Block.of(KNOWN[name].write(tmp_path))
    export(block, tmp_path / "block.step")
    points = nodes(tmp_path / "block.step")
    corner = np.array([0.0, 0.0, block.base_mm - 0.1])
    assert off_mm(points, known.pattern, block.size_mm, corner) < 0.0015 + known.error_mm
