"""A list of all drivers: what each of them needs, and whether its device is plugged in. Opens no device."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from tacbench_cad.lab.rig import registry
from tacbench_cad.lab.rig.drivers import find_driver
from tacbench_cad.lab.rig.ports import PortCandidate
from tacbench_cad.lab.rig.registry import Connection, Driver, Kind
from tacbench_cad.lab.rig.video_nodes import VideoNode
from tacbench_cad.util.entries import is_own
from tacbench_cad.util.errors import TacbenchError, one_line

#: The distribution whose drivers are ours.
OURS = "tacbench-cad"


@dataclass(frozen=True, kw_only=True)
class ListedDriver:
    """A driver in the list.

    Args:
        kind: The kind of device.
        name: The name for the study file.
        package: The package that adds the driver.
        summary: The devices that it drives.
        connection: The connection of the device; empty if the driver cannot be loaded.
        needs: The packages that it needs.
        missing: The needed packages that are not installed.
        install: The command that installs these packages; empty if none is missing.
        plugged_in: The connected devices that fit. For a driver of any serial device, these are all serial ports.
        certain: Whether these devices are recognised by their USB ids or product name.
        error: Why the driver cannot be loaded; empty if it can.
    """

    kind: Kind
    name: str
    package: str
    summary: str = ""
    connection: Connection | str = ""
    needs: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()
    install: str = ""
    plugged_in: tuple[str, ...] = ()
    certain: bool = False
    error: str = ""


def list_drivers(ports: Sequence[PortCandidate], cameras: Sequence[VideoNode]) -> tuple[ListedDriver, ...]:
    """Return all drivers, ours first. A driver of another package that cannot be loaded is listed with the reason.

    Args:
        ports: The serial ports of connected devices.
        cameras: The connected cameras.
    """
    rows = []
    for kind in registry.GROUPS:
        for name, entry in registry.drivers(kind).items():
            package = OURS if is_own(entry) or entry.dist is None else entry.dist.name
            try:
                driver = find_driver(kind, name)
            except TacbenchError as error:
                rows.append(ListedDriver(kind=kind, name=name, package=package, error=one_line(error)))
                continue
            rows.append(
                ListedDriver(
                    kind=kind,
                    name=name,
                    package=package,
                    summary=driver.summary,
                    connection=driver.connection,
                    needs=registry.distributions(driver.modules),
                    missing=driver.missing,
                    install=driver.install if driver.missing else "",
                    plugged_in=_plugged_in(driver, ports, cameras),
                    certain=bool(driver.usb or driver.product),
                )
            )
    return tuple(rows)


def _plugged_in(driver: Driver, ports: Sequence[PortCandidate], cameras: Sequence[VideoNode]) -> tuple[str, ...]:
    """Return the connected devices that fit a driver, by serial number if they have one."""
    if driver.connection == "serial port":
        fitting = [port for port in ports if not driver.usb or port.usb.startswith(driver.usb)]
        return tuple(port.name for port in fitting)
    if driver.connection == "camera":
        product = driver.product.lower()
        return tuple(node.serial_number or node.device for node in cameras if product in node.product.lower())
    return ()
