"""Connected devices as the system describes them, and installed packages that add drivers."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from tacbench_cad.util.entries import groups


def plug_camera(
    sysfs: Path, number: int, product: str, *, usb: str = "2833:0209", serial: str = "D20001", index: int = 0
) -> None:
    """Write the files and links by which Linux describes the node of a USB camera."""
    device = sysfs.parent / "devices" / f"usb1-{number}"
    interface = device / f"1-{number}:1.0"
    interface.mkdir(parents=True, exist_ok=True)
    vendor, identifier = usb.split(":")
    for name, text in (("product", product), ("serial", serial), ("idVendor", vendor), ("idProduct", identifier)):
        if text:
            (device / name).write_text(f"{text}\n")
    node = sysfs / f"video{number}"
    node.mkdir(parents=True)
    (node / "device").symlink_to(interface)
    (node / "name").write_text(f"{product}: {product}\n")
    (node / "index").write_text(f"{index}\n")


def install_package(folder: Path, monkeypatch: pytest.MonkeyPatch, entry_points: str, **modules: str) -> None:
    """Install a package with entry points and modules in a folder that is searched first."""
    info = folder / "lab_arm-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: lab-arm\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(entry_points)
    for name, source in modules.items():
        (folder / f"{name}.py").write_text(source)
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.syspath_prepend(str(folder))
    groups.cache_clear()
