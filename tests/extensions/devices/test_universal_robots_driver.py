"""Test the driver of Universal Robots' arms with an emulated arm. No robot was tried."""

from __future__ import annotations

import importlib.util
import math
import threading

import numpy as np
import pytest
from helpers.emulated_arm import EmulatedArm, install_arm

from tacbench_cad.extensions.conformance.stage import check_stage
from tacbench_cad.extensions.devices.universal_robots import UniversalRobot
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.drivers import open_stage
from tacbench_cad.lab.rig.errors import (
    AlarmError,
    DeviceLostError,
    NotThereError,
    OutOfRangeError,
    PositionLostError,
)
from tacbench_cad.lab.study.rotation import above, angles_of, from_vector, towards
from tacbench_cad.lab.study.spec import StageSettings
from tacbench_cad.util.errors import InputError, MissingToolError

CLOCK = Clock(speed=25.0)
#: The orientation of the emulated tool at opening.
ORIENTATION = (0.0, math.pi, 0.0)
UPRIGHT_TOOL = from_vector(ORIENTATION)
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


def test_a_tilt_keeps_the_summit_and_a_roll_moves_the_centre_of_the_dome(arm: EmulatedArm) -> None:
    settings = StageSettings(driver="ur", port="192.168.0.9", limits_mm=LIMITS, home=False)
    with open_stage(settings, CLOCK) as stage:
        assert stage.rotation() == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
        assert stage.turn(towards(0.0, 10.0), 20.0) == pytest.approx((0.0, 10.0, 0.0), abs=0.05)
        # All poses on the way have the summit at its place, and the tool leans more and more.
        path = np.array(arm.servoed)
        assert path[:, :3] == pytest.approx(np.tile((0.3, 0.1, 0.2), (len(path), 1)), abs=1e-6)
        tilts = [math.degrees(math.acos(-from_vector(tuple(pose[3:]))[2, 2])) for pose in arm.servoed]
        assert len(tilts) > 5 and tilts == sorted(tilts) and tilts[-1] == pytest.approx(10.0)
        # A move keeps the orientation.
        stage.move((300.0, 100.0, 210.0), 100.0)
        assert stage.rotation() == pytest.approx((0.0, 10.0, 0.0), abs=0.05)
        stage.turn((0.0, 0.0, 0.0), 20.0)
        length = 20.0 * math.radians(10.0)
        arm.servoed.clear()
        stage.turn(towards(0.0, 10.0), 20.0, above_mm=20.0, by_mm=(length, 0.0, 0.0))
        centres = [
            above((1000 * x, 1000 * y, 1000 * z), angles_of(from_vector((a, b, c)) @ UPRIGHT_TOOL.T), 20.0)
            for x, y, z, a, b, c in arm.servoed
        ]
        # The turn begins and ends within the tolerance of the driver.
        assert [z for _, _, z in centres] == pytest.approx([230.0] * len(centres), abs=0.05)
        assert centres[-1] == pytest.approx((300.0 + length, 100.0, 230.0), abs=0.05)
        with pytest.raises(OutOfRangeError, match=r"tilted by 31\.00 degrees, beyond tilt_limit_deg = 30"):
            stage.turn(towards(0.0, 31.0), 20.0)
        with pytest.raises(OutOfRangeError, match=r"stage x = 5\d\d\.\d+ mm: must be from 200 to 400 mm"):
            stage.turn((0.0, 0.0, 0.0), 20.0, by_mm=(200.0, 0.0, 0.0))


def test_a_tool_that_is_tilted_at_opening_turns_back(arm: EmulatedArm) -> None:
    with UniversalRobot("ur5e", clock=CLOCK) as stage:
        stage.turn(towards(60.0, 12.0), 30.0)
    arm.connected = arm.program = True
    with UniversalRobot("ur5e", clock=CLOCK) as stage:
        assert stage.rotation() == pytest.approx(towards(60.0, 12.0), abs=0.1)
        assert stage.turn((0.0, 0.0, 0.0), 30.0) == pytest.approx((0.0, 0.0, 0.0), abs=0.05)
        assert from_vector(tuple(arm.pose()[3:])) == pytest.approx(UPRIGHT_TOOL, abs=1e-3)


def test_a_turn_can_be_stopped_and_its_faults_are_named(arm: EmulatedArm) -> None:
    stage = UniversalRobot("ur5e", clock=Clock(), timeout_s=0.1)
    timer = threading.Timer(0.2, stage.stop)
    timer.start()
    with pytest.raises(NotThereError, match="stopped on request"):
        stage.turn(towards(0.0, 20.0), 5.0)
    timer.join()
    assert 0.0 < stage.rotation()[1] < 19.0
    with pytest.raises(PositionLostError, match="home the stage first"):
        stage.turn((0.0, 0.0, 0.0), 5.0)
    stage.home()
    assert stage.turn((0.0, 0.0, 0.0), 90.0) == pytest.approx((0.0, 0.0, 0.0), abs=0.05)
    arm.stuck = True
    with pytest.raises(NotThereError, match=r"is at rest 0\.000 mm and 5\.00 degrees away"):
        stage.turn(towards(0.0, 5.0), 90.0)
    arm.program = False
    with pytest.raises(AlarmError, match="refuses the turn"):
        stage.turn(towards(0.0, 5.0), 90.0)


def test_faults_of_the_robot_are_named(arm: EmulatedArm) -> None:
    stage = UniversalRobot("ur5e", clock=CLOCK, timeout_s=0.1)
    with pytest.raises(OutOfRangeError, match="beyond its reach"):
        stage.move((900.0, 0.0, 0.0), 10.0)
    arm.stuck = True
    with pytest.raises(NotThereError, match=r"is at rest 2\.500 mm away"):
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
