"""The order of the colours of an image. This is the only module that decides it.

Inside the program, a colour image is in the order blue, green, red (:data:`INSIDE`), because OpenCV reads and writes
image files in this order: a frame of a run, the frame of a sensor, and the argument of every function for frames.
Everything outside is in the order red, green, blue: an image file itself, every array that is imported or exported,
and the ``.npy`` files of a run folder.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

import numpy as np

from tacbench_cad.lab.rig.sensor import Frame, Sensor, is_image
from tacbench_cad.lab.rig.stage import Closing
from tacbench_cad.util.errors import InputError, one_of

#: The order of the colours of a pixel.
Channels = Literal["rgb", "bgr"]
#: The allowed orders.
CHANNELS: tuple[Channels, ...] = ("rgb", "bgr")
#: The order inside the program.
INSIDE: Channels = "bgr"
#: The order outside of the program.
OUTSIDE: Channels = "rgb"


def has_colours(frame: Frame) -> bool:
    """Return whether a frame is an image in colours."""
    return is_image(frame) and frame.ndim == 3


def swapped(frame: Frame) -> Frame:
    """Return an image, shape (height, width, 3), with its first and last channel exchanged."""
    return np.ascontiguousarray(frame[..., ::-1])


def outside(frame: Frame) -> Frame:
    """Return a frame as other programs expect it: an image in RGB, any other array unchanged."""
    return swapped(frame) if has_colours(frame) else frame


def from_outside(array: Frame, channels: Channels) -> Frame:
    """Return an array of another program as a frame of this program.

    Args:
        array: Any array. Only arrays of shape (height, width, 3) have colours.
        channels: The order of its colours.

    Returns:
        An image in the order :data:`INSIDE`; any other array in the order :data:`OUTSIDE`, in which it is stored.
    """
    if array.ndim != 3 or array.shape[2] != 3:
        return array
    return array if channels == (INSIDE if is_image(array) else OUTSIDE) else swapped(array)


class SwappedColours(Closing):
    """A sensor whose driver delivers images in the order red, green, blue. Its frames become blue, green, red.

    Args:
        sensor: The sensor.
    """

    name: str
    units: str
    shape: tuple[int, ...]
    simulated: str

    def __init__(self, sensor: Sensor) -> None:
        self._sensor = sensor
        requested = {**sensor.settings.get("requested", {}), "channels": "rgb"}
        self.settings: dict[str, Any] = {**sensor.settings, "requested": requested}

    def __getattr__(self, attribute: str) -> Any:
        value = getattr(self._sensor, attribute)
        return value if attribute != "grab" else lambda: _later(value())

    def read(self) -> Frame:
        """See :class:`tacbench_cad.lab.rig.sensor.Sensor`."""
        return from_outside(self._sensor.read(), "rgb")

    def close(self) -> None:
        """See :class:`tacbench_cad.lab.rig.sensor.Sensor`."""
        self._sensor.close()


def _later(take: Callable[[], Frame]) -> Callable[[], Frame]:
    return lambda: from_outside(take(), "rgb")


def with_inside_colours(sensor: Sensor, channels: Channels | None, driver: str) -> Sensor:
    """Return a sensor whose images are in the order :data:`INSIDE`.

    Args:
        sensor: The sensor.
        channels: The order that the user's settings state; None for the order that the sensor itself states.
        driver: The name of the driver, for error messages.

    Raises:
        InputError: The frames can be images in colours, but nothing states their order.
    """
    fault = channels_fault(sensor, channels)
    if fault:
        raise InputError("[sensor] channels", None, f"{fault}, or write it into the table [sensor] (driver {driver})")
    return SwappedColours(sensor) if (channels or getattr(sensor, "channels", None)) == "rgb" else sensor


def channels_fault(sensor: Sensor, channels: Channels | None = None) -> str:
    """Return what is wrong with a sensor's statement of the order of its colours; an empty text if nothing is."""
    stated = channels or getattr(sensor, "channels", None)
    if stated is not None:
        try:
            one_of("channels", str(stated), CHANNELS)
        except InputError as error:
            return str(error)
        return ""
    shape = tuple(sensor.shape)
    if len(shape) != 3 or shape[2] != 3 or min(shape[:2]) < 8:
        return ""
    return f'is missing; frames of shape {shape} have three channels: write channels = "rgb" or "bgr" into the class'
