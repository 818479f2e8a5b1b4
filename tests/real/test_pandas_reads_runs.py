"""A run folder, read as a user reads it: the table with pandas, the images with OpenCV, and as in tactile_learning."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("cv2")
pytest.importorskip("pandas")
import cv2
import pandas as pd

from tacbench_cad.extensions.exchange.exporting.tactile_data import export_tactile_data
from tacbench_cad.lab.rig.gauge import Force
from tacbench_cad.lab.runs.info import RunInfo
from tacbench_cad.lab.runs.run_writer import RunWriter
from tacbench_cad.lab.study.spec import HolderRim, PrintedBlock, Protocol, WorkFrame
from tacbench_cad.spec.block import Block

pytestmark = pytest.mark.real
START = datetime(2026, 1, 31, 12, 0, tzinfo=UTC)


def picture(number: int) -> np.ndarray:
    """Return a colour image with noise whose brightness depends on its number."""
    noise = np.random.default_rng(number).integers(0, 20, (48, 64, 3))
    return (noise + np.array([number, 2 * number % 200, 30])).astype(np.uint8)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a run with the 150 presses of the paper and small images."""
    info = RunInfo(
        printed=PrintedBlock(block=Block.of(6), printer="form-3", filament="grey-v4"),
        levels=(1, 2, 3),
        protocol=Protocol().changed(stationary_frames=0),
        grid_spacing="even",
        holder=HolderRim(),
        frame=WorkFrame(origin_mm=(0.0, 0.0, 0.0)),
        slot=0,
        stage={"simulated": "stage"},
        gauge={"simulated": ""},
        sensor={"name": "camera", "simulated": "", "units": "counts", "shape": (48, 64, 3)},
    )
    folder = tmp_path_factory.mktemp("runs") / "run"
    with RunWriter.open(folder, info, durable=False) as writer:
        writer.reference(picture(0), START)
        for press in info.presses:
            force = Force(mean_n=press.target_n or 0.0, spread_n=0.0, samples=1)
            when = START + timedelta(seconds=7 * press.number)
            pose = (press.x_mm, press.y_mm, -1.0)
            writer.press(press, pose, picture(press.number), force, None, True, when)
    return folder


def test_pandas_reads_the_table_with_its_types(folder: Path) -> None:
    table = pd.read_csv(folder / "targets.csv", parse_dates=["time_utc"])
    assert len(table) == 150
    assert table["in_band"].dtype == bool and table["in_band"].all()
    assert table["force_after_n"].isna().all()
    assert (table["time_utc"] - START).dt.total_seconds().tolist() == [7.0 * number for number in range(1, 151)]
    assert table["reference_age_s"].tolist() == [7.0 * number for number in range(1, 151)]
    means = table.groupby("force_level")["measured_force_n"].mean()
    assert means.tolist() == pytest.approx([0.08045, 1.91295, 3.0137])
    counts = table.groupby(["force_level", "repeat", "position"]).size()
    assert len(counts) == 150 and (counts == 1).all()
    assert sorted(table["pose_x"].unique()) == [4.0, 5.25, 6.5, 7.75, 9.0]


def test_the_export_is_read_as_in_tactile_learning(folder: Path, tmp_path: Path) -> None:
    export_tactile_data(folder, tmp_path / "data")
    table = pd.read_csv(tmp_path / "data" / "targets_images.csv")
    collect = json.loads((tmp_path / "data" / "collect_params.json").read_text())
    low, high = np.array(collect["pose_llims"]), np.array(collect["pose_ulims"])
    poses = table[collect["pose_label_names"]].to_numpy()
    assert ((low <= poses) & (poses <= high)).all()
    assert set(map(str, table["object_label"])) <= set(collect["object_poses"])
    for number, name in enumerate(table["sensor_image"], start=1):
        image = cv2.imread(str(tmp_path / "data" / "processed_images" / name))
        assert image.shape == (128, 128, 3)
        grey = cv2.cvtColor(picture(number)[:, 8:56], cv2.COLOR_BGR2GRAY)
        assert abs(float(image.mean()) - float(grey.mean())) < 1.0
