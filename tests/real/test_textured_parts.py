"""Textured parts of a user in other programs: gmsh meshes the STEP file, FreeCAD measures it, PrusaSlicer slices."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("cadquery")
pytest.importorskip("build123d")

import build123d as bd
import cadquery as cq
from helpers.outsiders import PATIENCE_S

from tacbench_cad import PrintPart, export, textured

pytestmark = pytest.mark.real

GMSH = """
import json, sys
import gmsh
gmsh.initialize(interruptible=False)
gmsh.option.setNumber("General.Terminal", 0)
shapes = gmsh.model.occ.importShapes(sys.argv[1])
gmsh.model.occ.synchronize()
gmsh.option.setNumber("Mesh.MeshSizeMax", 1.5)
gmsh.model.mesh.generate(2)
print(json.dumps([[gmsh.model.occ.getMass(*s) for s in shapes if s[0] == 3], len(gmsh.model.mesh.getNodes()[0])]))
"""
FREECAD = """
import os, Part
shape = Part.Shape()
shape.read(os.environ["STEP_FILE"])
half = shape.cut(Part.makeBox(200, 200, 200))
print("FOUND", len(shape.Solids), shape.isValid(), shape.Volume, half.Volume)
"""


def pillow_block() -> PrintPart:
    """The bearing pillow block of CadQuery's documentation, with a texture on its upper face."""
    block = cq.Workplane("XY").box(60.0, 80.0, 10.0).faces(">Z").workplane().hole(22.0)
    block = block.faces(">Z").workplane().rect(48.0, 68.0, forConstruction=True).vertices().cboreHole(2.4, 4.4, 2.1)
    return textured(block, block.faces(">Z"), 2, name="pillow-block").part()


def bushing() -> PrintPart:
    """A cylinder on a plate with a hole, as in build123d's introduction, with a texture around the cylinder."""
    part = bd.Box(40, 40, 4) + bd.Pos(0, 0, 12) * bd.Cylinder(12, 20) - bd.Cylinder(5, 60)
    side = max(part.faces().filter_by(bd.GeomType.CYLINDER), key=lambda face: face.area)
    return textured(part, side, 2, name="bushing", fade_mm=2.0).part()


def bracket() -> PrintPart:
    """A bracket of build123d's builder mode with fillets and a counterbored hole, with a texture on its floor."""
    with bd.BuildPart() as builder:
        bd.Box(60, 40, 6)
        with bd.Locations((-27, 0, 13)):
            bd.Box(6, 40, 20)
        with bd.Locations((12, 0, 3)):
            bd.CounterBoreHole(3, 6, 3)
        bd.fillet(builder.edges().filter_by(bd.Axis.Z), 2)
    level = builder.faces().filter_by(bd.Plane.XY).group_by(bd.Axis.Z)[-2]
    floor = max(level, key=lambda face: face.area)
    return textured(builder.part.solid(), floor, 2, name="bracket", depth_mm=0.8, margin_mm=2.0).part()


PARTS = {"pillow block": pillow_block, "bushing": bushing, "bracket": bracket}


@pytest.mark.parametrize("name", PARTS)
def test_other_programs_accept_the_files(name: str, tmp_path: Path) -> None:
    part = PARTS[name]()
    step, stl = tmp_path / "part.step", tmp_path / "part.stl"
    assert export(part, step).ok and export(part, stl).ok
    volume = part.solid[1].volume_mm3
    if shutil.which("prusa-slicer"):
        info = subprocess.run(["prusa-slicer", "--info", stl], capture_output=True, text=True, timeout=PATIENCE_S)
        assert "manifold = yes" in info.stdout
        order = ["prusa-slicer", "--export-gcode", "--output", tmp_path / "part.gcode", stl]
        subprocess.run(order, check=True, capture_output=True, timeout=PATIENCE_S)
        assert (tmp_path / "part.gcode").stat().st_size > 10_000
    if shutil.which("freecadcmd"):
        script = tmp_path / "measure.py"
        script.write_text(FREECAD)
        command, settings = ["freecadcmd", script], {"STEP_FILE": str(step), "HOME": str(tmp_path), "PATH": "/usr/bin"}
        output = subprocess.run(command, env=settings, capture_output=True, text=True, timeout=PATIENCE_S).stdout
        _, solids, valid, found, half = next(row for row in output.splitlines() if row.startswith("FOUND")).split()
        assert (solids, valid) == ("1", "True")
        assert float(found) == pytest.approx(volume, rel=1e-4)
        assert 0.0 <= float(half) < volume


@pytest.mark.parametrize("name", PARTS)
def test_gmsh_meshes_the_step_file(name: str, tmp_path: Path) -> None:
    pytest.importorskip("gmsh")
    part = PARTS[name]()
    step = tmp_path / "part.step"
    assert export(part, step).ok
    command = [sys.executable, "-c", GMSH, str(step)]
    result = subprocess.run(command, check=True, capture_output=True, text=True, timeout=PATIENCE_S)
    masses, nodes = json.loads(result.stdout)
    assert masses == [pytest.approx(part.solid[1].volume_mm3, rel=1e-4)]
    assert nodes > 1000
