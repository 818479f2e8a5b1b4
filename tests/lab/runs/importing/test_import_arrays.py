"""Test the import of arrays, videos and Hugging Face data sets with the labels of their frames."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from PIL import Image

from tacbench_cad.cli import main
from tacbench_cad.lab import ImportOptions, Run, import_samples
from tacbench_cad.lab.runs.importing import arrays
from tacbench_cad.util.errors import InputError


def frames(count: int = 12) -> np.ndarray:
    return np.random.default_rng(0).integers(0, 256, (count, 16, 24, 3), dtype=np.uint8)


def require_equal(out: Path, array: Any) -> None:
    """Check that the frames of label a are the even ones and those of label b the odd ones."""
    for first, name in enumerate(("a", "b")):
        run = Run.open(out / name)
        assert len(run.rows) == len(array) // 2
        for row in run.rows:
            assert np.array_equal(stored(run, row), array[first + 2 * (row.number - 1)])


def stored(run: Run, row: Any) -> np.ndarray:
    """Read the file of a frame with Pillow or NumPy."""
    path = run.folder / row.path
    return np.load(path) if path.suffix == ".npy" else np.asarray(Image.open(path))


def write_hdf5(path: Path, **arrays: Any) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        for name, array in arrays.items():
            file.create_dataset(f"data/{name}", data=array)
        file.create_dataset(b"\xff", data=np.zeros(12))  # a name that is not UTF-8 is left out


def test_grey_images_with_a_last_axis_of_one_are_images(table: Any, tmp_path: Path) -> None:
    array = frames()[..., :1]
    np.save(tmp_path / "X.npy", array)
    table(tmp_path / "X.csv", ("label",), [("a",), ("b",)] * 6)
    assert import_samples([tmp_path / "X.npy"], tmp_path / "out").ok
    assert Run.open(tmp_path / "out" / "a").info.frame_shape == (16, 24)
    require_equal(tmp_path / "out", array[..., 0])


def test_a_region_in_runs_without_images_is_refused_with_the_reason(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    np.save(tmp_path / "X.npy", np.zeros((8, 6, 10, 75)))
    assert main(["import-frames", str(tmp_path / "X.npy"), "--kind", "arrays", "-o", str(tmp_path / "out")]) == 0
    assert main(["roi", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert "is only for images, but" in error and "has no readable image" in error


@pytest.mark.parametrize("suffix", [".npy", ".npz", ".hdf5"])
@pytest.mark.parametrize("kind", [np.uint8, np.float32])
def test_arrays_with_a_table(suffix: str, kind: Any, table: Any, tmp_path: Path) -> None:
    array = frames().astype(kind)
    path = tmp_path / f"X{suffix}"
    if suffix == ".npy":
        np.save(path, array)
    elif suffix == ".npz":
        np.savez_compressed(path, images=array, gain=np.ones(3))
    else:
        write_hdf5(path, images=array, gain=np.ones(3))
    table(tmp_path / "X.csv", ("label",), [("a",), ("b",)] * 6)
    report = import_samples([path], tmp_path / "out")
    assert report.ok, report.left_out
    require_equal(tmp_path / "out", array)


@pytest.mark.parametrize("suffix", [".npz", ".h5"])
def test_a_file_can_contain_the_labels_of_its_frames(suffix: str, tmp_path: Path) -> None:
    array, labels = frames(), np.array(["a", "b"] * 6)
    path = tmp_path / f"X{suffix}"
    if suffix == ".npz":
        np.savez(path, X=array, label=labels, position=np.arange(12) // 2)
    else:
        write_hdf5(path, X=array, label=[str(word) for word in labels], position=np.arange(12) // 2)
    columns = {} if suffix == ".npz" else {"label": "data/label", "position": "data/position"}
    report = import_samples([path], tmp_path / "out", ImportOptions(columns=columns))
    assert report.ok, report.left_out
    require_equal(tmp_path / "out", array)
    assert [row.position for row in Run.open(tmp_path / "out" / "a").rows] == [1, 2, 3, 4, 5, 6]


def test_rows_may_name_frames_by_their_index(table: Any, tmp_path: Path) -> None:
    np.save(tmp_path / "X.npy", frames())
    table(tmp_path / "X.csv", ("index", "label"), [(11, "a"), (0, "a"), (12, "a"), ("x", "a")])
    report = import_samples([tmp_path / "X.npy"], tmp_path / "out")
    assert [sample.reason for sample in report.left_out] == ["is not a frame of X.npy, which has 0 to 11"] * 2
    run = Run.open(tmp_path / "out" / "a")
    assert np.array_equal(stored(run, run.rows[0]), frames()[11])


def test_damaged_arrays_are_left_out(table: Any, tmp_path: Path) -> None:
    table(tmp_path / "a.csv", ("label",), [("a",)] * 12)
    np.save(tmp_path / "a.npy", frames(13))
    np.savez(tmp_path / "b.npz", X=np.array([{}, 1], dtype=object))
    np.savez(tmp_path / "c.npz", X=frames(), Y=frames())
    (tmp_path / "d.npz").write_bytes(b"PK\x03\x04 torn")
    np.save(tmp_path / "e.npy", np.arange(5))
    (tmp_path / "f.h5").write_bytes(b"\x89HDF\r\n\x1a\n torn")
    np.savez_compressed(tmp_path / "g.npz", X=frames())
    content = bytearray((tmp_path / "g.npz").read_bytes())
    content[content.index(b"X.npy") + 25] = 0xFF  # the first byte of the compressed array
    (tmp_path / "g.npz").write_bytes(content)
    names = ("a.npy", "b.npz", "c.npz", "d.npz", "e.npy", "g.npz")
    report = import_samples([tmp_path / name for name in names], tmp_path / "out")
    messages = (
        "a.csv = .*rows, but a.npy has 13|has 12 rows, but a.npy has 13 frames",
        "pickled objects",
        "--columns array=NAME",
        "not a complete .npz",
        "first axis must count",
        "not a complete .npz file: Error -3",
    )
    assert not report.runs and len(report.left_out) == len(messages)
    import re

    for sample, message in zip(report.left_out, messages, strict=True):
        assert re.search(message, sample.reason), sample
    pytest.importorskip("h5py")
    (left_out,) = import_samples([tmp_path / "f.h5"], tmp_path / "out").left_out
    assert "not a complete HDF5 file" in left_out.reason
    assert not (tmp_path / "out").exists()


def test_hdf5_with_external_links_is_left_out(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    (tmp_path / "secret").write_bytes(bytes(12 * 16 * 24))
    with h5py.File(tmp_path / "X.h5", "w") as file:
        where = [(str(tmp_path / "secret"), 0, h5py.h5f.UNLIMITED)]
        file.create_dataset("X", (12, 16, 24), dtype=np.uint8, external=where)
        file["other"] = h5py.ExternalLink("other.h5", "/X")
    (left_out,) = import_samples([tmp_path / "X.h5"], tmp_path / "out").left_out
    assert "is stored in other files" in left_out.reason


def test_an_hdf5_file_that_takes_too_long_is_read_no_further(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_hdf5(tmp_path / "X.h5", X=frames())
    source = arrays.opened(tmp_path / "X.h5")
    assert np.array_equal(source.frame(3), frames()[3])
    with monkeypatch.context() as patch:
        patch.setattr(arrays, "HDF5_LIMITS_S", (0.0, 0.0))
        for read in (lambda: source.frame(4), lambda: arrays.opened(tmp_path / "X.h5")):
            with pytest.raises(InputError, match=r"X\.h5.*takes the HDF5 library longer than 0 s; .*TACBENCH_LIMITS=2"):
                read()
    with pytest.raises(InputError, match="takes the HDF5 library longer"):
        source.frame(3)


@pytest.fixture
def video(tmp_path: Path) -> Path:
    """Write a video of two seconds with 10 frames per second, each of a single grey level."""
    path = tmp_path / "press.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (32, 24))
    if not writer.isOpened():
        pytest.skip("this build of OpenCV writes no videos")
    for number in range(20):
        writer.write(np.full((24, 32, 3), 10 * number, np.uint8))
    writer.release()
    return path


def test_frames_of_a_video_at_the_times_of_a_table(video: Path, table: Any, tmp_path: Path) -> None:
    rows = [("0", "a"), ("0.55", "a"), ("0.6", "b"), ("1.9", "a"), ("0.1", "a"), ("2.5", "a"), ("-1", "a"), ("x", "b")]
    times = table(tmp_path / "times.csv", ("time", "label"), rows)
    report = import_samples([video, times], tmp_path / "out")
    run = Run.open(tmp_path / "out" / "a")
    levels = [round(float(run.frame(row).mean()) / 10) for row in run.rows]
    assert levels == [0, 5, 19, 1]
    assert [sample.where.partition(" (")[0] for sample in report.left_out] == [
        "times.csv line 7",
        "times.csv line 8",
        "times.csv line 9",
    ]
    assert "has no frame at 2.5 s; its last frame is at 1.9 s" in report.left_out[0].reason


def test_a_table_names_several_videos(video: Path, table: Any, tmp_path: Path) -> None:
    (tmp_path / "torn.avi").write_bytes(b"RIFF")
    rows = [("press.avi", 1, "a"), ("torn.avi", 1, "a"), ("nowhere.avi", 1, "a"), ("../press.avi", 1, "a")]
    times = table(tmp_path / "times.csv", ("video", "time", "session"), rows)
    report = import_samples([times], tmp_path / "out")
    assert [run.imported for run in report.runs] == [1] and len(report.left_out) == 3
    assert Run.open(report.runs[0].folder).info.printed.session == "a"  # type: ignore[attr-defined]
    (left_out,) = import_samples([video], tmp_path / "other").left_out
    assert "needs a table of times" in left_out.reason


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
