"""Test the measurement of the position at the end stops: on ideal switches, and with the virtual GRBL."""

from __future__ import annotations

from contextlib import suppress

import pytest
from helpers.rig_here import launch

from tacbench_cad.extensions.virtual_rig.faults import Fault
from tacbench_cad.lab.acquire.slips import require_repeatable_homing
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.errors import AlarmError, DeviceLostError, PositionLostError, RigError
from tacbench_cad.lab.rig.grbl import GrblStage
from tacbench_cad.lab.rig.marlin import MarlinStage
from tacbench_cad.lab.rig.probing import identify
from tacbench_cad.lab.rig.switches import SwitchCheck, offset_at_switch


@pytest.mark.parametrize("towards", [1, -1])
@pytest.mark.parametrize("error_mm", [0.0, 0.2, -0.2, 0.45, 3.0, 30.0, -0.5, -4.0])
def test_the_error_of_the_position_is_measured(error_mm: float, towards: int) -> None:
    visited = []

    def closed_at(coordinate_mm: float) -> bool:
        visited.append(towards * coordinate_mm)
        # The carriage is nearer to the switch than reported by error_mm.
        return towards * (coordinate_mm + towards * error_mm) >= towards * 50.0

    offset = offset_at_switch(closed_at, 50.0, towards)
    # Beyond these limits only the sign and a lower bound are known.
    assert towards * offset == pytest.approx(max(-0.6, min(error_mm, 20.0)), abs=0.011 if error_mm < 20.0 else 10.0)
    assert max(visited) <= towards * 50.0 + 0.61


@pytest.mark.usefixtures("rig_time")
@pytest.mark.parametrize("origin", ["pull-off", "switch"])
def test_grbl_measures_a_slip_of_any_axis(origin: str) -> None:
    options = {} if origin == "pull-off" else {"origin": "switch"}
    clock = Clock(speed=100.0)
    with launch("grbl", speed=100.0, **options) as virtual, GrblStage(virtual.port, clock=clock) as stage:
        stage.home()
        x, y, _ = stage.position()
        assert stage.home_offset_mm() == pytest.approx((0.0, 0.0, 0.0), abs=0.03)
        for axis, by_mm in (("x", 0.2), ("y", -0.25), ("z", -0.3)):
            stage.move((x + 30.0, y + 20.0, -20.0), 20.0)
            virtual.inject(Fault(kind="slip", axis=axis, mm=by_mm))
            offset = stage.home_offset_mm()
            assert offset == pytest.approx([by_mm if name == axis else 0.0 for name in "xyz"], abs=0.03)
        assert stage.home_offset_mm() == pytest.approx((0.0, 0.0, 0.0), abs=0.03)
        assert stage.settings[20] == stage.settings[21] == 1
        assert stage._link.settings() == stage.settings, "the firmware's limits are on again"


@pytest.mark.usefixtures("rig_time")
@pytest.mark.parametrize("dialect", ["grbl", "grblhal"])
def test_limits_that_a_killed_program_left_off_are_on_again(dialect: str, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock(speed=100.0)
    with launch(dialect, speed=100.0, resets_on_open=False) as virtual:
        with GrblStage(virtual.port, clock=clock) as stage:
            stage.home()
            identity = stage.identity

            def killed(*_: object) -> None:
                stage.close()
                raise DeviceLostError("as after a kill, nothing more is sent")

            monkeypatch.setattr(GrblStage, "_search_switches", killed)
            with pytest.raises(DeviceLostError):
                stage.home_offset_mm()
        for _ in range(2):  # a probe writes nothing, so the second sees the same
            rows = {row.name: row for row in identify(virtual.port).settings}
            assert [(rows[name].value, rows[name].change) for name in ("$20", "$21")] == [
                ("0", "$20=1"),
                ("0", "$21=1"),
            ]
        with GrblStage(virtual.port, clock=clock) as stage:
            assert (stage.settings[20], stage.settings[21]) == (1, 1)
            assert stage._link.marked == (20, 21), "the mark was there until now"
            assert "TACBENCH" not in stage.identity and identity.endswith(stage.identity.split(" 1.1")[1])
        with GrblStage(virtual.port, clock=clock) as stage:
            assert stage._link.marked == (), "the mark is gone"
            stage._link.set(20, 0.0)
        with pytest.raises(RigError, match=r"has no soft limits \(\$20=0\); send it \$20=1"):
            GrblStage(virtual.port, clock=clock)


@pytest.mark.usefixtures("rig_time")
def test_options_of_grblhal_in_the_limits_survive_a_check_of_the_end_stops() -> None:
    """In ``$21=3`` of grblHAL, bit 0 switches the end stops on, and bit 1 is its strict mode."""
    with launch("grblhal", speed=100.0, resets_on_open=False, settings={21: 3, 22: 33}) as virtual:
        with GrblStage(virtual.port, clock=Clock(speed=100.0)) as stage:
            stage.home()
            assert stage.home_offset_mm() == pytest.approx((0.0, 0.0, 0.0), abs=0.03)
        rows = {row.name: row for row in identify(virtual.port).settings}
    assert [(rows[name].value, rows[name].change) for name in ("$21", "$22")] == [("3", ""), ("33", "")]


@pytest.mark.usefixtures("rig_time")
def test_marlin_measures_a_slip_of_any_axis() -> None:
    with launch("marlin", speed=100.0) as virtual, MarlinStage(virtual.port) as stage:
        stage.home()
        assert stage.home_offset_mm() == pytest.approx((0.0, 0.0, 0.0), abs=0.08)
        for axis, by_mm in (("x", 0.2), ("y", -0.25), ("z", -0.3)):
            stage.move((60.0, 40.0, 80.0), 20.0)
            virtual.inject(Fault(kind="slip", axis=axis, mm=by_mm))
            offset = stage.home_offset_mm()
            assert offset == pytest.approx([by_mm if name == axis else 0.0 for name in "xyz"], abs=0.08)
        with pytest.raises(RigError, match="soft end stops"):
            stage.move((-0.3, 40.0, 80.0), 20.0)
        stage._link.command("M211 S0")
        stage.home()
        with pytest.raises(RigError, match="soft end stops"):
            stage.move((-0.3, 40.0, 80.0), 20.0)


def test_switches_that_the_firmware_does_not_report_are_not_used() -> None:
    check, homed = SwitchCheck(), []
    for _ in range(3):
        assert check.compare(lambda: (0.0, 0.0, -0.6), lambda: homed.append(1)) is None
    assert len(homed) == 4


def test_a_wrong_first_homing_is_not_taken_for_a_missing_switch() -> None:
    offsets = iter([(0.0, 0.0, -0.6), (0.0, 0.0, 0.0), (0.0, 0.0, -0.6)])
    check = SwitchCheck()
    assert check.compare(lambda: next(offsets), lambda: None) == (0.0, 0.0, -0.6)
    assert check.compare(lambda: next(offsets), lambda: None) == (0.0, 0.0, -0.6)


@pytest.mark.usefixtures("rig_time")
def test_an_end_stop_of_grbl_that_closes_for_an_instant_is_noticed() -> None:
    wrong = 0
    for delay_s in (2.4, 2.5, 2.6, 2.7, 2.8):
        with launch("grbl", speed=10.0) as virtual, GrblStage(virtual.port, clock=Clock(speed=10.0)) as stage:
            virtual.inject(Fault(kind="switch", axis="z", at_s=virtual.now_s() + delay_s, seconds=0.15))
            with suppress(AlarmError):
                stage.home()
                error = virtual.true_position()[2] - stage.position()[2]
                wrong += abs(error) > 0.1
                if abs(error) > 0.1:
                    with pytest.raises(PositionLostError, match="two homings differ by"):
                        require_repeatable_homing(stage, 0.1)
                else:
                    require_repeatable_homing(stage, 0.1)
    assert wrong > 0
