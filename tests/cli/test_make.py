"""The command ``tacbench make``: one shared run with solids and fixtures, and several small runs."""

from __future__ import annotations

import contextlib
import io
import json
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from helpers.own_formulas import largest_distance, points_of, top_of, waves

from tacbench_cad import __version__
from tacbench_cad.checks.meshcheck import read_mesh
from tacbench_cad.checks.report import Check, Report
from tacbench_cad.cli import main
from tacbench_cad.making import writing as making

pytestmark = pytest.mark.usefixtures("no_preview")

Capture = pytest.CaptureFixture[str]
TACBENCH = (sys.executable, "-c", "import sys; from tacbench_cad.cli import main; sys.exit(main())")
LIGHT = ("--formats", "stl", "--parts", "blocks")


class Run(NamedTuple):
    folder: Path
    document: dict[str, Any]
    messages: str


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Make texture 1 with its holder in every format."""
    for module in ("build123d", "lib3mf", "matplotlib"):
        pytest.importorskip(module)
    folder = tmp_path_factory.mktemp("made") / "new" / "folder"
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        assert main(["make", "--texture", "1", "--parts", "blocks,holder", "--json", "--out", str(folder)]) == 0
    return Run(folder, json.loads(out.getvalue()), err.getvalue())


def test_every_part_exists_in_every_format(result: Run) -> None:
    parts = ("texture-1_paper_x1", "holder_paper_x1")
    files = {f"{part}{suffix}" for part in parts for suffix in (".stl", ".3mf", ".step")}
    assert {path.name for path in result.folder.iterdir()} == files | {"manifest.json", "preview.png"}
    assert {row["file"] for row in result.document["files"]} == files


def test_the_document_is_the_manifest(result: Run) -> None:
    document = json.loads((result.folder / "manifest.json").read_text())
    assert document["files"] == result.document["files"]
    assert result.document["ok"] is True and result.document["failed"] == [] and result.document["left_out"] == []
    assert result.document["preview"] == "preview.png" and result.document["version"] == __version__


def test_solids_deviate_by_1_and_meshes_by_10_micrometres_at_most(result: Run) -> None:
    for row in result.document["files"]:
        if row["kind"] == "block":
            limit = 0.001 if row["format"] == "step" else 0.01
            assert 0.0 < row["deviation_mm"] <= row["certificate"]["distance_mm"] <= limit * (1 + 1e-9)


def test_the_table_names_part_size_triangles_deviation_and_checks(tmp_path: Path, capsys: Capture) -> None:
    assert main(["make", *LIGHT, "--texture", "5", "--out", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    for word in (
        "file",
        "size (mm)",
        "triangles",
        "deviation (mm)",
        "checks",
        "texture-5_paper_x1.stl",
        "23.3 x 30 x 7",
    ):
        assert word in out
    (row,) = json.loads((tmp_path / "manifest.json").read_text())["files"]
    assert str(row["triangles"]) in out and f"{len(row['checks'])} passed" in out


def test_the_deviation_in_the_table_is_not_below_the_true_distance(tmp_path: Path, capsys: Capture) -> None:
    assert main(["make", *LIGHT, "--texture", "ripple", "--tolerance", "0.03", "--out", str(tmp_path)]) == 0
    (line,) = [line for line in capsys.readouterr().out.splitlines() if " passed" in line]
    (row,) = json.loads((tmp_path / "manifest.json").read_text())["files"]
    datum, (a, b, c) = row["spec"]["datum_mm"], row["spec"]["mm_per_unit"]
    formula = waves([(1.0, 1.0, 1.0, 0.0), (0.5, 2.0, -2.0, np.pi / 2.0)])
    distance, at = largest_distance(
        points_of(top_of(read_mesh(tmp_path / row["file"]).triangle_points)),
        lambda x, y: np.asarray(datum + c * formula(x / a, y / b)),
        row["spec"]["size_mm"],
        row["deviation_mm"],
    )
    printed = line.split()[-3]
    assert float(printed) >= distance, f"{printed} mm is printed, but {distance} mm was measured at {at}"


def test_brackets_and_colons_are_printed_unchanged(tmp_path: Path, capsys: Capture) -> None:
    folder = tmp_path / "[bold]:smile:"
    assert main(["make", *LIGHT, "--texture", "1", "--out", str(folder)]) == 0
    assert "[bold]:smile:" in capsys.readouterr().out


def test_parts_left_out_are_listed_and_are_not_a_failure(tmp_path: Path, capsys: Capture) -> None:
    pytest.importorskip("OCP")
    argv = ["make", "--texture", "6", "--preset", "released", "--formats", "stl,step", "--parts", "blocks"]
    assert main([*argv, "--out", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    assert "left out: texture-6_released_x1.step: " in out
    row = json.loads((tmp_path / "manifest.json").read_text())["files"][0]
    assert row["file"] == "texture-6_released_x1.stl"
    assert row["grid_to_formula"]["aliases"] is True and row["grid_to_formula"]["vertical_mm"] > 0.5


def test_a_failed_check_ends_with_1_and_names_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    def verify(part: object, path: Path, full: bool = False) -> Report:
        return Report(path=path, checks=(Check(name="closed", ok=False, detail="3 open edges"),))

    monkeypatch.setattr(making, "verify", verify)
    assert main(["make", *LIGHT, "--texture", "1", "--json", "--out", str(tmp_path)]) == 1
    out, err = capsys.readouterr()
    document = json.loads(out)
    assert document["ok"] is False and document["files"] == []
    assert document["failed"] == [{"file": "texture-1_paper_x1.stl", "faults": ["closed: 3 open edges"]}]
    assert "not written: texture-1_paper_x1.stl: closed: 3 open edges" in err
    assert list(tmp_path.iterdir()) == []


def test_the_full_checks_are_additional_checks(tmp_path: Path, capsys: Capture) -> None:
    pytest.importorskip("pymeshlab")
    counts = []
    for options in ((), ("--verify", "full")):
        assert main(["make", *LIGHT, "--texture", "1", "--json", "--out", str(tmp_path), *options]) == 0
        counts.append(len(json.loads(capsys.readouterr().out)["files"][0]["checks"]))
    assert counts[1] > counts[0]


@pytest.mark.usefixtures("two_processors")
@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_an_interruption_ends_with_130_and_leaves_nothing_unfinished(tmp_path: Path) -> None:
    pytest.importorskip("OCP")
    argv = (*TACBENCH, "make", "--texture", "all", "--parts", "blocks", "--out", str(tmp_path))
    with subprocess.Popen(argv, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        for line in process.stderr:
            if line.startswith("[2/"):
                process.send_signal(signal.SIGINT)
                break
        rest = process.stderr.read()
        process.wait()
    assert process.returncode == 130, rest
    assert "interrupted" in rest and "Traceback" not in rest
    assert not list(tmp_path.glob(".tacbench*"))
    listed = {row["file"] for row in json.loads((tmp_path / "manifest.json").read_text())["files"]}
    assert len(listed) >= 2
    assert listed <= {path.name for path in tmp_path.iterdir()}


@pytest.mark.parametrize(
    ("options", "name"),
    [
        (["--grid=9x9", "--key"], "texture-1_paper_x1_key3_grid9x9"),
        (["--size", "20,24", "--key", "2", "--grid", "--label"], "texture-1_paper_x1_20x24x7_key2_grid162x161_label"),
        (["--mm-per-unit", "2,2,1", "--tolerance", "0.05"], "texture-1_paper_x1_mm2x2x1_tol0.05"),
        (["--height", "6", "--copies", "1"], "texture-1_paper_x1_23.3x30x6_copy01"),
    ],
)
def test_options_reach_the_block(options: list[str], name: str, tmp_path: Path) -> None:
    assert main(["make", *LIGHT, "--texture", "1", "--out", str(tmp_path), *options]) == 0
    assert [path.stem for path in tmp_path.glob("*.stl")] == [name]
