"""Exported runs, read by the libraries of their formats: datasets, mlcroissant, webdataset, zarr."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("cv2")
os.environ.setdefault("HF_HUB_OFFLINE", "1")

from tacbench_cad.extensions.exchange.exporting.columns import COLUMNS
from tacbench_cad.extensions.exchange.exporting.export_formats import export_runs
from tacbench_cad.lab.runs.info import RunInfo
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.lab.runs.run_writer import RunWriter
from tacbench_cad.lab.study.spec import HolderRim, PrintedBlock, Protocol, WorkFrame
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.protocol import PressGrid

pytestmark = pytest.mark.real
TEXTURES = (2, 5)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write one run for each of two textures, with 8 colour images and without gauge values or times."""
    out = tmp_path_factory.mktemp("runs")
    for texture in TEXTURES:
        protocol = Protocol().changed(
            forces_n=(0.5, 1.0), bands_n=(0.1, 0.1), grid=PressGrid(x_mm=(4.0, 9.0), y_mm=(18.0,)), stationary_frames=0
        )
        info = RunInfo(
            printed=PrintedBlock(block=Block.of(texture), printer="form-3", filament="grey-v4"),
            levels=(1, 2),
            protocol=protocol,
            grid_spacing="own",
            holder=HolderRim(),
            frame=WorkFrame(origin_mm=(0.0, 0.0, 0.0)),
            slot=0,
            stage={"simulated": "stage model"},
            gauge={"simulated": ""},
            sensor={"name": "camera", "simulated": "", "units": "counts", "shape": (24, 32, 3)},
        )
        with RunWriter.open(out / info.printed.name, info, durable=False) as writer:
            for press in info.presses:
                image = np.random.default_rng(10 * texture + press.number).integers(0, 256, (24, 32, 3), np.uint8)
                writer.press(press, (press.x_mm, press.y_mm, -1.0), image, None, None, None, None)
    return out


@pytest.fixture(scope="module")
def frames(runs: Path) -> list[Any]:
    """Return the frames in the order of the export, in RGB."""
    opened = [Run.open(folder) for folder in sorted(runs.iterdir())]
    return [run.frame(row)[..., ::-1] for run in opened for row in sorted(run.rows, key=lambda row: row.number)]


@pytest.fixture(scope="module")
def hugging_face(runs: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("pyarrow")
    out = tmp_path_factory.mktemp("out") / "dataset"
    export_runs([runs], "huggingface", out)
    return out


def check_columns(dataset: Any, frames: list[Any]) -> None:
    assert dataset.num_rows == len(frames) == 16
    assert {"image", *(column.name for column in COLUMNS)} <= set(dataset.column_names)
    assert dataset["label"][:] == ["texture-2"] * 8 + ["texture-5"] * 8
    assert dataset["repeat"][:2] == [1, 2] or set(dataset["repeat"][:]) == {1, 2}
    assert set(dataset["measured_force_n"][:]) == set(dataset["time_utc"][:]) == {None}
    for row, frame in zip(dataset, frames, strict=True):
        assert np.array_equal(np.asarray(row["image"]), frame)


def test_datasets_loads_the_folder(hugging_face: Path, frames: list[Any], tmp_path: Path) -> None:
    datasets = pytest.importorskip("datasets")
    dataset = datasets.load_dataset(str(hugging_face), split="train", cache_dir=str(tmp_path))
    check_columns(dataset, frames)
    assert dataset.features["time_utc"].dtype == "timestamp[ms, tz=UTC]"
    assert dataset.features["repeat"].dtype == "int64"
    assert set(dataset["simulated"][:]) == {"stage: stage model"}


def test_datasets_loads_the_image_folder(runs: Path, frames: list[Any], tmp_path: Path) -> None:
    datasets = pytest.importorskip("datasets")
    export_runs([runs], "imagefolder", tmp_path / "out")
    arguments = {"data_dir": str(tmp_path / "out"), "split": "train", "cache_dir": str(tmp_path / "cache")}
    check_columns(datasets.load_dataset("imagefolder", **arguments), frames)


def test_mlcroissant_finds_nothing_wrong_and_reads_the_records(hugging_face: Path, frames: list[Any]) -> None:
    mlcroissant = pytest.importorskip("mlcroissant")
    dataset = mlcroissant.Dataset(jsonld=hugging_face / "croissant.json")
    assert list(dataset.metadata.ctx.issues.errors) == []
    records = list(dataset.records("frames"))
    assert len(records) == 16
    for record, frame in zip(records, frames, strict=True):
        assert np.array_equal(np.asarray(record["frames/image"]), frame)
    assert {record["frames/label"] for record in records} == {b"texture-2", b"texture-5"}
    document = json.loads((hugging_face / "croissant.json").read_text())
    assert "simulated" in document["keywords"]


def test_webdataset_reads_the_tar_files(runs: Path, frames: list[Any], tmp_path: Path) -> None:
    webdataset = pytest.importorskip("webdataset")
    export_runs([runs], "webdataset", tmp_path / "out")
    shards = [str(path) for path in sorted((tmp_path / "out").glob("*.tar"))]
    samples = list(webdataset.WebDataset(shards, shardshuffle=False).decode("rgb8"))
    assert [sample["__key__"] for sample in samples] == [f"{number:08d}" for number in range(1, 17)]
    for sample, frame in zip(samples, frames, strict=True):
        assert np.array_equal(sample["png"], frame)
        assert sample["json"]["printer"] == "form-3" and sample["json"]["time_utc"] is None


def test_zarr_reads_the_group(runs: Path, frames: list[Any], tmp_path: Path) -> None:
    zarr = pytest.importorskip("zarr")
    export_runs([runs], "zarr", tmp_path / "out")
    group = zarr.open_group(tmp_path / "out" / "frames.zarr", mode="r")
    assert np.array_equal(group["frames"][:], frames) and group["frames"].attrs["channels"] == "rgb"
    assert "measured_force_n" not in group
    assert group["printer"][:].tolist() == ["form-3"] * 16
