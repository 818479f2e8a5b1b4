"""Test the order of colours: what is red outside is red in the stored image and in every export."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from helpers.cases import mostly_long
from PIL import Image

from tacbench_cad.extensions.exchange.exporting.export_formats import export_runs
from tacbench_cad.lab import ImportOptions, Run, find_runs, import_samples

#: Red, green and blue of the lower half of every frame; the upper half is noise.
ORANGE = (250, 120, 10)


def frames(kind: Any = np.uint8, count: int = 6) -> np.ndarray:
    """Return frames of shape (count, 24, 32, 3) in RGB."""
    array = np.random.default_rng(3).integers(0, 256, (count, 24, 32, 3), dtype=np.uint8)
    array[:, 12:] = ORANGE
    return array.astype(kind)


def write(folder: Path, suffix: str, array: np.ndarray) -> Path:
    path = folder / f"X{suffix}"
    labels = ["a", "b"] * (len(array) // 2)
    if suffix == ".npy":
        np.save(path, array)
        np.save(folder / "y.npy", np.array(labels))
    elif suffix == ".npz":
        np.savez(path, X=array, y=np.array(labels))
    else:
        h5py = pytest.importorskip("h5py")
        with h5py.File(path, "w") as file:
            file["X"], file["y"] = array, labels
    return path


def stored(out: Path) -> list[np.ndarray]:
    """Read the stored files of all frames with Pillow or NumPy, in the order of the array."""
    runs = [Run.open(out / name) for name in ("a", "b")]
    paths = [
        run.folder / row.path
        for rows in zip(*(run.rows for run in runs), strict=True)
        for run, row in zip(runs, rows, strict=True)
    ]
    return [np.load(path) if path.suffix == ".npy" else np.asarray(Image.open(path)) for path in paths]


@pytest.mark.parametrize(
    ("channels", "suffix", "kind"),
    mostly_long(
        itertools.product(["rgb", "bgr"], [".npy", ".npz", ".h5"], [np.uint8, np.float32, np.uint16]),
        ("bgr", ".npy", np.uint8),
        ("rgb", ".npz", np.float32),
        ("bgr", ".h5", np.uint16),
    ),
)
def test_red_stays_red_on_the_way_in_and_out(channels: Any, suffix: str, kind: Any, tmp_path: Path) -> None:
    truth = frames(kind)
    path = write(tmp_path, suffix, truth if channels == "rgb" else truth[..., ::-1])
    report = import_samples([path], tmp_path / "out", ImportOptions(channels=channels))
    assert report.ok, report.left_out
    assert any(f"the order of the colours is {channels.upper()}" in note for note in report.notes)
    assert np.array_equal(stored(tmp_path / "out"), truth)
    export_runs([tmp_path / "out"], "npz", tmp_path / "exported")
    with np.load(tmp_path / "exported" / "frames.npz") as data:
        assert sorted(map(bytes, data["frames"])) == sorted(map(bytes, truth)) and data["frames"].dtype == kind
    assert "red, green, blue (RGB)" in (tmp_path / "exported" / "README.md").read_text()
    # The way back: an exported array is imported without a setting.
    again = import_samples(
        [tmp_path / "exported" / "frames.npz"], tmp_path / "again", ImportOptions(columns={"array": "frames"})
    )
    assert again.ok, again.left_out
    assert sorted(map(bytes, stored(tmp_path / "again"))) == sorted(map(bytes, truth))


def test_the_authors_arrays_are_blue_first(tmp_path: Path) -> None:
    truth = frames(count=25)
    path = tmp_path / "PLAminus_z0_P30_Bambu.npy"
    np.save(path, truth[..., ::-1])
    import_samples([path], tmp_path / "out")
    (folder,) = find_runs([tmp_path / "out"])
    assert [tuple(np.asarray(Image.open(folder / row.path))[20, 20]) for row in Run.open(folder).rows] == [ORANGE] * 25


def test_a_deep_image_file_becomes_an_array_in_rgb(tmp_path: Path) -> None:
    (tmp_path / "deep").mkdir()
    truth = frames(np.uint16)[0] * 256
    cv2.imwrite(str(tmp_path / "deep" / "a.png"), truth[..., ::-1])
    assert import_samples([tmp_path / "deep"], tmp_path / "out").ok
    assert np.array_equal(np.load(tmp_path / "out" / "unknown" / "sensor_data" / "reading_1.npy"), truth)


def test_an_array_of_a_hugging_face_data_set_is_in_rgb(tmp_path: Path) -> None:
    datasets = pytest.importorskip("datasets")
    datasets.disable_progress_bars()
    features = datasets.Features(image=datasets.Array3D((24, 32, 3), "uint8"), label=datasets.Value("string"))
    columns = {"image": list(frames()), "label": ["a", "b"] * 3}
    datasets.Dataset.from_dict(columns, features=features).save_to_disk(tmp_path / "set")
    assert import_samples([tmp_path / "set"], tmp_path / "out").ok
    assert np.array_equal(stored(tmp_path / "out"), frames())
    assert all(row.path.endswith(".png") for row in Run.open(tmp_path / "out" / "a").rows)
