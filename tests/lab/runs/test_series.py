"""Test the storage of series of moving frames: writing, reading, checking, resuming, and setting aside."""

from __future__ import annotations

import csv
import os
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.run_fixtures import START, picture

from tacbench_cad.cli import main
from tacbench_cad.extensions.exchange.publishing.crate import _copy_run
from tacbench_cad.lab.runs.checking import check_run
from tacbench_cad.lab.runs.info import RunInfo
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.lab.runs.run_writer import RunWriter
from tacbench_cad.lab.runs.series import MovingFrame
from tacbench_cad.lab.study.motion import MotionSettings
from tacbench_cad.lab.study.presses import Press
from tacbench_cad.util.errors import CheckFailedError, InputError

FRAMES = 3


def slide_info(info: RunInfo, **changes: Any) -> RunInfo:
    assert info.protocol is not None
    slide = MotionSettings(name="slide", frames=FRAMES, options={"length_mm": 2.0})
    changes = {"motion": slide, "stationary_frames": 0, **changes}
    return replace(info, protocol=info.protocol.changed(**changes))


def moving(press: Press, count: int = FRAMES, forces: bool = True) -> list[MovingFrame]:
    return [
        MovingFrame(
            frame=picture(1000 * press.number + index),
            time_s=50.0 + 0.2 * index,
            pose_mm=(press.x_mm, press.y_mm + index, -1.5),
            pose_from="reports",
            force_n=0.5 + 0.01 * index if forces else None,
        )
        for index in range(count)
    ]


def press_all(writer: RunWriter, presses: Sequence[Press] | None = None, forces: bool = True) -> None:
    if writer.reference_time is None:
        writer.reference(picture(0), START)
    for press in writer.missing(writer.info.presses) if presses is None else presses:
        when = START + timedelta(seconds=press.number)
        series = moving(press, forces=forces)
        writer.press(press, (press.x_mm, press.y_mm, -1.5), picture(press.number), time_utc=when, moving=series)


@pytest.fixture(scope="module")
def complete(tmp_path_factory: pytest.TempPathFactory, make_info: Callable[..., RunInfo]) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "slide"
    with RunWriter.open(folder, slide_info(make_info()), durable=False) as writer:
        press_all(writer)
    return folder


@pytest.fixture
def folder(tmp_path: Path, complete: Path) -> Path:
    return shutil.copytree(complete, tmp_path / "run")


def findings(folder: Path) -> set[tuple[str, str]]:
    return {(finding.kind, finding.where) for finding in check_run(folder, workers=1).findings}


def test_a_series_is_read_back_as_it_was_written(complete: Path) -> None:
    run = Run.open(complete)
    assert run.info.series_frames == FRAMES
    press = run.info.presses[4]
    series = run.series(run.by_key[press.force_level, press.repeat, press.position], verify=True)
    assert series.frames.shape == (FRAMES, 24, 32)
    np.testing.assert_array_equal(series.frames[2], picture(1000 * press.number + 2))
    np.testing.assert_allclose(series.time_s, [0.0, 0.2, 0.4])
    np.testing.assert_allclose(series.pose_mm, [(press.x_mm, press.y_mm + i, -1.5) for i in range(FRAMES)])
    assert series.force_n is not None
    np.testing.assert_allclose(series.force_n, [0.5, 0.51, 0.52])
    assert series.pose_from == "reports"


def test_the_table_has_the_columns_of_the_manual(complete: Path) -> None:
    with (complete / "series" / "press_7" / "series.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    pose = [f"pose_{name}" for name in "xyz"]
    assert list(rows[0]) == ["time_s", *pose, "force_n", "frame", "sha256"]
    assert [row["frame"] for row in rows] == ["frame_01.png", "frame_02.png", "frame_03.png"]


def test_a_series_without_a_gauge_has_no_forces(tmp_path: Path, make_info: Callable[..., RunInfo]) -> None:
    with RunWriter.open(tmp_path / "run", slide_info(make_info()), durable=False) as writer:
        press_all(writer, writer.info.presses[:1], forces=False)
    run = Run.open(tmp_path / "run")
    assert run.series(run.rows[0]).force_n is None


def test_a_run_without_motion_has_no_series_and_no_new_keys(complete_run: Path) -> None:
    run = Run.open(complete_run)
    assert run.info.series_frames == 0
    assert run.info.as_dict()["protocol"]["motion"] is None
    assert not (complete_run / "series").exists()
    with pytest.raises(InputError, match="has no series: its protocol has no motion"):
        run.series(run.rows[0])


def test_a_press_without_its_whole_series_is_refused(tmp_path: Path, make_info: Callable[..., RunInfo]) -> None:
    with RunWriter.open(tmp_path / "run", slide_info(make_info()), durable=False) as writer:
        press = writer.info.presses[0]
        for series in ((), moving(press, 2), moving(press)[::-1]):
            with pytest.raises(InputError, match="series"):
                writer.press(press, (4.0, 18.0, -1.5), picture(1), moving=series)
    assert not Run.open(tmp_path / "run").rows


def test_the_series_is_on_the_disk_before_the_row(
    tmp_path: Path, make_info: Callable[..., RunInfo], monkeypatch: pytest.MonkeyPatch
) -> None:
    events: list[str] = []
    real_fsync = os.fsync

    def fsync(handle: int) -> None:
        events.append(Path(f"/proc/self/fd/{handle}").readlink().name)
        real_fsync(handle)

    with RunWriter.open(tmp_path / "run", slide_info(make_info())) as writer:
        monkeypatch.setattr(os, "fsync", fsync)
        press_all(writer, writer.info.presses[:1])
    frames = [events.index(f"frame_0{index}.png") for index in (1, 2, 3)]
    table = next(index for index, name in enumerate(events) if "series.csv" in name)
    assert frames == sorted(frames)
    assert frames[-1] < table < events.index("series") < events.index("image_1.png") < events.index("targets.csv")


def test_an_interrupted_series_is_replaced(tmp_path: Path, make_info: Callable[..., RunInfo]) -> None:
    info = slide_info(make_info())
    with RunWriter.open(tmp_path / "run", info, durable=False) as writer:
        press_all(writer, info.presses[:2])
    left_over = tmp_path / "run" / "series" / "press_3"
    left_over.mkdir()
    (left_over / "frame_07.png").write_bytes(b"half a fra")
    assert ("extra", "series/press_3") in findings(tmp_path / "run")
    with RunWriter.open(tmp_path / "run", info, durable=False) as writer:
        press_all(writer)
    assert findings(tmp_path / "run") == set()
    assert check_run(tmp_path / "run", workers=1).series == len(info.presses)


def test_a_row_whose_series_is_lost_is_refused_on_resuming(folder: Path) -> None:
    shutil.rmtree(folder / "series" / "press_2")
    with (
        pytest.raises(InputError, match=r"press_2.*is missing, but targets\.csv has a row"),
        RunWriter.open(folder, Run.open(folder).info),
    ):
        pass


def test_presses_are_set_aside_with_their_series(folder: Path) -> None:
    with RunWriter.open(folder, Run.open(folder).info, durable=False) as writer:
        count = writer.position_check("end", (0.5, 0.0, 0.0), None, False, START + timedelta(hours=1))
        assert not writer.done
    assert not list((folder / "series").iterdir())
    aside = folder / "set_aside" / "01" / "series"
    assert len(list(aside.glob("press_*/series.csv"))) == count == 16
    assert len(list(aside.glob("press_*/frame_*.png"))) == FRAMES * count


def change(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        (lambda here: (here / "frame_02.png").unlink(), ("missing", "series/press_5/frame_02.png")),
        (lambda here: (here / "series.csv").unlink(), ("missing", "series/press_5/series.csv")),
        (lambda here: shutil.rmtree(here), ("missing", "series/press_5/series.csv")),
        (lambda here: (here / "frame_03.png").write_bytes(b"no"), ("unreadable", "series/press_5/frame_03.png")),
        (
            lambda here: shutil.copy(here / "frame_01.png", here / "frame_9.png"),
            ("extra", "series/press_5/frame_9.png"),
        ),
        (lambda here: change(here / "series.csv", "\n0.2,", "\n0.0,"), ("row", "series/press_5/series.csv")),
        (lambda here: change(here / "series.csv", "frame_02.png", "../x.png"), ("row", "series/press_5/series.csv")),
        (lambda here: shutil.copytree(here, here.parent / "press_99"), ("extra", "series/press_99")),
        (
            lambda here: shutil.copy(here.parent / "press_6" / "frame_01.png", here / "frame_01.png"),
            ("checksum", "series/press_5/frame_01.png"),
        ),
    ],
)
def test_faults_of_a_series_are_found(folder: Path, fault: Callable[[Path], object], expected: tuple[str, str]) -> None:
    assert findings(folder) == set()
    fault(folder / "series" / "press_5")
    assert expected in findings(folder)


def test_a_changed_frame_is_refused_when_it_is_read(folder: Path) -> None:
    shutil.copy(folder / "series" / "press_6" / "frame_01.png", folder / "series" / "press_5" / "frame_01.png")
    run = Run.open(folder)
    row = next(row for row in run.rows if row.number == 5)
    assert run.series(row).frames.shape == (FRAMES, 24, 32)
    with pytest.raises(CheckFailedError, match="was changed"):
        run.series(row, verify=True)


@pytest.mark.parametrize("to", ["npz", "tactile-data"])
def test_an_export_says_that_it_leaves_the_series_out(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], to: str
) -> None:
    assert main(["export-runs", "--to", to, str(folder), "--out", str(tmp_path / "exported")]) == 0
    assert "The series of moving frames after the presses are not included." in capsys.readouterr().out
    assert not list((tmp_path / "exported").rglob("frame_0*"))


def test_a_published_run_contains_its_series_and_checks_them(folder: Path) -> None:
    files = Run.open(folder).series_files()
    assert len(files) == FRAMES * 16 and "series/press_16/frame_03.png" in files
    (folder / "series" / "press_16" / "frame_03.png").write_bytes(b"changed")
    with pytest.raises(CheckFailedError, match=r"press_16/frame_03\.png: was changed"):
        _copy_run(Run.open(folder), folder.parent / "data", {}, lambda name, count, total: None)
