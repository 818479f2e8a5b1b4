"""Test the writing of runs: the layout, the order of writes to the disk, and resuming after interruptions."""

from __future__ import annotations

import csv
import errno
import json
import os
import random
import signal
import stat
import subprocess
import sys
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tacbench_cad.lab.rig.errors import RigError
from tacbench_cad.lab.runs import run_tables
from tacbench_cad.lab.runs.checking import check_run
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.lab.runs.run_writer import RunWriter
from tacbench_cad.util.errors import InputError

NOW = datetime(2026, 1, 31, 12, 0, tzinfo=UTC)


def rows_of(folder: Path) -> list[dict[str, str]]:
    with (folder / "targets.csv").open(newline="") as stream:
        return list(csv.DictReader(stream))


def name_of(handle: int) -> str:
    """Return the name of an open file."""
    return Path(f"/proc/self/fd/{handle}").readlink().name


def test_a_run_folder_has_its_files_and_columns(run_folder: Path) -> None:
    images = {path.name for path in (run_folder / "sensor_images").iterdir()}
    assert images == {f"image_{number}.png" for number in range(17)}
    assert json.loads((run_folder / "run.json").read_text())
    assert len(list((run_folder / "stationary").glob("*.png"))) == 8
    head = (run_folder / "targets.csv").read_text().splitlines()[0]
    assert head == (
        "sensor_image,pose_x,pose_y,pose_z,position,force_level,repeat,target_force_n,in_band,measured_force_n,"
        "force_after_n,time_utc,reference_age_s,image_sha256"
    )


def test_run_json_describes_the_run(run_folder: Path) -> None:
    document = json.loads((run_folder / "run.json").read_text())
    assert (document["schema"], document["version"]) == ("tacbench-run", 3)
    assert document["simulated"] == ["stage: stage model"]
    assert document["protocol"]["positions"]["grid"] == {"x_mm": [4.0, 9.0], "y_mm": [18.0, 23.0]}
    assert document["holder"]["rim_mm"] == 1.18
    assert document["gauge"]["calibration"] == {"scale_n_per_count": 0.001}
    assert document["sensor"]["settings"]["requested"] == {"exposure": 5}
    assert document["sessions"][0]["software"]["numpy"] == np.__version__


def test_a_row_contains_all_data_of_its_press(run_folder: Path) -> None:
    row = rows_of(run_folder)[2]
    assert row == {
        "sensor_image": "image_3.png",
        "pose_x": "4.0",
        "pose_y": "23.0",
        "pose_z": "-1.5",
        "position": "3",
        "force_level": "1",
        "target_force_n": "0.5",
        "measured_force_n": "0.53",
        "force_after_n": "0.53",
        "in_band": "false",
        "repeat": "1",
        "time_utc": "2026-01-31T12:00:03.000Z",
        "image_sha256": row["image_sha256"],
        "reference_age_s": "3.0",
    }


def test_images_are_synced_before_rows_and_rows_before_the_next_press(
    tmp_path: Path, make_info: Any, noise: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    events: list[str] = []
    real_fsync, real_write = os.fsync, os.write

    def fsync(handle: int) -> None:
        events.append(f"sync {name_of(handle)}")
        real_fsync(handle)

    def write(handle: int, data: bytes) -> int:
        events.append(f"write {name_of(handle)}")
        return real_write(handle, data)

    if not Path("/proc/self/fd").is_dir():
        pytest.skip("the test needs /proc to observe the order of writes")
    info = make_info()
    with RunWriter.open(tmp_path / "run", info) as writer:
        monkeypatch.setattr(os, "fsync", fsync)
        monkeypatch.setattr(os, "write", write)
        writer.press(info.presses[0], (4.0, 18.0, -1.0), noise(1))
        monkeypatch.undo()
    assert events == ["sync image_1.png", "sync sensor_images", "write targets.csv", "sync targets.csv"]


def test_simulated_studies_skip_the_syncs(
    tmp_path: Path, make_info: Any, noise: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    info = make_info()
    with RunWriter.open(tmp_path / "run", info, durable=False) as writer:
        monkeypatch.setattr(os, "fsync", lambda _: pytest.fail("synced"))
        writer.press(info.presses[0], (4.0, 18.0, -1.0), noise(1))
        monkeypatch.undo()


def test_a_run_is_resumed_at_the_first_missing_press(tmp_path: Path, make_info: Any, filled: Any) -> None:
    info = make_info()
    with RunWriter.open(tmp_path / "run", info) as writer:
        filled(writer, count=5)
    before = rows_of(tmp_path / "run")
    with RunWriter.open(tmp_path / "run", make_info()) as writer:
        assert writer.done == {1, 2, 3, 4, 5}
        assert [press.number for press in writer.missing(info.presses)] == list(range(6, 17))
        assert writer.stationary_missing("start", True, 3) == (3,)
        assert writer.reference_time is not None
        filled(writer)
    after = rows_of(tmp_path / "run")
    assert after[:5] == before
    assert [row["sensor_image"] for row in after] == [f"image_{number}.png" for number in range(1, 17)]
    assert check_run(tmp_path / "run").ok


def test_no_press_is_stored_twice(tmp_path: Path, make_info: Any, noise: Any) -> None:
    info = make_info()
    with RunWriter.open(tmp_path / "run", info) as writer:
        writer.press(info.presses[0], (4.0, 18.0, -1.0), noise(1))
        with pytest.raises(InputError, match="press = 1: is already in the run"):
            writer.press(info.presses[0], (4.0, 18.0, -1.0), noise(2))
        writer.stationary("start", False, 1, noise(3))
        with pytest.raises(InputError, match="is already in the run"):
            writer.stationary("start", False, 1, noise(4))
    assert len(rows_of(tmp_path / "run")) == 1


def test_a_frame_of_another_shape_is_refused_before_anything_is_written(
    tmp_path: Path, make_info: Any, noise: Any
) -> None:
    info = make_info()
    with RunWriter.open(tmp_path / "run", info) as writer:
        with pytest.raises(RigError, match=r"\(9, 9\).*\(24, 32\)"):
            writer.press(info.presses[0], (4.0, 18.0, -1.0), noise(1, (9, 9)))
        assert not list((tmp_path / "run" / "sensor_images").iterdir())


@pytest.mark.parametrize("keep", [1, 40, 120, -1])
def test_an_incomplete_last_row_is_removed_and_reported(
    keep: int, run_folder: Path, make_info: Any, filled: Any
) -> None:
    path = run_folder / "targets.csv"
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join(lines[:-1]) + lines[-1][:keep])
    with RunWriter.open(run_folder, make_info()) as writer:
        assert "targets.csv: removed an incomplete last row" in writer.notes[0]
        assert [press.number for press in writer.missing(writer.info.presses)] == [16]
        filled(writer)
    assert check_run(run_folder).ok


def test_zero_bytes_after_a_power_cut_count_as_incomplete(run_folder: Path, make_info: Any) -> None:
    path = run_folder / "targets.csv"
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join(lines[:-1]) + lines[-1][:50] + bytes(200))
    with RunWriter.open(run_folder, make_info()) as writer:
        assert [press.number for press in writer.missing(writer.info.presses)] == [16]


def test_other_settings_are_refused_and_reported(run_folder: Path, make_info: Any) -> None:
    other = make_info(sensor={"settings": {"requested": {"exposure": 7}, "actual": {"exposure": 5}}})
    before = {path: path.read_bytes() for path in run_folder.rglob("*") if path.is_file()}
    with (
        pytest.raises(InputError, match=r"sensor.settings.requested.exposure was 5, is now 7"),
        RunWriter.open(run_folder, other),
    ):
        pass
    assert {path: path.read_bytes() for path in run_folder.rglob("*") if path.is_file()} == before


def test_a_second_process_is_refused(run_folder: Path, make_info: Any) -> None:
    with (
        RunWriter.open(run_folder, make_info()),
        pytest.raises(InputError, match="another tacbench is writing to it"),
        RunWriter.open(run_folder, make_info()),
    ):
        pass


def test_a_users_print_record_is_never_overwritten(run_folder: Path, make_info: Any) -> None:
    path = run_folder / "print.toml"
    path.write_text('printer = "mine"\n')
    with RunWriter.open(run_folder, make_info()):
        pass
    assert path.read_text() == 'printer = "mine"\n'


def test_a_later_session_with_other_devices_is_recorded(run_folder: Path, make_info: Any) -> None:
    stage = {**make_info().stage, "identity": "virtual GRBL on /dev/pts/9"}
    for _ in range(2):
        with RunWriter.open(run_folder, make_info(stage=stage)):
            pass
    sessions = json.loads((run_folder / "run.json").read_text())["sessions"]
    assert [session["devices"]["stage"][-1] for session in sessions] == ["3", "9"]


def test_later_references_have_their_own_files_and_name_the_press_before(
    tmp_path: Path, make_info: Any, noise: Any
) -> None:
    info = make_info()
    with RunWriter.open(tmp_path / "run", info) as writer:
        writer.reference(noise(0), NOW)
        writer.press(info.presses[0], (4.0, 18.0, -1.0), noise(1))
        writer.reference(noise(2), NOW)
    run = Run.open(tmp_path / "run")
    assert [(reference.path, reference.after_press) for reference in run.references] == [
        ("sensor_images/image_0.png", 0),
        ("references/reference_1.png", 1),
    ]
    assert np.array_equal(run.reference(), noise(0))
    assert np.array_equal(run.reference(1), noise(2))


def test_frames_that_are_not_images_are_stored_as_arrays(tmp_path: Path, make_info: Any, filled: Any) -> None:
    info = make_info(shape=(16,))
    with RunWriter.open(tmp_path / "run", info) as writer:
        filled(writer)
    assert rows_of(tmp_path / "run")[0]["sensor_image"] == "reading_1.npy"
    assert (tmp_path / "run" / "sensor_data" / "reading_0.npy").is_file()
    run = Run.open(tmp_path / "run")
    assert run.frame(run.rows[4], verify=True).shape == (16,)
    assert check_run(tmp_path / "run").ok


def test_a_large_array_of_taxels_is_not_an_image(tmp_path: Path, make_info: Any) -> None:
    info = make_info(shape=(16, 24))
    taxels = np.linspace(0.0, 1.0, 16 * 24).reshape(16, 24)
    with RunWriter.open(tmp_path / "run", info) as writer:
        writer.reference(taxels, NOW)
        writer.press(info.presses[0], (4.0, 18.0, -1.0), taxels + 0.5)
    run = Run.open(tmp_path / "run")
    assert (tmp_path / "run" / "sensor_data" / "reading_1.npy").is_file()
    assert np.array_equal(run.frame(run.rows[0], verify=True), taxels + 0.5)


def test_images_contain_what_was_simulated(run_folder: Path, tmp_path: Path, make_info: Any, noise: Any) -> None:
    data = (run_folder / "sensor_images" / "image_1.png").read_bytes()
    assert b"tEXtsimulated\0stage: stage model" in data
    Image = pytest.importorskip("PIL.Image")  # noqa: N806
    assert Image.open(run_folder / "sensor_images" / "image_1.png").text == {"simulated": "stage: stage model"}
    real = make_info(stage={"simulated": ""})
    with RunWriter.open(tmp_path / "real", real) as writer:
        writer.press(real.presses[0], (4.0, 18.0, -1.0), noise(1))
    assert b"tEXt" not in (tmp_path / "real" / "sensor_images" / "image_1.png").read_bytes()


def test_a_full_disk_loses_nothing(
    tmp_path: Path, make_info: Any, filled: Any, noise: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    info = make_info()
    real = os.write

    def full(handle: int, data: bytes) -> int:
        if len(data) > 40:
            return real(handle, data[:40])
        raise OSError(errno.ENOSPC, "No space left on device")

    with RunWriter.open(tmp_path / "run", info) as writer:
        filled(writer, count=3)
        before = (tmp_path / "run" / "targets.csv").read_bytes()
        monkeypatch.setattr(run_tables.os, "write", full)
        with pytest.raises(InputError, match="is full"):
            writer.press(info.presses[3], (4.0, 18.0, -1.0), noise(4))
        monkeypatch.undo()
        assert (tmp_path / "run" / "targets.csv").read_bytes() == before
        filled(writer)
    assert check_run(tmp_path / "run").ok


def test_a_full_disk_during_the_writing_of_an_image_is_reported(
    tmp_path: Path, make_info: Any, noise: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    info = make_info()

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with RunWriter.open(tmp_path / "run", info) as writer:
        monkeypatch.setattr(os, "fsync", full)
        with pytest.raises(InputError, match="is full"):
            writer.press(info.presses[0], (4.0, 18.0, -1.0), noise(4))
        monkeypatch.undo()
    assert rows_of(tmp_path / "run") == []


@pytest.mark.parametrize("code", [errno.EINVAL, errno.ENOTSUP])
def test_a_file_system_that_cannot_sync_folders_is_accepted(
    code: int, tmp_path: Path, make_info: Any, filled: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = os.fsync

    def fail_for_folders(handle: int) -> None:
        if stat.S_ISDIR(os.fstat(handle).st_mode):
            raise OSError(code, "not here")
        real(handle)

    monkeypatch.setattr(os, "fsync", fail_for_folders)
    with RunWriter.open(tmp_path / "run", make_info()) as writer:
        filled(writer, count=2)
    assert len(rows_of(tmp_path / "run")) == 2


def test_a_folder_that_cannot_be_created_is_reported(tmp_path: Path, make_info: Any) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="is not a folder"), RunWriter.open(tmp_path / "file" / "run", make_info()):
        pass


@pytest.mark.parametrize("name", ["sensor_images", "references", "stationary", "targets.csv", "run.json", "print.toml"])
def test_a_file_instead_of_a_folder_is_reported_and_vice_versa(name: str, tmp_path: Path, make_info: Any) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    if "." in name:
        (folder / name / "inner").mkdir(parents=True)
    else:
        (folder / name).write_text("")
    with pytest.raises(InputError), RunWriter.open(folder, make_info()):
        pass


@pytest.mark.parametrize("replaced_by_a_folder", [False, True])
def test_a_row_without_its_file_is_refused(replaced_by_a_folder: bool, run_folder: Path, make_info: Any) -> None:
    image = run_folder / "sensor_images" / "image_7.png"
    image.unlink()
    if replaced_by_a_folder:
        image.mkdir()
    with (
        pytest.raises(InputError, match=r"image_7.png: is missing, but targets.csv"),
        RunWriter.open(run_folder, make_info()),
    ):
        pass


def test_a_folder_at_the_path_of_the_next_image_is_refused(tmp_path: Path, make_info: Any, noise: Any) -> None:
    info = make_info()
    with RunWriter.open(tmp_path / "run", info) as writer:
        (tmp_path / "run" / "sensor_images" / "image_1.png").mkdir()
        with pytest.raises(InputError, match="sensor_images"):
            writer.press(info.presses[0], (4.0, 18.0, -1.0), noise(1))
    assert rows_of(tmp_path / "run") == []


def _version(folder: Path) -> None:
    document = json.loads((folder / "run.json").read_text())
    (folder / "run.json").write_text(json.dumps({**document, "version": 99}))


def _doubled(folder: Path) -> None:
    path = folder / "targets.csv"
    path.write_text(path.read_text() + path.read_text().splitlines(keepends=True)[3])


def _columns(folder: Path) -> None:
    path = folder / "targets.csv"
    path.write_text("\n".join(",".join(reversed(line.split(","))) for line in path.read_text().splitlines()) + "\n")


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (_version, "schema version 99, but this program reads 3"),
        (lambda folder: (folder / "run.json").write_text("{"), "is not valid JSON"),
        (lambda folder: (folder / "run.json").write_text('{"schema": "other"}'), "does not describe a run"),
        (lambda folder: (folder / "run.json").unlink(), "has a targets.csv but no run.json"),
        (_doubled, "line 18: sensor_image = 'image_3.png': is already in line 4"),
        (_columns, "has other columns, or another order"),
        (
            lambda folder: (folder / "stationary" / "stationary.csv").write_text(
                "reading,when,in_contact,index,image_sha256\nstationary/a.png,start,true,x,0\n"
            ),
            "stationary.csv line 2: index = 'x'",
        ),
        (lambda folder: (folder / "targets.csv").write_text("a,b\n1,2\n"), "the column sensor_image is missing"),
    ],
)
def test_a_damaged_folder_is_refused_and_not_changed(
    damage: Callable[[Path], object], message: str, run_folder: Path, make_info: Any
) -> None:
    damage(run_folder)
    before = {path: path.read_bytes() for path in run_folder.rglob("*") if path.is_file()}
    with pytest.raises(InputError, match=message), RunWriter.open(run_folder, make_info()):
        pass
    assert {path: path.read_bytes() for path in run_folder.rglob("*") if path.is_file()} == before


def test_reordered_rows_are_accepted(run_folder: Path, make_info: Any) -> None:
    path = run_folder / "targets.csv"
    head, *rows = path.read_text().splitlines(keepends=True)
    random.Random(0).shuffle(rows)
    path.write_text(head + "".join(rows))
    with RunWriter.open(run_folder, make_info()) as writer:
        assert writer.missing(writer.info.presses) == ()
    assert check_run(run_folder).ok


#: A program that makes the missing presses slowly enough to be killed; it prints a line when it begins.
_PRESSER = """
import sys
sys.path[:0] = {path!r}
from helpers.run_fixtures import press_all
from tacbench_cad.lab.runs.info import RunInfo
from tacbench_cad.lab.runs.run_writer import RunWriter
import json, pathlib
info = RunInfo.from_dict(json.loads(pathlib.Path({info!r}).read_text()))
print("ready", flush=True)
with RunWriter.open(pathlib.Path({folder!r}), info) as writer:
    press_all(writer)
"""


@pytest.mark.parametrize("kills", [2, pytest.param(200, marks=pytest.mark.long)])
def test_kills_at_any_time_lose_nothing(kills: int, tmp_path: Path, make_info: Any) -> None:
    folder, seeded = tmp_path / "run", random.Random(4)
    (tmp_path / "info.json").write_text(json.dumps(make_info().as_dict()))
    here = [str(Path(__file__).parents[2]), str(Path(__file__).parents[3])]
    script = _PRESSER.format(path=here, info=str(tmp_path / "info.json"), folder=str(folder))
    for _ in range(kills):
        with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == b"ready\n"
            time.sleep(seeded.uniform(0.0, 0.05))
            process.send_signal(signal.SIGKILL if hasattr(signal, "SIGKILL") else signal.SIGTERM)
        if folder.exists() and len(list(folder.glob("targets.csv"))) and len(rows_of(folder)) == 16:
            # The run is complete: start another one with the remaining kills.
            assert check_run(folder).ok
            folder = folder.with_name(f"{folder.name}x")
            script = _PRESSER.format(path=here, info=str(tmp_path / "info.json"), folder=str(folder))
    subprocess.run([sys.executable, "-c", script], check=True, stdout=subprocess.DEVNULL)
    report = check_run(folder)
    assert report.findings == ()
    assert report.presses == 16
