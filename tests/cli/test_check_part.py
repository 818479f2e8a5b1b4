"""The command ``tacbench check-part``: correct files, messages about faults, and exit codes."""

from __future__ import annotations

import json
import struct
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from helpers.cases import mostly_long

from tacbench_cad.cli import main

Capture = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def block(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return an STL file of texture 3."""
    folder = tmp_path_factory.mktemp("made")
    assert main(["make", "--texture", "3", "--formats", "stl", "--parts", "blocks", "--out", str(folder)]) == 0
    return folder / "texture-3_paper_x1.stl"


def triangles(path: Path) -> np.ndarray:
    """Return the triangle records of the file, shape (n, 50) bytes."""
    data = path.read_bytes()
    return np.frombuffer(data[84:], dtype=np.uint8).reshape(-1, 50).copy()


def write(path: Path, records: np.ndarray) -> Path:
    path.write_bytes(bytes(80) + struct.pack("<I", len(records)) + records.tobytes())
    return path


def test_a_correct_file_passes_and_is_recognised(block: Path, capsys: Capture) -> None:
    assert main(["check-part", str(block)]) == 0
    out = capsys.readouterr().out
    assert "texture-3" in out and "all checks passed" in out and "FAULT" not in out
    assert out.endswith("\nNext: tacbench check-gcode FILE.gcode --texture T\n")


def test_json_holds_a_report_for_each_file(block: Path, capsys: Capture) -> None:
    assert main(["check-part", "--json", str(block), str(block)]) == 0
    out, err = capsys.readouterr()
    document = json.loads(out)
    assert err == "" and document["ok"] is True and document["refused"] == []
    assert [row["file"] for row in document["files"]] == [block.name] * 2
    assert document["files"][0]["size_mm"] == pytest.approx([23.3, 30.0, 7.0], abs=1e-5)


def test_an_open_edge_is_named_and_ends_with_1(block: Path, tmp_path: Path, capsys: Capture) -> None:
    path = write(tmp_path / "hole.stl", triangles(block)[1:])
    assert main(["check-part", str(path)]) == 1
    out = capsys.readouterr().out
    assert "FAULT" in out and "open edge" in out and "fault" in out.splitlines()[-1]


def test_the_wrong_texture_is_a_fault_with_its_distance(block: Path, capsys: Capture) -> None:
    assert main(["check-part", str(block), "--texture", "2", "--json"]) == 1
    (report,) = json.loads(capsys.readouterr().out)["files"]
    faults = [check for check in report["checks"] if not check["ok"]]
    assert any("mm" in check["detail"] for check in faults)


def test_one_bad_file_among_good_files(block: Path, tmp_path: Path, capsys: Capture) -> None:
    cut = tmp_path / "cut.stl"
    cut.write_bytes(block.read_bytes()[:5000])
    assert main(["check-part", str(block), str(cut), "--json"]) == 1
    reports = json.loads(capsys.readouterr().out)["files"]
    assert [report["ok"] for report in reports] == [True, False]


def spoilt(kind: str, good: bytes) -> bytes:
    nan = bytearray(good)
    nan[84 + 12 : 84 + 16] = struct.pack("<f", float("nan"))
    lie = good[:80] + struct.pack("<I", 4_000_000_000) + good[84:]
    return {"empty": b"", "text": b"a shopping list\n", "nan": bytes(nan), "lie": lie, "half": good[: len(good) // 2]}[
        kind
    ]


@pytest.mark.parametrize(
    ("kind", "suffix"),
    mostly_long(
        product(["empty", "text", "nan", "lie", "half"], [".stl", ".3mf", ".step"]),
        *[("text", ".stl"), ("half", ".3mf"), ("empty", ".step")],
    ),
)
def test_files_with_the_wrong_content(kind: str, suffix: str, block: Path, tmp_path: Path, capsys: Capture) -> None:
    if suffix != ".stl":
        pytest.importorskip({".3mf": "lib3mf", ".step": "OCP"}[suffix])
    path = tmp_path / f"file{suffix}"
    content = spoilt(kind, block.read_bytes())
    path.write_bytes(content)
    assert main(["check-part", str(path)]) == 1
    out, err = capsys.readouterr()
    assert "FAULT" in out and "Traceback" not in out + err
    assert path.read_bytes() == content
