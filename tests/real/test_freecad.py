"""FreeCAD: our workbench in it (objects, recompute, documents, export), and our STEP files opened, cut and measured."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.cases import mostly_long
from helpers.checkout import ROOT
from helpers.outsiders import PATIENCE_S, Written, part_named

pytest.importorskip("OCP", reason="solids need the extra cad")

from housing import Holder, Jig
from tacbench_cad.checks.check import check
from tacbench_cad.formats.stl import read_stl
from tacbench_cad.geometry.brep import solid_block
from tacbench_cad.spec.block import Block

pytestmark = pytest.mark.real

Script = Callable[..., Any]

#: Runs before each script: the workbench uses this Python, and the script answers with one JSON value.
HEAD = """
import json, os, sys
import FreeCAD, Part
FreeCAD.ParamGet("User parameter:BaseApp/Preferences/Mod/Tacbench").SetString("Python", os.environ["OUR_PYTHON"])
def reply(value):
    with open(os.environ["ANSWER"], "w") as file:
        json.dump(value, file)
"""


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of FreeCAD's user with a link to the workbench."""
    folder = tmp_path_factory.mktemp("freecad")
    (folder / "Mod").mkdir()
    (folder / "Mod" / "tacbench-cad").symlink_to(ROOT)
    return folder


@pytest.fixture(scope="module")
def freecad(home: Path) -> Script:
    """A caller of FreeCAD without its window, which gives what a script replies."""
    program = shutil.which("freecadcmd") or shutil.which("FreeCADCmd")
    if program is None:
        pytest.skip("FreeCAD is not installed: apt-get install freecad")

    def run(script: str, python: str = sys.executable, **variables: str) -> Any:
        (home / "script.py").write_text(HEAD + script, encoding="utf-8")
        answer = home / "answer.json"
        answer.unlink(missing_ok=True)
        ours = {"FREECAD_USER_HOME": str(home), "OUR_PYTHON": python, "ANSWER": str(answer), "PYTHONPATH": str(ROOT)}
        done = subprocess.run(
            [program, str(home / "script.py")],
            cwd=home,
            env=os.environ | ours | variables,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=PATIENCE_S,
            check=False,
        )
        assert answer.exists(), done.stdout[-2000:] + done.stderr[-2000:]
        return json.loads(answer.read_text(encoding="utf-8"))

    return run


OBJECTS = """
from freecad.tacbench import make_block, make_holder, make_jig
document = FreeCAD.newDocument()
block = make_block(document, Texture="texture-2", Key=3)
holder = make_holder(document, block, Slots=2)
jig = make_jig(document, holder)
def state():
    document.recompute()
    return [
        {
            "ok": part.isValid(),
            "says": part.getStatusString(),
            "name": part.PartName,
            "kind": part.Shape.ShapeType,
            "sound": part.Shape.isValid(),
            "volume": part.Shape.Volume,
            "formula": part.FormulaVolume.Value,
            "at": list(part.Placement.Base),
        }
        for part in (block, holder, jig)
    ]
"""


def test_objects_follow_their_properties_and_links(freecad: Script) -> None:
    """Each object is one valid solid; a change of the block reaches holder and jig, and they stay in place."""
    before, after, moved = freecad(
        OBJECTS
        + """
states = [state()]
block.Texture, block.SizeX, block.Height, holder.Fit = "texture-1", 30, 8, "loose"
states.append(state())
block.Placement.Base = FreeCAD.Vector(5, 6, 7)
states.append(state())
reply(states)
"""
    )
    for states, own, fit in (
        (before, Block.of(2, key_mm=3.0), "slip"),
        (after, Block.of(1, key_mm=3.0, size_mm=(30.0, 30.0), height_mm=8.0), "loose"),
    ):
        holder = Holder(block=own, slots=2, fit=fit)
        expected = [
            (own.solid_name, own.volume_mm3(own.solid_datum_mm)),
            (holder.name, holder.volume_mm3),
            (Jig(holder=holder).name, Jig(holder=holder).volume_mm3),
        ]
        assert [(part["ok"], part["kind"], part["sound"]) for part in states] == [(True, "Solid", True)] * 3
        assert [part["name"] for part in states] == [name for name, _ in expected]
        for part, (_, volume) in zip(states, expected, strict=True):
            assert part["formula"] == pytest.approx(volume, rel=1e-12)
            assert part["volume"] == pytest.approx(volume, rel=1e-5)
        slot = holder.block_placements()[0].origin_mm
        assert [part["at"] for part in states] == [
            pytest.approx([0.0, 0.0, 0.0]),
            *[pytest.approx([-value for value in slot])] * 2,
        ]
    assert moved[0]["at"] == [5.0, 6.0, 7.0]
    assert moved[1]["at"] == pytest.approx([value - shift for value, shift in zip((5.0, 6.0, 7.0), slot, strict=True)])
    assert moved[2]["at"] == moved[1]["at"]


#: A bad value, and the line by which FreeCAD marks the object.
BAD_VALUES = {
    "block.Scale = 500": "scale = 500.0: must be from 0.01 to 100",
    "block.Key = 20": "key = 20.0: must be above 0 and at most 7.767 mm, a third of the shorter side",
    "block.TextureFile = 'none.toml'": "texture = 'none.toml': cannot be read: No such file or directory",
    "block.Outline = 'disk'": "outline = 'disk': did you mean \"disc\"?",
    "holder.Floor = 0.1": "floor = 0.1: ",
    "holder.Block = None": "Holder: Block is empty. Choose the texture block of the holder.",
}


def test_a_bad_value_marks_the_object_with_one_line(freecad: Script) -> None:
    bad, good = freecad(
        OBJECTS
        + f"""
state()
bad = []
for change in {list(BAD_VALUES)!r}:
    kept = block.Scale, block.Key, block.Outline, block.TextureFile, holder.Floor, holder.Block
    exec(change)
    bad.append(state())
    block.Scale, block.Key, block.Outline, block.TextureFile, holder.Floor, holder.Block = kept
reply([bad, state()])
"""
    )
    for states, message in zip(bad, BAD_VALUES.values(), strict=True):
        (marked,) = (part for part in states if not part["ok"])
        assert marked["says"].startswith(message)
        assert "\n" not in marked["says"]
        assert marked["kind"] == "Solid", "the last good shape stays"
    assert all(part["ok"] for part in good)


def test_a_document_keeps_its_objects(freecad: Script, tmp_path: Path) -> None:
    """Saved, opened by another FreeCAD, changed there, and written by FreeCAD itself as STEP and STL."""
    saved = tmp_path / "set.FCStd"
    freecad(OBJECTS + f"\nstate()\ndocument.saveAs({str(saved)!r})\nreply(None)")
    opened, changed = freecad(
        OBJECTS.split("def state")[1].join(("\ndef state", ""))
        + f"""
document = FreeCAD.open({str(saved)!r})
block, holder, jig = document.TextureBlock, document.Holder, document.Jig
opened = [part.Shape.Volume for part in (block, holder, jig)]
holder.Slots = 1
states = state()
import Mesh
Part.export([block, holder, jig], {str(tmp_path / "set.step")!r})
Mesh.export([holder], {str(tmp_path / "holder.stl")!r})
reply([opened, states])
"""
    )
    block = Block.of(2, key_mm=3.0)
    holder, pair = Holder(block=block), Holder(block=block, slots=2)
    volume = block.volume_mm3(block.solid_datum_mm)
    assert opened == pytest.approx([volume, pair.volume_mm3, Jig(holder=pair).volume_mm3], rel=1e-5)
    volumes = [volume, holder.volume_mm3, Jig(holder=holder).volume_mm3]
    assert [part["volume"] for part in changed] == pytest.approx(volumes, rel=1e-5)
    read = freecad(f"shape = Part.read({str(tmp_path / 'set.step')!r})\nreply([s.Volume for s in shape.Solids])")
    assert sorted(read) == pytest.approx(sorted(volumes), rel=1e-5)
    assert read_stl(tmp_path / "holder.stl").volume_mm3 == pytest.approx(holder.volume_mm3, rel=1e-3)


def test_a_texture_on_a_face_follows_the_part(freecad: Script, tmp_path: Path) -> None:
    """A plate with a hole in FreeCAD: the top and the wall of the hole get a texture, also after the hole has grown."""
    saved = tmp_path / "plate.FCStd"
    steps = freecad(
        f"""
from freecad.tacbench import make_textured_face
document = FreeCAD.newDocument()
box, hole = document.addObject("Part::Box", "Box"), document.addObject("Part::Cylinder", "Hole")
box.Length, box.Width, box.Height = 40, 30, 8
hole.Radius, hole.Height, hole.Placement.Base = 3, 20, FreeCAD.Vector(20, 10, -5)
plate = document.addObject("Part::Cut", "Plate")
plate.Base, plate.Tool = box, hole
document.recompute()
def name_of(fits):
    (number,) = (i for i, face in enumerate(plate.Shape.Faces, 1) if fits(face))
    return "Face%d" % number
top = name_of(lambda face: abs(face.CenterOfMass.z - 8) < 1e-6)
wall = name_of(lambda face: isinstance(face.Surface, Part.Cylinder))
rough = make_textured_face(document, plate, top, Texture="texture-2")
steps = []
def step():
    document.recompute()
    shape = rough.Shape
    steps.append({{
        "says": rough.getStatusString(),
        "sound": [shape.ShapeType, shape.isValid(), len(shape.Solids)],
        "volume": shape.Volume,
        "formula": rough.FormulaVolume.Value,
        "plate": plate.Shape.Volume,
        "x": rough.Placement.Base.x,
        "error": rough.Error,
    }})
step()
hole.Radius, plate.Placement.Base.x = 4, 100
step()
rough.Face, rough.Depth, rough.Sunk = (plate, [wall]), 0.5, True
step()
rough.Depth = 30
step()
rough.Depth = 0.5
sphere = document.addObject("Part::Sphere", "Sphere")
rough.Face = sphere, ["Face1"]
step()
rough.Face = plate, ["Face99"]
step()
rough.Face = plate, [top]
document.recompute()
document.saveAs({str(saved)!r})
reply(steps)
"""
    )
    for state, x in zip(steps[:3], (0.0, 100.0, 100.0), strict=True):
        assert state["says"] == "Valid"
        assert state["sound"] == ["Solid", True, 1]
        assert state["volume"] == pytest.approx(state["formula"], rel=1e-5)
        assert state["x"] == x
        assert state["error"].endswith(" micrometres (proved)")
    assert steps[0]["volume"] > steps[0]["plate"] + 100
    assert steps[2]["volume"] < steps[2]["plate"] - 10
    assert steps[3]["says"].startswith("depth_mm = 30.0: ")
    assert steps[5]["says"] == "Face = 'Face99': the part has Face1 to Face7; choose one of them"
    assert steps[4]["says"] == "face: is spherical; only planes and cylinders can get a texture"
    kept = freecad(
        f"""
from freecad.tacbench import export_object
document = FreeCAD.open({str(saved)!r})
rough = document.TexturedFace
rough.Depth = 0.8
document.recompute()
reports = [export_object(rough, {str(tmp_path / "plate")!r} + ending) for ending in (".stl", ".step")]
part = Part.read({str(tmp_path / "plate.step")!r})
half = part.common(Part.makeBox(20, 100, 100))
reply([rough.getStatusString(), rough.Shape.Volume, rough.FormulaVolume.Value, reports, part.Volume, half.isValid()])
"""
    )
    assert kept[0] == "Valid"
    assert kept[1] == pytest.approx(kept[2], rel=1e-5)
    assert [report.partition("\n")[0] for report in kept[3]] == ["plate.stl: passed", "plate.step: passed"]
    assert read_stl(tmp_path / "plate.stl").volume_mm3 == pytest.approx(kept[2], rel=1e-3)
    assert kept[4] == pytest.approx(kept[2], rel=1e-5)
    assert kept[5]


def test_the_macro_writes_files_that_are_ours(freecad: Script, home: Path) -> None:
    """The macro runs as it is; its files pass the checks of ``tacbench check`` as files of the program do."""
    macro = (ROOT / "freecad" / "print_set.FCMacro").read_text(encoding="utf-8")
    folder = Path(freecad(macro + "\nreply(str(FOLDER))"))
    block = Block.of(2, key_mm=3.0)
    for name, volume in (
        (block.name, block.volume_mm3(block.datum_mm)),
        (Holder(block=block).name, Holder(block=block).volume_mm3),
    ):
        assert read_stl(folder / f"{name}.stl").volume_mm3 == pytest.approx(volume, rel=1e-3)
        assert (folder / f"{name}.step").is_file()
    report = check(folder / f"{block.name}.stl")
    assert report.ok
    assert report.deviation_mm is not None
    assert report.deviation_mm < 0.01


@pytest.mark.parametrize("python", ["", "/nowhere/python", "/usr/bin/python3"])
def test_a_missing_tacbench_is_named(freecad: Script, python: str) -> None:
    """One line says what is missing and what to do, and the document stays empty."""
    says, objects = freecad(
        """
from freecad.tacbench import make_block
document = FreeCAD.newDocument()
try:
    make_block(document)
except RuntimeError as error:
    reply([str(error), len(document.Objects)])
""",
        python,
        PATH="/usr/bin:/bin",
        PYTHONPATH="",
    )
    assert 'Install tacbench-cad with the extra "cad"' in says
    assert "\n" not in says
    assert objects == 0


@pytest.mark.parametrize("scene", mostly_long(["parts", "face"], "parts"))
def test_the_buttons_make_the_parts_of_the_manuals_pictures(scene: str, tmp_path: Path) -> None:
    """In FreeCAD's window, the buttons make the parts without an error, and the view shows them in their colours."""
    image = pytest.importorskip("PIL.Image", reason="Pillow is not installed: pip install pillow")
    for program, package in (("freecad", "freecad"), ("xvfb-run", "xvfb xauth")):
        if shutil.which(program) is None:
            pytest.skip(f"{program} is not installed: apt-get install {package}")
    script, picture = ROOT / "docs" / "freecad_window.py", tmp_path / "window.png"
    done = subprocess.run(
        [sys.executable, str(script), str(picture), scene],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    with image.open(picture) as file:
        red, green, blue = np.asarray(file.convert("RGB"), dtype=int)[200:, 400:].reshape(-1, 3).T
    # A selected part is green; the texture on a face is ochre.
    shown = (green > red + 30) & (green > blue + 60) if scene == "parts" else (red > green + 12) & (green > blue)
    assert shown.sum() > 3000


@pytest.mark.parametrize(
    "name",
    mostly_long(["paper-1", "paper-4", "paper-6", "released-5", "keyed-4", "paper-knurl"], "paper-4", "keyed-4"),
)
def test_a_step_is_opened_cut_and_measured(freecad: Script, written: Written, name: str) -> None:
    """The volume of the whole and of the lower half in x, from our STEP file, by FreeCAD's kernel."""
    block = part_named(name).block
    assert block is not None
    whole, half, valid = freecad(
        f"""
shape = Part.read({str(written(name, "step"))!r})
(solid,) = shape.Solids
knife = Part.makeBox({block.size_mm[0] / 2 + 1}, 1000, 1000, FreeCAD.Vector(-1, -500, -500))
part = solid.common(knife)
reply([solid.Volume, part.Volume, solid.isValid() and part.isValid() and len(part.Solids) == 1])
"""
    )
    x, y = block.size_mm
    below = block.surface.integral((0.0, x / 2), (0.0, y)) + block.solid_datum_mm * x / 2 * y
    assert valid
    assert whole == pytest.approx(block.volume_mm3(block.solid_datum_mm), rel=1e-5)
    if block.engraving is None:
        assert half == pytest.approx(below, rel=1e-5)
    assert solid_block(block)[1].vertical_mm <= block.step_tolerance_mm
