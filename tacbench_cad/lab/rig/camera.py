"""A camera as a sensor, through OpenCV: settings that hold, and frames that began after they were asked for.

Cameras go on sending what they buffered, take settings without obeying, freeze, and come back in another size. OpenCV
says nothing of this, so everything is read back and looked at here.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from tacbench_cad.lab.rig.camera_devices import Capture, Opener, chosen_camera, open_capture
from tacbench_cad.lab.rig.errors import DeviceLostError, SensorError
from tacbench_cad.lab.rig.frames import FrameLimits, frame_faults
from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.rig.stage import Closing
from tacbench_cad.lab.study.spec import SensorSettings
from tacbench_cad.util.convert import Bounds, from_plain, to_plain

#: Frames that a driver may hold back: four on Linux, and one is being filled.
_BUFFERED = 5
#: Periods after which a frame that arrives cannot have begun before the call.
_PERIODS = 3.0
#: Longest time in which a fresh, sound frame must have come, in seconds.
_TIMEOUT_S = 10.0
#: Age up to which a frame's stamp is believed, in seconds: above the longest wait.
_OLDEST_S = 60.0
#: Faulty frames in a row that are let pass: one may be a glitch of the cable.
_GLITCHES = 2
#: Frames whose distances give the camera's pace when it is opened.
_PACE_FRAMES = 12
#: What an OpenCV property may differ from what was asked, as a fraction of it; cameras round to steps of their own.
_CLOSE = 0.01

# OpenCV's numbers of the properties (cv2.CAP_PROP_*); cv2 itself is only imported when a camera is opened.
_TIME_MS, _FPS, _AUTOFOCUS = 0, 5, 39
_PROPERTIES = {"width": 3, "height": 4, "fps": _FPS, "focus": 28, "gain": 14, "white_balance": 45, "exposure": 15}
#: Property that switches an automatism, the value that means off, and the setting that it would override. Automatic
#: exposure is off at another value on Windows: Video4Linux has a menu, Windows a fraction.
_AUTOMATISMS = (
    (_AUTOFOCUS, 0.0, "focus"),
    (44, 0.0, "white_balance"),
    (21, 1.0 if sys.platform.startswith("linux") else 0.25, "exposure"),
)


@dataclass(frozen=True, kw_only=True)
class CameraOptions:
    """What ``[sensor]`` says of a camera.

    Args:
        exposure: In the camera's own unit (on Linux 0.1 ms as a rule). Must be given: with automatic exposure the
            brightness follows the contact.
        width: Pixels.
        height: Pixels.
        fps: Frames a second; None for the camera's own choice.
        focus: In the camera's own unit; None for a lens that is set by hand.
        gain: Likewise; None leaves it as it is.
        white_balance: Colour temperature in kelvin; None leaves it as it is.
        colour: Whether frames are (height, width, 3) or grey (height, width).
        dark_counts: See :class:`~tacbench_cad.lab.rig.frames.FrameLimits`.
        blur_px: Likewise.
    """

    exposure: float
    width: Annotated[int, Bounds(8, 20_000)] = 640
    height: Annotated[int, Bounds(8, 20_000)] = 480
    fps: float | None = None
    focus: float | None = None
    gain: float | None = None
    white_balance: float | None = None
    colour: bool = True
    dark_counts: Annotated[float, Bounds(0.0, 255.0)] = FrameLimits.dark_counts
    blur_px: Annotated[float, Bounds(0.0, 1000.0)] = FrameLimits.blur_px

    @property
    def limits(self) -> FrameLimits:
        """When a frame is dark or blurred."""
        return FrameLimits(dark_counts=self.dark_counts, blur_px=self.blur_px)

    @property
    def requested(self) -> dict[str, float]:
        """The settings that the device must obey."""
        return {name: getattr(self, name) for name in _PROPERTIES if getattr(self, name) is not None}


class CameraSensor(Closing):
    """A camera that takes one picture when asked. See :class:`tacbench_cad.lab.rig.sensor.Sensor`.

    Args:
        device: The camera's stable name, or its number where the system has no such names.
        options: Its settings.
        opener: Opens the device; tests give one of their own.
        now_s: The real time in seconds, never going back.

    Raises:
        RigError: The camera does not open, does not obey, or gives no sound picture.
    """

    units = "counts"
    simulated = ""

    def __init__(
        self,
        device: str,
        options: CameraOptions,
        *,
        opener: Opener | None = None,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self.name = f"camera {device}"
        self.shape: tuple[int, ...] = (options.height, options.width, 3)[: 3 if options.colour else 2]
        self._device = device
        self._options = options
        self._now_s = now_s
        self._previous: NDArray[Any] | None = None
        self._capture: Capture | None = (opener or open_capture)(device)
        try:
            if not self._capture.isOpened():
                raise DeviceLostError(
                    f"{self.name}: does not open; is it plugged in, and is no other program using it?"
                )
            self.settings: dict[str, Any] = {
                "requested": {**options.requested, "colour": options.colour},
                "actual": self._configure(self._capture),
                "limits": to_plain(options.limits),
            }
            self._period_s = self._pace()
            self.read()
        except BaseException:
            self.close()
            raise

    def read(self) -> Frame:
        """A picture whose exposure began after this call.

        Frames are thrown away until as many are gone as a driver may hold back, and the time is over that a frame
        that was under way at the call needs to arrive: one period of exposure, one of transfer, and one more because
        arrivals are seen late. Where the system gives a frame's time, that must lie a period after the call too.

        Returns:
            uint8, shape (height, width, 3), BGR, or (height, width).

        Raises:
            DeviceLostError: The camera gives no frames any more.
            SensorError: The frames are dark, blurred, stuck or of another size.
        """
        faults: tuple[str, ...] = ()
        for _ in range(1 + _GLITCHES):
            image = self._fresh()
            faults = frame_faults(image, self._previous, self._options.limits)
            self._previous = image
            if not faults:
                return image
        raise SensorError(f"{self.name}: {_GLITCHES + 1} frames in a row are {' and '.join(faults)}; {_help(faults)}")

    def close(self) -> None:
        """Let go of the camera. Never raises; a second call does nothing."""
        capture, self._capture = self._capture, None
        if capture is not None:
            capture.release()

    def _fresh(self) -> NDArray[Any]:
        asked = self._now_s()
        grabbed = 0
        while True:
            self._grab()
            grabbed += 1
            now = self._now_s()
            if (
                grabbed > _BUFFERED
                and now >= asked + _PERIODS * self._period_s
                and self._time_s(now) >= (asked + self._period_s)
            ):
                return self._retrieve()
            if now > asked + _TIMEOUT_S:
                raise SensorError(
                    f"{self.name}: no fresh frame within {_TIMEOUT_S:g} s ({grabbed} old ones); unplug it and plug it "
                    "in again"
                )

    def _time_s(self, now_s: float) -> float:
        """When the last frame arrived by the system's own stamp; now, where it gives none that can be true."""
        stamp = self._open.get(_TIME_MS) * 1e-3
        # Of a stamp of another clock (a file's position, the time of day, 0) nothing follows.
        return stamp if now_s - _OLDEST_S < stamp <= now_s else now_s

    def _grab(self) -> None:
        """Wait for the next frame, without decoding it. OpenCV itself gives up after ten seconds (Video4Linux).

        Raises:
            DeviceLostError: There is none.
        """
        if not self._open.grab():
            raise DeviceLostError(f"{self.name}: gives no frames any more; is it still plugged in?")

    def _retrieve(self) -> NDArray[Any]:
        ok, image = self._open.retrieve()
        if not ok or image is None:
            raise SensorError(f"{self.name}: a frame could not be decoded; is the cable or the hub too slow?")
        whole = (self._options.height, self._options.width)
        if image.dtype != np.uint8 or image.shape[:2] != whole or image.shape[2:] not in ((), (3,)):
            raise SensorError(
                f"{self.name}: a frame has shape {image.shape}, {image.dtype}; asked was {self.shape}, uint8"
            )
        if self._options.colour:
            return image if image.ndim == 3 else np.repeat(image[..., None], 3, axis=2)
        return image if image.ndim == 2 else _grey(image)

    @property
    def _open(self) -> Capture:
        if self._capture is None:
            raise DeviceLostError(f"{self.name}: is closed")
        return self._capture

    def _configure(self, capture: Capture) -> dict[str, float]:
        """Set what was asked for and read it back.

        Returns:
            What the device says that it has.

        Raises:
            SensorError: It has something else.
        """
        requested = self._options.requested
        for prop, off, setting in _AUTOMATISMS:
            if setting in requested:
                capture.set(prop, off)
        for setting, value in requested.items():
            capture.set(_PROPERTIES[setting], value)
        # OpenCV's answer to a request only says that it was sent on; what counts is what the device reads afterwards.
        actual = {setting: float(capture.get(_PROPERTIES[setting])) for setting in requested}
        for setting, value in requested.items():
            if not abs(actual[setting] - value) <= _CLOSE * abs(value):
                raise SensorError(
                    f"{self.name}: {setting} = {value:g} was asked for, the device has {actual[setting]:g}; choose a "
                    "value that it obeys, or leave the setting out if the device has none"
                )
        for prop, off, setting in _AUTOMATISMS:
            state = float(capture.get(prop))
            # A device without this automatism reads 0 or -1.
            if setting in requested and state not in (off, 0.0, -1.0):
                raise SensorError(f"{self.name}: automatic {setting.replace('_', ' ')} stays on ({state:g})")
        if "focus" not in requested and float(capture.get(_AUTOFOCUS)) == 1.0:
            raise SensorError(f"{self.name}: its focus is automatic; give [sensor] focus a fixed value")
        return actual

    def _pace(self) -> float:
        """Seconds between two frames: measured, or as the camera says if that is longer."""
        times = []
        for _ in range(_BUFFERED + _PACE_FRAMES):
            self._grab()
            times.append(self._now_s())
        measured = float(np.median(np.diff(times[_BUFFERED:])))
        said = float(self._open.get(_FPS))
        return max(measured, 1.0 / said if 1.0 <= said <= 1000.0 else 0.0)


def open_camera(settings: SensorSettings, opener: Opener | None = None) -> CameraSensor:
    """Open the camera that ``[sensor]`` describes.

    Raises:
        InputError: A setting is not allowed, or the device is not named as it must be.
        RigError: The camera fails.
    """
    options = from_plain(CameraOptions, settings.options, "[sensor] ")
    return CameraSensor(chosen_camera(settings.device), options, opener=opener)


def _grey(image: NDArray[Any]) -> NDArray[Any]:
    """Grey of a BGR image by BT.601, uint8."""
    weighted = image.astype(np.float32) @ np.array([0.114, 0.587, 0.299], dtype=np.float32)
    return np.rint(weighted).astype(np.uint8)


def _help(faults: tuple[str, ...]) -> str:
    """What a person can do about it."""
    if "stuck" in faults:
        return "the camera froze: unplug it and plug it in again"
    if "dark" in faults:
        return "is the sensor's light on, and the exposure long enough?"
    return "is the lens in focus? For a sensor without markers set [sensor] blur_px = 0"
