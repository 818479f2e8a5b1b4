"""Test sensors that are found by their names: DIGIT, GelSight Mini, Raspberry Pi cameras, GenICam. All are emulated."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.devices import plug_camera
from helpers.emulated_cameras import UnavailableNode, install_genicam, install_picamera, picture

from tacbench_cad.extensions.conformance.checks import check_sensor
from tacbench_cad.extensions.devices import usb_sensors
from tacbench_cad.lab.rig import camera as camera_module
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.devices import open_sensor
from tacbench_cad.lab.rig.errors import DeviceLostError, RigError
from tacbench_cad.lab.study.spec import SensorSettings
from tacbench_cad.util.errors import InputError, MissingToolError


class UsbCapture:
    """A USB camera behind OpenCV, with the controls of a DIGIT."""

    def __init__(self) -> None:
        self.properties = {3: 320.0, 4: 240.0, 5: 60.0, 15: 100.0, 21: 3.0, 27: 0.0, 44: 1.0, 45: 4600.0}
        self.keeps: set[int] = set()
        self.count = 0

    def isOpened(self) -> bool:  # noqa: N802
        return True

    def set(self, prop: int, value: float) -> bool:
        if prop not in self.keeps:
            self.properties[prop] = value
        return True

    def get(self, prop: int) -> float:
        return 0.0 if prop == 0 else self.properties.get(prop, -1.0)

    def grab(self) -> bool:
        self.count += 1
        return True

    def retrieve(self) -> tuple[bool, Any]:
        return True, picture(self.count, int(self.properties[3]), int(self.properties[4]))

    def release(self) -> None:
        pass


@pytest.fixture
def usb(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> UsbCapture:
    sysfs = tmp_path / "class" / "video4linux"
    sysfs.mkdir(parents=True)
    plug_camera(sysfs, 0, "Integrated webcam", usb="04f2:b604", serial="")
    plug_camera(sysfs, 2, "DIGIT", serial="D20001")
    plug_camera(sysfs, 4, "GelSight Mini R0B 28F5-K4RR", usb="0c45:636d", serial="28F5K4RR")
    monkeypatch.setattr(usb_sensors.video_nodes, "__defaults__", (sysfs,))
    capture = UsbCapture()
    capture.opened = []  # type: ignore[attr-defined]

    def opener(device: str) -> UsbCapture:
        capture.opened.append(device)  # type: ignore[attr-defined]
        return capture

    monkeypatch.setattr(camera_module, "open_capture", opener)
    return capture


def opened(driver: str, device: str | None = None, **options: Any) -> Any:
    return open_sensor(SensorSettings(driver=driver, device=device, options=options), Clock())


def test_a_digit_is_found_by_its_serial_number_with_its_lamps(usb: UsbCapture) -> None:
    with opened("digit", "D20001", lamps=[15, 8, 0]) as sensor:
        assert usb.opened == ["/dev/video2"] and sensor.name == "DIGIT D20001"  # type: ignore[attr-defined]
        assert sensor.shape == (480, 640, 3) and sensor.read().shape == (480, 640, 3)
        assert usb.properties[27] == 0xF80 and sensor.settings["requested"]["lamps"] == 0xF80
        assert usb.properties[21] == 1.0 and usb.properties[44] == 0.0, "automatic controls are switched off"
        assert sensor.settings["actual"]["exposure"] == 100.0 and sensor.settings["actual"]["white_balance"] == 4600.0
        assert "automatic" not in sensor.settings["actual"]
    with pytest.raises(DeviceLostError, match="DIGIT with the serial number D7: is not connected; connected: D20001"):
        opened("digit", "D7")
    with pytest.raises(InputError, match="lamps"):
        opened("digit", lamps=[16, 0, 0])


def test_a_usb_camera_conforms(usb: UsbCapture) -> None:
    checks = check_sensor(opened("digit", "D20001", width=320, height=240, fps=60), Clock())
    assert {check.name for check in checks if check.result == "failed"} == set()


def test_a_gelsight_mini_is_found_by_its_product_name(usb: UsbCapture) -> None:
    with opened("gelsight-mini", exposure=120) as sensor:
        assert usb.opened == ["/dev/video4"]  # type: ignore[attr-defined]
        assert sensor.name == "GelSight Mini 28F5K4RR" and sensor.settings["actual"]["exposure"] == 120.0


@pytest.mark.parametrize(("prop", "name"), [(15, "exposure"), (45, "white balance")])
def test_a_setting_that_the_camera_changes_is_noticed(usb: UsbCapture, prop: int, name: str) -> None:
    with opened("digit") as sensor:
        before = usb.properties[prop]
        sensor.read()
        usb.properties[prop] = 2.0 * before
        with pytest.raises(RigError, match=rf"the {name} was {before:g} and is now {2 * before:g}"):
            sensor.read()


def test_the_order_of_colours_is_a_setting(usb: UsbCapture) -> None:
    with opened("digit") as sensor:
        image = sensor.read()
        assert image[10, 10, 0] < image[10, 10, 2], "blue, green, red"
    settings = SensorSettings(driver="digit", channels="rgb")
    with open_sensor(settings, Clock()) as sensor:
        swapped = sensor.read()
        assert swapped[10, 10, 0] > swapped[10, 10, 2] and swapped.flags["C_CONTIGUOUS"]
        assert sensor.settings["requested"]["channels"] == "rgb"


def test_a_raspberry_pi_camera_conforms(monkeypatch: pytest.MonkeyPatch) -> None:
    camera = install_picamera(monkeypatch, "imx708")
    camera.settles_after = 3
    sensor = opened("raspberry-pi", exposure_us=8000, gain=2.0, colour_gains=[1.8, 1.6])
    assert camera.controls["AeEnable"] is False and camera.controls["AwbEnable"] is False
    assert sensor.name == "Raspberry Pi camera 0, imx708"
    assert sensor.settings["actual"]["ExposureTime"] == [8000.0]
    image = sensor.read()
    assert image[10, 10, 0] < image[10, 10, 2], "blue, green, red"
    checks = check_sensor(sensor, Clock())
    assert {check.name for check in checks if check.result == "failed"} == set()


def test_faults_of_a_raspberry_pi_camera_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    camera = install_picamera(monkeypatch, "imx708", "imx296")
    with pytest.raises(InputError, match=r"write the number of one: 0 \(imx708\), 1 \(imx296\)"):
        opened("raspberry-pi", exposure_us=8000)
    with pytest.raises(DeviceLostError, match="camera imx500: is not connected"):
        opened("raspberry-pi", "imx500", exposure_us=8000)
    with opened("raspberry-pi", "imx296", exposure_us=8000) as sensor:
        camera.changes = {"AnalogueGain": 4.0}
        with pytest.raises(RigError, match=r"AnalogueGain is 4\.0 instead of 1\.0"):
            sensor.read()
        camera.silent = True
        with pytest.raises(DeviceLostError, match="no frame within 10 s"):
            sensor.read()
    camera.silent = False
    with pytest.raises(RigError, match=r"AnalogueGain is 4\.0 instead of 1\.0; choose values"):
        opened("raspberry-pi", "imx296", exposure_us=8000)


@pytest.mark.parametrize("pixel_format", ["Mono8", "BGR8", "RGB8"])
def test_a_genicam_camera_conforms(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, pixel_format: str) -> None:
    camera = install_genicam(monkeypatch, "22512345")
    (tmp_path / "maker.cti").touch()
    options = {"cti": str(tmp_path / "maker.cti"), "exposure_us": 5000, "gain": 3.0, "pixel_format": pixel_format}
    if pixel_format == "Mono8":
        camera.nodes.BalanceWhiteAuto = UnavailableNode()
    sensor = opened("genicam", "22512345", **options)
    assert sensor.settings["actual"] == {"ExposureTime": 5000.0, "Gain": 3.0}
    assert camera.nodes.ExposureAuto.value == camera.nodes.GainAuto.value == "Off"
    camera.waiting.append(camera._picture(99))
    image = sensor.read()
    assert not np.array_equal(image.ravel(), camera._picture(99).data), "an old picture is not returned"
    if image.ndim == 3:
        assert image[10, 10, 0] < image[10, 10, 2], "blue, green, red"
    checks = check_sensor(sensor, Clock())
    assert {check.name for check in checks if check.result == "failed"} == set()
    assert camera.destroyed


def test_faults_of_a_genicam_camera_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    camera = install_genicam(monkeypatch, "1", "2")
    with pytest.raises(InputError, match="install the software of the manufacturer"):
        opened("genicam", cti=str(tmp_path / "no.cti"), exposure_us=5000)
    options = {"cti": str(tmp_path / "maker.cti"), "exposure_us": 5000}
    (tmp_path / "maker.cti").touch()
    with pytest.raises(DeviceLostError, match="no device found"):
        opened("genicam", "3", **options)
    with opened("genicam", "2", **options) as sensor:
        camera.nodes.ExposureTime.value = 9000.0
        with pytest.raises(RigError, match="ExposureTime is 9000 instead of 5000"):
            sensor.read()
        camera.nodes.ExposureTime.value = 5000.0
        camera.nodes.GainAuto.value = "Continuous"
        with pytest.raises(RigError, match="GainAuto is on"):
            sensor.read()
        camera.nodes.GainAuto.value, camera.silent = "Off", True
        with pytest.raises(DeviceLostError, match=r"no picture: .*timed out"):
            sensor.read()
    camera.nodes.ExposureTime.fixed = True
    camera.nodes.ExposureTime._value = 7000.0
    with pytest.raises(RigError, match="ExposureTime is 7000 instead of 5000"):
        opened("genicam", "2", **options)


@pytest.mark.parametrize(("driver", "module"), [("raspberry-pi", "picamera2"), ("genicam", "harvesters")])
def test_a_missing_package_is_named(driver: str, module: str) -> None:
    if importlib.util.find_spec(module) is not None:
        pytest.skip(f"{module} is installed")
    with pytest.raises(MissingToolError, match=f"needs {module}, not installed: run "):
        opened(driver)
