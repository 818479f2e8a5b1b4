"""The examples of drivers conform. Their devices are emulated; no real device was tried."""

from __future__ import annotations

import math
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tacbench_cad.extensions.conformance import checks as conformance
from tacbench_cad.extensions.conformance.checks import DriverCheck, check_gauge
from tacbench_cad.extensions.conformance.stage import check_stage
from tacbench_cad.lab.rig import plugin
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.errors import DeviceLostError

FOLDER = Path(__file__).parents[3] / "examples" / "drivers"
LIMITS = ((200.0, 400.0), (0.0, 200.0), (100.0, 300.0))


@pytest.fixture(autouse=True)
def _here(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(FOLDER)
    monkeypatch.setattr(conformance, "WINDOW_S", 0.1)


def wrong(checks: Sequence[DriverCheck]) -> list[DriverCheck]:
    return [check for check in checks if check.result == "failed"]


def install(monkeypatch: pytest.MonkeyPatch, **modules: dict[str, Any]) -> None:
    for name, attributes in modules.items():
        module = ModuleType(name.replace("__", "."))
        vars(module).update(attributes)
        monkeypatch.setitem(sys.modules, module.__name__, module)


# --- cri ---


class EmulatedSyncRobot:
    """The part of cri.robot.SyncRobot that the example uses. Moves take their time and cannot be interrupted."""

    start = (300.0, 100.0, 200.0, 180.0, 0.0, 180.0)

    def __init__(self, controller: SimpleNamespace) -> None:
        self.info, self.controller, self.linear_speed = "Emulated robot", controller, 20.0
        self.tcp, self.axes = (0.0,) * 6, "rxyz"
        self.pose = self.start
        self.moves = 0

    def move_linear(self, pose: tuple[float, ...], elbow: float | None = None) -> None:
        if math.dist(pose[:3], (0.0, 0.0, 0.0)) > 850.0:
            raise RuntimeError("target is out of reach")
        assert self.axes == "sxyz"
        time.sleep(math.dist(pose[:3], self.pose[:3]) / self.linear_speed)
        self.pose, self.moves = tuple(pose), self.moves + 1

    def close(self) -> None:
        pass


@pytest.fixture
def cri(monkeypatch: pytest.MonkeyPatch) -> Any:
    controllers = ModuleType("cri.controller")
    controllers.RTDEController = lambda ip: SimpleNamespace(ip=ip)  # type: ignore[attr-defined]
    install(
        monkeypatch,
        cri={"controller": controllers},
        cri__robot={"SyncRobot": EmulatedSyncRobot},
        cri__controller=vars(controllers),
    )
    return plugin.load("cri_robot:CriRobot")


def test_a_robot_of_cri_conforms(cri: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock(speed=20.0)
    monkeypatch.setattr(EmulatedSyncRobot, "move_linear", _faster(clock))
    monkeypatch.setitem(sys.modules["cri_robot"].__dict__, "PIECE_S", 0.5)
    checks = check_stage(cri("192.168.1.5"), LIMITS, clock, beyond_mm=(2000.0, 0.0, 0.0))
    assert wrong(checks) == []


def _faster(clock: Clock) -> Callable[..., None]:
    move = EmulatedSyncRobot.move_linear

    def moved(robot: EmulatedSyncRobot, pose: tuple[float, ...]) -> None:
        speed = robot.linear_speed
        robot.linear_speed = clock.speed * speed
        move(robot, pose)
        robot.linear_speed = speed

    return moved


# --- Phidget ---


class EmulatedBridge:
    """The part of Phidget22's VoltageRatioInput that the example uses."""

    mass_g, silent = 0.0, False

    def __init__(self) -> None:
        self.settings: dict[str, Any] = {}
        self.random = np.random.default_rng(3)

    def __getattr__(self, name: str) -> Callable[[Any], None]:
        if name.startswith("set"):
            return lambda value: self.settings.update({name: value})
        raise AttributeError(name)

    def openWaitForAttachment(self, timeout: int) -> None:  # noqa: N802
        if self.settings.get("setDeviceSerialNumber") == 7:
            raise RuntimeError("PhidgetException 0x03 (Timed Out)")
        self.running = True
        threading.Thread(target=self._send, daemon=True).start()

    def _send(self) -> None:
        while self.running:
            time.sleep(0.004)
            ratio = 1e-3 * 9.80665e-3 * EmulatedBridge.mass_g / 5.0 + self.random.normal(0.0, 1e-7)
            if not EmulatedBridge.silent:
                self.settings["setOnVoltageRatioChangeHandler"](self, ratio)

    def getDeviceName(self) -> str:  # noqa: N802
        return "PhidgetBridge 4-Input"

    def getDeviceSerialNumber(self) -> int:  # noqa: N802
        return 137422

    def close(self) -> None:
        self.running = False


def test_a_phidget_bridge_conforms(monkeypatch: pytest.MonkeyPatch) -> None:
    install(
        monkeypatch,
        Phidget22={},
        Phidget22__Devices={},
        Phidget22__Devices__VoltageRatioInput={"VoltageRatioInput": EmulatedBridge},
    )
    bridge = plugin.load("phidget_bridge:PhidgetBridge")
    with pytest.raises(DeviceLostError, match="cannot be opened: PhidgetException"):
        bridge(newtons_per_mv_v=5.0, serial_number=7)
    gauge = bridge(newtons_per_mv_v=5.0, channel=2)
    assert gauge.identity == "PhidgetBridge 4-Input 137422, channel 2"
    assert gauge.input.settings["setVoltageRatioChangeTrigger"] == 0.0
    assert wrong(check_gauge(gauge, Clock(), load=lambda mass_g: setattr(EmulatedBridge, "mass_g", mass_g))) == []


# --- ATI ---


class EmulatedNetFt:
    """An ATI Net F/T box that sends samples over UDP between a request to start and a request to stop."""

    def __init__(self) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(0.002)
        self.address = f"127.0.0.1:{self.socket.getsockname()[1]}"
        self.mass_g, self.status, self.silent, self.running = 0.0, 0, False, True
        self.thread = threading.Thread(target=self._serve, daemon=True)
        self.thread.start()

    def _serve(self) -> None:
        to, count = None, 0
        random = np.random.default_rng(5)
        while self.running:
            try:
                data, sender = self.socket.recvfrom(64)
                header, command, samples = int.from_bytes(data[:2]), int.from_bytes(data[2:4]), data[4:]
                assert header == 0x1234 and len(samples) == 4
                to = {0: None, 2: sender}[command]
            except TimeoutError:
                pass
            if to is not None and not self.silent:
                count += 1
                force = round(-1e6 * 9.80665e-3 * self.mass_g + random.normal(0.0, 1000.0))
                words = (count, count, self.status, 0, 0, force, 0, 0, 0)
                self.socket.sendto(b"".join(word.to_bytes(4, "big", signed=word < 0) for word in words), to)

    def close(self) -> None:
        self.running = False
        self.thread.join()
        self.socket.close()


@pytest.fixture
def box() -> Iterator[EmulatedNetFt]:
    emulated = EmulatedNetFt()
    yield emulated
    emulated.close()


def test_an_ati_sensor_conforms(box: EmulatedNetFt) -> None:
    gauge = plugin.load("ati_net_ft:AtiNetFt")(box.address)
    assert wrong(check_gauge(gauge, Clock(), load=lambda mass_g: setattr(box, "mass_g", mass_g))) == []
