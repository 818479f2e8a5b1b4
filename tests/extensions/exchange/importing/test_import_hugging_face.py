"""Test the import of Hugging Face data sets."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tacbench_cad.lab import Run, import_samples


def test_a_hugging_face_data_set(tmp_path: Path, noise: Any) -> None:
    datasets = pytest.importorskip("datasets")
    files = []
    for number in range(6):
        files.append(str(tmp_path / f"{number}.png"))
        cv2.imwrite(files[-1], noise(number))
    features = datasets.Features(
        picture=datasets.Image(), label=datasets.ClassLabel(names=["cork", "felt"]), print=datasets.Value("int32")
    )
    columns = {"picture": files, "label": [0, 1] * 3, "print": [1, 1, 2, 2, 3, None]}
    datasets.DatasetDict(train=datasets.Dataset.from_dict(columns, features=features)).save_to_disk(tmp_path / "set")
    report = import_samples([tmp_path / "set"], tmp_path / "out")
    assert report.ok and sorted(run.folder.name for run in report.runs) == [
        *(f"cork_copy0{copy}" for copy in (1, 2, 3)),
        *("felt", "felt_copy01", "felt_copy02"),
    ]
    run = Run.open(tmp_path / "out" / "cork_copy02")
    assert np.array_equal(run.frame(run.rows[0]), noise(2))


def test_lists_and_file_names_of_a_hugging_face_data_set_are_kept(tmp_path: Path, noise: Any) -> None:
    datasets = pytest.importorskip("datasets")
    datasets.disable_progress_bars()
    for number in range(2):
        cv2.imwrite(str(tmp_path / f"tap {number}.png"), noise(number, (16, 16)))
    columns = {
        "image": [str(tmp_path / f"tap {number}.png") for number in range(2)],
        "label": ["a", "a"],
        "pose": [[0.5, 1.0, 2.0], [1.5, 1.0, 2.0]],
    }
    data = datasets.Dataset.from_dict(columns).cast_column("image", datasets.Image())
    data.save_to_disk(tmp_path / "set")
    assert import_samples([tmp_path / "set"], tmp_path / "out").ok
    run = Run.open(tmp_path / "out" / "a")
    said = [run.origins[row.sensor_image] for row in run.rows]
    assert [origin["pose"] for origin in said] == ["[0.5, 1.0, 2.0]", "[1.5, 1.0, 2.0]"]
    assert [origin["image"] for origin in said] == ["tap 0.png", "tap 1.png"]
    assert [(origin["source_file"], origin["source_frame"]) for origin in said] == [("set", "0"), ("set", "1")]
