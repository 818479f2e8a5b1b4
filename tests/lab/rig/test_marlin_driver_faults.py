"""Test the Marlin driver against virtual Marlin and all its faults."""

from __future__ import annotations

import pytest
from helpers.driver_faults import SPEED, survive
from helpers.rig_here import FakeTime, launch

from tacbench_cad.extensions.virtual_rig.faults import Fault
from tacbench_cad.lab.rig import marlin_link
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.devices import open_stage
from tacbench_cad.lab.rig.errors import RigError
from tacbench_cad.lab.rig.marlin import MarlinStage
from tacbench_cad.lab.study.spec import Point, StageSettings

LIMITS = ((0.0, 200.0), (0.0, 200.0), (0.0, 100.0))
CENTER: Point = (50.0, 60.0, 70.0)


pytestmark = pytest.mark.usefixtures("rig_time")


def opener(port: str) -> MarlinStage:
    return MarlinStage(port, clock=Clock(speed=SPEED), baud=250000, timeout_s=0.3, home_timeout_s=5.0)


@pytest.mark.parametrize("emergency_parser", [False, True])
def test_open_stage_homes_moves_and_stops(emergency_parser: bool, rig_time: FakeTime) -> None:
    with launch("marlin", speed=SPEED, emergency_parser=emergency_parser) as rig:
        settings = StageSettings(driver="marlin", port=rig.port, limits_mm=LIMITS)
        with open_stage(settings, Clock(speed=SPEED)) as stage:
            assert stage.move(CENTER, 20.0) == pytest.approx(CENTER, abs=0.01)
            assert rig.true_position() == pytest.approx(CENTER, abs=0.05)
            rig_time.after(0.05, stage.stop)
            with pytest.raises(RigError, match="stopped on request"):
                stage.move((150.0, 150.0, 10.0), 5.0)
            assert stage.position() == pytest.approx(rig.true_position(), abs=0.05)
            assert stage.position()[0] < 149.0
            assert stage.move(CENTER, 20.0) == pytest.approx(CENTER, abs=0.01)


def test_every_reply_may_come_late(monkeypatch: pytest.MonkeyPatch) -> None:
    # The replies come later than the driver waits before it repeats a line.
    monkeypatch.setattr(marlin_link, "QUIET_S", 0.05)
    late_s = (0.02 * SPEED, 0.08 * SPEED)
    with launch("marlin", speed=SPEED, resets_on_open=False, late_s=late_s) as rig, opener(rig.port) as stage:
        stage.home()
        for target in (CENTER, (50.0, 60.0, 69.995)):
            assert stage.move(target, 50.0) == pytest.approx(target, abs=0.013)
            assert rig.true_position() == pytest.approx(target, abs=0.03)


@pytest.mark.parametrize("emergency_parser", [False, True])
def test_an_interruption_stops_homing(emergency_parser: bool, rig_time: FakeTime) -> None:
    with (
        launch("marlin", speed=5.0, resets_on_open=False, emergency_parser=emergency_parser) as rig,
        opener(rig.port) as stage,
    ):
        rig_time.interrupt(0.6)
        with pytest.raises(KeyboardInterrupt) as caught:
            stage.home()
        assert caught.value.__notes__ == ["homing was stopped and the firmware halted; press its reset button"]
        stopped = rig.true_position()
        assert stopped[2] < 99.0
        rig_time.sleep(0.2)
        assert rig.true_position() == stopped


def test_homing_that_cannot_be_stopped_is_reported(rig_time: FakeTime) -> None:
    with launch("marlin", speed=5.0, resets_on_open=False) as rig, opener(rig.port) as stage:

        def cut() -> None:
            rig.inject(Fault(kind="silence", direction="both"))
            raise KeyboardInterrupt

        rig_time.after(0.6, cut)
        with pytest.raises(KeyboardInterrupt) as caught:
            stage.home()
        assert "the carriage may still move" in caught.value.__notes__[0]


#: The seeds garble bytes, silence the line and raise an alarm. The quick tests of the other drivers cover the other
#: faults, and the long tests cover all.
@pytest.mark.parametrize("seed", (2, 3, 5))
def test_faults_cause_specific_errors_and_moves_end_at_the_reported_position(seed: int) -> None:
    survive("marlin", opener, CENTER, seed)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(147))
def test_many_faults(seed: int) -> None:
    survive("marlin", opener, CENTER, seed)
