"""Serial ports by names that survive replugging and rebooting; several candidates are never guessed between."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tacbench_cad.util.errors import InputError

#: Where Linux lists serial devices by what they are, and by the socket they are plugged into.
BY_ID = Path("/dev/serial/by-id")
#: Where Linux lists serial devices by the socket they are plugged into.
BY_PATH = Path("/dev/serial/by-path")


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """A serial port of a device that is plugged in.

    Args:
        name: The name to write into a file: the most stable one there is.
        device: What the system calls it now: ``/dev/ttyUSB0``; may change when it is plugged in again.
        description: Product and maker as the device tells them.
        hardware: Vendor, product and serial number of the USB device.
        stable: Whether ``name`` survives replugging.
    """

    name: str
    device: str
    description: str
    hardware: str
    stable: bool


def candidates(by_id: Path = BY_ID, by_path: Path = BY_PATH) -> list[Candidate]:
    """The serial ports of USB devices, sorted by name. A computer's built-in ports are left out.

    Args:
        by_id: Folder of links named after devices (Linux).
        by_path: Folder of links named after sockets; used for devices without a serial number of their own.
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
            Candidate(
                name=str(link or port.device),
                device=port.device,
                description=described,
                hardware=port.hwid,
                stable=link is not None,
            )
        )
    return sorted(ports, key=lambda candidate: candidate.name)


def resolve(port: str | None, what: str, *, taken: Sequence[str] = ()) -> str:
    """The port to open.

    Args:
        port: As the user wrote it, a path, a name or a pyserial URL; None takes the only candidate.
        what: What is looked for, for the messages: ``stage``.
        taken: Ports that other devices of the rig have.

    Raises:
        InputError: None was written and there is no candidate, or more than one.
    """
    if port is not None:
        if not port:
            raise InputError(f"{what} port", port, "must be a path, a name or a URL such as socket://host:port")
        return port
    used = {str(Path(other).resolve()) for other in taken}
    free = [candidate for candidate in candidates() if str(Path(candidate.device).resolve()) not in used]
    if not free:
        raise InputError(f"{what} port", None, "no serial device is plugged in; `tacbench rig probe` lists them")
    if len(free) > 1:
        names = ", ".join(candidate.name for candidate in free)
        raise InputError(f"{what} port", None, f"there are several, none is guessed; write one of: {names}")
    return free[0].name


def _links(folder: Path) -> dict[str, Path]:
    """Device's real path to its link in a folder; the first by name where there are several."""
    if not folder.is_dir():
        return {}
    return {str(link.resolve()): link for link in sorted(folder.iterdir(), reverse=True)}
