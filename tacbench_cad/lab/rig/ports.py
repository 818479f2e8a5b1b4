"""Stable names of serial ports. If several ports are possible, the user must choose one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tacbench_cad.util.errors import InputError

#: The folder where Linux lists serial devices by manufacturer, product and serial number.
BY_ID = Path("/dev/serial/by-id")
#: The folder where Linux lists serial devices by USB socket.
BY_PATH = Path("/dev/serial/by-path")


@dataclass(frozen=True, kw_only=True)
class PortCandidate:
    """A serial port of a connected device.

    Args:
        name: The most stable name of the port, for a settings file.
        device: The system's present name: ``/dev/ttyUSB0``. It may change when the device is reconnected.
        description: The manufacturer and product that the device reports.
        stable: Whether ``name`` stays the same when the device is reconnected.
    """

    name: str
    device: str
    description: str
    stable: bool


def candidates(by_id: Path = BY_ID, by_path: Path = BY_PATH) -> list[PortCandidate]:
    """Return the serial ports of USB devices, sorted by name. Built-in ports are left out.

    Args:
        by_id: The folder with links named after devices (Linux).
        by_path: The folder with links named after USB sockets, for devices without a serial number.
    """
    from serial.tools import list_ports

    links = _links(by_path) | _links(by_id)
    ports = []
    for port in list_ports.comports():
        if port.vid is None:
            continue
        link = links.get(str(Path(port.device).resolve()))
        described = " ".join(part for part in (port.manufacturer, port.product or port.description) if part)
        ports.append(
            PortCandidate(
                name=str(link or port.device),
                device=port.device,
                description=described,
                stable=link is not None,
            )
        )
    return sorted(ports, key=lambda candidate: candidate.name)


def resolve(port: str | None, what: str, *, taken: Sequence[str] = ()) -> str:
    """Choose the port to open.

    Args:
        port: The user's path, name or pyserial URL; None for the only connected device.
        what: The kind of device, for error messages: ``stage``.
        taken: The ports of the rig's other devices.

    Raises:
        InputError: The port is None, and the number of connected devices is not one.
    """
    if port is not None:
        if not port:
            raise InputError(f"{what} port", port, "must be a path, a name or a URL such as socket://host:port")
        return port
    used = {str(Path(other).resolve()) for other in taken}
    free = [candidate for candidate in candidates() if str(Path(candidate.device).resolve()) not in used]
    if not free:
        raise InputError(f"{what} port", None, "no serial device is connected; `tacbench rig probe` lists them")
    if len(free) > 1:
        names = ", ".join(candidate.name for candidate in free)
        raise InputError(f"{what} port", None, f"several serial devices are connected; write one of: {names}")
    return free[0].name


def _links(folder: Path) -> dict[str, Path]:
    """Return the link to each device in a folder, by the device's real path; the first by name if several exist."""
    if not folder.is_dir():
        return {}
    return {str(link.resolve()): link for link in sorted(folder.iterdir(), reverse=True)}
