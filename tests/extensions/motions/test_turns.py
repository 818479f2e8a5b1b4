"""Press, roll and tilt on the simulated arm: series with angles, the force guard, signals and an arm left tilted."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.arms import ARM_RIG, CLOCK, rig_of, turning_protocol
from helpers.emulated_arm import install_arm
from helpers.rigs import FakeRig, printed, rig_settings, study_of

from tacbench_cad.extensions.devices.universal_robots import UniversalRobot
from tacbench_cad.lab.acquire.interruption import RunInterruptedError
from tacbench_cad.lab.acquire.person import Typing
from tacbench_cad.lab.acquire.progress import Silent
from tacbench_cad.lab.acquire.session import acquire_study
from tacbench_cad.lab.rig.devices import Rig
from tacbench_cad.lab.rig.errors import DepthLimitError, ForceLimitError
from tacbench_cad.lab.runs.checking import check_run
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.lab.simulate.contact import contact_for
from tacbench_cad.lab.simulate.simulated_stage import SimulatedStage
from tacbench_cad.lab.study.motion import course_of
from tacbench_cad.lab.study.rotation import UPRIGHT, angle_between, lowest, tilt, towards
from tacbench_cad.lab.study.spec import (
    Angles,
    Point,
    PrintedBlock,
    Protocol,
    RigSettings,
    WorkFrame,
)
from tacbench_cad.util.errors import InputError


class Arm(SimulatedStage):
    """An arm that calls a function after each part of a turn, with the angles on the way."""

    def __init__(self, on_way: Callable[[Angles], None], **start: Any) -> None:
        self.on_way = on_way
        super().__init__(CLOCK, **start)
        self.turns: list[tuple[Point, Angles]] = []

    def turn(self, angles_deg: Angles, speed_deg_s: float, **path: Any) -> Angles:
        self.turns.append((self.position(), angles_deg))
        return super().turn(angles_deg, speed_deg_s, **path)

    def _pose(self) -> tuple[Point, Angles]:
        summit, angles = super()._pose()
        if threading.current_thread() is threading.main_thread():
            self.on_way(angles)
        return summit, angles


class Rigs:
    """Opens the simulated rig, each time with the same arm, and keeps it open for a look afterwards."""

    def __init__(self, on_way: Callable[[Angles], None] = lambda angles: None, **start: Any) -> None:
        self.arm = Arm(on_way, **start)

    def opener(self, settings: RigSettings, block: PrintedBlock, frame: WorkFrame) -> AbstractContextManager[Rig]:
        return rig_of(self.arm, settings, block, frame)


def acquire(protocol: Protocol, out: Path, rigs: Rigs, said: list[str] | None = None) -> Run:
    class Saying(Silent):
        def say(self, text: str) -> None:
            if said is not None:
                said.append(text)

    person = Typing(lambda prompt: "", lambda message: None)
    acquire_study(
        study_of(protocol, 2), ARM_RIG, out, person=person, progress=Saying(), durable=False, opener=rigs.opener
    )
    return Run.open(out / printed(2).name)


@pytest.mark.parametrize(("motion", "direction"), [("roll", 90.0), ("tilt", 30.0)])
def test_a_run_has_the_poses_the_angles_and_the_forces_of_each_turn(
    motion: str, direction: float, tmp_path: Path
) -> None:
    protocol, rigs = turning_protocol(motion=motion, turn_direction_deg=direction), Rigs()
    run = acquire(protocol, tmp_path, rigs)
    assert check_run(run.folder, workers=1).findings == ()
    contact = contact_for(printed(2), ARM_RIG.holder)
    for row in run.rows:
        assert (row.pose_rx, row.pose_ry, row.pose_rz) == (0.0, 0.0, 0.0)
        series = run.series(row, verify=True)
        course = course_of(protocol, row.pose_mm)
        done = np.array([angle_between(UPRIGHT, tuple(angles)) for angles in series.rotation_deg]) / 6.0
        # How equal the angles are depends on the speed of this machine.
        assert (done[0], done[-1]) == (0.0, pytest.approx(1.0)) and list(done) == sorted(done)
        for part, pose, angles in zip(done, series.pose_mm, series.rotation_deg, strict=True):
            summit, expected = course.at(float(part))
            assert pose == pytest.approx(summit, abs=1e-3)
            assert angles == pytest.approx(expected, abs=1e-3)
        assert series.force_n is not None
        assert series.force_n[0] == pytest.approx(row.measured_force_n, abs=0.05)
        assert series.force_n[-1] == pytest.approx(contact.force_n(*lowest(*course.at(1.0))), abs=0.15)
        assert np.count_nonzero(np.abs(series.frames[-1].astype(int) - series.frames[0]) > 60) > 50
    # After each lift, the sensor was turned upright at the travel height.
    back = [summit for summit, angles in rigs.arm.turns if angles == UPRIGHT]
    assert len(back) == 2 and all(z >= 40.0 + protocol.clearance_mm for _, _, z in back)
    assert rigs.arm.rotation() == UPRIGHT


def test_an_arm_that_was_left_tilted_in_contact_is_lifted_before_it_turns_upright(tmp_path: Path) -> None:
    protocol = turning_protocol()
    start = ARM_RIG.stage.frame.to_stage((6.0, 20.0, -1.0))
    rigs = Rigs(summit_mm=start, angles_deg=towards(20.0, 12.0))
    acquire(protocol, tmp_path, rigs)
    (x, y, z), angles = rigs.arm.turns[0]
    assert angles == UPRIGHT
    assert (x, y) == pytest.approx(start[:2])
    assert z == pytest.approx(40.0 + protocol.clearance_mm)


def test_a_force_above_the_limit_stops_a_tilt_and_the_sensor_is_lifted_and_upright(tmp_path: Path) -> None:
    rigs, said, most = Rigs(), [], 0.0

    def on_way(angles: Angles) -> None:
        nonlocal most
        most = max(most, tilt(angles))

    rigs.arm.on_way = on_way
    protocol = turning_protocol(motion="tilt", turn_angle_deg=25.0, hard_limit_n=1.6, depth_limit_mm=9.0)
    with pytest.raises(ForceLimitError, match=r"above the hard limit of 1\.6 N"):
        acquire(protocol, tmp_path, rigs, said)
    assert 1.0 < most < 25.0
    assert rigs.arm.rotation() == UPRIGHT
    assert rigs.arm.position()[2] > 40.0 + protocol.clearance_mm - 0.1
    assert said == []
    assert Run.open(tmp_path / printed(2).name).rows == ()


@pytest.mark.skipif(not hasattr(signal, "SIGINT") or os.name == "nt", reason="needs signals")
def test_a_signal_in_a_roll_lifts_the_sensor_turns_it_back_and_the_run_is_resumed(tmp_path: Path) -> None:
    rigs, sent = Rigs(), []

    def on_way(angles: Angles) -> None:
        # In the second press, in the middle of the roll.
        if not sent and tilt(angles) > 2.0 and len([end for _, end in rigs.arm.turns if end != UPRIGHT]) == 2:
            sent.append(tilt(angles))
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.01)

    rigs.arm.on_way = on_way
    with pytest.raises(RunInterruptedError) as caught:
        acquire(turning_protocol(), tmp_path, rigs)
    assert 2.0 < sent[0] < 6.0
    assert f"{caught.value}" == "the sensor is lifted; 1 of 2 presses are saved"
    assert rigs.arm.rotation() == UPRIGHT
    run = acquire(turning_protocol(), tmp_path, Rigs())
    assert [row.number for row in run.rows] == [1, 2]
    assert check_run(run.folder, workers=1).findings == ()


def test_a_tilt_below_the_depth_limit_is_not_begun(tmp_path: Path) -> None:
    rigs = Rigs()
    with pytest.raises(DepthLimitError, match=r"the dome would move down to z = -\d\.\d+ mm, below the depth limit"):
        acquire(turning_protocol(motion="tilt", turn_angle_deg=25.0, depth_limit_mm=3.0), tmp_path, rigs)
    assert rigs.arm.turns == []


def test_a_stage_that_cannot_turn_is_refused_before_a_device_is_opened(tmp_path: Path) -> None:
    rig, person = FakeRig(), Typing(lambda prompt: "", lambda message: None)
    for settings, words in (
        (rig_settings(), r"\[stage\] driver = 'grbl': cannot turn the sensor, as motion = \"roll\" needs"),
        (rig_settings(driver="ur", tilt_limit_deg=5.0), r"turn_angle_deg = 6.0: must be at most tilt_limit_deg .* 5"),
        (rig_settings(driver="helpers.example_stage:ExampleStage"), r"cannot turn the sensor"),
    ):
        with pytest.raises(InputError, match=words):
            acquire_study(
                study_of(turning_protocol(), 2),
                settings,
                tmp_path,
                person=person,
                progress=Silent(),
                opener=rig.opener,
            )
    assert rig.opened == 0
    # Whether a function returns such a stage is known only once it is open.
    settings = rig_settings(driver="helpers.rigs:printed")
    with pytest.raises(InputError, match="cannot turn the sensor"):
        acquire_study(
            study_of(turning_protocol(), 2), settings, tmp_path, person=person, progress=Silent(), opener=rig.opener
        )
    assert rig.opened == 1 and rig.stage.closed


def test_an_emulated_arm_of_universal_robots_rolls_is_interrupted_and_goes_on(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    emulated, protocol = install_arm(monkeypatch, CLOCK), turning_protocol()
    limits = ((200.0, 400.0), (50.0, 250.0), (100.0, 300.0))
    stage = replace(ARM_RIG.stage, driver="ur", port="ur5e", origin_mm=(320.0, 100.0, 150.0), limits_mm=limits)
    settings, person = replace(ARM_RIG, stage=stage), Typing(lambda prompt: "", lambda message: None)
    sent: list[float] = []

    def opener(settings: RigSettings, block: PrintedBlock, frame: WorkFrame) -> AbstractContextManager[Rig]:
        emulated.connected = emulated.program = True
        return rig_of(UniversalRobot("ur5e", clock=CLOCK), settings, block, frame)

    def follow(pose: list[float], *settings: float) -> bool:
        if not sent and len(emulated.servoed) > 10:
            sent.append(len(emulated.servoed))
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.01)
        return servo(pose, *settings)

    servo = emulated.servoL
    monkeypatch.setattr(emulated, "servoL", follow)
    for _ in range(2):
        try:
            acquire_study(
                study_of(protocol, 2),
                settings,
                tmp_path,
                person=person,
                progress=Silent(),
                durable=False,
                opener=opener,
            )
        except RunInterruptedError as error:
            assert f"{error}" == "the sensor is lifted; 0 of 2 presses are saved"
        arm = UniversalRobot("ur5e", clock=CLOCK)
        assert angle_between(UPRIGHT, arm.rotation()) < 0.1
        assert arm.position()[2] > 150.0 + protocol.clearance_mm - 0.1
    assert sent
    run = Run.open(tmp_path / printed(2).name)
    assert [row.number for row in run.rows] == [1, 2]
    for row in run.rows:
        series = run.series(row)
        assert angle_between(UPRIGHT, tuple(series.rotation_deg[-1])) == pytest.approx(6.0, abs=0.1)
        assert series.pose_from == "reports"
