"""The manifest: the rows that it keeps and drops. Its bytes depend only on its rows."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tacbench_cad.making import manifest
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.files import MANIFEST_NAME, sha256


def row(folder: Path, name: str, content: str = "solid") -> dict[str, Any]:
    (folder / name).write_text(content)
    return {"file": name, "sha256": sha256(folder / name), "volume_mm3": 1.0 / 3.0}


def test_rows_are_read_back_in_the_order_of_their_names(tmp_path: Path) -> None:
    rows = [row(tmp_path, "b.stl"), row(tmp_path, "a.stl")]
    manifest.write_manifest(tmp_path, rows)
    assert manifest.read_rows(tmp_path) == [rows[1], rows[0]]


def test_the_same_rows_in_any_order_give_the_same_bytes(tmp_path: Path) -> None:
    rows = [row(tmp_path, name) for name in ("c.stl", "a.stl", "b.step")]
    first = manifest.write_manifest(tmp_path, rows).read_bytes()
    assert manifest.write_manifest(tmp_path, rows[::-1]).read_bytes() == first
    assert first.endswith(b"\n") and b"\r" not in first


def test_the_rows_of_changed_and_removed_files_are_dropped(tmp_path: Path) -> None:
    rows = [row(tmp_path, name) for name in ("kept.stl", "altered.stl", "removed.stl")]
    (tmp_path / "altered.stl").write_text("something else")
    (tmp_path / "removed.stl").unlink()
    assert [entry["file"] for entry in manifest.unchanged(tmp_path, rows)] == ["kept.stl"]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        '{"files": {}}',
        '{"schema": 1, "files": [{"file": "a.stl"}]}',
        '{"schema": 1, "files": [{"file": "../a.stl", "sha256": "0"}]}',
        '{"schema": 999, "files": []}',
    ],
)
def test_a_file_that_is_not_a_manifest_is_refused_and_kept(tmp_path: Path, text: str) -> None:
    path = tmp_path / MANIFEST_NAME
    path.write_text(text)
    with pytest.raises(InputError, match=r"manifest"):
        manifest.read_rows(tmp_path)
    assert path.read_text() == text


def test_the_old_manifest_is_kept_if_a_row_cannot_be_written(tmp_path: Path) -> None:
    path = manifest.write_manifest(tmp_path, [row(tmp_path, "a.stl")])
    before = path.read_bytes()
    with pytest.raises(ValueError, match="JSON"):
        manifest.write_manifest(tmp_path, [{"file": "b.stl", "sha256": "0", "volume_mm3": float("nan")}])
    assert path.read_bytes() == before
    assert sorted(file.name for file in tmp_path.iterdir()) == ["a.stl", "manifest.json"]


def test_the_manifest_contains_no_folder_and_no_time(tmp_path: Path) -> None:
    text = manifest.write_manifest(tmp_path, [row(tmp_path, "a.stl")]).read_text()
    assert str(tmp_path) not in text
    assert set(json.loads(text)) == {"schema", "units", "files"}
