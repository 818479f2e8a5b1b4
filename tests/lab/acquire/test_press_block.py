"""Test the pressing of a block: each press once, resuming at the first missing one, and lifting at every end."""

from __future__ import annotations

import errno
import itertools
import os
import random
import re
import shutil
import signal
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest
from helpers.fakes import Plate
from helpers.rigs import FakeRig, info_of, small_protocol

from tacbench_cad.lab.acquire.block_presses import BlockResult, press_block
from tacbench_cad.lab.acquire.progress import PressProgress
from tacbench_cad.lab.acquire.safety import RunInterruptedError
from tacbench_cad.lab.acquire.signals import Signals
from tacbench_cad.lab.rig.errors import (
    AlarmError,
    ContactError,
    DeviceLostError,
    ForceLimitError,
    NoAnswerError,
    PositionLostError,
    RigError,
)
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.lab.study.presses import Press
from tacbench_cad.lab.study.spec import Point, Protocol
from tacbench_cad.util.errors import InputError, TacbenchError

TRAVEL_MM = 5.0
#: Only presses of the largest force are deeper, in mm.
IN_CONTACT_MM = -1.0


class Notes(PressProgress):
    """A progress report that keeps its messages."""

    def __init__(self) -> None:
        self.messages: list[str] = []

    def say(self, message: str) -> None:
        self.messages.append(message)


class Waiting(Notes):
    """A progress report that keeps the forces of each press, and waits for a signal before the third press."""

    def __init__(self) -> None:
        super().__init__()
        self.forces: list[list[tuple[float, float]]] = []

    def before(self, press: Press, check: Callable[[], None]) -> None:
        self.forces.append([])
        if len(self.forces) == 3:
            os.kill(os.getpid(), signal.SIGINT)
            while True:
                check()

    def felt(self, z_mm: float, force_n: float) -> None:
        if self.forces:
            self.forces[-1].append((z_mm, force_n))


def pressed(rig: FakeRig, folder: Path, protocol: Protocol, notes: Notes | None = None) -> BlockResult:
    opened = rig.rig()
    with Signals() as signals:
        return press_block(
            opened,
            info_of(opened, protocol),
            folder,
            signals=signals,
            progress=notes or Notes(),
            taught_mm=(0.0,),
            durable=False,
        )


def check_complete(folder: Path, protocol: Protocol) -> Run:
    """Check that every press exists once, that frames match their checksums, and that all stationary frames exist."""
    run = Run.open(folder)
    count = protocol.levels * protocol.repeats * len(protocol.positions.grid.positions_mm)
    assert sorted(row.number for row in run.rows) == list(range(1, count + 1))
    assert len(run.by_key) == count
    for row in run.rows:
        run.frame(row, verify=True)
    for when in ("start", "end"):
        for contact in (True, False):
            assert len(run.stationary(when, contact)) == protocol.checks.stationary_frames
    return run


def test_every_press_of_a_block_is_made(tmp_path: Path) -> None:
    rig, protocol = FakeRig(), small_protocol()
    result = pressed(rig, tmp_path / "run", protocol)
    assert (result.presses, result.missed) == (16, 0)
    run = check_complete(tmp_path / "run", protocol)
    for row in run.rows:
        assert row.in_band
        assert row.target_force_n is not None
        assert row.force_after_n == pytest.approx(row.target_force_n, abs=0.012)
        assert row.reference_age_s is not None
        # At the recorded pose this plate carries the target force.
        assert rig.plate.force_n(row.pose_mm) == pytest.approx(row.target_force_n, abs=0.012)
    assert rig.stage.at[2] == pytest.approx(TRAVEL_MM)


def test_the_stage_moves_sideways_only_at_the_travel_height(tmp_path: Path) -> None:
    rig = FakeRig()
    pressed(rig, tmp_path / "run", small_protocol())
    for before, after in zip(rig.stage.path, rig.stage.path[1:], strict=False):
        if before[:2] != after[:2]:
            assert min(before[2], after[2]) >= TRAVEL_MM - 0.01


def test_references_are_taken_at_the_chosen_interval(tmp_path: Path) -> None:
    # The test clock runs so fast that a reference is due at every press.
    rig, protocol = FakeRig(), small_protocol()
    pressed(rig, tmp_path / "run", protocol)
    assert len(Run.open(tmp_path / "run").references) == 1 + 16


@pytest.mark.parametrize("touch", ["sensor", "taught"])
def test_a_rig_without_a_gauge(tmp_path: Path, touch: str) -> None:
    rig, protocol = FakeRig(gauge=False), small_protocol(contact="depth", touch=touch)
    pressed(rig, tmp_path / "run", protocol)
    for row in check_complete(tmp_path / "run", protocol).rows:
        assert (row.target_force_n, row.measured_force_n, row.force_after_n, row.in_band) == (None,) * 4
        assert row.force_level is not None
        assert row.target_depth_mm == protocol.targets.depths_mm[row.force_level - 1]
        assert row.touch_height_mm == pytest.approx(row.pose_mm[2] + row.target_depth_mm, abs=0.02)
    header = (tmp_path / "run" / "targets.csv").read_text().splitlines()[0]
    assert header == (
        "sensor_image,pose_x,pose_y,pose_z,position,force_level,repeat,target_depth_mm,touch_height_mm,time_utc,"
        "reference_age_s,image_sha256"
    )


def test_five_misses_in_a_row_stop_the_run_and_keep_their_rows(tmp_path: Path) -> None:
    rig, protocol = FakeRig(step_mm=0.05), small_protocol(search_steps=6, bands_n=(0.0005, 0.0005))
    with pytest.raises(RigError, match="5 presses in a row were outside the force band"):
        pressed(rig, tmp_path / "run", protocol)
    assert [row.in_band for row in Run.open(tmp_path / "run").rows] == [False] * 5
    assert rig.stage.at[2] == pytest.approx(TRAVEL_MM, abs=0.05)


FAULTS = [
    NoAnswerError("the stage is silent"),
    AlarmError("ALARM:1"),
    PositionLostError("the stage was reset"),
    RigError("the gauge is stuck"),
    DeviceLostError("the gauge was unplugged"),
    RigError("the image is dark"),
]


@pytest.mark.parametrize("error", FAULTS, ids=lambda error: type(error).__name__)
@pytest.mark.parametrize("where", ["stage", "gauge", "sensor"])
def test_a_fault_lifts_the_sensor_and_the_run_can_be_resumed(tmp_path: Path, where: str, error: RigError) -> None:
    rig, protocol = FakeRig(), small_protocol()
    assert rig.gauge is not None
    faults = {"stage": rig.stage.faults, "gauge": rig.gauge.faults, "sensor": rig.sensor.faults}[where]
    faults[12 if where == "sensor" else 300] = error
    with pytest.raises(type(error), match=str(error)) as caught:
        pressed(rig, tmp_path / "run", protocol)
    assert caught.value.exit_code == 3
    assert rig.stage.at[2] >= TRAVEL_MM - 0.01
    assert 0 < len(Run.open(tmp_path / "run").rows) < 16
    pressed(rig, tmp_path / "run", protocol)
    check_complete(tmp_path / "run", protocol)


def test_a_locked_stage_is_homed_to_lift_the_sensor(tmp_path: Path) -> None:
    rig = FakeRig()
    error = AlarmError("ALARM:3")
    rig.stage.faults.update({200: error, 201: error, 202: error})
    with pytest.raises(AlarmError):
        pressed(rig, tmp_path / "run", small_protocol())
    assert rig.stage.homed == 1
    assert rig.stage.at[2] == 20.0


def test_a_dead_stage_is_reported_and_no_press_is_lost(tmp_path: Path) -> None:
    protocol, notes = small_protocol(), Notes()
    rig = FakeRig(dead_after=(300, DeviceLostError("/dev/stage is gone")))
    with pytest.raises(DeviceLostError, match="/dev/stage is gone"):
        pressed(rig, tmp_path / "run", protocol, notes)
    assert any("was not lifted" in message and "by hand" in message for message in notes.messages)
    pressed(FakeRig(), tmp_path / "run", protocol)
    check_complete(tmp_path / "run", protocol)


@pytest.mark.parametrize("above_mm", [0.8, 1.3, 3.0, -1.6])
@pytest.mark.parametrize("contact", ["force", "depth"])
def test_a_block_at_another_height_than_taught_is_pressed_only_after_a_yes(
    contact: str, above_mm: float, tmp_path: Path
) -> None:
    """The plate is flat, and texture 1 nominally touches the dome 0.11 mm below its highest point there."""
    rig, notes = FakeRig(plate=Plate(top=lambda x, y: above_mm - 0.11)), Notes()
    protocol = small_protocol(contact=contact)
    asked: list[str] = []

    def session(answer: bool) -> None:
        def confirm(problem: str) -> bool:
            assert rig.stage.at[2] >= TRAVEL_MM - 0.01
            asked.append(problem)
            return answer

        opened = rig.rig()
        info = info_of(opened, protocol)
        with Signals() as signals:
            press_block(opened, info, tmp_path / "run", signals=signals, progress=notes, durable=False, confirm=confirm)

    word = "higher" if above_mm > 0.0 else "lower"
    said = re.compile(rf"the block is {int(abs(above_mm))}\.\d mm {word} than taught")
    if abs(above_mm) > 1.0:
        with pytest.raises(RigError, match=said):
            session(False)
        assert rig.gauge is not None
        assert max(map(abs, rig.gauge.readings)) < 0.08, "it was only touched"
        assert Run.open(tmp_path / "run").rows == () and rig.stage.at[2] >= TRAVEL_MM - 0.01
        assert len(asked) == 1 and said.fullmatch(asked[0])
        session(True)
    else:
        session(False)
        assert len([message for message in notes.messages if said.fullmatch(message)]) == 1 and asked == []
    check_complete(tmp_path / "run", protocol)


def test_the_force_limit_stops_the_run(tmp_path: Path) -> None:
    # The load is so stiff that one approach step leads from below the target to above the limit.
    plate = Plate(stiffness=90.0, power=1.0)
    rig, protocol = FakeRig(plate=plate), small_protocol()
    with pytest.raises(ForceLimitError, match="above the hard limit of 5 N"):
        pressed(rig, tmp_path / "run", protocol)
    assert rig.stage.at[2] == pytest.approx(TRAVEL_MM)
    assert rig.gauge is not None
    assert max(rig.gauge.readings) <= protocol.limits.hard_limit_n + protocol.steps.approach_step_mm * 90.0


def test_a_lift_with_a_stalled_motor_is_noticed_before_the_sensor_moves_sideways(tmp_path: Path) -> None:
    rig, protocol = FakeRig(), small_protocol()
    settled = rig.sensor.read

    def read() -> object:
        frame = settled()
        if rig.sensor.count == 25:  # a press at the second force
            rig.stage.stalls[rig.stage.calls + 2] = 2
        return frame

    rig.sensor.read = read  # type: ignore[method-assign, assignment]
    with pytest.raises(ContactError, match="at the travel height, where the sensor should be free"):
        pressed(rig, tmp_path / "run", protocol)
    assert rig.stage.homed == 1, "the height is unknown, so only homing lifts the sensor"
    assert max(rig.plate.force_n(at) for at in rig.stage.true_path) < 2.0
    for before, after in zip(rig.stage.true_path, rig.stage.true_path[1:], strict=False):
        assert before[:2] == after[:2] or before[2] > 0.0
    pressed(rig, tmp_path / "run", protocol)
    check_complete(tmp_path / "run", protocol)


def test_a_repeated_image_means_a_stuck_sensor(tmp_path: Path) -> None:
    rig = FakeRig()
    frozen = rig.sensor.read()
    rig.sensor.read = lambda: frozen  # type: ignore[method-assign]
    with pytest.raises(RigError, match="the same image twice"):
        pressed(rig, tmp_path / "run", small_protocol())
    assert rig.stage.at[2] >= TRAVEL_MM - 0.01


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_signal_lifts_the_sensor_and_the_run_can_be_resumed(tmp_path: Path, name: str) -> None:
    if not hasattr(signal, name):
        pytest.skip(f"{name} does not exist on this system")
    rig, protocol = FakeRig(), small_protocol()
    before = signal.getsignal(getattr(signal, name))
    rig.stage.on_move = lambda at: signal.raise_signal(getattr(signal, name)) if at[2] < IN_CONTACT_MM else None
    with pytest.raises(RunInterruptedError, match="the sensor is lifted") as caught:
        pressed(rig, tmp_path / "run", protocol)
    assert caught.value.signal == name and isinstance(caught.value, KeyboardInterrupt)
    assert rig.stage.stopped == 1
    assert rig.stage.at[2] >= TRAVEL_MM - 0.01
    assert signal.getsignal(getattr(signal, name)) == before
    rig.stage.on_move = lambda _: None
    pressed(rig, tmp_path / "run", protocol)
    check_complete(tmp_path / "run", protocol)


def test_a_second_signal_does_not_disturb_the_lift(tmp_path: Path) -> None:
    rig = FakeRig()

    def twice(_: object) -> None:
        if rig.stage.calls >= 250:
            signal.raise_signal(signal.SIGINT)

    rig.stage.on_move = twice
    with pytest.raises(RunInterruptedError):
        pressed(rig, tmp_path / "run", small_protocol())
    assert rig.stage.stopped == 1
    assert rig.stage.at[2] >= TRAVEL_MM - 0.01


def test_an_interruption_reports_that_the_lift_failed(tmp_path: Path) -> None:
    rig = FakeRig()

    def gone(at: Point) -> None:
        if at[2] < IN_CONTACT_MM:
            rig.stage.dead_after = (rig.stage.calls + 1, DeviceLostError("unplugged"))
            signal.raise_signal(signal.SIGINT)

    rig.stage.on_move = gone
    with pytest.raises(RunInterruptedError, match="the sensor was NOT lifted: lift it by hand"):
        pressed(rig, tmp_path / "run", small_protocol())


def test_a_full_disk_lifts_the_sensor_and_the_run_can_be_resumed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig, protocol = FakeRig(), small_protocol()
    real, calls = os.fsync, []

    def full(handle: int) -> None:
        calls.append(handle)
        if len(calls) > 60:
            raise OSError(errno.ENOSPC, "No space left on device")
        real(handle)

    monkeypatch.setattr(os, "fsync", full)
    opened = rig.rig()
    with pytest.raises(InputError, match="no space left"), Signals() as signals:
        press_block(opened, info_of(opened, protocol), tmp_path / "run", signals=signals, progress=PressProgress())
    assert rig.stage.at[2] >= TRAVEL_MM - 0.01
    monkeypatch.undo()
    pressed(rig, tmp_path / "run", protocol)
    check_complete(tmp_path / "run", protocol)


def test_nothing_moves_if_the_folder_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "run").write_text("a file")
    rig = FakeRig()
    with pytest.raises(InputError, match="is not a folder"):
        pressed(rig, tmp_path / "run", small_protocol())
    assert len(rig.stage.path) == 1


def test_other_settings_are_refused_before_anything_moves(tmp_path: Path) -> None:
    rig, protocol = FakeRig(), small_protocol()
    pressed(rig, tmp_path / "run", protocol)
    moves = len(rig.stage.path)
    rig.sensor.settings["requested"]["exposure"] = 7
    with pytest.raises(InputError, match=r"sensor\.settings\.requested\.exposure was 5, is now 7"):
        pressed(rig, tmp_path / "run", protocol)
    assert len(rig.stage.path) == moves


def run_with_random_faults(seed: int, folder: Path) -> Counter[str]:
    """Resume a run with random faults until it is complete, and check the invariants of the press loop each time.

    Returns:
        The faults that ended a session, counted by the names of their errors.
    """
    dice = random.Random(seed)
    protocol = small_protocol()
    plate = dice.choice([Plate(), Plate(stiffness=8.0, power=1.0), Plate(stiffness=30.0, power=1.5)])
    protocol = small_protocol(bands_n=(0.05, 0.2), fine_step_mm=0.0001)
    rig = FakeRig(plate=plate)
    assert rig.gauge is not None
    rows: list[int] = []
    faults: Counter[str] = Counter()
    for session in range(12):
        rig.stage.calls = rig.sensor.count = 0
        rig.gauge.readings.clear()
        rig.stage.path = rig.stage.path[-1:]
        errors = dice.choices(FAULTS, k=2)
        kind = dice.choice(["stage", "gauge", "sensor", "force", "nothing"])
        at = dice.randrange(5, 450)
        rig.stage.faults = {at: errors[0], at + dice.randrange(1, 4): errors[1]} if kind == "stage" else {}
        force = dice.choice([5.4, -5.4, float("nan")])
        rig.gauge.faults = {"gauge": {at: errors[0]}, "force": {at: force}}.get(kind, {})
        rig.sensor.faults = {dice.randrange(3, 30): errors[0]} if kind == "sensor" else {}
        try:
            pressed(rig, folder, protocol)
            finished = True
        except TacbenchError as error:
            assert isinstance(error, RigError), error
            assert str(error)
            faults[type(error).__name__] += 1
            finished = False
        rig.stage.faults, rig.gauge.faults, rig.sensor.faults = {}, {}, {}
        assert min(z for _, _, z in rig.stage.path) >= -protocol.limits.depth_limit_mm
        assert rig.stage.at[2] >= TRAVEL_MM - 0.01, "not lifted"
        stiffest = plate.stiffness_n_per_mm(protocol.limits.hard_limit_n)
        true_n = max(plate.force_n(position) for position in rig.stage.path)
        assert true_n <= protocol.limits.hard_limit_n + protocol.steps.approach_step_mm * stiffest
        now = [row.number for row in Run.open(folder).rows]
        assert now[: len(rows)] == rows
        assert len(set(now)) == len(now)
        rows = now
        if finished and session:
            break
    else:
        pressed(rig, folder, protocol)
    check_complete(folder, protocol)
    return faults


@pytest.mark.parametrize("seed", range(6))
def test_the_invariants_hold_under_random_faults(seed: int, tmp_path: Path) -> None:
    run_with_random_faults(seed, tmp_path / "run")


@pytest.mark.long
def test_the_invariants_hold_under_four_hundred_random_faults(tmp_path: Path) -> None:
    """Only faults that ended a session count; others hit a call after the end of the run."""
    faults: Counter[str] = Counter()
    for seed in itertools.count(1000):
        faults += run_with_random_faults(seed, tmp_path / "run")
        shutil.rmtree(tmp_path / "run")
        if faults.total() >= 400:
            break
    print(f"{faults.total()} faults in {seed - 999} runs, no press lost: {dict(faults.most_common())}")
    assert len(faults) >= 6


def test_the_progress_gets_every_force_and_may_wait_before_a_press_until_a_signal_comes(tmp_path: Path) -> None:
    rig, notes, protocol = FakeRig(), Waiting(), small_protocol(repeats=1, stationary_frames=0)
    with pytest.raises(RunInterruptedError) as caught:
        pressed(rig, tmp_path / "run", protocol, notes)
    assert caught.value.lifted and rig.stage.position()[2] >= TRAVEL_MM
    rows = Run.open(tmp_path / "run").rows
    assert len(rows) == 2
    for row, forces in zip(rows, notes.forces, strict=False):
        heights = [z for z, _ in forces]
        assert max(heights) > row.pose_z == pytest.approx(min(heights), abs=0.1)
        assert row.measured_force_n in [round(force, 6) for _, force in forces]
