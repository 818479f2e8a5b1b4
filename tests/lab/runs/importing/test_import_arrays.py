"""Test the import of arrays with the labels of their frames."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.array_frames import frames, require_equal, stored, write_hdf5

from tacbench_cad.cli import main
from tacbench_cad.lab import ImportOptions, Run, import_samples


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
