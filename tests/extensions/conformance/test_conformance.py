"""The conformance kit passes our drivers, and names the defect of each wrong driver."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from helpers import wrong_drivers
from helpers.wrong_drivers import GAUGES, SENSORS, STAGES, GoodGauge, GoodSensor, GoodStage

from tacbench_cad.extensions.conformance import stage as conformance_stage
from tacbench_cad.extensions.conformance.checks import DriverCheck, check_gauge, check_sensor
from tacbench_cad.extensions.conformance.stage import check_stage
from tacbench_cad.extensions.virtual_rig import launch
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.marlin import MarlinStage
from tacbench_cad.lab.rig.registry import Context, open_device
from tacbench_cad.lab.simulate.simulated_devices import SimulatedGauge, SimulatedSensor
from tacbench_cad.lab.study.spec import StageSettings
from tacbench_cad.util.errors import InputError

LIMITS = ((0.0, 100.0), (0.0, 100.0), (0.0, 100.0))
BEYOND = (0.0, 0.0, 500.0)
SPEED = 50.0


def failed(checks: Sequence[DriverCheck]) -> set[str]:
    return {check.name for check in checks if check.result == "failed"}


def detail(checks: Sequence[DriverCheck], name: str) -> str:
    return next(check.detail for check in checks if check.name == name and check.result != "passed")


#: What the report says about some defects.
DETAILS: dict[type, tuple[str, str]] = {
    wrong_drivers.Inches: ("unit", "are these inches?"),
    wrong_drivers.WrongClass: ("limits", "raised ValueError instead of a RigError"),
    wrong_drivers.SilentClamp: ("limits", "returned (0.0, 0.0, 100.0) without an error"),
    wrong_drivers.Grams: ("unit", "are these grams?"),
    wrong_drivers.ChangingShape: ("shape", "frames are (12, 16, 3) uint8, (10, 16, 3) uint8"),
}


def require_failed(checks: Sequence[DriverCheck], kind: type, expected: set[str]) -> None:
    """Check that exactly the expected checks failed, and that the report says why."""
    assert failed(checks) == expected, [check for check in checks if check.result == "failed"]
    if kind in DETAILS:
        name, text = DETAILS[kind]
        assert text in detail(checks, name)


@pytest.mark.parametrize("kind", STAGES, ids=lambda kind: kind.__name__)
def test_the_defect_of_a_stage_is_named(kind: type[GoodStage], monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock(speed=SPEED)
    if kind is wrong_drivers.MmPerMinute:
        monkeypatch.setattr(conformance_stage, "SLACK_S", 0.5)
    checks = check_stage(kind(clock), LIMITS, clock, beyond_mm=BEYOND)
    require_failed(checks, kind, STAGES[kind])


@pytest.mark.parametrize("kind", GAUGES, ids=lambda kind: kind.__name__)
def test_the_defect_of_a_gauge_is_named(kind: type[GoodGauge]) -> None:
    clock = Clock(speed=SPEED)
    gauge = kind(clock)
    checks = check_gauge(gauge, clock, load=gauge.put)
    require_failed(checks, kind, GAUGES[kind])


@pytest.mark.parametrize("kind", SENSORS, ids=lambda kind: kind.__name__)
def test_the_defect_of_a_sensor_is_named(kind: type[GoodSensor]) -> None:
    checks = check_sensor(kind(), Clock())
    require_failed(checks, kind, SENSORS[kind])


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


def test_marlin_passes() -> None:
    clock = Clock(speed=SPEED)
    limits = ((0.0, 200.0), (0.0, 200.0), (0.0, 100.0))
    with launch("marlin", speed=SPEED) as rig:
        checks = check_stage(MarlinStage(rig.port, clock=clock), limits, clock, beyond_mm=BEYOND)
    assert failed(checks) == set(), [check for check in checks if check.result == "failed"]


def test_our_simulated_devices_pass_although_they_have_nothing_to_close() -> None:
    clock = Clock(speed=SPEED)
    gauge = SimulatedGauge(lambda: (0.0, 0.0, 0.0), clock, seed=1)
    sensor = SimulatedSensor(lambda: (0.0, 0.0, 0.0), clock, {"seed": 1})
    checks = check_gauge(gauge, clock)
    assert failed(checks) == set() and (checks[-1].name, checks[-1].result) == ("close", "not tested")
    checks = check_sensor(sensor, clock)
    assert failed(checks) == set() and sensor.read().dtype == np.uint8


def test_grblhal_over_tcp_passes_by_its_address() -> None:
    clock = Clock(speed=SPEED)
    limits = ((0.0, 200.0), (0.0, 200.0), (-100.0, 0.0))
    with launch("grblhal", speed=SPEED, tcp=True) as rig:
        assert rig.port.startswith("socket://127.0.0.1:")
        settings = StageSettings(driver="grbl", port=rig.port, limits_mm=limits, home=False)
        checks = check_stage(open_device("stage", settings, Context(clock=clock)), limits, clock, beyond_mm=BEYOND)
    assert failed(checks) == set(), [check for check in checks if check.result == "failed"]
