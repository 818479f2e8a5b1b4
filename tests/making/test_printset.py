"""The print set: the parts that a request means. A file is written completely and checked, or not at all."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from tacbench_cad.checks.report import Check, Report
from tacbench_cad.geometry.part import PrintPart
from tacbench_cad.making import printset, request
from tacbench_cad.making import writing as making
from tacbench_cad.making.manifest import read_rows
from tacbench_cad.making.printset import Request, build, plan
from tacbench_cad.spec.families import equation1
from tacbench_cad.spec.textures import Texture
from tacbench_cad.util import packages as tools
from tacbench_cad.util.errors import InputError, MissingToolError
from tacbench_cad.util.files import sha256
from tacbench_cad.util.text import at_most

pytestmark = pytest.mark.usefixtures("no_preview")

LIGHT = Request(formats=("stl",), parts=("blocks",))


def names(request: Request) -> list[str]:
    return [source.part.name for source in plan(request).sources]


def needs_cad() -> None:
    pytest.importorskip("build123d")


# The parts that a request means


def test_the_default_is_six_blocks_holder_and_jig_in_all_formats() -> None:
    needs_cad()
    pytest.importorskip("lib3mf")
    work = plan(Request())
    blocks = [f"texture-{i}_paper_x1" for i in range(1, 7)]
    assert [source.part.name for source in work.sources] == [*blocks, "holder_paper_x1", "jig_paper_x1"]
    assert {source.formats for source in work.sources} == {("stl", "3mf", "step")}
    assert work.left_out == ()
    assert work.file_count == 24


def test_copies_are_separate_parts_with_labels() -> None:
    work = plan(replace(LIGHT, textures=("2", "5"), copies=2))
    assert [source.part.name for source in work.sources] == [
        *("texture-2_paper_x1_copy01", "texture-2_paper_x1_copy02"),
        *("texture-5_paper_x1_copy01", "texture-5_paper_x1_copy02"),
    ]
    assert all(source.part.block is not None and source.part.block.label for source in work.sources)


def test_the_preset_released_includes_the_holder_of_the_authors() -> None:
    needs_cad()
    request = Request(preset="released", textures=("1",), formats=("stl",), parts=("holder",))
    (holder,) = plan(request).sources
    assert holder.part.size_mm == pytest.approx((45.39, 65.01, 7.47))
    (fitted,) = plan(replace(request, fit="press")).sources
    assert fitted.part.size_mm != holder.part.size_mm and fitted.part.name != holder.part.name


def test_two_files_with_one_name_are_refused(tmp_path: Path) -> None:
    text = '[texture]\nname = "mine"\nfamily = "series"\nlaw = "square"\nN = 3\n'
    for name in ("a.toml", "b.toml"):
        (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=r"'mine'.*twice"):
        plan(replace(LIGHT, textures=(str(tmp_path / "a.toml"), str(tmp_path / "b.toml"))))


@pytest.mark.parametrize("number", [4, 6])
def test_released_square_waves_have_no_solid(number: int) -> None:
    pytest.importorskip("OCP")
    work = plan(Request(textures=(str(number),), preset="released", formats=("stl", "step"), parts=("blocks",)))
    (source,) = work.sources
    assert source.formats == ("stl",)
    assert [item.what for item in work.left_out] == [f"texture-{number}_released_x1.step"]
    assert work.left_out[0].reason


def test_an_impossible_jig_is_left_out_unless_it_is_requested() -> None:
    needs_cad()
    small = Request(textures=("1",), size_mm=(30.0, 20.0), formats=("stl",))
    work = plan(small)
    assert [source.part.kind for source in work.sources] == ["block", "holder"]
    (left,) = work.left_out
    assert left.what == "jig" and "9 x 23 mm" in left.reason and "30 x 20 mm" in left.reason
    for options in ({"jig": "default"}, {"parts": ("jig",)}):
        with pytest.raises(InputError, match="9 x 23 mm"):
            plan(replace(small, **options))


def test_without_the_kernel_only_meshes_of_blocks_are_planned(monkeypatch: pytest.MonkeyPatch) -> None:
    reason = 'needs cadquery-ocp, not installed: run pip install "tacbench-cad[cad]"'
    monkeypatch.setattr(request, "why_missing", lambda *modules: reason if "OCP" in modules else None)
    step = request.FORMATS["step"]
    monkeypatch.setitem(request.FORMATS, "step", replace(step, why_missing=lambda: reason))
    work = plan(Request(textures=("1",)))
    assert [source.part.kind for source in work.sources] == ["block"]
    assert "step" not in work.sources[0].formats
    assert {item.what for item in work.left_out} == {"step", "holder, jig"}
    assert all("pip install" in item.reason for item in work.left_out)
    for options in ({"formats": ("step",)}, {"parts": ("holder",)}, {"jig": "all"}):
        with pytest.raises(MissingToolError, match="pip install"):
            plan(Request(textures=("1",), **options))


# Making the files


@pytest.fixture
def broken_kernel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Put a kernel that does not load, as without libGL, before the real kernel in the import path."""
    (tmp_path / "site" / "OCP").mkdir(parents=True)
    text = "raise ImportError('libGL.so.1: cannot open shared object file')"
    (tmp_path / "site" / "OCP" / "__init__.py").write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path / "site"))


@pytest.mark.usefixtures("broken_kernel")
def test_with_a_broken_kernel_only_meshes_of_blocks_are_made(tmp_path: Path) -> None:
    result = build(Request(textures=("1",), out=tmp_path / "out"))
    assert [row["file"] for row in result.rows if row["format"] == "stl"] == ["texture-1_paper_x1.stl"]
    assert not [row for row in result.rows if row["format"] == "step" or row["kind"] != "block"]
    (left,) = [item for item in result.left_out if "kernel" in item.reason]
    assert left.what == "step, holder, jig" and "libGL.so.1" in left.reason and "doctor" in left.reason


@pytest.mark.usefixtures("broken_kernel")
def test_a_broken_kernel_is_an_error_if_a_solid_is_requested(tmp_path: Path) -> None:
    with pytest.raises(MissingToolError, match=r"libGL\.so\.1"):
        build(Request(textures=("1",), formats=("stl", "step"), parts=("blocks",), out=tmp_path / "out"))
    assert not (tmp_path / "out").exists()


def test_textures_are_numbers_or_objects(tmp_path: Path) -> None:
    ridges = Texture(name="ridges", surface=equation1(1.0, 1.0, 2.0, 2.0))
    assert names(replace(LIGHT, textures=(4, ridges, "1"))) == [
        "texture-4_paper_x1",
        "ridges_paper_x1",
        "texture-1_paper_x1",
    ]
    with pytest.raises(InputError, match="given twice"):
        plan(replace(LIGHT, textures=(ridges, ridges)))
    result = build(replace(LIGHT, textures=(ridges,), out=tmp_path))
    (row,) = result.rows
    head, line = str(result).splitlines()
    assert head == f"1 file in {tmp_path}"
    distance = at_most(row["certificate"]["distance_mm"], 2)
    assert line.split("  ")[1:] == [
        "ridges_paper_x1.stl",
        f"{len(row['checks'])} checks passed, at most {distance} mm from the formula",
    ]


def test_a_row_describes_its_file(tmp_path: Path) -> None:
    result = build(replace(LIGHT, textures=("3",), out=tmp_path))
    (row,) = read_rows(tmp_path)
    assert [row] == result.rows
    path = tmp_path / row["file"]
    assert row["sha256"] == sha256(path) and row["bytes"] == path.stat().st_size == 84 + 50 * row["triangles"]
    assert row["size_mm"] == pytest.approx([23.3, 30.0, 7.0], abs=1e-5)
    assert row["volume_mm3"] == pytest.approx(row["closed_form_volume_mm3"], rel=1e-5)
    assert 0.0 < row["deviation_mm"] <= row["certificate"]["distance_mm"] <= 0.01 <= row["certificate"]["vertical_mm"]
    assert all(check["ok"] for check in row["checks"]) and len(row["checks"]) > 5
    assert row["spec"]["texture"] == "texture-3"
    assert "grid_to_formula" not in row


def test_a_second_call_replaces_only_its_own_files(tmp_path: Path) -> None:
    build(replace(LIGHT, textures=("1", "3", "5"), out=tmp_path))
    before = {row["file"]: row for row in read_rows(tmp_path)}
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "texture-5_paper_x1.stl").write_bytes(b"altered by hand")
    build(replace(LIGHT, textures=("1",), scale=2.0, out=tmp_path))
    build(replace(LIGHT, textures=("1",), out=tmp_path))
    after = {row["file"]: row for row in read_rows(tmp_path)}
    assert list(after) == ["texture-1_paper_x1.stl", "texture-1_paper_x2.stl", "texture-3_paper_x1.stl"]
    for name in ("texture-1_paper_x1.stl", "texture-3_paper_x1.stl"):
        assert after[name] == before[name]
    assert (tmp_path / "notes.txt").read_text() == "mine"
    assert (tmp_path / "texture-5_paper_x1.stl").read_bytes() == b"altered by hand"


def spoil(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """Make the checks of one part fail."""
    original = making.verify

    def verify(part: PrintPart, path: Path, full: bool = False) -> Report:
        report = original(part, path, full=full)
        wrong = Check(name="closed", ok=False, detail="3 open edges")
        return replace(report, checks=(*report.checks, wrong)) if part.name == name else report

    monkeypatch.setattr(making, "verify", verify)


def test_a_part_that_fails_its_checks_does_not_replace_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    build(replace(LIGHT, textures=("3",), out=tmp_path))
    before = (tmp_path / "texture-3_paper_x1.stl").read_bytes()
    spoil(monkeypatch, "texture-3_paper_x1")
    result = build(replace(LIGHT, textures=("1", "3"), out=tmp_path))
    assert not result.ok
    assert [(failure.file, failure.faults) for failure in result.failures] == [
        ("texture-3_paper_x1.stl", ("closed: 3 open edges",))
    ]
    assert [row["file"] for row in result.rows] == ["texture-1_paper_x1.stl"]
    assert (tmp_path / "texture-3_paper_x1.stl").read_bytes() == before
    assert len(read_rows(tmp_path)) == 2, "the old file and its row must still be there"
    assert not list(tmp_path.glob(".tacbench*"))


def stop_after(count: int) -> Callable[[str, int, int], None]:
    def progress(message: str, done: int, total: int) -> None:
        if done == count:
            raise KeyboardInterrupt

    return progress


def test_an_interruption_leaves_complete_files_and_a_correct_manifest(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        build(replace(LIGHT, textures=("1", "3", "5"), out=tmp_path), stop_after(2))
    rows = read_rows(tmp_path)
    assert [row["file"] for row in rows] == ["texture-1_paper_x1.stl", "texture-3_paper_x1.stl"]
    assert all(sha256(tmp_path / row["file"]) == row["sha256"] for row in rows)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["manifest.json", *(row["file"] for row in rows)]


def test_without_matplotlib_the_picture_is_left_out_with_the_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reason = 'needs matplotlib, not installed: run pip install "tacbench-cad[plot]"'
    monkeypatch.setattr(printset, "why_missing", lambda name: reason if name == "matplotlib" else None)
    result = build(replace(LIGHT, textures=("1",), out=tmp_path))
    assert result.ok and not result.preview and not (tmp_path / "preview.png").exists()
    assert [(item.what, item.reason) for item in result.left_out] == [("preview.png", reason)]


def test_the_full_checks_need_their_tool(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tools, "has_module", lambda name: name != "pymeshlab")
    with pytest.raises(MissingToolError, match="verify = 'full': needs pymeshlab"):
        build(replace(LIGHT, textures=("1",), full=True, out=tmp_path / "out"))
    assert not (tmp_path / "out").exists()


def test_a_refused_height_names_a_height_that_suits_all_textures(tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        plan(replace(LIGHT, height_mm=3.0))
    height = float(caught.value.allowed.split("a height of at least ")[1].split(" mm")[0])
    assert plan(replace(LIGHT, height_mm=height)).sources
    assert math.isclose(height, 5.52)
