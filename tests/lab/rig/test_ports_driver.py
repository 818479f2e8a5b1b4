"""Test ports by stable names; the program never guesses among several candidates."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from serial.tools import list_ports

from tacbench_cad.lab.rig import ports
from tacbench_cad.util.errors import InputError


def usb(device: Path, product: str = "USB Serial", vid: int | None = 0x1A86) -> SimpleNamespace:
    return SimpleNamespace(
        device=str(device),
        vid=vid,
        manufacturer="wch.cn",
        product=product,
        description=product,
    )


def plug(monkeypatch: pytest.MonkeyPatch, *devices: SimpleNamespace) -> None:
    monkeypatch.setattr(list_ports, "comports", lambda: list(devices))


@pytest.mark.skipif(sys.platform == "win32", reason="symbolic links need permissions on Windows")
def test_a_candidate_is_named_by_id_then_by_socket_then_by_device(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    by_id, by_path = tmp_path / "by-id", tmp_path / "by-path"
    by_id.mkdir()
    by_path.mkdir()
    devices = [tmp_path / name for name in ("ttyUSB0", "ttyUSB1", "ttyUSB2")]
    for device in devices:
        device.touch()
    (by_id / "usb-1a86-if00").symlink_to(devices[0])
    (by_path / "pci-0-port0").symlink_to(devices[0])
    (by_path / "pci-0-port1").symlink_to(devices[1])
    plug(monkeypatch, *(usb(device) for device in devices), usb(tmp_path / "ttyS0", vid=None))
    candidates = {candidate.device: candidate for candidate in ports.candidates(by_id, by_path)}
    assert [candidates[str(device)].name for device in devices] == [
        str(by_id / "usb-1a86-if00"),
        str(by_path / "pci-0-port1"),
        str(devices[2]),
    ]
    assert [candidates[str(device)].stable for device in devices] == [True, True, False]
    assert len(candidates) == 3
    assert candidates[str(devices[0])].description == "wch.cn USB Serial"


def test_a_single_candidate_is_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plug(monkeypatch, usb(tmp_path / "ttyUSB0"))
    assert ports.resolve(None, "stage") == str(tmp_path / "ttyUSB0")


def test_several_candidates_are_listed_and_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plug(monkeypatch, usb(tmp_path / "ttyUSB0"), usb(tmp_path / "ttyUSB1"))
    with pytest.raises(InputError, match=r"several serial devices are connected.*ttyUSB0.*ttyUSB1"):
        ports.resolve(None, "stage")


def test_a_port_of_another_device_is_not_a_candidate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plug(monkeypatch, usb(tmp_path / "ttyUSB0"), usb(tmp_path / "ttyUSB1"))
    assert ports.resolve(None, "gauge", taken=(str(tmp_path / "ttyUSB0"),)) == str(tmp_path / "ttyUSB1")


def test_missing_devices_are_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    plug(monkeypatch)
    with pytest.raises(InputError, match="no serial device is connected"):
        ports.resolve(None, "stage")


@pytest.mark.parametrize("port", ["socket://rig.local:4000", "COM3", "/dev/serial/by-id/usb-x", "rfc2217://h:1"])
def test_a_written_port_is_used(port: str) -> None:
    assert ports.resolve(port, "stage") == port


def test_an_empty_name_is_refused() -> None:
    with pytest.raises(InputError, match="must be a path"):
        ports.resolve("", "stage")
