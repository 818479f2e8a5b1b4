"""Test the layouts of public data sets: each frame is imported byte for byte, with everything that is said about it.

The sizes and the layouts are those of real data; the frames are noise.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.cases import mostly_long
from PIL import Image

from tacbench_cad.cli import main
from tacbench_cad.lab import ImportOptions, Run, find_runs, import_samples, read

Capture = pytest.CaptureFixture[str]
POSES = [f"pose_{number}" for number in range(1, 7)]
MOVES = [f"move_{number}" for number in range(1, 7)]


def noise(seed: int, *shape: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, shape, dtype=np.uint8)


def save(path: Path, seed: int, *shape: int, mode: str | None = None) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    image = Image.fromarray(noise(seed, *shape))
    (image.convert(mode) if mode else image).save(path)


def origins(out: Path) -> dict[str, tuple[Path, dict[str, str]]]:
    """Return the file of each imported frame and its row of ``source.csv``, by the name of the source's file."""
    found = {}
    for folder in find_runs([out]):
        run = Run.open(folder)
        with (folder / "source.csv").open(newline="", encoding="utf-8") as stream:
            table = {row["sensor_image"]: row for row in csv.DictReader(stream)}
        assert len(table) == len(run.rows) and run.origins == table
        for row in run.rows:
            run.frame(row, verify=True)
            origin = table[row.sensor_image]
            found[f"{origin['source_file']} {origin['source_frame']}".strip()] = (folder / row.path, origin)
    return found


def require_same_files(data: Path, out: Path, count: int) -> dict[str, dict[str, str]]:
    """Check that each imported file has the bytes of the file that it came from."""
    found = origins(out)
    assert len(found) == count
    for name, (path, _) in found.items():
        assert path.read_bytes() == (data.parent / name).read_bytes(), name
    return {name: origin for name, (_, origin) in found.items()}


def write_toolchain(folder: Path, images: str, count: int, seed: int, side: int = 128, mode: str | None = None) -> None:
    """Write a folder of an older TacTip toolchain."""
    rows = np.random.default_rng(seed).uniform(-5.0, 5.0, (count, 12)).round(6).tolist()
    for number in range(1, count + 1):
        save(folder / images / f"image_{number}.png", seed + number, side, side, mode=mode)
    with (folder / "targets.csv").open("w", newline="") as stream:
        table = csv.writer(stream)
        table.writerow(["sensor_image", "pose_id", *POSES, *MOVES, "remark"])
        table.writerows([f"image_{n}.png", n, *row, f"tap {n}, by hand"] for n, row in enumerate(rows, start=1))
    (folder / "meta.json").write_text(json.dumps({"robot": "abb", "num_poses": count}))


@pytest.mark.parametrize(
    ("images", "mode", "kind"),
    [("images", None, None), ("frames_bw", "1", "tactip"), ("frames", None, None), ("", None, "tactip")],
)
def test_an_older_folder_of_a_toolchain(images: str, mode: str | None, kind: str | None, tmp_path: Path) -> None:
    data = tmp_path / "csv_train"
    write_toolchain(data, images, 12, 1, mode=mode)
    columns = {"Rx": "pose_4", "Ry": "pose_5", "Rz": "pose_6", "x": "pose_1", "repeat": "pose_id"}
    report = import_samples([data], tmp_path / "out", ImportOptions(kind=kind, columns=columns))
    assert report.ok and [run.kind for run in report.runs] == ["a TacTip toolchain's folder"]
    require_same_files(data, tmp_path / "out", 12)
    with (data / "targets.csv").open(newline="") as stream:
        source = list(csv.DictReader(stream))
    run = Run.open(tmp_path / "out" / "unknown")
    for row, said in zip(run.rows, source, strict=True):
        origin = run.origins[row.sensor_image]
        assert Path(origin["source_file"]).name == said["sensor_image"] == origin["source_sensor_image"]
        assert {name: origin[name] for name in (*POSES, *MOVES, "remark")} == {
            name: said[name] for name in (*POSES, *MOVES, "remark")
        }
        turned = (row.pose_x, row.pose_y, row.pose_rx, row.pose_ry, row.pose_rz)
        assert turned == (float(said["pose_1"]), None, *(float(said[f"pose_{n}"]) for n in (4, 5, 6)))


@pytest.mark.parametrize(("deeper", "kind"), [("", "tactip"), ("tactip-127/edge2d", None)])
def test_several_such_folders_side_by_side(deeper: str, kind: Any, tmp_path: Path, capsys: Capture) -> None:
    data = tmp_path / "data"
    for seed, name in ((100, "csv_train"), (200, "csv_val")):
        write_toolchain(data / deeper / name, "frames_bw", 11, seed)
    (data / "meta.json").write_text("{}")
    words = ["import-frames", str(data), *(["--kind", kind] if kind else []), "-o", str(tmp_path / "out")]
    assert main(words) == 0
    assert "22 samples in 1 run" in capsys.readouterr().out
    names = {str(Path(name).parent) for name in require_same_files(data, tmp_path / "out", 22)}
    assert names == {str(Path("data", deeper, name, "frames_bw")) for name in ("csv_train", "csv_val")}


def test_images_beside_such_folders_are_reported(tmp_path: Path) -> None:
    write_toolchain(tmp_path / "data" / "csv_train", "images", 3, 1)
    save(tmp_path / "data" / "other" / "a.png", 1, 16, 16)
    (left_out,) = import_samples([tmp_path / "data"], tmp_path / "out").left_out
    assert left_out.where.endswith("a.png") and "not in a folder with a table of targets" in left_out.reason


def test_the_kind_without_its_table_is_one_clear_line(tmp_path: Path, capsys: Capture) -> None:
    save(tmp_path / "data" / "images" / "image_1.png", 1, 16, 16)
    words = ["import-frames", str(tmp_path / "data"), "--kind", "tactip", "-o", str(tmp_path / "out")]
    assert main(words) == 1
    assert "data: has no targets_images.csv or targets.csv" in capsys.readouterr().out


def test_two_folders_with_the_same_names_are_told_to_the_user(tmp_path: Path) -> None:
    write_toolchain(tmp_path / "data", "images", 3, 1)
    write_toolchain(tmp_path / "data", "frames_bw", 3, 50)
    report = import_samples([tmp_path / "data"], tmp_path / "out")
    assert report.ok
    assert "data: the images in images are used; images of the same names are in frames_bw" in report.notes
    assert set(require_same_files(tmp_path / "data", tmp_path / "out", 3)) == {
        f"data/images/image_{n}.png" for n in (1, 2, 3)
    }


#: The classes of public data sets: the number of classes, the suffix, the mode in Pillow, and the shape of an image.
CLASSES: dict[str, tuple[int, str, str | None, tuple[int, ...]]] = {
    "TacTip, thresholded": (4, ".png", "1", (128, 128)),
    "TacTip-127": (3, ".png", None, (256, 256)),
    "TacTip, four textures": (4, ".png", None, (300, 300)),
    "GelSight with dots": (10, ".png", None, (480, 640, 3)),
    "DIGIT": (15, ".jpg", None, (320, 240, 3)),
}


@pytest.mark.parametrize("name", mostly_long(CLASSES, "TacTip, thresholded", "DIGIT"))
def test_classes_beside_other_files(name: str, tmp_path: Path, capsys: Capture) -> None:
    count, suffix, mode, shape = CLASSES[name]
    data = tmp_path / "classes"
    for label in range(1, count + 1):
        for number in range(2):
            save(data / f"material_{label}" / f"frame_{number}{suffix}", 10 * label + number, *shape, mode=mode)
            (data / f"material_{label}" / f"frame_{number}_tracks.json").write_text("[]")
        np.save(data / f"material_{label}" / "labels.npy", np.zeros(2))
    (data / "README").write_text("Ten materials.")
    (data / ".DS_Store").write_bytes(b"\0")
    assert main(["import-frames", str(data), "-o", str(tmp_path / "out")]) == 0
    out, err = capsys.readouterr()
    note = f"classes: {3 * count + 1} other files not imported: {2 * count} .json, {count} .npy, 1 README"
    assert note in err and "left out" not in out.partition("sample")[2]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted(
        f"material_{label}" for label in range(1, count + 1)
    )
    places = [out.index(f" material_{label} ") for label in range(1, count + 1)]
    assert places == sorted(places), "material_2 before material_10"
    for origin in require_same_files(data, tmp_path / "out", 2 * count).values():
        assert set(origin) == {"sensor_image", "source_file", "source_frame"}


def test_a_damaged_image_among_other_files_is_still_a_failure(tmp_path: Path, capsys: Capture) -> None:
    for number in range(3):
        save(tmp_path / "classes" / "a" / f"{number}.png", number, 16, 16)
    (tmp_path / "classes" / "a" / "1.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    (tmp_path / "classes" / "a" / "meta.json").write_text("{}")
    assert main(["import-frames", str(tmp_path / "classes"), "-o", str(tmp_path / "out")]) == 1
    assert "1 left out" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("labels", "shape", "way"),
    [
        (lambda classes: classes, (19, 150), "folder"),
        (lambda classes: classes.astype(float), (6, 10, 75), "two files"),
        (lambda classes: classes[:, None], (19, 150), "one file"),
        (lambda classes: np.eye(20)[classes], (6, 10, 75), "folder"),
        (lambda classes: np.array([f"{label}" for label in classes]), (6, 10, 75), "one file"),
    ],
)
def test_arrays_with_an_array_of_labels(
    labels: Callable[[Any], Any], shape: tuple[int, ...], way: str, tmp_path: Path
) -> None:
    data = tmp_path / "biotac"
    data.mkdir()
    frames, classes = np.random.default_rng(0).normal(size=(40, *shape)), np.arange(40) % 20
    np.save(data / "X.npy", frames)
    np.save(data / "y.npy", labels(classes))
    (data / "README.md").write_text("Twenty textures.")
    paths = {"folder": [data], "two files": [data / "X.npy", data / "y.npy"], "one file": [data / "X.npy"]}[way]
    report = import_samples(paths, tmp_path / "out")
    assert report.ok, report.left_out
    assert [run.folder.name for run in report.runs] == [str(label) for label in range(20)]
    seen = {}
    for path, origin in ((path, origin) for path, origin in origins(tmp_path / "out").values()):
        seen[int(origin["source_frame"])] = (int(path.parent.parent.name), np.load(path))
        assert Path(origin["source_file"]).name == "X.npy"
    for index in range(40):
        label, frame = seen[index]
        assert label == classes[index] and np.array_equal(frame, frames[index])


def test_training_and_test_arrays_get_their_own_labels_and_numbers(tmp_path: Path) -> None:
    data = tmp_path / "data"
    data.mkdir()
    for name, count, label in (("train", 12, 1), ("test", 12, 2)):
        np.save(data / f"X_{name}.npy", np.full((count, 9, 9), label, np.uint8))
        np.save(data / f"y_{name}.npy", np.full(count, label))
    np.save(data / "pose_train.npy", np.arange(72.0).reshape(12, 6))
    report = import_samples([data], tmp_path / "out")
    assert report.ok, report.left_out
    for label in (1, 2):
        run = Run.open(tmp_path / "out" / str(label))
        assert {int(run.frame(row).max()) for row in run.rows} == {label} and len(run.rows) == 12
    run = Run.open(tmp_path / "out" / "1")
    assert [run.origins[row.sensor_image]["pose_train_6"] for row in run.rows] == [f"{6 * n + 5}.0" for n in range(12)]


def test_arrays_without_labels_need_the_kind(tmp_path: Path, capsys: Capture) -> None:
    np.save(tmp_path / "X.npy", noise(0, 6, 16, 16))
    assert main(["import-frames", str(tmp_path / "X.npy"), "-o", str(tmp_path / "out")]) == 1
    assert "import them without labels with --kind arrays" in capsys.readouterr().out
    assert main(["import-frames", str(tmp_path / "X.npy"), "--kind", "arrays", "-o", str(tmp_path / "out")]) == 0
    assert "6 samples in 1 run" in capsys.readouterr().out
    run = Run.open(tmp_path / "out" / "unknown")
    assert [np.array_equal(run.frame(row), noise(0, 6, 16, 16)[row.number - 1]) for row in run.rows] == [True] * 6


def test_the_kind_chooses_the_arrays_in_a_folder_with_images(tmp_path: Path) -> None:
    save(tmp_path / "data" / "plot.png", 1, 16, 16)
    np.save(tmp_path / "data" / "X.npy", noise(0, 6, 16, 16))
    np.save(tmp_path / "data" / "y.npy", np.arange(6) % 2)
    report = import_samples([tmp_path / "data"], tmp_path / "out", ImportOptions(kind="arrays"))
    assert report.ok and [(run.folder.name, run.imported) for run in report.runs] == [("0", 3), ("1", 3)]


def test_a_label_array_that_does_not_fit_is_left_out(tmp_path: Path) -> None:
    np.save(tmp_path / "X.npy", noise(0, 6, 16, 16))
    np.save(tmp_path / "y.npy", np.arange(5))
    report = import_samples([tmp_path / "X.npy", tmp_path / "y.npy"], tmp_path / "out")
    assert not report.runs and [Path(each.where).name for each in report.left_out] == ["X.npy", "y.npy"]
    np.save(tmp_path / "y.npy", np.array([{}] * 6), allow_pickle=True)
    report = import_samples([tmp_path / "X.npy", tmp_path / "y.npy"], tmp_path / "other")
    assert "pickled" in report.left_out[1].reason


def test_names_get_a_hash_only_if_they_would_be_the_same(tmp_path: Path) -> None:
    for number, label in enumerate(("material_1", "Filz grün", "a b", "a-b")):
        save(tmp_path / "classes" / label / "0.png", number, 16, 16)
    report = import_samples([tmp_path / "classes"], tmp_path / "out")
    names = {Run.open(run.folder).info.printed.texture: run.folder.name for run in report.runs}
    assert names["material_1"] == "material_1" and names["Filz grün"] == "Filz-grün"
    alike = {names["a b"], names["a-b"]}
    assert len(alike) == 2 and all(name.startswith("a-b_") for name in alike)
    assert len(read(tmp_path / "out")) == 4


def test_every_column_of_a_table_stays_with_its_frame(images: Any, table: Any, tmp_path: Path) -> None:
    header = ("image", "label", "gain_db", "operator", "remark", "source_file")
    rows = [(f"{n}.png", "cork", 1.25 * n, "Müller", 'said "no"\nin two lines', "camera 7") for n in range(4)]
    labels = table(tmp_path / "labels.csv", header, rows)
    report = import_samples([images(4), labels], tmp_path / "out")
    assert report.notes == (
        "labels.csv: image=image, label=label; kept in source.csv: gain_db, operator, remark, source_file",
    )
    run = Run.open(tmp_path / "out" / "cork")
    for row, said in zip(run.rows, rows, strict=True):
        origin = run.origins[row.sensor_image]
        assert [origin[name] for name in ("image", "label", "gain_db", "operator", "remark")] == list(
            map(str, said[:5])
        )
        assert origin["source_file"] == f"frames/{said[0]}" and origin["source_source_file"] == "camera 7"


def test_a_wrong_number_in_a_pose_leaves_the_frame_out(images: Any, table: Any, tmp_path: Path) -> None:
    labels = table(
        tmp_path / "labels.csv", ("image", "label", "pose_4"), [("0.png", "a", "1.5"), ("1.png", "a", "left")]
    )
    report = import_samples([images(2), labels], tmp_path / "out", ImportOptions(columns={"rx": "pose_4"}))
    assert [each.reason for each in report.left_out] == ["Rx = 'left' is not a number"]
