"""The connected cameras as Linux describes them in sysfs: product name, USB ids and serial number. Opens no camera."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tacbench_cad.lab.rig.errors import DeviceLostError
from tacbench_cad.util.errors import InputError

#: The folder in which Linux lists the nodes of all cameras.
SYSFS = Path("/sys/class/video4linux")


@dataclass(frozen=True, kw_only=True)
class VideoNode:
    """The node of a camera that delivers pictures.

    Args:
        device: The system's present name: ``/dev/video0``. It may change when the camera is reconnected.
        product: The name of the product.
        usb: The vendor and the product of the USB device: ``2833:0209``; empty for another kind of camera.
        serial_number: The serial number of the USB device; empty if it has none.
    """

    device: str
    product: str
    usb: str
    serial_number: str


def video_nodes(sysfs: Path = SYSFS) -> tuple[VideoNode, ...]:
    """Return the cameras, sorted by node. Nodes that deliver metadata are left out."""
    nodes = []
    for folder in sorted(sysfs.glob("video*"), key=lambda folder: (len(folder.name), folder.name)):
        if _text(folder / "index") not in ("0", ""):
            continue
        interface = (folder / "device").resolve()
        # The node belongs to an interface of the USB device, whose own folder has the ids.
        usb = next((place for place in (interface, *interface.parents[:2]) if (place / "idVendor").is_file()), None)
        nodes.append(
            VideoNode(
                device=f"/dev/{folder.name}",
                product=(_text(usb / "product") if usb else "") or _text(folder / "name"),
                usb=f"{_text(usb / 'idVendor')}:{_text(usb / 'idProduct')}" if usb else "",
                serial_number=_text(usb / "serial") if usb else "",
            )
        )
    return tuple(nodes)


def find_camera(device: str | None, product: str, nodes: tuple[VideoNode, ...] | None = None) -> VideoNode:
    """Find a camera by its serial number.

    Args:
        device: The value of ``[sensor] device``: a serial number; None for the only camera of this product.
        product: A part of the product name.
        nodes: The connected cameras; None to look for them.

    Raises:
        InputError: No serial number is given, and several cameras of this product are connected.
        DeviceLostError: The camera is not connected.
    """
    every = video_nodes() if nodes is None else nodes
    known = [node for node in every if product.lower() in node.product.lower()]
    listed = ", ".join(node.serial_number or node.device for node in known) or "none"
    matching = [node for node in known if device in (None, node.serial_number)]
    if not matching:
        number = "" if device is None else f" with the serial number {device}"
        raise DeviceLostError(f"{product}{number}: is not connected; connected: {listed}")
    if len(matching) > 1:
        raise InputError("[sensor] device", device, f"several {product} are connected; write one of: {listed}")
    return matching[0]


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""
