"""An industrial camera of the GenICam standard (USB3 Vision, GigE Vision) as a sensor, by the package harvesters.

The manufacturer's software has a file with the suffix ``.cti``, which harvesters loads. Each picture is triggered by
this program, so its exposure begins after the request. Exposure and gain are fixed and read back before each picture.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from tacbench_cad.lab.rig import (
    INSIDE,
    Closing,
    Context,
    DeviceLostError,
    Driver,
    Frame,
    FrameLimits,
    RigError,
    require_good_frame,
)
from tacbench_cad.lab.study import SensorSettings
from tacbench_cad.util.convert import from_plain, to_plain
from tacbench_cad.util.errors import InputError, one_line

#: The longest wait for a picture in addition to its exposure, in s.
TIMEOUT_S = 5.0
#: The time in which an old picture that waits is found, in s. With 0, harvesters would wait for ever.
DRAIN_S = 0.002
#: The allowed relative difference between a requested and a reported value.
CLOSE = 0.01
#: The automatic controls of the standard, which a camera need not have.
AUTOMATISMS = ("ExposureAuto", "GainAuto", "BalanceWhiteAuto")
#: The order of the channels of each pixel format that the driver reads; one channel for grey.
FORMATS = {"Mono8": 1, "BGR8": 3, "RGB8": 3}


@dataclass(frozen=True, kw_only=True)
class GenicamOptions:
    """The options of the camera in ``[sensor]``.

    Args:
        cti: The file of the manufacturer's software.
        exposure_us: The exposure in microseconds.
        gain: The gain in the camera's own unit, usually dB; None keeps the present one.
        pixel_format: The format in which the camera sends pictures.
        dark_counts: See :class:`~tacbench_cad.lab.rig.frames.FrameLimits`.
        blur_px: See :class:`~tacbench_cad.lab.rig.frames.FrameLimits`.
    """

    cti: str
    exposure_us: Annotated[float, Interval(ge=1.0, le=10_000_000.0)]
    gain: float | None = None
    pixel_format: Literal["Mono8", "BGR8", "RGB8"] = "Mono8"
    dark_counts: Annotated[float, Interval(ge=0.0, le=255.0)] = FrameLimits.dark_counts
    blur_px: Annotated[float, Interval(ge=0.0, le=1000.0)] = FrameLimits.blur_px


class GenicamSensor(Closing):
    """A camera. See :class:`tacbench_cad.lab.rig.sensor.Sensor`.

    Args:
        device: The serial number; None for the only camera.
        options: See :class:`GenicamOptions`.

    Raises:
        InputError: The file of the manufacturer's software does not exist.
        RigError: The camera is not connected, or does not keep a value.
    """

    units = "counts"
    channels = INSIDE
    simulated = ""

    def __init__(self, device: str | None, options: GenicamOptions) -> None:
        from harvesters.core import Harvester

        if not Path(options.cti).is_file():
            raise InputError("[sensor] cti", options.cti, "does not exist; install the software of the manufacturer")
        self.name, self._options = f"GenICam camera {device or ''}".strip(), options
        self._limits = FrameLimits(dark_counts=options.dark_counts, blur_px=options.blur_px)
        self._previous: NDArray[Any] | None = None
        self._harvester, self._camera = Harvester(), None
        try:
            self._harvester.add_file(options.cti)
            self._harvester.update()
            self._camera = self._harvester.create(None if device is None else {"serial_number": device})
            self._nodes = self._camera.remote_device.node_map
            actual = self._configure()
            self._camera.start()
        except (InputError, RigError):
            self.close()
            raise
        except Exception as error:
            # The package raises exceptions of several classes, also those of the manufacturer's software.
            self.close()
            raise DeviceLostError(f"{self.name}: cannot be opened: {one_line(error, 200)}") from None
        height, width = int(self._nodes.Height.value), int(self._nodes.Width.value)
        self.shape: tuple[int, ...] = (height, width, 3)[: 2 if options.pixel_format == "Mono8" else 3]
        self.settings: dict[str, Any] = {
            "requested": to_plain(options),
            "actual": actual,
            "limits": to_plain(self._limits),
        }

    def read(self) -> Frame:
        """Trigger a picture.

        Returns:
            uint8, shape (height, width) or (height, width, 3), in the order blue, green, red.

        Raises:
            DeviceLostError: The camera no longer delivers pictures.
            RigError: The picture is dark, blurred or stuck, or a value has changed.
        """
        if self._camera is None:
            raise DeviceLostError(f"{self.name}: is closed")
        try:
            self._values()
            while (old := self._camera.try_fetch(timeout=DRAIN_S)) is not None:
                old.queue()
            self._nodes.TriggerSoftware.execute()
            with self._camera.fetch(timeout=TIMEOUT_S + 1e-6 * self._options.exposure_us) as buffer:
                picture = buffer.payload.components[0]
                image = np.array(picture.data, dtype=np.uint8).reshape(picture.height, picture.width, -1)
        except RigError:
            raise
        except Exception as error:
            raise DeviceLostError(f"{self.name}: no picture: {one_line(error, 200)}; check the cable") from None
        image = image[..., 0] if image.shape[2] == 1 else image
        if image.shape != self.shape:
            raise RigError(f"{self.name}: a picture has shape {image.shape}; expected was {self.shape}")
        if self._options.pixel_format == "RGB8":
            image = np.ascontiguousarray(image[..., ::-1])
        previous, self._previous = self._previous, image
        require_good_frame(self.name, image, previous, self._limits)
        return image

    def close(self) -> None:
        """Close the camera. Never raises; a second call has no effect."""
        camera, self._camera = self._camera, None
        ends = () if camera is None else (camera.stop, camera.destroy)
        for end in (*ends, self._harvester.reset):
            with contextlib.suppress(Exception):
                end()

    def _configure(self) -> dict[str, Any]:
        """Switch automatic controls off, set the values and the trigger, and return the values that the camera has."""
        for name in AUTOMATISMS:
            if self._state(name) not in ("", "Off"):
                getattr(self._nodes, name).value = "Off"
        self._nodes.PixelFormat.value = self._options.pixel_format
        self._nodes.ExposureTime.value = self._options.exposure_us
        if self._options.gain is not None:
            self._nodes.Gain.value = self._options.gain
        self._nodes.TriggerSelector.value = "FrameStart"
        self._nodes.TriggerMode.value = "On"
        self._nodes.TriggerSource.value = "Software"
        return self._values()

    def _state(self, name: str) -> str:
        """Return the state of an automatic control; empty if the camera does not have it.

        A grey camera may list the white balance, but then reading it raises an exception of the package.
        """
        try:
            return str(getattr(self._nodes, name).value)
        except Exception:
            return ""

    def _values(self) -> dict[str, Any]:
        """Return the values that the camera has.

        Raises:
            RigError: One of them differs from the requested value, or an automatic control is on.
        """
        requested = {"ExposureTime": self._options.exposure_us}
        if self._options.gain is not None:
            requested["Gain"] = self._options.gain
        actual = {name: float(getattr(self._nodes, name).value) for name in requested}
        for name, value in requested.items():
            if abs(actual[name] - value) > CLOSE * max(abs(value), 1.0):
                raise RigError(f"{self.name}: {name} is {actual[name]:g} instead of {value:g}")
        for name in AUTOMATISMS:
            if self._state(name) not in ("", "Off"):
                raise RigError(f"{self.name}: {name} is on; switch it off")
        return actual


def _open(settings: SensorSettings, context: Context) -> GenicamSensor:
    return GenicamSensor(settings.device, from_plain(GenicamOptions, dict(settings.options), "[sensor] "))


DRIVER = Driver(
    open=_open,
    summary="industrial cameras of the GenICam standard",
    modules=("harvesters",),
    install="pip install harvesters",
)
