"""Test the driver of the paper's firmware against the virtual firmware and all its faults."""

from __future__ import annotations

import pytest
from helpers.driver_faults import SPEED, survive
from helpers.rig_here import launch

from tacbench_cad.lab.rig.arduino import ArduinoStage
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.devices import open_stage
from tacbench_cad.lab.study.spec import Point, StageSettings

LIMITS = ((0.0, 200.0), (0.0, 200.0), (-100.0, 0.0))
CENTER: Point = (50.0, 60.0, -30.0)
STEPS_PER_MM = (400.0, 400.0, 400.0)


pytestmark = pytest.mark.usefixtures("rig_time")


def opener(port: str) -> ArduinoStage:
    clock = Clock(speed=SPEED)
    return ArduinoStage(port, steps_per_mm=STEPS_PER_MM, clock=clock, timeout_s=0.4, home_timeout_s=3.0)


def test_open_stage_homes_and_moves() -> None:
    with launch("arduino", speed=SPEED) as rig:
        options = {"steps_per_mm": list(STEPS_PER_MM)}
        settings = StageSettings(driver="arduino", port=rig.port, limits_mm=LIMITS, options=options)
        with open_stage(settings, Clock(speed=SPEED)) as stage:
            assert stage.move(CENTER, 20.0) == pytest.approx(CENTER, abs=0.002)
            assert rig.true_position() == pytest.approx(CENTER, abs=0.02)


#: This seed unplugs the device. The quick tests of the other drivers cover the other faults, and the long tests all.
@pytest.mark.parametrize("seed", (6,))
def test_faults_cause_specific_errors_and_moves_end_at_the_reported_position(seed: int) -> None:
    survive("arduino", opener, CENTER, seed)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(147))
def test_many_faults(seed: int) -> None:
    survive("arduino", opener, CENTER, seed)
