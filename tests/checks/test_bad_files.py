"""Bad input files and folders: each gives one clear message and the right exit code, and no file is lost."""

from __future__ import annotations

import errno
import os
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from helpers.hostile_files import step_of, threemf, zip_of
from helpers.shapes import box_mesh, mesh_part

from tacbench_cad.checks.identify import examine
from tacbench_cad.checks.verify import verify
from tacbench_cad.formats import FORMATS, format_of
from tacbench_cad.formats.step import read_step
from tacbench_cad.formats.stl import read_stl
from tacbench_cad.formats.threemf import read_3mf
from tacbench_cad.geometry.block_part import block_part
from tacbench_cad.spec.block import Block
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.files import LOCK_NAME, TEMPORARY_PREFIX, locked, remove_leftovers, replacing

READERS: dict[str, Callable[[Path], object]] = {"stl": read_stl, "3mf": read_3mf, "step": read_step}


#: The STL file of a box.
STL = b"x".ljust(80, b"\0") + struct.pack("<I", 12)
STL += b"".join(struct.pack("<12fH", 0, 0, 0, *points.ravel(), 0) for points in box_mesh().triangle_points)


def _with_count(count: int) -> bytes:
    return STL[:80] + struct.pack("<I", count) + STL[84:]


def _with_value(value: float) -> bytes:
    return STL[:96] + struct.pack("<f", value) + STL[100:]


def _threemf(old: bytes, new: bytes) -> bytes:
    """Return the 3MF file of a box with a change of its model."""
    return threemf(change=lambda model: model.replace(old, new, 1))


ASCII_STL = b"solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"

BAD: dict[str, tuple[str, Callable[[], bytes], str]] = {
    "stl empty": ("stl", lambda: b"", "empty"),
    "stl short": ("stl", lambda: b"short", "at least 84 bytes"),
    "stl header only": ("stl", lambda: STL[:84], "states 12 triangles, but the file contains 0"),
    "stl cut off": ("stl", lambda: STL[:-25], "states 12 triangles, but the file contains 11"),
    "stl count too high": ("stl", lambda: _with_count(13), "states 13 triangles, but the file contains 12"),
    "stl count too low": ("stl", lambda: _with_count(11), "an STL of 11 triangles has"),
    "stl count absurd": ("stl", lambda: _with_count(2**32 - 1), "states 4294967295"),
    "stl zero facets": ("stl", lambda: b"x".ljust(80, b"\0") + b"\0\0\0\0", "no triangles"),
    "stl NaN": ("stl", lambda: _with_value(float("nan")), "not a finite number"),
    "stl infinite": ("stl", lambda: _with_value(float("-inf")), "not a finite number"),
    "stl is a zip": ("stl", lambda: zip_of({"a": b"b" * 200}), "zip or 3MF"),
    "stl is a STEP": ("stl", lambda: step_of(""), "a STEP file"),
    "stl is text": ("stl", lambda: b"Dear reader,\n" * 30, "not an STL"),
    "stl is an image": ("stl", lambda: b"\x89PNG\r\n\x1a\n" + bytes(range(256)) * 3, "not an STL"),
    "ascii cut off": ("stl", lambda: ASCII_STL, "incomplete"),
    "ascii no facets": ("stl", lambda: b"solid a\nendsolid a\n", "no triangles"),
    "ascii lost corner": ("stl", lambda: ASCII_STL.replace(b"vertex 1 0 0\n", b"") + b"endsolid", "2 corners"),
    "ascii word": ("stl", lambda: ASCII_STL.replace(b"vertex 1", b"vertex one") + b"endsolid", "not a number"),
    "ascii NaN": ("stl", lambda: ASCII_STL.replace(b"vertex 1", b"vertex nan") + b"endsolid", "not a finite"),
    "ascii too large": ("stl", lambda: ASCII_STL.replace(b"vertex 1", b"vertex 1e99") + b"endsolid", "not a finite"),
    "3mf empty": ("3mf", lambda: b"", "empty"),
    "3mf is an STL": ("3mf", lambda: STL, "not a 3MF"),
    "3mf cut off": ("3mf", lambda: threemf()[:-40], "not a 3MF"),
    "3mf other zip": ("3mf", lambda: zip_of({"mimetype": b"application/epub+zip"}), "no 3MF model"),
    "3mf bomb": ("3mf", lambda: zip_of({"3D/3dmodel.model": b" " * 30_000_000}), "a 3MF model may be at most"),
    "3mf broken xml": ("3mf", lambda: threemf(change=lambda model: model[: len(model) // 2]), "refuses"),
    "3mf damaged": ("3mf", lambda: threemf().replace(b"PK\x03\x04", b"PK\x03\x05"), "3MF"),
    "3mf no triangles": ("3mf", lambda: threemf(item=""), "no triangles"),
    "3mf index out of range": ("3mf", lambda: _threemf(b'v1="0"', b'v1="99"'), "refuses"),
    "3mf NaN": ("3mf", lambda: _threemf(b'x="0.0"', b'x="nan"'), "refuses|finite"),
    "3mf infinite": ("3mf", lambda: _threemf(b'x="0.0"', b'x="1e60"'), "refuses|finite"),
    "3mf unknown element": ("3mf", lambda: _threemf(b"<build", b"<blob/><build"), "refuses|warns"),
    "step empty": ("step", lambda: b"", "empty"),
    "step is an STL": ("step", lambda: STL, "not a STEP file"),
    "step cut off": ("step", lambda: step_of("#1 = CARTESIAN_POINT('',(0.,")[:-28], "incomplete"),
    "step no shape": ("step", lambda: step_of(""), "no shape|cannot read"),
    "step garbage within": ("step", lambda: step_of("").replace(b"DATA;", b"\xff\x00" * 500), "STEP"),
}


def _need(form: str) -> None:
    if FORMATS[form].why_missing() is not None:
        pytest.skip(f"the packages for {form} files are not installed")


@pytest.mark.parametrize("name", BAD)
def test_a_bad_file_is_refused_in_one_line_and_reported_by_checks(name: str, tmp_path: Path) -> None:
    form, content, words = BAD[name]
    _need(form)
    path = tmp_path / f"a.{form}"
    path.write_bytes(content())
    with pytest.raises(CheckFailedError, match=words) as caught:
        READERS[form](path)
    assert caught.value.exit_code == 1
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)
    for report in (examine(path), verify(mesh_part(box_mesh()), path)):
        assert not report.ok and report.size_mm is None
        assert [check.name for check in report.checks] == ["file"]


@pytest.mark.parametrize("form", ["stl", "3mf", "step"])
def test_a_missing_file_and_a_folder_are_refused(form: str, tmp_path: Path) -> None:
    _need(form)
    (tmp_path / f"folder.{form}").mkdir()
    for name, words in (("missing", "No such file"), ("folder", "is a folder")):
        with pytest.raises(InputError, match=words) as caught:
            examine(tmp_path / f"{name}.{form}")
        assert caught.value.exit_code == 2


def test_an_unknown_file_ending_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.slt").write_bytes(STL)
    with pytest.raises(InputError, match=r"\.stl"):
        format_of(tmp_path / "a.slt")
    with pytest.raises(InputError, match="ending"):
        examine(tmp_path / "a.slt")


def test_a_step_file_with_two_solids_is_a_fault(tmp_path: Path) -> None:
    _need("step")
    from OCP.BRep import BRep_Builder
    from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox
    from OCP.gp import gp_Pnt
    from OCP.TopoDS import TopoDS_Compound

    from tacbench_cad.formats.step import write_shape

    both, builder = TopoDS_Compound(), BRep_Builder()
    builder.MakeCompound(both)
    builder.Add(both, BRepPrimAPI_MakeBox(1.0, 2.0, 3.0).Shape())
    builder.Add(both, BRepPrimAPI_MakeBox(gp_Pnt(5.0, 0.0, 0.0), 1.0, 2.0, 3.0).Shape())
    write_shape(both, "two", "Two boxes", tmp_path / "a.step")
    report = examine(tmp_path / "a.step")
    assert not report.ok
    assert "2 solids" in next(check.detail for check in report.faults if check.name == "one solid")


def test_a_step_file_with_only_a_face_is_a_fault(tmp_path: Path) -> None:
    _need("step")
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeFace
    from OCP.gp import gp_Pln

    from tacbench_cad.formats.step import write_shape

    write_shape(BRepBuilderAPI_MakeFace(gp_Pln(), 0.0, 1.0, 0.0, 1.0).Face(), "face", "A face", tmp_path / "a.step")
    assert "one solid" in {check.name for check in examine(tmp_path / "a.step").faults}


# --- files are written completely or not at all -------------------------------------------------------------------


def test_replacing_keeps_the_old_file_when_anything_goes_wrong(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("old")
    for error in (RuntimeError, KeyboardInterrupt, SystemExit):
        with pytest.raises(error), replacing(path) as temporary:
            temporary.write_text("half")
            raise error
    assert path.read_text() == "old"
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.txt"]
    with replacing(path) as temporary:
        assert temporary.suffix == ".txt"
        assert temporary.parent == tmp_path
        temporary.write_text("new")
        assert path.read_text() == "old"
    assert path.read_text() == "new"
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.txt"]


def test_replacing_refuses_a_path_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "a.stl").mkdir()
    with pytest.raises(InputError, match="is a folder"), replacing(tmp_path / "a.stl"):
        pass
    with pytest.raises(InputError, match="does not exist"), replacing(tmp_path / "no" / "a.stl"):
        pass
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="not a folder"), replacing(tmp_path / "file" / "a.stl"):
        pass


def _raise(code: int) -> None:
    raise OSError(code, os.strerror(code))


@pytest.mark.parametrize(
    ("code", "words"), [(errno.ENOSPC, "full"), (errno.EACCES, "not writable"), (errno.EROFS, "read-only")]
)
def test_a_full_or_unwritable_folder_is_named(code: int, words: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=words) as caught, replacing(tmp_path / "a.stl"):
        _raise(code)
    assert str(tmp_path) in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_locked_makes_the_folder_and_leaves_no_lock_file(tmp_path: Path) -> None:
    folder = tmp_path / "a" / "b"
    with locked(folder):
        (folder / "kept").write_text("")
    assert [entry.name for entry in folder.iterdir()] == ["kept"]
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="not a folder"), locked(tmp_path / "file"):
        pass


_HOLD = """
import sys, time
from pathlib import Path
from tacbench_cad.util.files import locked, replacing
with locked(Path(sys.argv[1])), replacing(Path(sys.argv[1]) / "a.stl") as path:
    path.write_text("half")
    print("held", flush=True)
    time.sleep(60)
"""


def test_a_second_process_is_refused_and_the_lock_of_a_killed_process_ends(tmp_path: Path) -> None:
    holder = subprocess.Popen([sys.executable, "-c", _HOLD, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    try:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        with pytest.raises(InputError, match="another tacbench"), locked(tmp_path):
            pass
        (left,) = tmp_path.glob(f"{TEMPORARY_PREFIX}*")
        assert left.name.endswith("-a.stl")
        remove_leftovers(tmp_path)
        assert left.read_text() == "half", "the process that writes this file is running"
        holder.send_signal(signal.SIGKILL)
        holder.wait(timeout=10)
        assert (tmp_path / LOCK_NAME).exists()  # the killed process leaves the file, but no lock on it
        with locked(tmp_path):
            assert not left.exists()
        assert list(tmp_path.iterdir()) == []
    finally:
        holder.kill()
        holder.wait()


def test_temporary_files_of_other_machines_are_deleted_after_a_day(tmp_path: Path) -> None:
    paths = [tmp_path / f"{TEMPORARY_PREFIX}{name}" for name in ("1-0123abcd-a.csv", "2-0123abcd-b.csv", "last.png")]
    for path in paths:
        path.touch()
    os.utime(paths[1], (0.0, time.time() - 25 * 3600.0))
    with locked(tmp_path):
        assert [path.exists() for path in paths] == [True, False, True]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
@pytest.mark.parametrize("form", ["stl", "3mf", "step"])
def test_a_full_device_is_refused(form: str, tmp_path: Path) -> None:
    _need(form)
    part = block_part(Block.of(2))
    link = tmp_path / f"link.{form}"
    link.symlink_to("/dev/full")
    with pytest.raises(InputError, match="output folder"), replacing(tmp_path / f"a.{form}"):
        FORMATS[form].write(part, link)
    assert not (tmp_path / f"a.{form}").exists()
