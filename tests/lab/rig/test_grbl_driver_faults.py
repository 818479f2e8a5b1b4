"""Test the GRBL driver against virtual GRBL and grblHAL and all their faults."""

from __future__ import annotations

import contextlib
import itertools

import pytest
from helpers.cases import mostly_long
from helpers.driver_faults import SPEED, survive
from helpers.rig_here import FakeTime, launch

from tacbench_cad.extensions.virtual_rig.faults import Fault
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.devices import open_stage
from tacbench_cad.lab.rig.errors import (
    AlarmError,
    DeviceLostError,
    NoAnswerError,
    OutOfRangeError,
    PositionLostError,
    RigError,
)
from tacbench_cad.lab.rig.grbl import GrblStage
from tacbench_cad.lab.study.spec import Point, StageSettings
from tacbench_cad.util.errors import InputError

LIMITS = ((0.0, 200.0), (0.0, 200.0), (-100.0, 0.0))
CENTER: Point = (50.0, 60.0, -30.0)


pytestmark = pytest.mark.usefixtures("rig_time")


def opener(port: str) -> GrblStage:
    return GrblStage(port, clock=Clock(speed=SPEED), timeout_s=0.5, home_timeout_s=5.0)


def test_open_stage_homes_moves_and_keeps_its_limits() -> None:
    with launch("grbl", speed=SPEED) as rig:
        settings = StageSettings(driver="grbl", port=rig.port, limits_mm=LIMITS)
        with open_stage(settings, Clock(speed=SPEED)) as stage:
            assert stage.move(CENTER, 20.0) == pytest.approx(CENTER, abs=0.002)
            assert rig.true_position() == pytest.approx(CENTER, abs=0.01)
            before = rig.true_position()
            with pytest.raises(OutOfRangeError, match="nothing was sent"):
                stage.move((50.0, 60.0, 1.0), 20.0)
            assert rig.true_position() == before


def test_a_stop_in_motion_keeps_the_position(rig_time: FakeTime) -> None:
    with launch("grbl", speed=SPEED) as rig, opener(rig.port) as stage:
        stage.home()
        rig_time.after(0.05, stage.stop)
        with pytest.raises(RigError, match="stopped on request"):
            stage.move((150.0, 150.0, -50.0), 20.0)
        assert stage.position() == pytest.approx(rig.true_position(), abs=0.01)
        assert stage.position()[0] < 149.0
        assert stage.move(CENTER, 20.0) == pytest.approx(CENTER, abs=0.002)


def test_an_interruption_stops_homing(rig_time: FakeTime) -> None:
    with launch("grbl", speed=10.0, start_mm=(60.0, 45.0, -80.0)) as rig, opener(rig.port) as stage:
        rig_time.interrupt(0.2)
        with pytest.raises(KeyboardInterrupt) as caught:
            stage.home()
        assert caught.value.__notes__ == ["homing was stopped, so the position is unknown"]
        where = rig.true_position()
        rig_time.sleep(0.2)
        assert rig.true_position() == where
        assert where[2] < -1.0, "homing had ended before the interruption"
        with pytest.raises(PositionLostError):
            stage.position()


@pytest.mark.parametrize(("quiet", "message"), [(False, "ALARM:1"), (True, "Check Limits")])
def test_a_limit_is_an_alarm_even_if_only_the_lines_after_the_banner_report_it(
    quiet: bool, message: str, rig_time: FakeTime
) -> None:
    with launch("grbl", speed=SPEED, quiet_limits=quiet) as rig, opener(rig.port) as stage:
        stage.home()
        stage.move(CENTER, 20.0)
        rig.inject(Fault(kind="switch", axis="x", seconds=20.0))
        rig_time.sleep(0.05)
        with pytest.raises(AlarmError, match=message):
            stage.move((51.0, 60.0, -30.0), 20.0)


def test_homing_does_not_press_deeper_when_the_switch_of_z_is_stuck() -> None:
    with launch("grbl", speed=SPEED) as rig, opener(rig.port) as stage:
        stage.home()
        stage.move(CENTER, 20.0)
        rig.inject(Fault(kind="switch", axis="z"))
        where = rig.true_position()
        with pytest.raises(AlarmError):
            stage.move(CENTER, 20.0)
        with pytest.raises(AlarmError, match=r"z stays closed although the carriage is 30\.0 mm below it"):
            stage.home()
        assert rig.true_position() == where


@pytest.mark.parametrize(("kind", "direction"), [("drop", "in"), ("garble", "in"), ("garble", "out")])
def test_a_dead_or_disturbed_line_is_not_another_device(kind: str, direction: str) -> None:
    fault = Fault(kind=kind, chance=1.0, direction=direction)
    with launch("grbl", speed=SPEED, faults=[fault]) as rig, pytest.raises(NoAnswerError, match="disturbed"):
        opener(rig.port)


def test_the_default_build_keeps_clear_of_the_switch_at_the_top() -> None:
    with launch("grbl", speed=SPEED, origin="switch", seed=4) as rig:
        limits = ((-200.0, 0.0), (-200.0, 0.0), (-100.0, 0.0))
        settings = StageSettings(driver="grbl", port=rig.port, limits_mm=limits)
        with open_stage(settings, Clock(speed=SPEED)) as stage:
            assert stage.limits_mm[2] == (-100.0, -1.0)
            assert stage.move((-100.0, -100.0, -1.0), 20.0)[2] == -1.0
            with pytest.raises(OutOfRangeError, match="nothing was sent"):
                stage.move((-100.0, -100.0, 0.0), 20.0)


@pytest.mark.parametrize(
    ("origin", "limits", "allowed"),
    [
        ("pulloff", ((0.0, 210.0), (0.0, 200.0), (-100.0, 0.0)), "x = .*beyond the travel .*, 0 to 200 mm"),
        ("switch", ((-200.0, 0.0), (0.0, 200.0), (-100.0, 0.0)), "y = .*beyond the travel .*, -200 to 0 mm"),
    ],
)
def test_limits_beyond_the_travel_of_the_firmware_are_refused(
    origin: str, limits: tuple[tuple[float, float], ...], allowed: str
) -> None:
    with launch("grbl", speed=SPEED, origin=origin) as rig:
        settings = StageSettings(driver="grbl", port=rig.port, limits_mm=limits)  # type: ignore[arg-type]
        with pytest.raises(InputError, match=allowed):
            open_stage(settings, Clock(speed=SPEED))


def test_a_stage_that_a_killed_program_left_in_motion_is_stopped_and_usable(rig_time: FakeTime) -> None:
    with launch("grbl", speed=30.0, resets_on_open=False) as rig:
        with opener(rig.port) as stage:
            stage.home()
            stage._line.write(b"G53G1X100Y100Z-50F200\n")
            rig_time.sleep(0.05)
        with opener(rig.port) as stage:
            where = rig.true_position()
            rig_time.sleep(0.1)
            assert rig.true_position() == where
            with pytest.raises(PositionLostError):
                stage.position()
            stage.home()
            assert stage.move(CENTER, 20.0) == pytest.approx(CENTER, abs=0.002)


#: Faults after which a run must be able to go on.
STOPPING = {
    "nothing": None,
    "reset": Fault(kind="reset"),
    "lost byte": Fault(kind="drop", direction="in", count=1),
    "silence": Fault(kind="silence", direction="both", seconds=3.0 * SPEED),
    "unplugged": Fault(kind="unplug", seconds=0.5 * SPEED),
}


def resume_slowly(
    kind: str, fault: Fault | None, late_s: tuple[float, float], timeout_s: float, rig_time: FakeTime
) -> None:
    """Move, have a fault, open the port again, and move, while each reply comes late. The times are real ones."""
    with launch(kind, speed=SPEED, late_s=(late_s[0] * SPEED, late_s[1] * SPEED)) as rig:

        def slow_stage() -> GrblStage:
            return GrblStage(rig.port, clock=Clock(speed=SPEED), timeout_s=timeout_s, home_timeout_s=20.0)

        with slow_stage() as stage:
            stage.home()
            assert stage.move(CENTER, 20.0) == pytest.approx(CENTER, abs=0.002)
            if fault is not None:
                rig.inject(fault)
                with contextlib.suppress(PositionLostError, DeviceLostError):
                    stage.move((51.0, 60.0, -30.0), 20.0)
        if fault is not None and fault.kind == "unplug":
            rig_time.sleep(1.0)
        with slow_stage() as stage:
            stage.home()
            assert stage.move(CENTER, 20.0) == pytest.approx(CENTER, abs=0.002)
            assert rig.true_position() == pytest.approx(CENTER, abs=0.01)


@pytest.mark.parametrize(
    ("kind", "fault"),
    mostly_long(
        itertools.product(["grbl", "grblhal"], STOPPING),
        ("grbl", "silence"),
        ("grblhal", "reset"),
        ("grbl", "unplugged"),
    ),
)
def test_a_very_slow_stage_is_used_again(kind: str, fault: str, rig_time: FakeTime) -> None:
    resume_slowly(kind, STOPPING[fault], (0.3, 1.0), 10.0, rig_time)


#: The seeds drop bytes, double bytes and reset grblHAL. The quick tests of the other drivers cover the other faults,
#: and the long tests cover all.
@pytest.mark.parametrize(("kind", "seed"), [("grbl", 0), ("grbl", 1), ("grblhal", 4)])
def test_faults_cause_specific_errors_and_moves_end_at_the_reported_position(kind: str, seed: int) -> None:
    survive(kind, opener, CENTER, seed)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(147))
@pytest.mark.parametrize("kind", ["grbl", "grblhal"])
def test_many_faults(kind: str, seed: int) -> None:
    survive(kind, opener, CENTER, seed)


@pytest.mark.parametrize("direction", ["in", "out"])
@pytest.mark.parametrize("kind", ["garble", "drop", "double"])
def test_a_disturbed_byte_in_a_check_at_the_end_stops_is_survived(kind: str, direction: str) -> None:
    with launch("grbl", speed=SPEED, resets_on_open=False) as rig:
        with GrblStage(rig.port, clock=Clock(speed=SPEED), timeout_s=3.0) as stage:
            stage.home()
            kept = stage._link.settings()
            rig.inject(Fault(kind=kind, direction=direction, count=1))
            assert stage.home_offset_mm() == pytest.approx((0.0, 0.0, 0.0), abs=0.03)
            assert stage._link.settings() == kept
        with opener(rig.port) as stage:
            assert stage._link.marked == ()
