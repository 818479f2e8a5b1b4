"""The same texture file means the same millimetres in every command, in Python, CadQuery, build123d and FreeCAD.

Each way makes a textured plate or a block. Points on its surface are compared with a formula in mm of this test.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.cases import mostly_long
from helpers.checkout import ROOT
from helpers.millimetres import KNOWN, PLATE_MM, REGION_MM, off_mm, stl_points

cq = pytest.importorskip("cadquery", reason="solids need the extra cad")
bd = pytest.importorskip("build123d", reason="solids need the extra cad")

from tacbench_cad import Block, InputError, Texture, export, textured
from tacbench_cad.bd import TextureBlock
from tacbench_cad.bd import textured as bd_textured
from tacbench_cad.cli import main
from tacbench_cad.cq import register
from tacbench_cad.cq import solid as cq_solid
from tacbench_cad.cq import textured as cq_textured
from tacbench_cad.util.types import Floats

#: The largest distance along z of a solid and of a mesh with the default tolerances, whose distance across a slope is
#: at most 0.001 and 0.01 mm.
SOLID_MM, MESH_MM = 0.0015, 0.015
#: A point on the top of the plate.
TOP = "7,5,4"


def plate() -> Any:
    return cq.Workplane().box(*PLATE_MM, centered=False)


def points_of(shape: Any) -> Floats:
    """Return points on the faces of a shape of CadQuery or build123d."""
    vertices, _ = shape.tessellate(0.02, 0.2)
    return np.array([tuple(vertex.toTuple() if hasattr(vertex, "toTuple") else vertex) for vertex in vertices])


def of_step(path: Path) -> Floats:
    return points_of(cq.importers.importStep(str(path)).val())


def commanded(folder: Path, file: Path, ending: str) -> Floats:
    before, after = folder / f"plate.{ending}", folder / f"textured.{ending}"
    cq.exporters.export(plate(), str(before))
    place = ["--face", ">Z"] if ending == "step" else ["--at", TOP]
    assert main(["texture-part", str(before), *place, "--texture", str(file), "--out", str(after)]) == 0
    return of_step(after) if ending == "step" else stl_points(after)


def with_cq(_: Path, file: Path) -> Floats:
    return points_of(cq_textured(plate(), ">Z", str(file)).val())


def chained(_: Path, file: Path) -> Floats:
    register()
    try:
        return points_of(plate().faces(">Z").texture(file).val())
    finally:  # only the user registers the methods
        del cq.Workplane.texture, cq.Workplane.textureBlock


def with_bd(_: Path, file: Path) -> Floats:
    box = bd.Box(*PLATE_MM, align=(bd.Align.MIN,) * 3)
    return points_of(bd_textured(box, box.faces().sort_by(bd.Axis.Z)[-1], file))


def with_freecad(folder: Path, file: Path) -> Floats:
    """The request that the workbench sends for a face with its default properties."""
    part = folder / "plate.brep"
    plate().val().exportBrep(str(part))
    shape = plate().val()
    (number,) = (i for i, face in enumerate(shape.Faces(), start=1) if abs(face.Center().z - PLATE_MM[2]) < 1e-9)
    request = {
        "action": "shape",
        "part": part.read_text(encoding="utf-8"),
        "face": number,
        "brep": str(folder / "textured.brep"),
        "texturing": {"texture": "texture-1", "file": str(file), "depth_mm": None, "mm_per_unit": None},
    }
    answer = subprocess.run(
        [sys.executable, "-P", str(ROOT / "freecad" / "tacbench" / "worker.py")],
        input=json.dumps(request) + "\n",
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=100,
        check=True,
    ).stdout
    assert "error" not in json.loads(answer), answer
    return points_of(cq.Shape.importBrep(request["brep"]))


def exported(folder: Path, file: Path) -> Floats:
    """A part in a file lies with its lower corner at the origin, as the plate does."""
    box = plate()
    export(textured(box, box.faces(">Z"), str(file), name="part"), folder / "part.stl")
    return stl_points(folder / "part.stl")


def on_mesh(folder: Path, file: Path) -> Floats:
    cq.exporters.export(plate(), str(folder / "plate.stl"))
    mesh = textured(folder / "plate.stl", (7, 5, 4), file).mesh
    return np.concatenate([mesh.vertices, mesh.triangle_points.mean(axis=1)])


PARTS: dict[str, tuple[Callable[[Path, Path], Floats], float]] = {
    "texture-part STEP": (lambda folder, file: commanded(folder, file, "step"), SOLID_MM),
    "texture-part STL": (lambda folder, file: commanded(folder, file, "stl"), MESH_MM),
    "cadquery": (with_cq, SOLID_MM),
    "cadquery chain": (chained, SOLID_MM),
    "build123d": (with_bd, SOLID_MM),
    "FreeCAD": (with_freecad, SOLID_MM),
    "textured solid": (exported, MESH_MM),
    "textured mesh": (on_mesh, MESH_MM),
}


#: The kinds of files. The normal run takes one of them with each way.
NAMES = ("table", "height map", "wavelength_mm")


@pytest.mark.parametrize(
    ("way", "name"),
    mostly_long(
        [(way, name) for way in PARTS for name in NAMES if (way, name) != ("FreeCAD", "height map")],
        *((way, NAMES[i % 3]) for i, way in enumerate(PARTS) if way != "FreeCAD"),
        ("FreeCAD", "table"),
    ),
)
def test_a_part_has_the_millimetres_of_the_file(way: str, name: str, tmp_path: Path) -> None:
    known, (make, tolerance_mm) = KNOWN[name], PARTS[way]
    points = make(tmp_path, known.write(tmp_path))
    corner = np.array([1.0, 1.0, PLATE_MM[2] + 0.1])
    assert off_mm(points, known.pattern, REGION_MM, corner) <= tolerance_mm + known.error_mm
    assert points[:, 2].max() == pytest.approx(PLATE_MM[2] + 0.2 + relief(name), abs=0.02)


def relief(name: str) -> float:
    """Return the peak-to-peak height of a pattern over the textured region."""
    x, y = (np.linspace(0.0, side, 600) for side in REGION_MM)
    return float(np.ptp(KNOWN[name].pattern(x[:, None], y[None, :])))


def made(folder: Path, file: Path) -> list[Floats]:
    words = ["make", "--texture", str(file), "--parts", "blocks", "--formats", "stl,step", "--out", str(folder)]
    assert main(words) == 0
    (stl,), (step,) = folder.glob("*.stl"), folder.glob("*.step")
    return [stl_points(stl), of_step(step)]


BLOCKS: dict[str, tuple[Callable[[Path, Path], list[Floats]], float]] = {
    "make": (made, MESH_MM),
    "CadQuery": (lambda _, file: [points_of(cq_solid(Block.of(str(file))))], SOLID_MM),
    "build123d": (lambda _, file: [points_of(TextureBlock(file, align=None))], SOLID_MM),
}


@pytest.mark.parametrize(
    ("way", "name"),
    mostly_long(
        [("make", "wavelength_mm"), ("make", "table"), ("build123d", "table"), *(("CadQuery", n) for n in KNOWN)],
        ("make", "table"),
        ("CadQuery", "height map"),
    ),
)
def test_a_block_has_the_millimetres_of_the_file(way: str, name: str, tmp_path: Path) -> None:
    known, (make, tolerance_mm) = KNOWN[name], BLOCKS[way]
    file = known.write(tmp_path)
    block = Block.of(file)
    for points in make(tmp_path, file):
        corner = np.array([0.0, 0.0, block.base_mm - 0.1])
        assert off_mm(points, known.pattern, block.size_mm, corner) <= tolerance_mm + known.error_mm


def test_a_surface_in_mm_without_a_file(tmp_path: Path) -> None:
    """The same millimetres for an array in Python, whatever the preset; only the scale enlarges it."""
    KNOWN["height map"].write(tmp_path)
    texture = Texture.from_heights(np.load(tmp_path / "map.npy"), mm_per_pixel=0.1, name="own")
    pattern = KNOWN["height map"].pattern
    x, y = np.random.default_rng(0).uniform(0.0, 9.0, (2, 1000))
    for block in (
        Block.of(texture),
        Block.of(texture, size_mm=(10.0, 9.0)),
        Block.of(texture, "released", sampling="grid"),
        Block.of(texture, mm_per_unit=(1.0, 1.0, 1.0)),
    ):
        assert np.ptp(block.height_at(x, y) - pattern(x, y)) < 2e-5
        assert block.size_mm in ((16.0, 12.0), (10.0, 9.0))
    assert np.ptp(Block.of(texture, scale=2.0).height_at(2.0 * x, 2.0 * y) - 2.0 * pattern(x, y)) < 4e-5
    with pytest.raises(InputError, match=r"mm_per_unit = \(1\.2, 1\.5, 1\.0\): the texture is in mm; .* use scale"):
        Block.of(texture, mm_per_unit=(1.2, 1.5, 1.0))
    with pytest.raises(InputError, match=r"mm_per_unit = \(1\.2, 1\.5\): the texture is in mm; .* use scale"):
        cq_textured(plate(), ">Z", texture, mm_per_unit=(1.2, 1.5))
    larger = cq.Workplane().box(30, 30, 4)
    with pytest.raises(InputError, match=r"texture = 'own': covers 0 to 16 mm along x, but the textured region 28 mm"):
        cq_textured(larger, ">Z", texture)
    with pytest.raises(InputError, match=r"domain = 'u 0 to 20': is larger than the surface"):
        Block.of(texture, size_mm=(20.0, 9.0))


def test_a_given_depth_and_unit_still_count(tmp_path: Path) -> None:
    """An explicit depth scales the height only. A texture of the paper keeps a depth of 1 mm and the paper's unit."""
    hexbumps, corner = KNOWN["wavelength_mm"], np.array([1.0, 1.0, PLATE_MM[2] + 0.1])
    factor = 0.5 / relief("wavelength_mm")
    points = points_of(cq_textured(plate(), ">Z", hexbumps.write(tmp_path), depth_mm=0.5).val())
    assert off_mm(points, lambda x, y: factor * hexbumps.pattern(x, y), REGION_MM, corner) <= SOLID_MM
    points = points_of(cq_textured(plate(), ">Z", 1).val())
    paper = 23.3 / (6.0 * np.pi + 0.5)
    assert off_mm(points, lambda x, y: 0.5 * np.sin(x / paper) + 0.0 * y, REGION_MM, corner) <= SOLID_MM


def test_a_texture_on_a_cylinder_says_how_it_was_stretched(tmp_path: Path) -> None:
    """Around a whole cylinder, a texture must close, so it cannot keep its millimetres; the result says so."""
    drum, file = tmp_path / "drum.step", KNOWN["wavelength_mm"].write(tmp_path)
    cq.exporters.export(cq.Workplane().circle(5).extrude(12), str(drum))
    result = textured(drum, "%Cylinder", file)
    closed = 2.0 * np.pi * 5.0 / 4.0  # the waves repeat after 4 mm around the drum
    assert (
        f", {round(closed)} periods around it, stretched by {100.0 * (closed / 8.0 - 1.0):+.2g} % to close"
        in (result.lines()[0])
    )
