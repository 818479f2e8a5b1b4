"""Test the slide after a press: frames at equal distances, the force guard, stops, repetitions and resuming."""

from __future__ import annotations

import os
import signal
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.emulated import emulated_study
from helpers.fakes import Plate, SlidingStage
from helpers.rigs import AT_ONCE, FakeRig, info_of, small_protocol, study_of

from tacbench_cad.extensions.motions.slide import nearest_frames
from tacbench_cad.extensions.motions.track import StageTrack
from tacbench_cad.lab.acquire.block_presses import press_block
from tacbench_cad.lab.acquire.person import Typing
from tacbench_cad.lab.acquire.progress import PressProgress
from tacbench_cad.lab.acquire.safety import RunInterruptedError
from tacbench_cad.lab.acquire.session import acquire_study
from tacbench_cad.lab.acquire.signals import Signals
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.errors import DeviceLostError, ForceLimitError, PositionLostError, RigError
from tacbench_cad.lab.runs.checking import check_run
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.lab.study.motion import MotionSettings
from tacbench_cad.lab.study.spec import Protocol
from tacbench_cad.spec.protocol import PressGrid
from tacbench_cad.util.errors import MissingToolError

FRAMES = 5
TRAVEL_MM = 5.0


class Notes(PressProgress):
    def __init__(self) -> None:
        self.messages: list[str] = []

    def say(self, message: str) -> None:
        self.messages.append(message)


def slide(frames: int = FRAMES, speed_mm_s: float = 4.0) -> MotionSettings:
    return MotionSettings(name="slide", frames=frames, options={"length_mm": 4.0, "speed_mm_s": speed_mm_s})


def slide_protocol(**changes: Any) -> Protocol:
    values: dict[str, Any] = {
        "motion": slide(),
        "forces_n": (1.0,),
        "bands_n": (0.01,),
        "depths_mm": (1.0,),
        "repeats": 1,
        "stationary_frames": 1,
    }
    return small_protocol(**{**values, **changes})


class RealTime(Clock):
    """Real time without waits."""

    def sleep(self, seconds: float) -> None:
        pass


def pressed(rig: FakeRig, folder: Path, protocol: Protocol | None = None, clock: Clock = AT_ONCE) -> list[str]:
    opened, notes = rig.rig(), Notes()
    opened.clock = clock
    info = info_of(opened, protocol or slide_protocol())
    with Signals() as signals:
        press_block(opened, info, folder, signals=signals, progress=notes, taught_mm=(0.0,), durable=False)
    return notes.messages


def stage_of(rig: FakeRig) -> SlidingStage:
    assert isinstance(rig.stage, SlidingStage)
    return rig.stage


def series_names(folder: Path) -> set[str]:
    return {path.name for path in (folder / "series").iterdir()}


def test_each_press_has_frames_at_equal_distances_along_the_line(tmp_path: Path) -> None:
    slope = Plate(top=lambda x, y: 0.01 * (y - 18.0))
    rig = FakeRig(slides=True, plate=slope)
    assert pressed(rig, tmp_path / "run") == []
    run = Run.open(tmp_path / "run")
    assert len(run.rows) == len(run.info.presses) == 4
    assert [finding for finding in check_run(run.folder).findings if finding.kind not in ("dark", "blurred")] == []
    for row in run.rows:
        series = run.series(row, verify=True)
        assert series.pose_from == "reports"
        assert np.all(np.diff(series.time_s) > 0.0)
        # The stage moves in twelve parts, and the position between two reports is interpolated.
        np.testing.assert_allclose(series.pose_mm[:, 1] - row.pose_mm[1], [0.0, 1.0, 2.0, 3.0, 4.0], atol=0.4)
        np.testing.assert_allclose(series.pose_mm[:, [0, 2]], [[row.pose_mm[0], row.pose_mm[2]]] * FRAMES, atol=1e-6)
        assert series.pose_mm[-1, 1] == pytest.approx(row.pose_mm[1] + 4.0)
        assert series.force_n is not None and row.measured_force_n is not None
        assert series.force_n[0] == pytest.approx(row.measured_force_n, abs=0.03)
        # The block rises along the slide, so the force grows.
        rise_n = slope.force_n((0.0, 4.0 + row.pose_mm[1], row.pose_mm[2])) - row.measured_force_n
        assert series.force_n[-1] - series.force_n[0] == pytest.approx(rise_n, abs=0.01)


def test_without_reports_the_poses_are_computed_from_the_time(tmp_path: Path) -> None:
    rig = FakeRig(slides=True, reports=False, gauge=False)
    pressed(
        rig,
        tmp_path / "run",
        slide_protocol(contact="depth", touch="taught", motion=slide(speed_mm_s=0.001)),
        RealTime(),
    )
    run = Run.open(tmp_path / "run")
    for row in run.rows:
        series = run.series(row)
        assert series.pose_from == "time" and series.force_n is None
        assert np.all(np.diff(series.pose_mm[:, 1]) > 0.0)


def test_a_force_above_the_hard_limit_stops_the_slide_and_lifts(tmp_path: Path) -> None:
    # A ridge in the middle of the second slide. The gauge sees it before the stage is over it.
    ridge = Plate(top=lambda x, y: 3.0 * max(0.0, y - 19.5) if x > 8.0 and y < 22.0 else 0.0)
    rig = FakeRig(slides=True, plate=ridge)
    with pytest.raises(ForceLimitError, match=r"above the hard limit of 5 N"):
        pressed(rig, tmp_path / "run")
    assert rig.stage.stopped > 0
    assert rig.stage.at[2] == TRAVEL_MM
    assert rig.stage.at[1] < 22.0, "the slide was not stopped"
    assert [row.number for row in Run.open(tmp_path / "run").rows] == [1]
    rig.plate = rig.sensor.plate = rig.gauge.plate = Plate()
    pressed(rig, tmp_path / "run")
    assert len(Run.open(tmp_path / "run").rows) == 4


@pytest.mark.parametrize("device", ["sensor", "gauge", "stage"])
def test_a_device_that_fails_during_a_slide_ends_the_run_lifted_and_is_the_cause(tmp_path: Path, device: str) -> None:
    rig = FakeRig(slides=True)
    lost = DeviceLostError(f"{device} is gone")

    def fail(part: int) -> None:
        if part == 4 and stage_of(rig).slides == 2:
            if device == "sensor":
                rig.sensor.faults[rig.sensor.count + 2] = lost
            elif rig.gauge is not None and device == "gauge":
                rig.gauge.faults[len(rig.gauge.readings) + 3] = lost
            else:
                raise lost

    stage_of(rig).on_part = fail
    with pytest.raises(RigError) as error:
        pressed(rig, tmp_path / "run")
    assert error.value is lost
    assert rig.stage.at[2] == TRAVEL_MM
    assert [row.number for row in Run.open(tmp_path / "run").rows] == [1]
    assert series_names(tmp_path / "run") == {"press_1"}
    stage_of(rig).on_part = lambda _: None
    pressed(rig, tmp_path / "run")
    assert len(Run.open(tmp_path / "run").rows) == 4


def test_a_signal_during_a_slide_lifts_and_the_run_can_be_resumed(tmp_path: Path) -> None:
    rig = FakeRig(slides=True)

    def interrupt(part: int) -> None:
        if part == 5 and stage_of(rig).slides == 3:
            os.kill(os.getpid(), signal.SIGINT)

    stage_of(rig).on_part = interrupt
    with pytest.raises(RunInterruptedError) as error:
        pressed(rig, tmp_path / "run")
    assert error.value.lifted and rig.stage.at[2] == TRAVEL_MM and rig.stage.stopped
    assert len(Run.open(tmp_path / "run").rows) == 2
    stage_of(rig).on_part = lambda _: None
    pressed(rig, tmp_path / "run")
    assert check_run(tmp_path / "run").series == 4


def test_a_motor_that_slips_during_a_slide_sets_the_series_aside_and_they_are_made_again(tmp_path: Path) -> None:
    rig = FakeRig(slides=True)
    rig.stage.measures_offset = True
    protocol = slide_protocol(home_every=2)

    def slip(part: int) -> None:
        if part == 6 and stage_of(rig).slides == 4:
            x, y, z = rig.stage.true
            rig.stage.true = (x + 0.5, y, z)

    stage_of(rig).on_part = slip
    with pytest.raises(PositionLostError, match=r"1 press since the last good check was set aside"):
        pressed(rig, tmp_path / "run", protocol)
    assert series_names(tmp_path / "run") == {"press_1", "press_2", "press_3"}
    (aside,) = (tmp_path / "run" / "set_aside").iterdir()
    assert series_names(aside) == {"press_4"} and (aside / "targets.csv").exists()
    pressed(rig, tmp_path / "run", protocol)
    report = check_run(tmp_path / "run")
    assert (report.series, report.unchecked) == (4, 0)


def test_a_press_is_made_again_if_the_sensor_was_too_slow_and_then_given_up(tmp_path: Path) -> None:
    rig = FakeRig(slides=True, parts=2, frames_each=1)
    with pytest.raises(RigError, match=r"delivered \d+ frames during a slide of 4 mm, too few"):
        pressed(rig, tmp_path / "run", slide_protocol(motion=slide(frames=40)))
    assert stage_of(rig).slides == 3
    assert rig.stage.at[2] == TRAVEL_MM
    assert not Run.open(tmp_path / "run").rows


def track(count: int) -> tuple[StageTrack, np.ndarray]:
    """Return a track of 8 mm at 1 mm/s from 10 s on, and the times of frames from 9 to 19 s."""

    class SetClock(Clock):
        time_s = 10.0

        def now_s(self) -> float:
            return SetClock.time_s

    path = StageTrack((0.0, 0.0, 0.0), (8.0, 0.0, 0.0), 1.0, SetClock())
    path.begin()
    SetClock.time_s = 18.0
    path.end()
    return path, np.linspace(9.0, 19.0, count)


@pytest.mark.parametrize(("count", "expected"), [(101, [10, 30, 50, 70, 90]), (11, [1, 3, 5, 7, 9])])
def test_the_frames_nearest_to_the_places_are_kept(count: int, expected: list[int]) -> None:
    assert list(nearest_frames(*track(count), 5)) == expected


@pytest.mark.skipif(sys.platform == "win32", reason="the virtual rig's pseudo-terminals do not exist on Windows")
@pytest.mark.parametrize(
    ("driver", "pose_from"),
    [("virtual-grbl", "reports"), pytest.param("virtual-marlin", "time", marks=pytest.mark.long)],
)
def test_a_slide_on_virtual_firmware_with_the_simulated_sensor(tmp_path: Path, driver: str, pose_from: str) -> None:
    chosen = emulated_study(driver, texture="4", speed=50.0)
    # The slide is slow, so that a busy computer has enough frames of a rig that is 50 times faster than a real one.
    protocol = slide_protocol(grid=PressGrid(x_mm=(6.5,), y_mm=(18.0,)), motion=slide(4, 0.4), bands_n=(0.05,))
    (planned,) = chosen.study.blocks
    study = replace(chosen.study, protocol=protocol, blocks=(replace(planned, levels=(1,)),), grid_spacing="own")
    person = Typing(lambda prompt: "", lambda message: None)
    acquire_study(study, chosen.required_rig, tmp_path, person=person, progress=Notes(), durable=False)
    run = Run.open(tmp_path / planned.printed.name)
    assert check_run(run.folder, workers=1).findings == ()
    (row,) = run.rows
    series = run.series(row, verify=True)
    assert series.pose_from == pose_from
    np.testing.assert_allclose(series.pose_mm[[0, -1], 1], [18.0, 22.0], atol=0.2)
    np.testing.assert_allclose(series.pose_mm[:, [0, 2]], [[6.5, row.pose_mm[2]]] * 4, atol=0.01)
    assert series.force_n is not None and 0.2 < series.force_n.min() <= series.force_n.max() < 5.0
    # The pins have moved, and the press itself was before the motion.
    changed = np.count_nonzero(np.abs(series.frames.astype(float) - run.frame(row)) > 40.0, axis=(1, 2))
    assert changed[-1] > 1000 and changed[0] < changed[-1]


def test_a_motion_without_its_extension_is_refused_before_a_device_is_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tacbench_cad.lab.study.motion.entries", lambda group: {})
    with pytest.raises(MissingToolError, match='name = "slide" needs an extension that is not installed'):
        study_of(slide_protocol(), 1)
