"""What a tactile sensor is: something that gives an array when it is asked."""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from tacbench_cad.lab.rig.stage import Device

#: One image or array of a sensor.
Frame = NDArray[Any]


@runtime_checkable
class Sensor(Device, Protocol):
    """A tactile sensor, connected and identified when it is made.

    Attributes:
        name: What it is, for people and for ``run.json``.
        units: Unit of the numbers: ``counts`` of an image.
        shape: Shape of every frame.
        simulated: What of it is simulated, or an empty text.
        settings: ``{"requested": {...}, "actual": {...}}``, plain values.
    """

    name: str
    units: str
    shape: tuple[int, ...]
    simulated: str
    settings: dict[str, Any]

    def read(self) -> Frame:
        """A frame whose exposure or sampling began after this call.

        Returns:
            An array of the sensor's ``shape``; an image is uint8 of shape (height, width) or (height, width, 3), BGR.

        Raises:
            RigError: Lost, silent, or sending what cannot be a frame.
        """


def is_image(frame: Frame) -> bool:
    """Whether a frame is stored as a picture: uint8, (height, width) or (height, width, 3), at least 8 a side."""
    if frame.dtype != np.uint8 or frame.ndim not in (2, 3):
        return False
    return min(frame.shape[:2]) >= 8 and (frame.ndim == 2 or frame.shape[2] == 3)
