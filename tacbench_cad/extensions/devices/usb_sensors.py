"""Camera-based tactile sensors on USB, which are found by their product name and serial number: DIGIT, GelSight Mini.

Both are cameras of the class that every system supports, so no package of their manufacturers is needed. The camera
numbers of the system change with every restart; the serial number stays. Linux only, since it is read from sysfs.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Annotated, Any

from tacbench_cad.lab.rig import CameraOptions, CameraSensor, Context, Driver, Opener, find_camera
from tacbench_cad.lab.study import SensorSettings
from tacbench_cad.util.convert import Bounds, from_plain

#: The property by which OpenCV sets the lamps of a DIGIT (its firmware uses the control of a zoom lens for them).
_ZOOM = 27
#: The limit for blurred frames is off by default: neither sensor needs markers on its gel.
_DEFAULTS: dict[str, dict[str, Any]] = {
    "DIGIT": {"width": 640, "height": 480, "fps": 30, "blur_px": 0.0},
    "GelSight Mini": {"width": 640, "height": 480, "blur_px": 0.0},
}


@dataclass(frozen=True, kw_only=True)
class Lamps:
    """The lamps of a DIGIT in ``[sensor]``.

    Args:
        lamps: The brightness of the red, the green and the blue lamp, from 0 to 15.
    """

    lamps: tuple[Annotated[int, Bounds(0, 15)], Annotated[int, Bounds(0, 15)], Annotated[int, Bounds(0, 15)]] = (
        15,
        15,
        15,
    )

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


def _digit(settings: SensorSettings, context: Context) -> CameraSensor:
    return open_usb_sensor(settings, "DIGIT")


def _gelsight_mini(settings: SensorSettings, context: Context) -> CameraSensor:
    return open_usb_sensor(settings, "GelSight Mini")


DIGIT = Driver(
    open=_digit,
    summary="DIGIT, by its serial number",
    connection="camera",
    modules=("cv2",),
    usb=("2833:0209",),
    product="DIGIT",
)
GELSIGHT_MINI = Driver(
    open=_gelsight_mini,
    summary="GelSight Mini, by its serial number",
    connection="camera",
    modules=("cv2",),
    product="GelSight Mini",
)
