"""The interface of a tactile sensor, which returns an array on request."""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from tacbench_cad.lab.rig.stage import Device

#: One image or array of a sensor.
Frame = NDArray[Any]


@runtime_checkable
class Sensor(Device, Protocol):
    """A tactile sensor. It is connected and identified when it is created.

    Attributes:
        name: The sensor, for people and for ``run.json``.
        units: The unit of the values: ``counts`` for an image.
        shape: The shape of every frame: ``(height, width)`` or ``(height, width, 3)`` for an image.
        simulated: The simulated part, or an empty text.
        settings: ``{"requested": {...}, "actual": {...}}``, plain values.

    A driver of images in colours also has the attribute ``channels``, the order of their colours: ``rgb`` or ``bgr``.
    The study file can state it instead.

    A driver can have two optional members for moving frames. The method ``grab()`` takes a frame as :meth:`read` does,
    but returns a function that returns the frame, so that slow work is done later, and only for frames that are kept.
    The attribute ``frame_age_s`` is the time from the middle of the last frame's exposure to the end of the call, in s
    of real time. Without it, the middle of the call counts as the time of a moving frame.
    """

    name: str
    units: str
    shape: tuple[int, ...]
    simulated: str
    settings: dict[str, Any]

    def read(self) -> Frame:
        """Return a frame whose exposure or sampling began after this call.

        Returns:
            An array of the sensor's ``shape``; an image is uint8 of shape (height, width) or (height, width, 3).

        Raises:
            RigError: The sensor is gone or silent, or sends invalid frames.
        """


def is_image(frame: Frame) -> bool:
    """Return whether a frame is stored as an image: uint8, (height, width) or (height, width, 3), 8 pixels or more."""
    if frame.dtype != np.uint8 or frame.ndim not in (2, 3):
        return False
    return min(frame.shape[:2]) >= 8 and (frame.ndim == 2 or frame.shape[2] == 3)
