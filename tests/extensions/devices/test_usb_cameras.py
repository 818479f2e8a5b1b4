"""USB sensors are found by the product name and the serial number that Linux lists."""

from __future__ import annotations

from pathlib import Path

import pytest
from helpers.devices import plug_camera

from tacbench_cad.extensions.devices import usb_sensors
from tacbench_cad.lab.rig.errors import DeviceLostError
from tacbench_cad.util.errors import InputError


@pytest.fixture
def sysfs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "class" / "video4linux"
    folder.mkdir(parents=True)
    monkeypatch.setattr(usb_sensors.video_nodes, "__defaults__", (folder,))
    return folder


def test_cameras_are_described_without_opening_them(sysfs: Path) -> None:
    plug_camera(sysfs, 0, "DIGIT", serial="D20001")
    plug_camera(sysfs, 1, "DIGIT", serial="D20001", index=1)
    plug_camera(sysfs, 10, "GelSight Mini R0B 28F5-K4RR", usb="0c45:636d", serial="28F5K4RR")
    nodes = usb_sensors.video_nodes()
    assert [(node.device, node.product, node.serial_number) for node in nodes] == [
        ("/dev/video0", "DIGIT", "D20001"),
        ("/dev/video10", "GelSight Mini R0B 28F5-K4RR", "28F5K4RR"),
    ]


def test_a_camera_is_found_by_its_serial_number(sysfs: Path) -> None:
    plug_camera(sysfs, 0, "DIGIT", serial="D20001")
    plug_camera(sysfs, 2, "DIGIT", serial="D20002")
    assert usb_sensors.find_camera("D20002", "DIGIT").device == "/dev/video2"
    with pytest.raises(InputError, match="several DIGIT are connected; write one of: D20001, D20002"):
        usb_sensors.find_camera(None, "DIGIT")
    with pytest.raises(DeviceLostError, match="DIGIT with the serial number D3: is not connected; connected: D20001"):
        usb_sensors.find_camera("D3", "DIGIT")
    with pytest.raises(DeviceLostError, match="GelSight Mini: is not connected; connected: none"):
        usb_sensors.find_camera(None, "GelSight Mini")
