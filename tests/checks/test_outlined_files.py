"""Identification of files of blocks whose outlines are not rectangles."""

import json
from pathlib import Path

import numpy as np
import pytest

from tacbench_cad import Block, export
from tacbench_cad.checks.check import check
from tacbench_cad.formats.stl import read_stl
from tacbench_cad.spec.sampling import Tolerance
from tacbench_cad.spec.storage import block_values
from tacbench_cad.util.files import MANIFEST_NAME


def keep_in_manifest(path: Path, block: Block) -> None:
    """Write the manifest that states the block of an STL file, as ``tacbench make`` does."""
    row = {"file": path.name, "part": block.name, "sha256": "", "block": block_values(block)}
    (path.parent / MANIFEST_NAME).write_text(json.dumps({"files": [row]}))


@pytest.mark.parametrize(
    ("outline", "label", "suffix"),
    [("disc:30", True, ".stl"), ("ring:40,12", False, ".3mf"), ("hexagon:30", False, ".stl")],
)
def test_own_files_are_identified_with_their_outline(tmp_path, outline: str, label: bool, suffix: str) -> None:
    block = Block.of(2, outline=outline, label=label, sampling=Tolerance(mm=0.05))
    path = tmp_path / f"block{suffix}"
    assert export(block, path).ok
    if suffix == ".stl":
        keep_in_manifest(path, block)
    report = check(path)
    assert report.ok, str(report)
    assert [row.detail for row in report.checks if row.name == "outline"] == [str(block.outline)]


def test_the_outline_of_a_foreign_file_is_named(tmp_path) -> None:
    path = tmp_path / "block.stl"
    export(Block.of(2, outline="disc:30"), path)
    path.write_bytes(b"foreign".ljust(80) + path.read_bytes()[80:])
    rows = {row.name: row for row in check(path).checks}
    assert rows["outline"].ok and rows["outline"].detail == "disc of 30 mm"
    assert "key" not in rows and "sides" not in rows


def test_a_wall_beside_the_outline_is_a_fault(tmp_path) -> None:
    path, block = tmp_path / "block.stl", Block.of(2, outline="disc:30")
    export(block, path)
    keep_in_manifest(path, block)
    data = bytearray(path.read_bytes())
    triangles = np.frombuffer(data, dtype="<u1")[84:].reshape(-1, 50)
    points = triangles[:, 12:48].copy().view("<f4").reshape(-1, 3)
    left = points[:, 0] < 0.5
    points[left, 0] += 0.1
    triangles[:, 12:48] = points.reshape(-1, 9).view("<u1").reshape(-1, 36)
    path.write_bytes(data)
    assert len(read_stl(path).faces) == len(triangles)
    rows = {row.name: row for row in check(path).checks}
    assert not rows["outline"].ok
