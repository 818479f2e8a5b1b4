"""A camera on the camera connector of a Raspberry Pi as a sensor, by the package picamera2.

Exposure, gain and colour gains are fixed, and every frame says with which values it was taken. A frame with other
values is an error. Picamera2 itself waits for a frame whose exposure began after the request.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from typing import Annotated, Any

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

#: The longest wait for a frame, in s.
TIMEOUT_S = 10.0
#: The number of frames after which the fixed values must hold.
SETTLE_FRAMES = 20
#: The allowed relative difference between a requested and a reported value. The camera counts lines and steps of gain.
CLOSE = 0.03


_ColourGain = Annotated[float, Interval(ge=0.0, le=32.0)]


@dataclass(frozen=True, kw_only=True)
class PiCameraOptions:
    """The options of the camera in ``[sensor]``.

    Args:
        exposure_us: The exposure in microseconds.
        gain: The analogue gain.
        colour_gains: The gains of red and blue, which replace the automatic white balance.
        width: The width of a frame in pixels.
        height: The height of a frame in pixels.
        dark_counts: See :class:`~tacbench_cad.lab.rig.frames.FrameLimits`.
        blur_px: See :class:`~tacbench_cad.lab.rig.frames.FrameLimits`.
    """

    exposure_us: Annotated[int, Interval(ge=10, le=10_000_000)]
    gain: Annotated[float, Interval(ge=1.0, le=64.0)] = 1.0
    colour_gains: tuple[_ColourGain, _ColourGain] = (1.5, 1.5)
    width: Annotated[int, Interval(ge=64, le=20_000)] = 640
    height: Annotated[int, Interval(ge=64, le=20_000)] = 480
    dark_counts: Annotated[float, Interval(ge=0.0, le=255.0)] = FrameLimits.dark_counts
    blur_px: Annotated[float, Interval(ge=0.0, le=1000.0)] = FrameLimits.blur_px


class PiCameraSensor(Closing):
    """A camera. See :class:`tacbench_cad.lab.rig.sensor.Sensor`.

    Args:
        device: The number of the camera, or its model such as ``imx708``; None for the only camera.
        options: See :class:`PiCameraOptions`.

    Raises:
        InputError: Several cameras are connected, and none is named.
        RigError: The camera is not connected or does not keep the values.
    """

    units = "counts"
    channels = INSIDE
    simulated = ""

    def __init__(self, device: str | None, options: PiCameraOptions) -> None:
        from picamera2 import Picamera2

        number, model = _chosen(Picamera2.global_camera_info(), device)
        self.name = f"Raspberry Pi camera {number}, {model}"
        self.shape: tuple[int, ...] = (options.height, options.width, 3)
        self._limits = FrameLimits(dark_counts=options.dark_counts, blur_px=options.blur_px)
        self._previous: NDArray[Any] | None = None
        self._fixed = {
            "ExposureTime": (float(options.exposure_us),),
            "AnalogueGain": (options.gain,),
            "ColourGains": options.colour_gains,
        }
        controls = {
            "AeEnable": False,
            "AwbEnable": False,
            "ExposureTime": options.exposure_us,
            "AnalogueGain": options.gain,
            "ColourGains": options.colour_gains,
        }
        self._camera: Any = None
        try:
            self._camera = Picamera2(number)
            # In picamera2, the format RGB888 is an array in the order blue, green, red.
            main = {"size": (options.width, options.height), "format": "RGB888"}
            self._camera.configure(self._camera.create_video_configuration(main=main, controls=controls))
            self._camera.start()
            actual = self._settle()
        except (RuntimeError, OSError, IndexError) as error:
            self.close()
            raise DeviceLostError(f"{self.name}: cannot be opened: {one_line(error, 200)}") from None
        except BaseException:
            self.close()
            raise
        self.settings: dict[str, Any] = {
            "requested": to_plain(options),
            "actual": actual,
            "limits": to_plain(self._limits),
        }

    def read(self) -> Frame:
        """Take a picture whose exposure began after this call.

        Returns:
            uint8, shape (height, width, 3), in the order blue, green, red.

        Raises:
            DeviceLostError: The camera no longer delivers frames.
            RigError: The frame is dark, blurred or stuck, or was taken with other values.
        """
        image, actual = self._take()
        wrong = self._wrong(actual)
        if wrong:
            raise RigError(f"{self.name}: {wrong}; another program may use the camera")
        previous, self._previous = self._previous, image
        require_good_frame(self.name, image, previous, self._limits)
        return image

    def close(self) -> None:
        """Close the camera. Never raises; a second call has no effect."""
        camera, self._camera = self._camera, None
        if camera is not None:
            for end in (camera.stop, camera.close):
                with contextlib.suppress(Exception):
                    end()

    def _settle(self) -> dict[str, Any]:
        """Wait until the values hold, and return them."""
        wrong = ""
        for _ in range(SETTLE_FRAMES):
            _, actual = self._take()
            wrong = self._wrong(actual)
            if not wrong:
                return {name: list(np.atleast_1d(actual[name]).astype(float)) for name in self._fixed}
        raise RigError(f"{self.name}: {wrong}; choose values that the camera supports")

    def _take(self) -> tuple[NDArray[np.uint8], dict[str, Any]]:
        if self._camera is None:
            raise DeviceLostError(f"{self.name}: is closed")
        try:
            request = self._camera.capture_request(wait=TIMEOUT_S, flush=True)
        except TimeoutError:
            raise DeviceLostError(f"{self.name}: no frame within {TIMEOUT_S:g} s; check the cable") from None
        try:
            image = np.array(request.make_array("main"), dtype=np.uint8)
            actual = dict(request.get_metadata())
        finally:
            request.release()
        if image.shape != self.shape:
            raise RigError(f"{self.name}: a frame has shape {image.shape}; requested was {self.shape}")
        return image, actual

    def _wrong(self, actual: dict[str, Any]) -> str:
        """Return the values that differ from the fixed ones, as text; empty if none does."""
        wrong = []
        for name, values in self._fixed.items():
            now = np.atleast_1d(actual.get(name, ()))
            if len(now) != len(values) or not np.allclose(now, values, rtol=CLOSE, atol=0.0):
                wrong.append(f"{name} is {actual.get(name)} instead of {values[0] if len(values) == 1 else values}")
        return ", ".join(wrong)


def _chosen(cameras: list[dict[str, Any]], device: str | None) -> tuple[int, str]:
    """Return the number and the model of the camera."""
    listed = ", ".join(f"{camera['Num']} ({camera['Model']})" for camera in cameras) or "none"
    matching = [camera for camera in cameras if device in (None, str(camera["Num"]), camera["Model"])]
    if not matching:
        raise DeviceLostError(f"camera {device}: is not connected; connected: {listed}")
    if len(matching) > 1:
        raise InputError("[sensor] device", device, f"fits several cameras; write the number of one: {listed}")
    return int(matching[0]["Num"]), str(matching[0]["Model"])


def _open(settings: SensorSettings, context: Context) -> PiCameraSensor:
    return PiCameraSensor(settings.device, from_plain(PiCameraOptions, dict(settings.options), "[sensor] "))


DRIVER = Driver(
    open=_open,
    summary="camera on the camera connector of a Raspberry Pi",
    modules=("picamera2",),
    install="sudo apt install python3-picamera2",
)
