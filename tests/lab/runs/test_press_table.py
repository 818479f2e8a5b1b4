"""Test the table of presses: of runs, of series, and of folders of images that were not imported."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest
from helpers.studies import GRID, WHEN, Frame, noise_image, write_study

from tacbench_cad import lab
from tacbench_cad.lab.runs.importing.importer import import_samples
from tacbench_cad.lab.runs.press_table import COLUMNS, read_frame, stationary
from tacbench_cad.util.errors import CheckFailedError, InputError


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("parent") / "study"
    write_study(folder, levels=(1, 3), simulated="a formula")
    return folder


def write_images(folder: Path, *names: str) -> None:
    """Write an image of its own for each name."""
    for number, name in enumerate(names):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(folder / name), np.full((6, 8), number, dtype=np.uint8))


def test_images_of_every_format_are_read_as_the_import_stores_them(tmp_path: Path) -> None:
    colours = np.random.default_rng(1).integers(0, 256, (12, 16, 3), dtype=np.uint8)
    opaque = np.dstack([colours, np.full((12, 16), 255, dtype=np.uint8)])
    folder = tmp_path / "frames" / "ridges"
    folder.mkdir(parents=True)
    written = {"a.PNG": colours, "b.jpeg": colours, "c.bmp": colours, "d.tif": colours, "e.TIFF": opaque}
    for name, image in written.items():
        cv2.imwrite(str(folder / name), image)
    presses = lab.read(folder.parent).sort_values("frame")
    report = import_samples([folder.parent], tmp_path / "runs")
    assert report.ok
    imported = {np.asarray(frame).tobytes() for frame in lab.iter_frames(lab.read(tmp_path / "runs"))}
    frames = dict(zip((Path(path).name for path in presses["frame"]), lab.iter_frames(presses), strict=True))
    assert frames.keys() == {*written}
    assert {frame.tobytes() for frame in frames.values()} == imported
    assert all(np.array_equal(frames[name], colours) for name in written if name != "b.jpeg")
    deep = tmp_path / "deep" / "bumps" / "a.tif"  # an array that is no image of 8 bits is stored in RGB
    deep.parent.mkdir(parents=True)
    cv2.imwrite(str(deep), colours.astype(np.uint16) * 257)
    assert np.array_equal(read_frame(deep), colours[..., ::-1].astype(np.uint16) * 257)
    opaque[0, 0, 3] = 7
    cv2.imwrite(str(folder / "e.TIFF"), opaque)
    with pytest.raises(CheckFailedError, match=r"e\.TIFF: has transparent pixels"):
        lab.frames(presses)


def test_every_press_has_a_row_with_the_facts_of_its_print(study: Path) -> None:
    presses = lab.read(study)
    assert tuple(presses.columns) == COLUMNS
    assert len(presses) == 8 * 2 * 2 * len(GRID.positions_mm)
    for index in (0, 17, len(presses) - 1):
        row = presses.iloc[index]
        run = lab.Run.open(Path(row["folder"]))
        press = run.info.presses[row["press"] - 1]
        assert (row["force_level"], row["repeat"], row["position"]) == (press.force_level, press.repeat, press.position)
        assert (row["pose_x"], row["pose_y"]) == (press.x_mm, press.y_mm)
        assert row["target_force_n"] == press.target_n and pd.isna(row["target_depth_mm"])
        printed = run.info.printed
        of_print = ("texture", "printer", "filament", "copy")
        assert [row[name] for name in of_print] == [getattr(printed, name) for name in of_print]
        assert (row["preset"], row["scale"], row["run"]) == ("paper", 1.0, printed.name)
        assert (row["sensor"], row["units"], row["contact"]) == ("test sensor", "counts", "force")
        assert Path(row["frame"]).is_absolute() and row["time_utc"] == WHEN
        assert np.array_equal(read_frame(row["frame"], row["folder"]), run.frame(run.rows[row["press"] - 1]))
    assert presses["planned"].all()


def test_simulated_data_are_marked_in_rows_and_attributes(study: Path, tmp_path: Path) -> None:
    presses = lab.read(study)
    assert set(presses["simulated"]) == {"sensor: a formula"}
    assert presses.attrs["simulated"] == ["sensor: a formula"]
    write_study(tmp_path, textures=(1,), copies=1)
    real = lab.read(tmp_path)
    assert real["simulated"].isna().all() and real.attrs["simulated"] == []


def test_the_same_runs_given_twice_are_read_once(study: Path) -> None:
    presses = lab.read(study)
    folders = sorted(study.iterdir())
    pd.testing.assert_frame_equal(lab.read([study.parent, *folders]), presses)
    assert set(lab.read(folders[:1])["folder"]) == {str(folders[0])}


def test_frames_are_read_in_the_order_of_the_table(study: Path) -> None:
    presses = lab.read(study)
    some = presses[(presses.texture == "texture-2") & (presses.force_level == 3) & (presses.position == 4)]
    assert len(some) == 2 * 2 * 2 and set(some["copy"]) == {1, 2}
    whole, small = lab.frames(some), lab.frames(some, size=(16, 12))
    assert whole.shape == (8, 24, 32) and small.shape == (8, 12, 16) and small.dtype == np.uint8
    assert all(np.array_equal(frame, read_frame(path)) for frame, path in zip(whole, some["frame"], strict=True))
    # At half the resolution, a pixel is the mean of four pixels.
    assert np.abs(small - whole.reshape(8, 12, 2, 16, 2).mean(axis=(2, 4))).max() <= 0.5
    assert np.array_equal(next(lab.iter_frames(some)), whole[0])


def test_a_damaged_frame_is_reported_when_it_is_read(tmp_path: Path) -> None:
    (folder, *_) = write_study(tmp_path, textures=(1,), copies=1)
    presses = lab.read(folder)
    (folder / "sensor_images" / "image_3.png").write_bytes(b"no picture")
    with pytest.raises(CheckFailedError, match=r"image_3\.png"):
        lab.frames(presses)
    (folder / "sensor_images" / "image_3.png").unlink()
    (folder / "sensor_images" / "image_3.png").symlink_to(tmp_path / "elsewhere.png")
    with pytest.raises(CheckFailedError, match=r"image_3\.png"):
        read_frame(presses["frame"][2], folder)


def test_a_table_of_series_has_a_row_for_each_moving_frame(tmp_path: Path) -> None:
    def moving(printed: object, press: object, index: int, rng: np.random.Generator) -> Frame:
        return np.full((24, 32), 10 * index, dtype=np.uint8)

    write_study(tmp_path, textures=(1,), copies=1, moving=moving, moving_force=lambda *_: 0.5)
    series = lab.read(tmp_path, series=True)
    presses = lab.read(tmp_path)
    assert len(series) == 4 * len(presses)
    first = series[:4]
    assert first["step"].tolist() == [1, 2, 3, 4] and first["press"].nunique() == 1
    assert first["time_s"].tolist() == pytest.approx([0.0, 0.1, 0.2, 0.3])
    assert (first["pose_y"] - first["pose_y"].iloc[0]).tolist() == pytest.approx([0.0, 0.5, 1.0, 1.5])
    assert set(series["measured_force_n"]) == {0.5}
    assert [int(frame[0, 0]) for frame in lab.iter_frames(first)] == [0, 10, 20, 30]
    assert len(lab.read(tmp_path, series=True, frames=3)) == 3 * len(presses)
    with pytest.raises(InputError, match="must be from 1 to 4"):
        lab.read(tmp_path, series=True, frames=5)


def test_stationary_frames_are_a_table_too(study: Path) -> None:
    still = stationary(lab.read(study))
    assert len(still) == 8 * 6 and set(still["when"]) == {"start", "end"} and still["in_contact"].all()
    assert read_frame(still["frame"][0]).shape == (24, 32)


def test_images_in_a_folder_for_each_class_need_no_import(tmp_path: Path) -> None:
    write_images(tmp_path, "cork/a.png", "cork/b.png", "felt/a.png")
    presses = lab.read(tmp_path)
    assert presses["texture"].tolist() == ["cork", "cork", "felt"]
    assert [Path(path).name for path in presses["frame"]] == ["a.png", "b.png", "a.png"]
    assert lab.frames(presses)[:, 0, 0].tolist() == [0, 1, 2]
    unknown = ("printer", "filament", "copy", "position", "force_level", "target_force_n", "pose_x", "simulated")
    assert presses[[*unknown, "folder", "contact"]].isna().all(axis=None)
    assert not presses["planned"].any()


def test_images_with_a_table_need_no_import(tmp_path: Path) -> None:
    write_images(tmp_path, "1.png", "2.png", "3.png")
    rows = ["file,label,force_n,printer,copy", "1.png,cork,1.5,mk4,1", "2.png,felt,1.5,mk4,1", "3.png,felt,,mk4,2"]
    (tmp_path / "labels.csv").write_text("\n".join(rows), encoding="utf-8")
    presses = lab.read(tmp_path).sort_values("frame", ignore_index=True)
    assert presses["texture"].tolist() == ["cork", "felt", "felt"]
    assert presses["printer"].tolist() == ["mk4"] * 3
    assert presses["target_force_n"].isna().tolist() == [False, False, True]


@pytest.mark.parametrize("name", ["nowhere", "empty", "file"])
def test_a_folder_without_presses_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=name):
        lab.read(tmp_path / name)


def test_series_that_do_not_exist_are_refused(study: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="has no series of frames"):
        lab.read(study, series=True)
    write_images(tmp_path, "cork/a.png", "felt/a.png")
    with pytest.raises(InputError, match="folder of images, not of runs"):
        lab.read(tmp_path, series=True)


def test_frames_of_different_shapes_are_refused(tmp_path: Path) -> None:
    write_study(tmp_path, textures=(1,), copies=1, image=noise_image)
    presses = lab.read(tmp_path)
    cv2.imwrite(presses["frame"][1], np.zeros((4, 4), dtype=np.uint8))
    with pytest.raises(CheckFailedError, match=r"has shape \(4, 4\), but the first frame has \(24, 32\)"):
        lab.frames(presses)
