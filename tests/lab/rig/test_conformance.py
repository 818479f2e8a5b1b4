"""The conformance kit passes our drivers, and names the defect of each wrong driver."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from helpers import wrong_drivers
from helpers.wrong_drivers import GAUGES, SENSORS, STAGES, GoodGauge, GoodSensor, GoodStage, Number

from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.conformance import Check, check_gauge, check_sensor
from tacbench_cad.lab.rig.conformance_stage import check_stage
from tacbench_cad.lab.rig.drivers import open_device
from tacbench_cad.lab.rig.grbl import GrblStage
from tacbench_cad.lab.rig.loadcell import LoadCellOptions, open_load_cell
from tacbench_cad.lab.rig.marlin import MarlinStage
from tacbench_cad.lab.rig.registry import Context
from tacbench_cad.lab.rig.stage import Stage
from tacbench_cad.lab.simulate.devices import SimulatedGauge, SimulatedSensor
from tacbench_cad.lab.study.spec import StageSettings
from tacbench_cad.util.errors import InputError
from tacbench_cad.virtual_rig.process import launch

HERE = Path(wrong_drivers.__file__).parent
LIMITS = ((0.0, 100.0), (0.0, 100.0), (0.0, 100.0))
BEYOND = (0.0, 0.0, 500.0)
SPEED = 25.0
VIRTUAL_SPEED = 50.0


def failed(checks: Sequence[Check]) -> set[str]:
    return {check.name for check in checks if check.result == "failed"}


def detail(checks: Sequence[Check], name: str) -> str:
    return next(check.detail for check in checks if check.name == name and check.result != "passed")


@pytest.mark.parametrize("kind", STAGES, ids=lambda kind: kind.__name__)
def test_the_defect_of_a_stage_is_named(kind: type[GoodStage]) -> None:
    clock = Clock(speed=SPEED)
    checks = check_stage(kind(clock), LIMITS, clock, beyond_mm=BEYOND)
    assert failed(checks) == STAGES[kind], [check for check in checks if check.result == "failed"]


@pytest.mark.parametrize("kind", GAUGES, ids=lambda kind: kind.__name__)
def test_the_defect_of_a_gauge_is_named(kind: type[GoodGauge]) -> None:
    clock = Clock(speed=SPEED)
    gauge = kind(clock)
    checks = check_gauge(gauge, clock, load=gauge.put)
    assert failed(checks) == GAUGES[kind], [check for check in checks if check.result == "failed"]


@pytest.mark.parametrize("kind", SENSORS, ids=lambda kind: kind.__name__)
def test_the_defect_of_a_sensor_is_named(kind: type[GoodSensor]) -> None:
    checks = check_sensor(kind(), Clock())
    assert failed(checks) == SENSORS[kind], [check for check in checks if check.result == "failed"]


def test_details_say_what_is_wrong() -> None:
    clock = Clock(speed=SPEED)
    assert "are these inches?" in detail(check_stage(wrong_drivers.Inches(clock), LIMITS, clock), "unit")
    wrong_class = check_stage(wrong_drivers.WrongClass(clock), LIMITS, clock, beyond_mm=BEYOND)
    assert "raised ValueError instead of a RigError" in detail(wrong_class, "limits")
    clamp = check_stage(wrong_drivers.SilentClamp(clock), LIMITS, clock, beyond_mm=BEYOND)
    assert "returned (0.0, 0.0, 100.0) without an error" in detail(clamp, "limits")
    grams = wrong_drivers.Grams(clock)
    assert "are these grams?" in detail(check_gauge(grams, clock, load=grams.put), "unit")
    assert "instead of a Force" in detail(check_gauge(Number(clock), clock), "read")
    assert "frames are (12, 16, 3) uint8, (10, 16, 3) uint8" in detail(
        check_sensor(wrong_drivers.ChangingShape(), Clock()), "shape"
    )


def test_checks_that_need_help_are_not_called_passed() -> None:
    clock = Clock(speed=SPEED)
    stage, gauge = check_stage(GoodStage(clock), LIMITS, clock), check_gauge(GoodGauge(clock), clock)
    untested = {check.name for check in (*stage, *gauge) if check.result == "not tested"}
    assert untested == {"limits", "sign", "unit", "fresh samples"} and not failed(stage) and not failed(gauge)


def test_a_device_without_its_methods_is_not_used() -> None:
    checks = check_stage(GoodGauge(Clock()), LIMITS, Clock())
    assert failed(checks) == {"interface"} and "lacks home, move, position, stop" in detail(checks, "interface")


def test_too_narrow_limits_are_refused() -> None:
    with pytest.raises(InputError, match="limits_mm y"):
        check_stage(GoodStage(), ((0.0, 100.0), (0.0, 5.0), (0.0, 100.0)), Clock())


@pytest.mark.parametrize(
    ("firmware", "driver", "low_z"),
    [("grbl", GrblStage, -100.0), ("grblhal", GrblStage, -100.0), ("marlin", MarlinStage, 0.0)],
)
def test_our_stages_pass(firmware: str, driver: type[Stage], low_z: float) -> None:
    clock = Clock(speed=VIRTUAL_SPEED)
    limits = ((0.0, 200.0), (0.0, 200.0), (low_z, low_z + 100.0))
    with launch(firmware, speed=VIRTUAL_SPEED) as rig:
        checks = check_stage(driver(rig.port, clock=clock), limits, clock, beyond_mm=BEYOND)  # type: ignore[call-arg]
    assert failed(checks) == set(), [check for check in checks if check.result == "failed"]


def test_our_load_cell_passes() -> None:
    clock = Clock(speed=SPEED)
    with launch("grbl", speed=SPEED, start_mm=(100.0, 100.0, -50.0), gauge={"newtons": True}) as rig:

        def load(mass_g: float) -> None:
            rig.put({"flat_z_mm": -49.0, "n_per_mm": 9.80665e-3 * mass_g} if mass_g else None)
            time.sleep(0.1)  # until nothing moves

        load(0.0)
        gauge = open_load_cell(rig.gauge_port, None, options=LoadCellOptions(unit="newtons"), clock=clock)
        checks = check_gauge(gauge, clock, load=load)
    assert failed(checks) == set(), [check for check in checks if check.result == "failed"]


def test_our_simulated_devices_pass_except_that_they_never_close() -> None:
    clock = Clock(speed=SPEED)
    gauge = SimulatedGauge(lambda: (0.0, 0.0, 0.0), clock, seed=1)
    sensor = SimulatedSensor(lambda: (0.0, 0.0, 0.0), clock, {"seed": 1})
    assert failed(check_gauge(gauge, clock)) == {"close"}
    checks = check_sensor(sensor, clock)
    assert failed(checks) == {"close"} and sensor.read().dtype == np.uint8


def test_grblhal_over_tcp_passes_by_its_address() -> None:
    clock = Clock(speed=VIRTUAL_SPEED)
    limits = ((0.0, 200.0), (0.0, 200.0), (-100.0, 0.0))
    with launch("grblhal", speed=VIRTUAL_SPEED, tcp=True) as rig:
        assert rig.port.startswith("socket://127.0.0.1:")
        settings = StageSettings(driver="grbl", port=rig.port, limits_mm=limits, home=False)
        checks = check_stage(open_device("stage", settings, Context(clock=clock)), limits, clock, beyond_mm=BEYOND)
    assert failed(checks) == set(), [check for check in checks if check.result == "failed"]
