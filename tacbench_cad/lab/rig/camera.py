"""A camera as a sensor, through OpenCV: checked settings, and frames whose exposure began after the request.

Cameras deliver buffered frames, ignore settings, freeze, and return with another frame size. OpenCV reports none of
this, so this module reads every setting back and checks every frame.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from tacbench_cad.lab.rig.camera_devices import Capture, Opener, chosen_camera, open_capture
from tacbench_cad.lab.rig.colours import INSIDE
from tacbench_cad.lab.rig.errors import DeviceLostError, RigError
from tacbench_cad.lab.rig.frames import FrameLimits, frame_faults
from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.rig.stage import Closing
from tacbench_cad.lab.study.spec import SensorSettings
from tacbench_cad.util.convert import from_plain, to_plain
from tacbench_cad.util.errors import InputError

#: The number of frames that a driver may buffer: four on Linux, and one that is being filled.
_BUFFERED = 5
#: The number of frame periods after which a new frame must have begun after the call.
_PERIODS = 3.0
#: The longest wait for a new frame without faults, in s.
_TIMEOUT_S = 10.0
#: The largest plausible age of a frame by its time stamp, in s; longer than the longest wait.
_OLDEST_S = 60.0
#: The number of consecutive faulty frames that are skipped, since the cable may cause single errors.
_GLITCHES = 2
#: The number of frames from which the frame period is measured when the camera is opened.
_PACE_FRAMES = 12
#: The settings that must not change by themselves during a run.
_LOCKED = ("exposure", "gain", "white_balance", "focus")
#: The allowed relative difference between a requested and an actual setting. Cameras round to their own steps.
_CLOSE = 0.01

# OpenCV's property numbers (cv2.CAP_PROP_*). The module imports cv2 only when it opens a camera.
_TIME_MS, _FPS, _AUTOFOCUS = 0, 5, 39
_PROPERTIES = {"width": 3, "height": 4, "fps": _FPS, "focus": 28, "gain": 14, "white_balance": 45, "exposure": 15}
#: The property of each automatic control, its value for "off", and the setting that it would override. The value for
#: manual exposure depends on the system: Video4Linux has a menu, Windows a fraction.
_AUTOMATISMS = (
    (_AUTOFOCUS, 0.0, "focus"),
    (44, 0.0, "white_balance"),
    (21, 1.0 if sys.platform.startswith("linux") else 0.25, "exposure"),
)


@dataclass(frozen=True, kw_only=True)
class CameraOptions:
    """The options of a camera in ``[sensor]``.

    Args:
        exposure: The exposure in the camera's own unit (usually 0.1 ms on Linux). It is required for a camera without a
            driver of its own, since with automatic exposure the brightness would change with the contact.
        width: The width of a frame in pixels.
        height: The height of a frame in pixels.
        fps: Frames per second; None for the camera's default.
        focus: The focus in the camera's own unit; None for a lens that is focused by hand.
        gain: The gain in the camera's own unit; None leaves it unchanged.
        white_balance: The colour temperature in kelvin; None keeps the present one.
        colour: Whether frames are (height, width, 3) or grey (height, width).
        dark_counts: See :class:`~tacbench_cad.lab.rig.frames.FrameLimits`.
        blur_px: See :class:`~tacbench_cad.lab.rig.frames.FrameLimits`.
    """

    exposure: float | None = None
    width: Annotated[int, Interval(ge=8, le=20_000)] = 640
    height: Annotated[int, Interval(ge=8, le=20_000)] = 480
    fps: float | None = None
    focus: float | None = None
    gain: float | None = None
    white_balance: float | None = None
    colour: bool = True
    dark_counts: Annotated[float, Interval(ge=0.0, le=255.0)] = FrameLimits.dark_counts
    blur_px: Annotated[float, Interval(ge=0.0, le=1000.0)] = FrameLimits.blur_px

    @property
    def limits(self) -> FrameLimits:
        """The limits beyond which a frame is dark or blurred."""
        return FrameLimits(dark_counts=self.dark_counts, blur_px=self.blur_px)

    @property
    def requested(self) -> dict[str, float]:
        """The settings that the device must accept."""
        return {name: getattr(self, name) for name in _PROPERTIES if getattr(self, name) is not None}


class CameraSensor(Closing):
    """A camera that takes one picture per request. See :class:`tacbench_cad.lab.rig.sensor.Sensor`.

    Args:
        device: The camera's stable name, or its number if the system has no stable names.
        options: The settings of the camera.
        name: The camera, for people and for ``run.json``; None for the name of the device.
        extra: Other settings by their names: the number of OpenCV's property and the requested value.
        opener: Opens the device; tests pass their own.
        now_s: Returns the real time in seconds, never decreasing.

    Raises:
        RigError: The camera does not open, does not accept a setting, or delivers only faulty frames.
    """

    units = "counts"
    channels = INSIDE
    simulated = ""

    def __init__(
        self,
        device: str,
        options: CameraOptions,
        *,
        name: str | None = None,
        extra: Mapping[str, tuple[int, float]] | None = None,
        opener: Opener | None = None,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self.name = name or f"camera {device}"
        self.shape: tuple[int, ...] = (options.height, options.width, 3)[: 3 if options.colour else 2]
        self._device = device
        self._options = options
        self._now_s = now_s
        self._extra = dict(extra or {})
        self._previous: NDArray[Any] | None = None
        self._capture: Capture | None = (opener or open_capture)(device)
        try:
            if not self._capture.isOpened():
                raise DeviceLostError(
                    f"{self.name}: cannot be opened; check that it is plugged in and not in use by another program"
                )
            self.settings: dict[str, Any] = {
                "requested": {**self._requested, "colour": options.colour},
                "actual": self._configure(self._capture),
                "limits": to_plain(options.limits),
            }
            present = {setting: self._capture.get(_PROPERTIES[setting]) for setting in _LOCKED}
            self._locked = {setting: value for setting, value in present.items() if value not in (0.0, -1.0)}
            self._period_s = self._pace()
            #: The age of the last picture of :meth:`grab`, with an error of about half a period.
            self.frame_age_s = self._period_s
            self.read()
        except BaseException:
            self.close()
            raise

    def read(self) -> Frame:
        """Take a picture whose exposure began after this call.

        The method discards as many frames as a driver may buffer. It then waits until a frame that was in progress at
        the call has certainly arrived: one period for exposure, one for transfer, and one because arrivals are seen
        late. If the system reports the time of a frame, that time must also be at least one period after the call.

        Returns:
            uint8, shape (height, width, 3), BGR, or (height, width).

        Raises:
            DeviceLostError: The camera no longer delivers frames.
            RigError: The frames are dark, blurred or stuck, or have another size, or the camera has changed one of
                its settings by itself.
        """
        return self._good(self._fresh)

    def grab(self) -> Callable[[], Frame]:
        """Take the next picture of the camera while the sensor moves; see :class:`tacbench_cad.lab.rig.sensor.Sensor`.

        The pictures follow each other at the camera's own rate, since no buffered frame is discarded.

        Raises:
            RigError: Same as for :meth:`read`.
        """
        image = self._good(self._next)
        return lambda: image

    def _good(self, take: Callable[[], NDArray[Any]]) -> NDArray[Any]:
        """Take pictures until one has no fault."""
        faults: tuple[str, ...] = ()
        for _ in range(1 + _GLITCHES):
            image = take()
            faults = frame_faults(image, self._previous, self._options.limits)
            self._previous = image
            if not faults:
                self._require_unchanged()
                return image
        raise RigError(f"{self.name}: {_GLITCHES + 1} frames in a row are {' and '.join(faults)}; {_help(faults)}")

    def close(self) -> None:
        """Close the camera. Never raises; a second call has no effect."""
        capture, self._capture = self._capture, None
        if capture is not None:
            capture.release()

    def _next(self) -> NDArray[Any]:
        self._grab()
        now_s = self._now_s()
        # A frame arrives about half a period after the end of its exposure, which takes up to a period.
        self.frame_age_s = now_s - self._time_s(now_s) + self._period_s
        return self._retrieve()

    def _fresh(self) -> NDArray[Any]:
        requested_s = self._now_s()
        grabbed = 0
        while True:
            self._grab()
            grabbed += 1
            now = self._now_s()
            if (
                grabbed > _BUFFERED
                and now >= requested_s + _PERIODS * self._period_s
                and self._time_s(now) >= (requested_s + self._period_s)
            ):
                return self._retrieve()
            if now > requested_s + _TIMEOUT_S:
                raise RigError(
                    f"{self.name}: no new frame within {_TIMEOUT_S:g} s ({grabbed} old ones); unplug it and plug it "
                    "in again"
                )

    def _time_s(self, now_s: float) -> float:
        """Return the arrival time of the last frame by the system's stamp, or now if the stamp is implausible."""
        stamp = self._open.get(_TIME_MS) * 1e-3
        # A stamp of another clock (position in a file, time of day, 0) says nothing about the arrival.
        return stamp if now_s - _OLDEST_S < stamp <= now_s else now_s

    def _grab(self) -> None:
        """Wait for the next frame, without decoding it. OpenCV itself stops waiting after ten seconds (Video4Linux).

        Raises:
            DeviceLostError: No frame arrived.
        """
        if not self._open.grab():
            raise DeviceLostError(f"{self.name}: no longer delivers frames; check that it is plugged in")

    def _retrieve(self) -> NDArray[Any]:
        ok, image = self._open.retrieve()
        if not ok or image is None:
            raise RigError(f"{self.name}: a frame could not be decoded; check the cable and the USB hub")
        size = (self._options.height, self._options.width)
        if image.dtype != np.uint8 or image.shape[:2] != size or image.shape[2:] not in ((), (3,)):
            raise RigError(
                f"{self.name}: a frame has shape {image.shape}, {image.dtype}; requested was {self.shape}, uint8"
            )
        if self._options.colour:
            return image if image.ndim == 3 else np.repeat(image[..., None], 3, axis=2)
        return image if image.ndim == 2 else _grey(image)

    @property
    def _open(self) -> Capture:
        if self._capture is None:
            raise DeviceLostError(f"{self.name}: is closed")
        return self._capture

    def _require_unchanged(self) -> None:
        """Check the settings that were locked when the camera was opened.

        Raises:
            RigError: The camera has changed a setting by itself.
        """
        for setting, value in self._locked.items():
            now = self._open.get(_PROPERTIES[setting])
            if not abs(now - value) <= _CLOSE * abs(value):
                shown = setting.replace("_", " ")
                raise RigError(
                    f"{self.name}: the {shown} was {value:g} and is now {now:g}; the camera or another program changed "
                    f"it. Set [sensor] {setting} to a fixed value, and close other programs that use the camera"
                )

    @property
    def _requested(self) -> dict[str, float]:
        return {**self._options.requested, **{name: value for name, (_, value) in self._extra.items()}}

    def _configure(self, capture: Capture) -> dict[str, Any]:
        """Switch automatic controls off, apply the requested settings and read them back.

        Returns:
            The settings that the device reports. ``automatic`` lists the controls that it does not switch off.

        Raises:
            RigError: The device reports another value.
        """
        requested = self._requested
        properties = {**_PROPERTIES, **{name: prop for name, (prop, _) in self._extra.items()}}
        for prop, off, setting in _AUTOMATISMS:
            if setting != "focus" or setting in requested:
                capture.set(prop, off)
        for setting, value in requested.items():
            capture.set(properties[setting], value)
        # OpenCV's return value only tells that the request was sent. Only the value that is read back counts.
        actual: dict[str, Any] = {setting: float(capture.get(properties[setting])) for setting in requested}
        for setting, value in requested.items():
            if not abs(actual[setting] - value) <= _CLOSE * abs(value):
                raise RigError(
                    f"{self.name}: {setting} = {value:g} was requested, but the device has {actual[setting]:g}; choose "
                    "a value that the device supports, or omit the setting if the device does not have it"
                )
        automatic = []
        for prop, off, setting in _AUTOMATISMS:
            state = float(capture.get(prop))
            # A device without this automatic control returns 0 or -1.
            if state in (off, 0.0, -1.0):
                continue
            if setting in requested:
                raise RigError(f"{self.name}: automatic {setting.replace('_', ' ')} cannot be switched off ({state:g})")
            automatic.append(setting)
        if "focus" not in requested and float(capture.get(_AUTOFOCUS)) == 1.0:
            raise RigError(f"{self.name}: the focus is automatic; set [sensor] focus to a fixed value")
        for setting in _LOCKED:
            if setting not in actual and (present := float(capture.get(_PROPERTIES[setting]))) not in (0.0, -1.0):
                actual[setting] = present
        return actual | ({"automatic": automatic} if automatic else {})

    def _pace(self) -> float:
        """Return the frame period in s: the measured one, or the camera's own value if that is longer."""
        times = []
        for _ in range(_BUFFERED + _PACE_FRAMES):
            self._grab()
            times.append(self._now_s())
        measured = float(np.median(np.diff(times[_BUFFERED:])))
        reported_fps = float(self._open.get(_FPS))
        return max(measured, 1.0 / reported_fps if 1.0 <= reported_fps <= 1000.0 else 0.0)


def open_camera(settings: SensorSettings, opener: Opener | None = None) -> CameraSensor:
    """Open the camera that ``[sensor]`` describes.

    Raises:
        InputError: A setting is not allowed, or the name of the device is not.
        RigError: The camera fails.
    """
    options = from_plain(CameraOptions, settings.options, "[sensor] ")
    if options.exposure is None:
        raise InputError(
            "[sensor] exposure", None, "is missing; a fixed exposure is required, in the camera's own unit"
        )
    return CameraSensor(chosen_camera(settings.device), options, opener=opener)


def _grey(image: NDArray[Any]) -> NDArray[Any]:
    """Convert a BGR image to grey by BT.601, uint8."""
    weighted = image.astype(np.float32) @ np.array([0.114, 0.587, 0.299], dtype=np.float32)
    return np.rint(weighted).astype(np.uint8)


def _help(faults: tuple[str, ...]) -> str:
    """Return advice for the user."""
    if "stuck" in faults:
        return "the camera is frozen: unplug it and plug it in again"
    if "dark" in faults:
        return "check that the sensor's light is on and that the exposure is long enough"
    return "check the focus of the lens; for a sensor without markers set [sensor] blur_px = 0"
