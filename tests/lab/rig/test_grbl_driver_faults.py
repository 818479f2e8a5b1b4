"""Test the GRBL driver against virtual GRBL and grblHAL and all their faults."""

from __future__ import annotations

import sys
import threading

import pytest

if sys.platform == "win32":
    pytest.skip("Windows has no pseudo-terminals", allow_module_level=True)

from helpers.driver_faults import SPEED, survive

from tacbench_cad.lab.rig import grbl_link
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.drivers import open_stage
from tacbench_cad.lab.rig.errors import NotThereError, OutOfRangeError, PositionLostError
from tacbench_cad.lab.rig.grbl import GrblStage
from tacbench_cad.lab.study.spec import Point, StageSettings
from tacbench_cad.virtual_rig.faults import Fault
from tacbench_cad.virtual_rig.process import launch

LIMITS = ((0.0, 200.0), (0.0, 200.0), (-100.0, 0.0))
CENTER: Point = (50.0, 60.0, -30.0)


@pytest.fixture(autouse=True)
def _short_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, seconds in (("RESET_S", 0.4), ("GREETING_S", 2.0), ("ATTEMPT_S", 0.3)):
        monkeypatch.setattr(grbl_link, name, seconds)


def opener(port: str) -> GrblStage:
    return GrblStage(port, clock=Clock(speed=SPEED), timeout_s=0.5, home_timeout_s=5.0)


@pytest.mark.parametrize("tcp", [pytest.param(False, marks=pytest.mark.long), True])
def test_open_stage_homes_moves_and_keeps_its_limits(tcp: bool) -> None:
    with launch("grbl", speed=SPEED, tcp=tcp) as rig:
        settings = StageSettings(driver="virtual-grbl", port=rig.port, limits_mm=LIMITS, options={"speed": SPEED})
        with open_stage(settings, Clock(speed=SPEED)) as stage:
            assert stage.simulated == "stage (virtual-grbl)"
            assert stage.move(CENTER, 20.0) == pytest.approx(CENTER, abs=0.002)
            assert rig.true_position() == pytest.approx(CENTER, abs=0.01)
            before = rig.true_position()
            with pytest.raises(OutOfRangeError, match="nothing was sent"):
                stage.move((50.0, 60.0, 1.0), 20.0)
            assert rig.true_position() == before


def test_steps_of_a_micrometre_are_made() -> None:
    with launch("grbl", speed=SPEED) as rig, opener(rig.port) as stage:
        stage.home()
        stage.move(CENTER, 20.0)
        heights = [stage.move((50.0, 60.0, -30.0 - 0.001 * step), 2.0)[2] for step in range(1, 9)]
        assert heights == pytest.approx([-30.0 - 0.001 * step for step in range(1, 9)], abs=0.001)


@pytest.mark.long
def test_a_taught_position_is_the_same_after_a_power_cycle() -> None:
    places = []
    for seed in (1, 2):
        with launch("grbl", speed=SPEED, seed=seed) as rig, opener(rig.port) as stage:
            stage.home()
            stage.move(CENTER, 20.0)
            places.append(rig.true_position())
    assert places[0] == pytest.approx(places[1], abs=0.03)


def test_a_stop_in_motion_keeps_the_position() -> None:
    with launch("grbl", speed=SPEED) as rig, opener(rig.port) as stage:
        stage.home()
        threading.Timer(0.05, stage.stop).start()
        with pytest.raises(NotThereError, match="stopped on request"):
            stage.move((150.0, 150.0, -50.0), 20.0)
        assert stage.position() == pytest.approx(rig.true_position(), abs=0.01)
        assert stage.position()[0] < 149.0
        assert stage.move(CENTER, 20.0) == pytest.approx(CENTER, abs=0.002)


@pytest.mark.long
def test_the_reset_button_between_moves_is_detected() -> None:
    with launch("grbl", speed=SPEED, settings={20: 0, 22: 0}) as rig, opener(rig.port) as stage:
        with pytest.raises(PositionLostError, match="opening the port"):
            stage.position()
        rig.inject(Fault(kind="reset"))
        with pytest.raises(PositionLostError):
            stage.move(CENTER, 20.0)


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
