"""Inject faults into the virtual rig during a run: a specific error, a lifted sensor, and a run that can be resumed."""

from __future__ import annotations

import random
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from helpers.cases import mostly_long
from helpers.emulated import emulated_study
from helpers.rig_here import RigHere
from helpers.rigs import small_protocol

from tacbench_cad.extensions.virtual_rig import drivers
from tacbench_cad.extensions.virtual_rig.faults import Fault
from tacbench_cad.lab.acquire.person import Typing
from tacbench_cad.lab.acquire.progress import PressProgress
from tacbench_cad.lab.acquire.session import acquire_study
from tacbench_cad.lab.acquire.study_file import StudyFile
from tacbench_cad.lab.rig.errors import ContactError, PositionLostError, RigError
from tacbench_cad.lab.rig.gauge import Force
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.lab.study.spec import Study
from tacbench_cad.spec.protocol import PressGrid

pytestmark = pytest.mark.usefixtures("rig_time")
#: The travel height over the virtual rigs' blocks, in the work frame, in mm.
CLEARANCE_MM = 1.5
#: The time for which a firmware stands still, in s: several attempts to lift the sensor fail meanwhile.
STANDS_S = 15.0


class Trial(PressProgress):
    """A session on a virtual rig with a fault after the second press.

    Args:
        file: The study and the rig.
        fault: The fault; None for no fault.
        delay_s: The rig time from the second press to the fault, in s.
    """

    def __init__(self, file: StudyFile, fault: Fault | None, delay_s: float) -> None:
        self.file, self.fault, self.delay_s = file, fault, delay_s
        self.rig: RigHere | None = None
        self.lowest_mm = self.left_at_mm = 1e9
        self.messages: list[str] = []
        self.count = 0

    def pressed(self, done: int, force: Force | None, in_band: bool | None, reading: Path) -> None:
        self.count += 1
        if self.count == 2 and self.fault is not None and self.rig is not None:
            self.rig.inject(replace(self.fault, at_s=self.rig.now_s() + self.delay_s))

    def say(self, message: str) -> None:
        self.messages.append(message)

    def run(self, out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        """Start or resume the run, and store the true height of the carriage when the devices are closed."""
        start = drivers.launch

        def launched(*values: Any, **named: Any) -> RigHere:
            rig = start(*values, **named)
            self.rig = rig
            close = rig.close
            monkeypatch.setattr(rig, "close", lambda: (self._look(rig), close()))
            return rig

        with monkeypatch.context() as patched:
            patched.setattr(drivers, "launch", launched)
            acquire_study(
                self.file.study,
                self.file.required_rig,
                out,
                person=Typing(lambda _: "", lambda _: None),
                progress=self,
                durable=False,
            )

    def _look(self, rig: RigHere) -> None:
        origin = self.file.required_rig.stage.origin_mm[2]
        self.left_at_mm = rig.true_position()[2] - origin


def short_file(driver: str) -> StudyFile:
    """Return a study of four presses at four positions with short timeouts."""
    file = emulated_study(driver, speed=100.0)
    protocol = small_protocol(repeats=1, stationary_frames=1, clearance_mm=CLEARANCE_MM)
    blocks = tuple(replace(block, levels=(2,)) for block in file.study.blocks)
    study = Study(blocks=blocks, protocol=protocol)
    rig = file.required_rig
    rig = replace(rig, stage=replace(rig.stage, timeout_s=1.0), gauge=replace(rig.gauge, timeout_s=0.5))
    return StudyFile(study=study, rig=rig)


def try_fault(
    driver: str,
    fault: Fault,
    delay_s: float,
    out: Path,
    monkeypatch: pytest.MonkeyPatch,
    late_s: tuple[float, float] = (0.0, 0.0),
) -> tuple[RigError | None, Trial]:
    """Run a session with the fault and a session without it, after which the run must be complete.

    Returns:
        The error of the first session, or None, and the first session.
    """
    file = short_file(driver)
    if any(late_s):
        # A stage whose replies come late, in s of real time.
        stage = file.required_rig.stage
        options = stage.options | {"late_s": [100.0 * seconds for seconds in late_s]}
        slow = replace(stage, timeout_s=10.0, options=options)
        file = replace(file, rig=replace(file.required_rig, stage=slow))
    trial = Trial(file, fault, delay_s)
    caught: RigError | None = None
    try:
        trial.run(out, monkeypatch)
    except RigError as error:
        caught = error
        assert error.exit_code == 3
        assert str(error)
    folder = out / file.study.blocks[0].printed.name
    before = [row.number for row in Run.open(folder).rows]
    assert len(before) >= 2
    Trial(file, None, 0.0).run(out, monkeypatch)
    run = Run.open(folder)
    assert [row.number for row in run.rows] == [1, 2, 3, 4]
    for row in run.rows:
        run.frame(row, verify=True)
        assert row.measured_force_n is not None
        assert row.measured_force_n < file.study.protocol.limits.hard_limit_n
    return caught, trial


def test_an_alarm_on_grbl_lifts_the_sensor(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    error, trial = try_fault("virtual-grbl", Fault(kind="alarm"), 1.0, tmp_path, monkeypatch)
    assert error is not None
    assert trial.left_at_mm >= CLEARANCE_MM - 0.1, (error, trial.messages)


@pytest.mark.parametrize("origin", mostly_long(["pulloff", "switch"], "switch"))
def test_both_builds_of_grbl_are_pressed_with_and_checked(
    origin: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Coordinates are 0 where homing ends, or at the switches: GRBL's default build, where all are negative."""
    file = short_file("virtual-grbl")
    stage = file.required_rig.stage
    if origin == "switch":
        x, y, z = stage.origin_mm
        stage = replace(
            stage,
            origin_mm=(x - 200.0, y - 200.0, z),
            limits_mm=((-200.0, 0.0), (-200.0, 0.0), stage.limits_mm[2]),
            options={**stage.options, "origin": origin},
        )
    grid = PressGrid(x_mm=(4.0, 9.0), y_mm=(18.0,))
    protocol = file.study.protocol.changed(home_every=50, grid=grid)
    study = replace(file.study, protocol=protocol)
    file = StudyFile(study=study, rig=replace(file.required_rig, stage=stage))
    trial = Trial(file, None, 0.0)
    trial.run(tmp_path, monkeypatch)
    run = Run.open(tmp_path / study.blocks[0].printed.name)
    assert [row.number for row in run.rows] == [1, 2] and all(row.in_band for row in run.rows)
    assert [check.reason for check in run.position_checks] == ["start", "end", "first"]
    for check in run.position_checks[:-1]:
        assert check.ok and check.covers_all_axes
        offset = (check.offset_x_mm, check.offset_y_mm, check.offset_z_mm)
        assert offset == pytest.approx((0.0, 0.0, 0.0), abs=0.03)
    assert trial.left_at_mm >= CLEARANCE_MM - 0.1


@pytest.mark.long
@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_a_slip_on_grbl_is_found_and_its_presses_are_made_again(
    axis: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = short_file("virtual-grbl")
    file = replace(file, study=replace(file.study, protocol=file.study.protocol.changed(home_every=4)))
    with pytest.raises((PositionLostError, ContactError)):
        Trial(file, Fault(kind="slip", axis=axis, mm=-0.3), 0.0).run(tmp_path, monkeypatch)
    folder = tmp_path / file.study.blocks[0].printed.name
    assert [row.number for row in Run.open(folder).rows] in ([1], [1, 2])
    Trial(file, None, 0.0).run(tmp_path, monkeypatch)
    run = Run.open(folder)
    assert sorted(row.number for row in run.rows) == [1, 2, 3, 4]
    assert run.position_checks[-2].ok and run.position_checks[-2].covers_all_axes


class StandsStill(Trial):
    """A session in which the firmware stands still for some seconds while the sensor is in contact."""

    def felt(self, z_mm: float, force_n: float) -> None:
        if self.count == 2 and force_n > 0.3 and self.rig is not None and not self.stopped:
            self.stopped = True
            self.rig.stand_still(STANDS_S)

    stopped = False


@pytest.mark.parametrize("driver", mostly_long(["virtual-grbl", "virtual-marlin"], "virtual-grbl"))
def test_a_firmware_that_stands_still_in_contact_lifts_when_it_answers_again(
    driver: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    trial = StandsStill(short_file(driver), None, 0.0)
    with pytest.raises(RigError) as caught:
        trial.run(tmp_path, monkeypatch)
    # The driver of Marlin itself waits longer than the firmware stands still.
    assert trial.messages == ["the stage does not answer; trying to lift the sensor for 60 s"] * ("grbl" in driver)
    assert "the sensor is lifted" in caught.value.__notes__
    assert trial.left_at_mm >= CLEARANCE_MM - 0.1
    again = Trial(short_file(driver), None, 0.0)
    again.run(tmp_path, monkeypatch)


#: Faults after which the program cannot lift the sensor: the port is gone or stays silent.
DEAD = {
    "unplugged": Fault(kind="unplug"),
    "silent": Fault(kind="silence", direction="both"),
}
ALL = {
    **DEAD,
    "alarm": Fault(kind="alarm"),
    "stuck gauge": Fault(kind="stuck", where="gauge"),
    "gauge unplugged": Fault(kind="unplug", where="gauge"),
    "dropped byte": Fault(kind="drop", count=1),
    "dropped bytes": Fault(kind="drop", chance=0.05, seconds=30.0),
    "doubled bytes": Fault(kind="double", chance=0.05, seconds=30.0),
    "garbled bytes": Fault(kind="garble", chance=0.05, seconds=30.0),
    "garbled orders": Fault(kind="garble", chance=0.05, seconds=30.0, direction="in"),
    "short silence": Fault(kind="silence", direction="both", seconds=20.0),
    "reset": Fault(kind="reset"),
    "slipping motor": Fault(kind="slip", mm=0.3),
    "stalled motor": Fault(kind="stall", seconds=5.0),
    "noisy gauge": Fault(kind="noise", where="gauge", n=0.5),
    "saturated gauge": Fault(kind="saturated", where="gauge"),
    "garbled gauge": Fault(kind="garble", where="gauge", chance=0.1, seconds=60.0),
    "silent gauge": Fault(kind="silence", where="gauge"),
}


@pytest.mark.long
@pytest.mark.parametrize("driver", ["virtual-grbl", "virtual-marlin"])
@pytest.mark.parametrize("name", ALL)
def test_every_fault_on_every_driver(name: str, driver: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    dice = random.Random(f"{name} {driver}")
    for attempt in range(3):
        error, trial = try_fault(driver, ALL[name], dice.uniform(0.0, 4.0), tmp_path / str(attempt), monkeypatch)
        if name in DEAD:
            assert error is not None
            assert any("by hand" in message for message in trial.messages)
        elif name == "alarm" and driver == "virtual-marlin":
            # A halted Marlin ignores everything until a person presses its reset button, so it may stay down.
            assert error is not None and "reset button" in str(error)
            assert trial.left_at_mm >= CLEARANCE_MM - 0.4 or any("by hand" in message for message in trial.messages)
        else:
            assert trial.left_at_mm >= CLEARANCE_MM - 0.4, (error, trial.messages)


@pytest.mark.long
@pytest.mark.parametrize("name", ["reset", "dropped byte", "garbled orders", "short silence", "alarm"])
def test_a_slow_stage_resumes_after_faults(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    try_fault("virtual-grbl", ALL[name], 1.0, tmp_path, monkeypatch, late_s=(0.02, 0.1))
