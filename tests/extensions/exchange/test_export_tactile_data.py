"""Test ``tacbench export-runs --to tactile-data``, whose output tactile_learning reads."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tacbench_cad.cli import main
from tacbench_cad.extensions.exchange.exporting.tactile_data import Processing, export_tactile_data
from tacbench_cad.lab.runs.frame_files import decoded
from tacbench_cad.lab.runs.run_writer import RunWriter
from tacbench_cad.util.errors import CheckFailedError, InputError

Capture = pytest.CaptureFixture[str]


def image_of(path: Path) -> Any:
    return decoded(path.read_bytes())


def test_images_table_and_parameters_have_the_paths_of_tactile_learning(run_folder: Path) -> None:
    assert export_tactile_data(run_folder) == 16
    with (run_folder / "targets_images.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 16
    for row in rows:
        assert image_of(run_folder / "processed_images" / row["sensor_image"]).shape == (128, 128)
        assert {"object_label", "pose_x", "pose_Rz", "shear_x", "shear_Rz"} <= set(row)
    assert image_of(run_folder / "processed_images" / "image_0.png").shape == (128, 128)
    collect = json.loads((run_folder / "collect_params.json").read_text())
    assert len(collect["pose_llims"]) == len(collect["pose_ulims"]) == len(collect["shear_llims"]) == 6
    assert set(collect["object_poses"]) == {row["object_label"] for row in rows}
    for name, low, high in zip(collect["pose_label_names"], collect["pose_llims"], collect["pose_ulims"], strict=True):
        assert all(low <= float(row[name]) <= high for row in rows)
    environment = json.loads((run_folder / "env_params.json").read_text())
    assert environment["robot"] == "sim"
    assert environment["work_frame"] == [80.0, 80.0, -60.0, 0.0, 0.0, 0.0]
    assert environment["work_frame_meaning"].startswith("x and y are the block's own")
    sensor = json.loads((run_folder / "sensor_image_params.json").read_text())
    assert (sensor["image_size"], sensor["gray"]) == ([32, 24], True)
    processed = json.loads((run_folder / "processed_image_params.json").read_text())
    assert processed["bbox"] == [4, 0, 28, 24]
    assert processed["dims"] == [128, 128]
    assert processed["simulated"] == ["stage: stage model"]


def test_an_export_to_another_folder_does_not_change_the_run(run_folder: Path, tmp_path: Path) -> None:
    before = sorted(path for path in run_folder.rglob("*") if path.name != ".tacbench-lock")
    export_tactile_data(run_folder, tmp_path / "out")
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "collect_params.json",
        "env_params.json",
        "processed_image_params.json",
        "processed_images",
        "sensor_image_params.json",
        "targets_images.csv",
    ]
    assert sorted(path for path in run_folder.rglob("*") if path.name != ".tacbench-lock") == before


def test_colours_become_grey_by_bt601_and_images_are_resized(tmp_path: Path) -> None:
    image = np.zeros((40, 60, 3), np.uint8)
    image[:, 30:] = (200, 100, 50)
    grey = Processing(bbox=(40, 10, 60, 30), size=(10, 10))(image)
    assert grey.shape == (10, 10)
    assert np.all(np.abs(grey - (0.114 * 200 + 0.587 * 100 + 0.299 * 50)) <= 1.0)
    assert Processing(size=(8, 8), grey=False)(image).shape == (8, 8, 3)


@pytest.mark.parametrize("bbox", [(0, 0, 0, 5), (5, 0, 2, 5), (-1, 0, 5, 5)])
def test_invalid_boxes_are_refused(bbox: tuple[int, int, int, int]) -> None:
    with pytest.raises(InputError, match="bbox"):
        Processing(bbox=bbox)


def test_a_changed_image_stops_the_export(run_folder: Path) -> None:
    path = run_folder / "sensor_images" / "image_3.png"
    path.write_bytes((run_folder / "sensor_images" / "image_4.png").read_bytes())
    with pytest.raises(CheckFailedError, match=r"image_3.png: was changed"):
        export_tactile_data(run_folder)
    assert not (run_folder / "targets_images.csv").exists()


def test_a_sensor_without_images_is_refused(tmp_path: Path, make_info: Any, filled: Any) -> None:
    with RunWriter.open(tmp_path / "run", make_info(shape=(16,))) as writer:
        filled(writer)
    with pytest.raises(InputError, match="is for sensors whose frames are images"):
        export_tactile_data(tmp_path / "run")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--to", "tactile_data"], 'did you mean "tactile-data"?'),
        (["--to", "tactile-data", "--size", "64"], "must be WxH"),
        (["--to", "tactile-data", "--size", "0x64"], "must be from 1x1"),
        (["--to", "tactile-data", "--bbox", "1,2,3"], "must be X0,Y0,X1,Y1"),
    ],
)
def test_invalid_options_are_refused(words: list[str], message: str, run_folder: Path, capsys: Capture) -> None:
    assert main(["export-runs", str(run_folder), *words]) == 2
    assert message in capsys.readouterr().err
