"""Test the driver of Universal Robots' arms with an emulated arm. No robot was tried."""

from __future__ import annotations

import importlib.util
import math
import threading

import pytest
from helpers.emulated_arm import EmulatedArm, install_arm

from tacbench_cad.extensions.conformance.stage import check_stage
from tacbench_cad.extensions.devices.universal_robots import UniversalRobot
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.devices import open_stage
from tacbench_cad.lab.rig.errors import (
    AlarmError,
    DeviceLostError,
    OutOfRangeError,
    PositionLostError,
    RigError,
)
from tacbench_cad.lab.study.spec import StageSettings
from tacbench_cad.util.errors import InputError, MissingToolError

CLOCK = Clock(speed=25.0)
#: The orientation of the emulated tool at opening.
ORIENTATION = (0.0, math.pi, 0.0)
LIMITS = ((200.0, 400.0), (0.0, 200.0), (100.0, 300.0))


@pytest.fixture
def arm(monkeypatch: pytest.MonkeyPatch) -> EmulatedArm:
    return install_arm(monkeypatch, CLOCK)


def test_the_driver_conforms(arm: EmulatedArm) -> None:
    checks = check_stage(UniversalRobot("ur5e", clock=CLOCK), LIMITS, CLOCK, beyond_mm=(2000.0, 0.0, 0.0))
    assert [check for check in checks if check.result != "passed"] == []


def test_positions_are_in_mm_and_the_orientation_is_kept(arm: EmulatedArm) -> None:
    settings = StageSettings(driver="ur", port="192.168.0.9", limits_mm=LIMITS, home=False)
    with open_stage(settings, CLOCK) as stage:
        assert stage.position() == pytest.approx((300.0, 100.0, 200.0))
        assert stage.move((310.0, 90.0, 150.0), 100.0) == pytest.approx((310.0, 90.0, 150.0))
        assert arm.pose() == pytest.approx([0.31, 0.09, 0.15, *ORIENTATION])
    assert not arm.connected and not arm.program


def test_a_move_can_be_stopped(arm: EmulatedArm) -> None:
    stage = UniversalRobot("ur5e", clock=Clock(), timeout_s=0.1)
    timer = threading.Timer(0.2, stage.stop)
    timer.start()
    with pytest.raises(RigError, match="stopped on request"):
        stage.move((320.0, 100.0, 200.0), 1.0)
    timer.join()
    assert 300.0 < stage.position()[0] < 319.0
    with pytest.raises(PositionLostError, match="home the stage first"):
        stage.move((320.0, 100.0, 200.0), 1.0)
    stage.home()
    assert stage.move((320.0, 100.0, 200.0), 200.0) == pytest.approx((320.0, 100.0, 200.0))


def test_faults_of_the_robot_are_named(arm: EmulatedArm) -> None:
    stage = UniversalRobot("ur5e", clock=CLOCK, timeout_s=0.1)
    with pytest.raises(OutOfRangeError, match="beyond its reach"):
        stage.move((900.0, 0.0, 0.0), 10.0)
    arm.stuck = True
    with pytest.raises(RigError, match=r"is at rest 2\.500 mm away"):
        stage.move((305.0, 100.0, 200.0), 50.0)
    arm.stuck, arm.protective = False, True
    with pytest.raises(AlarmError, match="protective stop"):
        stage.move((305.0, 100.0, 200.0), 50.0)
    arm.protective, arm.emergency = False, True
    with pytest.raises(AlarmError, match="emergency stop is pressed"):
        stage.home()
    arm.emergency, arm.program = False, False
    with pytest.raises(AlarmError, match="refuses the move"):
        stage.move((305.0, 100.0, 200.0), 50.0)
    stage.home()
    assert stage.move((305.0, 100.0, 200.0), 50.0) == pytest.approx((305.0, 100.0, 200.0))
    arm.connected = False
    with pytest.raises(DeviceLostError, match="is not connected"):
        stage.position()


def test_a_robot_that_cannot_be_reached(arm: EmulatedArm) -> None:
    arm.reachable = False
    with pytest.raises(DeviceLostError, match="Could not connect to: ur5e"):
        UniversalRobot("ur5e")
    with pytest.raises(InputError, match="address of the robot"):
        open_stage(StageSettings(driver="ur", limits_mm=LIMITS))


@pytest.mark.skipif(importlib.util.find_spec("rtde_control") is not None, reason="ur-rtde is installed")
def test_without_its_package_the_driver_says_how_to_install_it() -> None:
    with pytest.raises(
        MissingToolError, match="needs rtde_control, rtde_receive, not installed: run pip install ur-rtde"
    ):
        open_stage(StageSettings(driver="ur", port="192.168.0.9", limits_mm=LIMITS))
