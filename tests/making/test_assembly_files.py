"""``make --assembly``: one STEP and one 3MF file with holder, blocks and jig in their places of use."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("build123d")
pytest.importorskip("lib3mf")

import build123d as bd
from helpers.fixtures import HOLDER as SINGLE
from helpers.fixtures import PAIR as HOLDER
from helpers.fixtures import PAIR_JIG as JIG

from housing import Assembly
from housing.bd import assembled
from tacbench_cad.checks.identify import examine
from tacbench_cad.cli import main
from tacbench_cad.formats import step, threemf
from tacbench_cad.geometry.part import COLOURS
from tacbench_cad.making.printset import Request, plan
from tacbench_cad.making.writing import Failure, make_files
from tacbench_cad.spec.block import Block
from tacbench_cad.util.errors import InputError

BLOCKS = (Block.of(1, key_mm=3.0), Block.of(2, key_mm=3.0))
SET = Assembly(holder=HOLDER, blocks=BLOCKS, jig=JIG)
#: The smallest assembly with several colours.
SMALL = Assembly(holder=SINGLE, blocks=(Block.of(1),), jig=None)
NAMES = [HOLDER.name, *(block.name for block in BLOCKS), JIG.name]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("assembly")
    rows = make_files(SET.part(), ("3mf", "step"), out, False)
    assert not any(isinstance(row, Failure) for row in rows), rows
    (out / "rows.json").write_text(json.dumps(rows))
    return out


@lru_cache
def boxes() -> list[tuple[float, ...]]:
    """Return the bounding box of each part, placed by the joints of build123d."""
    bounds = [child.bounding_box() for child in assembled(HOLDER, BLOCKS, JIG).children]
    return [(*box.min, *box.max) for box in bounds]


def test_the_step_has_each_part_with_its_name_colour_and_place(folder: Path) -> None:
    assembly = bd.import_step(str(folder / f"{SET.name}.step"))
    assert assembly.label == SET.name
    assert [child.label for child in assembly.children] == NAMES
    for child, box, kind in zip(assembly.children, boxes(), ("holder", "block", "block", "jig"), strict=True):
        bounds = child.bounding_box()
        assert (*bounds.min, *bounds.max) == pytest.approx(box, abs=2e-3)
        assert tuple(child.color)[:3] == pytest.approx(tuple(bd.Color(COLOURS[kind]))[:3], abs=1e-2)


def test_the_3mf_has_each_part_in_its_place(folder: Path) -> None:
    mesh, entries = threemf.read_3mf(folder / f"{SET.name}.3mf")
    assert entries["kind"] == "assembly" and entries["name"] == SET.name
    first = 0
    for (part, _), box in zip(SET.part().placed, boxes(), strict=True):
        points = mesh.vertices[first : first + len(part.mesh[0].vertices)]
        assert (*points.min(axis=0), *points.max(axis=0)) == pytest.approx(box, abs=2e-3)
        first += len(points)
    assert first == len(mesh.vertices)


@pytest.mark.parametrize("ending", ["3mf", pytest.param("step", marks=pytest.mark.long)])
def test_check_examines_each_part_by_its_own_specification(folder: Path, ending: str) -> None:
    report = examine(folder / f"{SET.name}.{ending}", full=False)
    assert report.ok, report.faults
    details = {check.name: check.detail for check in report.checks}
    assert details["bodies"].startswith("4, 2 of them with a relief")
    for slot, block in enumerate(BLOCKS, start=1):
        name = f"{block.name} in slot {slot}" if ending == "3mf" else block.name
        assert f"{block.texture.name}, preset paper, scale 1" in details[f"{name}: relief"]
        assert details[f"{name}: key"] == "3 mm at the corner (X, 0)"
        assert "turned by 90 degrees" in details[f"{name}: placement"]
    assert details[f"{JIG.name}: texture"].startswith("none: a part of")
    assert report.size_mm == pytest.approx([*JIG.seat.outer.size_mm, JIG.seat.roof_mm[1]], abs=1e-3)
    assert report.deviation_mm is not None and report.deviation_mm <= 0.01 + 1e-5


def test_a_part_in_the_wrong_place_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def shifted(placed: list[tuple[object, np.ndarray]], *rest: object) -> None:
        transformed = [(part, matrix + np.eye(4, k=3) * 0.01 * (i == 1)) for i, (part, matrix) in enumerate(placed)]
        write(transformed, *rest)  # type: ignore[arg-type]

    write = step.write_assembly
    monkeypatch.setattr(step, "write_assembly", shifted)
    (result,) = make_files(SMALL.part(), ("step",), tmp_path, False)
    assert isinstance(result, Failure)
    assert any(fault.startswith(f"{SMALL.blocks[0].name}: place: 1.0e-02 mm") for fault in result.faults)
    assert list(tmp_path.iterdir()) == []


def test_the_blocks_that_an_assembly_contains() -> None:
    (assembly,) = plan(Request(assembly=True, slots=2)).assemblies
    assert [block.texture.number for block in assembly.thing.blocks] == [1, 2]
    assert assembly.thing.jig is not None and assembly.formats == ("3mf", "step")
    (left,) = plan(Request(assembly=True, slots=2)).left_out
    assert left.what == f"4 of 6 blocks in {assembly.thing.name}"
    assert left.reason == "the holder has only 2 slots, used by texture-1, texture-2; use --slots for more"
    (copied,) = plan(Request(textures=("3", "2"), copies=2, assembly=True, slots=3)).assemblies
    assert [(block.texture.number, block.copy) for block in copied.thing.blocks] == [(3, 1), (2, 1), (3, 2)]
    assert plan(Request()).assemblies == ()
    counted = plan(Request(textures=("1",), assembly=True))
    assert counted.file_count == 3 * 3 + 2
    (alone,) = plan(Request(textures=("1",), parts=("blocks", "holder"), assembly=True)).assemblies
    assert alone.thing.jig is None


def test_an_assembly_with_a_block_without_solid_is_3mf_only() -> None:
    work = plan(Request(textures=("4",), preset="released", assembly=True))
    assert work.assemblies[0].formats == ("3mf",)
    assert any(item.what.startswith("assembly") and "texture-4" in item.reason for item in work.left_out)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"formats": ("stl",)}, "formats = 'stl': --assembly needs one of 3mf, step"),
        ({"parts": ("blocks",)}, "assembly: needs a holder and a block"),
        ({"parts": ("holder", "jig")}, "assembly: needs a holder and a block"),
    ],
)
def test_an_assembly_needs_a_holder_and_a_block(changes: dict[str, tuple[str, ...]], message: str) -> None:
    with pytest.raises(InputError, match=message):
        plan(replace(Request(textures=("1",), assembly=True), **changes))


def test_the_command_writes_it_and_the_manifest_lists_it(tmp_path: Path) -> None:
    argv = ["make", "--texture", "1", "--parts", "blocks,holder", "--formats", "3mf", "--assembly"]
    assert main([*argv, "--out", str(tmp_path)]) == 0
    files = {row["file"] for row in json.loads((tmp_path / "manifest.json").read_text())["files"]}
    assert files == {"texture-1_paper_x1.3mf", "holder_paper_x1.3mf", "assembly_paper_x1.3mf"}
    assert files <= {path.name for path in tmp_path.iterdir()}


def test_the_same_assembly_gives_the_same_bytes(tmp_path: Path) -> None:
    """The kernel continues its numbering in the same process, but the files do not depend on it."""
    files = []
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
        make_files(SMALL.part(), ("3mf", "step"), tmp_path / name, False)
        files.append([path.read_bytes() for path in sorted((tmp_path / name).iterdir())])
    assert len(files[0]) == 2 and files[0] == files[1]
