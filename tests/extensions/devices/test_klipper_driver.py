"""Test the driver of Klipper against an emulated Moonraker."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator

import pytest
from helpers.emulated_moonraker import EmulatedMoonraker

from tacbench_cad.extensions.conformance.stage import check_stage
from tacbench_cad.extensions.devices.klipper import KlipperOptions, KlipperStage
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
from tacbench_cad.lab.study.spec import StageSettings
from tacbench_cad.util.errors import InputError

SPEED = 20.0
LIMITS = ((0.0, 220.0), (0.0, 220.0), (5.0, 200.0))


@pytest.fixture
def moonraker() -> Iterator[EmulatedMoonraker]:
    server = EmulatedMoonraker(speed=SPEED)
    yield server
    server.close()


@pytest.fixture
def stage(moonraker: EmulatedMoonraker) -> Iterator[KlipperStage]:
    with KlipperStage(moonraker.url, clock=Clock(speed=SPEED), timeout_s=2.0) as opened:
        opened.home()
        yield opened


def test_the_driver_conforms(moonraker: EmulatedMoonraker) -> None:
    stage = KlipperStage(moonraker.url, clock=Clock(speed=SPEED))
    checks = check_stage(stage, LIMITS, Clock(speed=SPEED), beyond_mm=(0.0, 0.0, 500.0))
    assert [check for check in checks if check.result != "passed"] == []


def test_it_is_opened_by_its_name_and_waits_for_the_end_of_a_move(moonraker: EmulatedMoonraker) -> None:
    settings = StageSettings(driver="klipper", port=moonraker.url, limits_mm=LIMITS)
    with open_stage(settings, Clock(speed=SPEED)) as stage:
        assert stage.identity == f"klipper: v0.12.0-emulated at {moonraker.url}"
        assert stage.move((10.0, 20.0, 30.5), 20.0) == (10.0, 20.0, 30.5) == moonraker.live()
        assert "G1 X10.0000 Y20.0000 Z30.5000 F1200.000" in moonraker.scripts
        with pytest.raises(OutOfRangeError, match="its limits; nothing was sent"):
            stage.move((10.0, 20.0, 1.0), 20.0)


def test_homing_lifts_a_homed_axis_first(stage: KlipperStage, moonraker: EmulatedMoonraker) -> None:
    stage.move((50.0, 50.0, 40.0), 100.0)
    stage.home()
    assert moonraker.scripts[-7:-2] == ["G90", "G1 Z45.0000 F600", "M400", "G28", "M400"]
    assert stage.position() == (0.0, 0.0, 10.0)


def test_a_slip_shows_when_the_stage_is_homed_again(stage: KlipperStage, moonraker: EmulatedMoonraker) -> None:
    for slip in ([0.0, 0.0, 0.0], [0.3, 0.0, 0.0], [0.0, -0.25, 0.0], [0.0, 0.0, 0.2]):
        stage.move((50.0, 60.0, 40.0), 100.0)
        moonraker.slip_mm = list(slip)
        assert stage.home_offset_mm() == pytest.approx(slip, abs=0.01)
    assert stage.home_offset_mm() is None, "without a way, the length of a step is unknown"


def test_klippers_own_limits_are_an_error(stage: KlipperStage) -> None:
    with pytest.raises(OutOfRangeError, match=r"Move out of range: 0\.000 0\.000 500\.000"):
        stage.move((0.0, 0.0, 500.0), 20.0)
    assert stage.position() == (0.0, 0.0, 10.0)


def test_a_restart_loses_the_position(stage: KlipperStage, moonraker: EmulatedMoonraker) -> None:
    moonraker.homed = ""
    with pytest.raises(PositionLostError, match="restarted"):
        stage.move((1.0, 1.0, 20.0), 20.0)
    stage.home()
    assert stage.move((1.0, 1.0, 20.0), 20.0) == (1.0, 1.0, 20.0)


def test_a_bed_mesh_is_noticed(stage: KlipperStage, moonraker: EmulatedMoonraker) -> None:
    moonraker.mesh_mm = 0.12
    with pytest.raises(RigError, match=r"z 20\.120 mm instead of .* z 20\.000 mm; clear the bed mesh"):
        stage.move((1.0, 1.0, 20.0), 20.0)


def test_a_stop_halts_klipper_and_homing_restarts_it(stage: KlipperStage, moonraker: EmulatedMoonraker) -> None:
    timer = threading.Timer(0.1, stage.stop)
    timer.start()
    with pytest.raises(RigError, match="stopped by an emergency stop; home the stage first"):
        stage.move((100.0, 100.0, 100.0), 10.0)
    assert moonraker.state == "shutdown" and moonraker.live()[0] < 90.0
    with pytest.raises(PositionLostError):
        stage.position()
    stage.home()
    assert moonraker.state == "ready" and stage.position() == (0.0, 0.0, 10.0)


def test_a_silent_printer_is_halted(stage: KlipperStage, moonraker: EmulatedMoonraker) -> None:
    moonraker.silent = True
    with pytest.raises((NoAnswerError, DeviceLostError)):
        stage.position()


def test_a_halted_klipper_is_opened_and_restarted_by_homing(moonraker: EmulatedMoonraker) -> None:
    moonraker.state = "shutdown"
    with KlipperStage(moonraker.url, clock=Clock(speed=SPEED)) as stage:
        stage.home()
        assert stage.position() == (0.0, 0.0, 10.0)
    moonraker.state = "startup"
    with pytest.raises(AlarmError, match="not ready: Printer is startup"):
        KlipperStage(moonraker.url)


def test_the_key_of_moonraker_is_sent() -> None:
    server = EmulatedMoonraker(api_key="abc")
    try:
        with pytest.raises(RigError, match=r"set options\.api_key"):
            KlipperStage(server.url)
        with KlipperStage(server.url, KlipperOptions(api_key="abc")) as stage:
            assert "emulated" in stage.identity
    finally:
        server.close()


def test_wrong_addresses_are_explained() -> None:
    with pytest.raises(InputError, match="must be the address of Moonraker"):
        KlipperStage("/dev/ttyUSB0")
    with pytest.raises(InputError, match="write the address of Moonraker"):
        open_stage(StageSettings(driver="klipper", limits_mm=LIMITS))
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    with pytest.raises(DeviceLostError, match="cannot be reached"):
        KlipperStage(f"http://127.0.0.1:{port}")
    with pytest.raises(InputError, match=r"\[stage\.options\] home_lift"):
        settings = StageSettings(
            driver="klipper", port="http://127.0.0.1:1", limits_mm=LIMITS, options={"home_lift": 3}
        )
        open_stage(settings)
