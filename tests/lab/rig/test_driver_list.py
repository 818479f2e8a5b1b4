"""The list of drivers: what each needs, and whether its device is plugged in."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from helpers.devices import install_package, plug_camera

from tacbench_cad.cli import rig
from tacbench_cad.lab.rig import ports, video_nodes
from tacbench_cad.lab.rig.errors import DeviceLostError
from tacbench_cad.lab.rig.ports import PortCandidate
from tacbench_cad.util.entries import groups
from tacbench_cad.util.errors import InputError

Capture = pytest.CaptureFixture[str]
PORT = PortCandidate(
    name="/dev/serial/by-id/usb-1a86-if00",
    device="/dev/ttyUSB0",
    description="wch.cn USB Serial",
    hardware="USB",
    stable=True,
    usb="1a86:7523",
)


@pytest.fixture
def sysfs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    folder = tmp_path / "class" / "video4linux"
    folder.mkdir(parents=True)
    monkeypatch.setattr(video_nodes.video_nodes, "__defaults__", (folder,))
    monkeypatch.setattr(ports, "candidates", lambda: [PORT])
    yield folder
    groups.cache_clear()


def listed(capsys: Capture, *words: str) -> str:
    rig.command(["drivers", *words], prog_name="tacbench rig", standalone_mode=False)
    return capsys.readouterr().out


def test_cameras_are_described_without_opening_them(sysfs: Path) -> None:
    plug_camera(sysfs, 0, "DIGIT", serial="D20001")
    plug_camera(sysfs, 1, "DIGIT", serial="D20001", index=1)
    plug_camera(sysfs, 10, "GelSight Mini R0B 28F5-K4RR", usb="0c45:636d", serial="28F5K4RR")
    nodes = video_nodes.video_nodes()
    assert [(node.device, node.product, node.usb, node.serial_number) for node in nodes] == [
        ("/dev/video0", "DIGIT", "2833:0209", "D20001"),
        ("/dev/video10", "GelSight Mini R0B 28F5-K4RR", "0c45:636d", "28F5K4RR"),
    ]


def test_a_camera_that_is_not_on_usb_has_its_name_only(sysfs: Path) -> None:
    (sysfs / "video3").mkdir()
    (sysfs / "video3" / "name").write_text("unicam-image\n")
    (node,) = video_nodes.video_nodes()
    assert (node.product, node.usb, node.serial_number) == ("unicam-image", "", "")


def test_a_camera_is_found_by_its_serial_number(sysfs: Path) -> None:
    plug_camera(sysfs, 0, "DIGIT", serial="D20001")
    plug_camera(sysfs, 2, "DIGIT", serial="D20002")
    assert video_nodes.find_camera("D20002", "DIGIT").device == "/dev/video2"
    with pytest.raises(InputError, match="several DIGIT are connected; write one of: D20001, D20002"):
        video_nodes.find_camera(None, "DIGIT")
    with pytest.raises(DeviceLostError, match="DIGIT with the serial number D3: is not connected; connected: D20001"):
        video_nodes.find_camera("D3", "DIGIT")
    with pytest.raises(DeviceLostError, match="GelSight Mini: is not connected; connected: none"):
        video_nodes.find_camera(None, "GelSight Mini")


def test_the_list_names_needs_and_connected_devices(sysfs: Path, capsys: Capture) -> None:
    plug_camera(sysfs, 0, "Arducam OV5647", serial="UC762")
    document = json.loads(listed(capsys, "--json"))
    drivers = {(row["kind"], row["name"]): row for row in document["drivers"]}
    grbl, opencv = drivers["stage", "grbl"], drivers["sensor", "opencv"]
    assert grbl["needs"] == ["pyserial"] and grbl["missing"] == [] and grbl["package"] == "tacbench-cad"
    assert grbl["plugged_in"] == [PORT.name] and not grbl["certain"]
    assert opencv["plugged_in"] == ["UC762"]
    assert document["ports"][0]["usb"] == "1a86:7523" and document["cameras"][0]["serial_number"] == "UC762"
    table = listed(capsys)
    assert "perhaps /dev/serial/by-id/usb-1a86-if00" in table and "Arducam OV5647" in table


def test_a_driver_that_cannot_be_imported_is_listed_with_the_reason(
    sysfs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    install_package(tmp_path, monkeypatch, "[tacbench.gauges]\nlab-cell = lab_cell:Cell\n", lab_cell="1 / 0\n")
    rows = json.loads(listed(capsys, "--json"))["drivers"]
    (row,) = [row for row in rows if row["name"] == "lab-cell"]
    assert row["package"] == "lab-arm" and "ZeroDivisionError" in row["error"]
    assert "ZeroDivisionError" in listed(capsys)
