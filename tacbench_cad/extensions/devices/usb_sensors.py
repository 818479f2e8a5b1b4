"""Camera-based tactile sensors on USB, which are found by their product name and serial number: DIGIT, GelSight Mini.

Both are cameras of the class that every system supports, so no package of their manufacturers is needed. The camera
numbers of the system change with every restart; the serial number stays. Linux only, since it is read from sysfs.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any

from annotated_types import Interval

from tacbench_cad.lab.rig import CameraOptions, CameraSensor, Context, DeviceLostError, Driver, Opener
from tacbench_cad.lab.study import SensorSettings
from tacbench_cad.util.convert import from_plain
from tacbench_cad.util.errors import InputError

#: The folder in which Linux lists the nodes of all cameras.
SYSFS = Path("/sys/class/video4linux")


#: The property by which OpenCV sets the lamps of a DIGIT (its firmware uses the control of a zoom lens for them).
_ZOOM = 27
#: The limit for blurred frames is off by default: neither sensor needs markers on its gel.
_DEFAULTS: dict[str, dict[str, Any]] = {
    "DIGIT": {"width": 640, "height": 480, "fps": 30, "blur_px": 0.0},
    "GelSight Mini": {"width": 640, "height": 480, "blur_px": 0.0},
}


@dataclass(frozen=True, kw_only=True)
class VideoNode:
    """The node of a camera that delivers pictures.

    Args:
        device: The system's present name: ``/dev/video0``. It may change when the camera is reconnected.
        product: The name of the product.
        serial_number: The serial number of the USB device; empty if it has none.
    """

    device: str
    product: str
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


_Brightness = Annotated[int, Interval(ge=0, le=15)]


@dataclass(frozen=True, kw_only=True)
class Lamps:
    """The lamps of a DIGIT in ``[sensor]``.

    Args:
        lamps: The brightness of the red, the green and the blue lamp, from 0 to 15.
    """

    lamps: tuple[_Brightness, _Brightness, _Brightness] = (15, 15, 15)

    @property
    def word(self) -> float:
        """The value of the property: four bits for each lamp."""
        red, green, blue = self.lamps
        return float(red << 8 | green << 4 | blue)


def open_usb_sensor(settings: SensorSettings, product: str, *, opener: Opener | None = None) -> CameraSensor:
    """Open a sensor.

    Args:
        settings: The table. ``device`` is the serial number; None for the only sensor of this product.
        product: ``DIGIT`` or ``GelSight Mini``. ``lamps`` is an option of a DIGIT only.
        opener: Opens the camera; tests pass their own.

    Raises:
        InputError: A setting is not allowed, or several sensors are connected and none is named.
        RigError: The sensor is not connected or fails.
    """
    values = {**_DEFAULTS[product], **settings.options}
    extra = {}
    if product == "DIGIT":
        own = {field.name: values.pop(field.name) for field in fields(Lamps) if field.name in values}
        extra = {"lamps": (_ZOOM, from_plain(Lamps, own, "[sensor] ").word)}
    options = from_plain(CameraOptions, values, "[sensor] ")
    node = find_camera(settings.device, product)
    name = " ".join(word for word in (product, node.serial_number) if word)
    return CameraSensor(node.device, options, name=name, extra=extra, opener=opener)


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""


def _digit(settings: SensorSettings, context: Context) -> CameraSensor:
    return open_usb_sensor(settings, "DIGIT")


def _gelsight_mini(settings: SensorSettings, context: Context) -> CameraSensor:
    return open_usb_sensor(settings, "GelSight Mini")


DIGIT = Driver(
    open=_digit,
    summary="DIGIT, by its serial number",
    connection="camera",
    modules=("cv2",),
)
GELSIGHT_MINI = Driver(
    open=_gelsight_mini,
    summary="GelSight Mini, by its serial number",
    connection="camera",
    modules=("cv2",),
)
