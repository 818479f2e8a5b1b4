"""Test complete simulated studies: their contents, their marks, and that interruptions lose nothing."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from tacbench_cad.cli import main
from tacbench_cad.lab.runs.checking import check_run
from tacbench_cad.lab.runs.info import RunInfo
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.lab.simulate.study import (
    SimulationEstimate,
    SimulationOptions,
    estimate_simulation,
    images_there,
    other_images,
    paper_study,
    quick_study,
    require_room,
    run_infos,
    simulate_block,
    simulate_study,
)
from tacbench_cad.lab.study import names
from tacbench_cad.lab.study.motion import MotionSettings
from tacbench_cad.lab.study.spec import PlannedBlock, PrintedBlock, Protocol, Study
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.protocol import FORCE_SPREADS_N, FORCES_N, PressGrid
from tacbench_cad.util.errors import InputError, TacbenchError

GRID = PressGrid(x_mm=(4.0, 9.0), y_mm=(18.0, 23.0))
STUDY_FILE = """
out = "runs"
[study]
textures = [1, 4]
prints = [{ printer = "resin", filament = "resin", copies = 2 }]
[protocol]
positions.grid = { x_mm = [4.0, 9.0], y_mm = [18.0, 23.0] }
checks.stationary_frames = 1
repeats = 1
"""


def _study(**changes: object) -> Study:
    protocol = Protocol().changed(grid=GRID, stationary_frames=2, **changes)  # type: ignore[arg-type]
    blocks = [
        PlannedBlock(
            printed=PrintedBlock(block=Block.of(texture), printer="ender-3", filament="petg", copy=1),
            levels=tuple(range(1, protocol.levels + 1)),
        )
        for texture in (2, 4)
    ]
    return Study(blocks=tuple(blocks), protocol=protocol, grid_spacing="own")


def _infos(study: Study, options: SimulationOptions | None = None) -> list[RunInfo]:
    return run_infos(study, options or SimulationOptions())


def _files(folder: Path) -> dict[str, bytes]:
    """Return every file of a study except ``run.json``, which contains the time, and remains of killed processes."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and path.name != "run.json" and not path.name.startswith(".tacbench-")
    }


@pytest.fixture(scope="module")
def study_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Return a small study that two processes simulated."""
    out = tmp_path_factory.mktemp("made")
    counts: list[int] = []
    blocks = simulate_study(_study(), out, SimulationOptions(), jobs=2, progress=counts.append)
    assert [block.presses for block in blocks] == [24, 24]
    assert [images_there(block.folder) for block in blocks] == [24 + 9, 24 + 9]
    assert counts and counts[-1] == 66 == sum(images_there(folder) for folder in out.iterdir())
    yield out


def test_the_papers_study_has_the_papers_number_of_images() -> None:
    study = paper_study()
    firsts = [block for block in study.blocks if block.printed.copy == 1]
    more = [block for block in study.blocks if block.printed.copy > 1]
    places = len(study.protocol.positions.grid.positions_mm)
    assert sum(len(block.levels) * 2 * places for block in firsts) == 8100
    assert sum(len(block.levels) * 2 * places for block in more) == 4500
    assert study.presses == 12_600
    assert {(block.printed.printer, block.printed.filament) for block in firsts} == set(names.COMBINATIONS)
    assert {block.levels for block in more} == {(2,)}
    prints = Counter((block.printed.printer, block.printed.filament) for block in study.blocks)
    assert {combination for combination, count in prints.items() if count == 36} == set(names.SELECTED)
    assert study.protocol.targets.forces_n == FORCES_N and study.protocol.repeats == 2


def test_the_quick_study_has_two_of_everything_and_is_small(tmp_path: Path) -> None:
    study = quick_study()
    assert {block.printed.object_label for block in study.blocks} == set(range(1, 7))
    assert len({block.printed.printer for block in study.blocks}) == 2
    assert {block.printed.copy for block in study.blocks} == {1, 2}
    assert {block.levels for block in study.blocks} == {(1, 2, 3)}
    paper = {tuple(place) for place in PressGrid.paper().positions_mm}
    assert {tuple(place) for place in study.protocol.positions.grid.positions_mm} < paper
    assert study.protocol.checks.stationary_frames >= 2
    needed = estimate_simulation(study, tmp_path, SimulationOptions(), jobs=2)
    assert needed.missing == 1296 + 24 * 21
    assert needed.gb < 0.3


def test_every_force_lies_in_its_band(study_folder: Path) -> None:
    for folder in study_folder.iterdir():
        rows = Run.open(folder).rows
        assert len(rows) == 24
        for row in rows:
            assert row.measured_force_n is not None and row.target_force_n is not None
            band = FORCE_SPREADS_N[row.force_level - 1]
            assert abs(row.measured_force_n - row.target_force_n) < band / 10.0
            assert row.in_band is True


def test_a_run_folder_passes_the_check(study_folder: Path) -> None:
    report = check_run(next(study_folder.iterdir()))
    assert report.ok, [str(finding) for finding in report.findings]


def test_everything_is_marked_as_simulated(study_folder: Path) -> None:
    for folder in study_folder.iterdir():
        run = Run.open(folder)
        assert len(run.info.simulated) == 3
        assert "virtual printer, ender-3 with petg" in run.info.simulated[0]
        document = json.loads((folder / "run.json").read_text())
        assert document["stage"]["settings"]["options"]["virtual_printer"]["layer_mm"] == 0.2
        for image in folder.rglob("*.png"):
            assert b"tEXtsimulated\0" in image.read_bytes()[:200]
        record = run.print_record
        assert record.values["printer"] == "ender-3, virtual"
        assert record.values["nozzle_mm"] == 0.4


def test_images_are_grey_and_repeats_differ_by_noise(study_folder: Path) -> None:
    run = Run.open(next(iter(sorted(study_folder.iterdir()))))
    first, second = (
        cv2.imread(str(run.folder / "sensor_images" / run.by_key[(3, repeat, 1)].sensor_image), cv2.IMREAD_UNCHANGED)
        for repeat in (1, 2)
    )
    assert first.shape == (480, 640) and first.dtype == np.uint8
    difference = first.astype(int) - second
    assert 0 < np.var(difference) < 6.0


def test_an_interrupted_study_ends_like_an_uninterrupted_one(study_folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "again"
    shutil.copytree(study_folder, out)
    first, second = sorted(out.iterdir())
    shutil.rmtree(second)
    lines = (first / "targets.csv").read_text().splitlines(keepends=True)
    # The process was killed during the tenth row. Its image and a later one exist, the stationary end frames do not.
    (first / "targets.csv").write_text("".join(lines[:10]) + lines[10][:17])
    still = (first / "stationary" / "stationary.csv").read_text().splitlines(keepends=True)
    (first / "stationary" / "stationary.csv").write_text("".join(still[:5]))
    for path in (first / "sensor_images").glob("image_2?.png"):
        path.unlink()
    blocks = simulate_study(_study(), out, SimulationOptions(), jobs=2)
    assert [block.presses for block in blocks] == [15, 24]
    assert _files(out) == _files(study_folder)


def test_a_complete_study_is_not_simulated_again(study_folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "again"
    shutil.copytree(study_folder, out)
    blocks = simulate_study(_study(), out, SimulationOptions(), jobs=1)
    assert [block.presses for block in blocks] == [0, 0]
    assert estimate_simulation(_study(), out, SimulationOptions(), jobs=1).missing == 0
    assert _files(out) == _files(study_folder)


@pytest.mark.parametrize(
    ("options", "message"), [(SimulationOptions(colour=True), "shape"), (SimulationOptions(seed=7), "seed")]
)
def test_a_run_is_not_resumed_with_other_options(
    study_folder: Path, tmp_path: Path, options: SimulationOptions, message: str
) -> None:
    out = tmp_path / "again"
    shutil.copytree(study_folder, out)
    with pytest.raises(TacbenchError, match=message) as refusal:
        simulate_study(_study(), out, options, jobs=1)
    assert refusal.value.exit_code == 2
    assert _files(out) == _files(study_folder)


def test_colour_and_another_seed_change_the_images(tmp_path: Path) -> None:
    study = _study(forces_n=(1.0,), bands_n=(0.01,), repeats=1)
    images = []
    for name, options in (("a", SimulationOptions(colour=True)), ("b", SimulationOptions(colour=True, seed=1))):
        result = simulate_block(tmp_path / name, _infos(study, options)[0], options)
        (row,) = Run.open(result.folder).rows[:1]
        assert row.measured_force_n == pytest.approx(1.0, abs=1.1e-5)
        images.append(cv2.imread(str(tmp_path / name / result.folder.name / "sensor_images" / "image_1.png"), -1))
    assert images[0].shape == (480, 640, 3)
    assert not np.array_equal(*images)


def test_depth_mode_leaves_the_force_empty(tmp_path: Path) -> None:
    study = _study(contact="depth", depths_mm=(0.5, 1.0), repeats=1)
    info = _infos(study)[0]
    simulate_block(tmp_path, info, SimulationOptions())
    rows = Run.open(tmp_path / info.printed.name).rows
    assert len(rows) == 8
    assert all(row.measured_force_n is None and row.in_band is None for row in rows)
    shallow, deep = ({row.position: row.pose_mm[2] for row in rows if row.force_level == level} for level in (1, 2))
    assert [deep[place] for place in shallow] == pytest.approx([z - 0.5 for z in shallow.values()], abs=1e-4)


def test_references_are_repeated_at_the_interval(tmp_path: Path) -> None:
    study = _study(reference_every_s=30.0, repeats=1)
    info = _infos(study)[0]
    result = simulate_block(tmp_path, info, SimulationOptions())
    references = Run.open(tmp_path / info.printed.name).references
    assert [reference.after_press for reference in references] == [0, 7]
    assert images_there(result.folder) == 12 + other_images(info)


def test_a_press_below_the_depth_limit_is_refused(tmp_path: Path) -> None:
    study = _study(depth_limit_mm=2.5)
    with pytest.raises(InputError, match=r"depth_limit_mm.*would go"):
        simulate_block(tmp_path, _infos(study)[1], SimulationOptions())


def test_a_disk_without_space_is_refused_with_the_numbers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    needed = SimulationEstimate(blocks=1, presses=1000, others=21, there=21, bytes_each=1e6, seconds_each=0.01, jobs=2)
    assert needed.gb == pytest.approx(1.0)
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: SimpleNamespace(free=1.0e9))
    with pytest.raises(InputError, match=r"has 1\.00 GB free.*1\.05 GB"):
        require_room(tmp_path / "not" / "there", needed)
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: SimpleNamespace(free=1.1e9))
    require_room(tmp_path, needed)


def test_the_command_simulates_a_study_from_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "study.toml").write_text(STUDY_FILE.replace("[18.0, 23.0]", "[18.0]"))
    assert main(["simulate", "--study", str(tmp_path / "study.toml"), "--jobs", "1", "--json"]) == 0
    out, err = capsys.readouterr()
    document = json.loads(out)
    assert document["images"] == document["images_made"] == 4 * (6 + 5)
    assert {run["name"] for run in document["runs"]} == {path.name for path in (tmp_path / "runs").iterdir()}
    assert "4 blocks, 24 images of presses" in err and "GB" in err
    assert "about 1 minute in 1 process" in err
    assert main(["simulate", "--study", str(tmp_path / "study.toml")]) == 0
    out, err = capsys.readouterr()
    assert "44 images exist; 0 images to make" in err
    assert "form-3" in out and "0 images" in out
    assert out.endswith(f"\nNext: tacbench check-runs {tmp_path / 'runs'}\n")


@pytest.mark.parametrize(
    ("argv", "message"),
    [
        (["--study", "papr", "--out", "x"], "papr"),
        (["--study", "quick"], "name the folder"),
        (["--study", "nowhere.toml", "--out", "x"], "cannot be read"),
        (["--out", "x", "--jobs", "0"], "1 or more"),
        (["--out", "x", "--seed", "-1"], "seed"),
    ],
)
def test_invalid_options_are_reported_in_one_line(
    argv: list[str], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["simulate", *argv]) == 2
    out, err = capsys.readouterr()
    assert out == "" and message in err and len(err.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGINT for another process")
def test_an_interruption_ends_with_130_and_the_study_can_be_resumed(tmp_path: Path) -> None:
    text = STUDY_FILE.replace("repeats = 1", "repeats = 2").replace("textures = [1, 4]", "textures = [1]")
    (tmp_path / "study.toml").write_text(text)
    words = ["simulate", "--study", str(tmp_path / "study.toml"), "--jobs", "2"]
    command = [sys.executable, "-m", "tacbench_cad", *words]
    running = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    folder = tmp_path / "runs"
    deadline = time.monotonic() + 60.0
    while sum(1 for _ in folder.glob("*/sensor_images/*.png")) < 10 and time.monotonic() < deadline:
        time.sleep(0.01)
    os.kill(running.pid, signal.SIGINT)
    _, err = running.communicate(timeout=60)
    assert running.returncode == 130
    assert "error: interrupted\n" in err and "Traceback" not in err
    assert err.splitlines()[-1].startswith("resume with: tacbench simulate --study")
    images = sum(1 for _ in folder.glob("*/sensor_images/*.png"))
    assert 10 <= images < 2 * (24 + 1)
    assert main(words) == 0
    for run in folder.iterdir():
        assert len(Run.open(run).rows) == 24


def test_a_slide_study_has_a_series_of_moving_frames_for_each_press(tmp_path: Path) -> None:
    slide = MotionSettings(name="slide", frames=4, options={"length_mm": 6.0, "speed_mm_s": 3.0})
    study = _study(motion=slide, repeats=1)
    study = replace(study, blocks=(replace(study.blocks[1], levels=(2,)),))
    needed = estimate_simulation(study, tmp_path)
    (block,) = simulate_study(study, tmp_path)
    folder = block.folder
    assert images_there(folder) == needed.presses + needed.others
    assert check_run(folder, workers=1).findings == ()
    run = Run.open(folder)
    for row in run.rows:
        series = run.series(row, verify=True)
        np.testing.assert_allclose(series.time_s, [0.0, 2 / 3, 4 / 3, 2.0], atol=1e-4)
        np.testing.assert_allclose(series.pose_mm[:, 1], row.pose_mm[1] + np.array([0.0, 2.0, 4.0, 6.0]), atol=1e-6)
        np.testing.assert_allclose(series.pose_mm[:, [0, 2]], [[row.pose_mm[0], row.pose_mm[2]]] * 4, atol=1e-6)
        assert series.force_n is not None and series.force_n[0] == pytest.approx(row.measured_force_n, abs=1e-5)
        assert series.pose_from == "time"
    assert b"simulated TacTip" in (folder / "series" / "press_1" / "frame_02.png").read_bytes()[:400]
