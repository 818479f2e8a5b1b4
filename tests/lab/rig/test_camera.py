"""Test the camera driver against the faults of real cameras: buffers, ignored settings, freezing and darkness."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tacbench_cad.lab.rig.camera import CameraOptions, CameraSensor, open_camera
from tacbench_cad.lab.rig.camera_devices import cameras, chosen_camera
from tacbench_cad.lab.rig.errors import DeviceLostError, RigError
from tacbench_cad.lab.rig.sensor import Sensor, is_image
from tacbench_cad.lab.study.spec import SensorSettings
from tacbench_cad.util.convert import from_plain
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Bytes

links_only = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no names of cameras")

BUFFERS = 4


def picture(seed: int, width: int = 640, height: int = 480, light: int = 200) -> Bytes:
    """Return bright squares on a dark background with read noise, shape (height, width, 3)."""
    noise = np.random.default_rng(seed).integers(0, 4, (height, width, 3), dtype=np.uint8)
    image = np.zeros((height, width, 3), dtype=np.uint8)
    for row in range(8, height - 16, 32):
        for column in range(8, width - 16, 32):
            image[row : row + 8, column : column + 8] = light
    return image + noise


@dataclass
class Time:
    """A clock that only advances when somebody waits."""

    now: float = 100.0

    def __call__(self) -> float:
        return self.now


@dataclass
class FakeCapture:
    """A replacement of ``cv2.VideoCapture`` for a camera that exposes a frame in every period.

    Frame k is exposed from k to k + 1 periods and arrives one period later. The operating system's driver keeps the
    first four unread frames and drops later ones.
    """

    time: Time
    period_s: float = 1.0 / 30.0
    obeys: bool = True
    ignores: tuple[int, ...] = ()
    stamps: bool = True
    opened: bool = True
    alter: Callable[[int, Bytes], Any] = lambda frame, image: image
    properties: dict[int, float] = field(default_factory=dict)
    unplugged_at: float = float("inf")
    released: int = 0
    #: The start of the exposure of the last read frame, in s.
    exposed_at: float = 0.0
    _held: list[int] = field(default_factory=list)
    _next: int = 0
    _taken: int = 0

    def __post_init__(self) -> None:
        self.properties = {3: 640.0, 4: 480.0, 5: 30.0, 15: 156.0, 21: 3.0, 28: 0.0, 39: 0.0, 44: 1.0} | self.properties
        self._next = round(self.time.now / self.period_s)

    def isOpened(self) -> bool:  # noqa: N802
        return self.opened

    def set(self, prop: int, value: float) -> bool:
        if prop not in self.ignores:
            self.properties[prop] = value
        return True

    def get(self, prop: int) -> float:
        if prop == 0:
            return 1000.0 * (self._taken + 2) * self.period_s if self.stamps else 0.0
        return self.properties.get(prop, -1.0)

    def _fill(self) -> None:
        while (self._next + 2) * self.period_s <= self.time.now:
            if len(self._held) < BUFFERS:
                self._held.append(self._next)
            self._next += 1

    def grab(self) -> bool:
        if self.time.now >= self.unplugged_at:
            return False
        self._fill()
        if not self._held:
            self.time.now = (self._next + 2) * self.period_s + 1e-9
            self._fill()
        self._taken = self._held.pop(0)
        self.exposed_at = self._taken * self.period_s
        self.time.now += 0.0005
        return True

    def retrieve(self) -> tuple[bool, Any]:
        image = self.alter(self._taken, picture(self._taken % 1000))
        return (image is not None, image)

    def release(self) -> None:
        self.released += 1


def camera(capture: FakeCapture, **options: Any) -> CameraSensor:
    chosen = from_plain(CameraOptions, {"exposure": 156} | options, "[sensor] ")
    return CameraSensor("cam", chosen, opener=lambda device: capture, now_s=capture.time)


@pytest.fixture
def fake() -> FakeCapture:
    return FakeCapture(Time())


def test_the_camera_is_a_sensor_whose_frames_are_images(fake: FakeCapture) -> None:
    with camera(fake) as sensor:
        assert isinstance(sensor, Sensor)
        image = sensor.read()
        assert image.shape == sensor.shape == (480, 640, 3) and is_image(image)
        assert (sensor.units, sensor.simulated) == ("counts", "")
    assert fake.released == 1
    sensor.close()
    assert fake.released == 1


@pytest.mark.parametrize("stamps", [True, False])
@pytest.mark.parametrize("period_s", [1 / 90, 1 / 30, 1 / 7.5])
@pytest.mark.parametrize("waited_s", [0.0, 0.013, 0.4, 60.0])
def test_the_exposure_of_a_frame_begins_after_the_request(stamps: bool, period_s: float, waited_s: float) -> None:
    fake = FakeCapture(Time(), period_s=period_s, stamps=stamps, properties={5: 0.0})
    sensor = camera(fake)
    for _ in range(5):
        fake.time.now += waited_s
        requested_at = fake.time.now
        sensor.read()
        assert fake.exposed_at >= requested_at


def test_an_overstated_frame_rate_is_measured() -> None:
    fake = FakeCapture(Time(), period_s=0.2, stamps=False, properties={5: 60.0})
    sensor = camera(fake)
    fake.time.now += 3.0
    requested_at = fake.time.now
    sensor.read()
    assert fake.exposed_at >= requested_at


def test_time_stamps_that_lag_far_behind_cause_an_error(fake: FakeCapture) -> None:
    sensor = camera(fake)
    start = fake.time.now
    fake.get = lambda prop: 1000.0 * (start - 1.0) if prop == 0 else fake.properties[prop]  # type: ignore[method-assign]
    with pytest.raises(RigError, match="no new frame within 10 s"):
        sensor.read()


def test_requested_and_actual_settings_are_stored(fake: FakeCapture) -> None:
    sensor = camera(fake, focus=40, gain=3.0, fps=30)
    requested = {"width": 640, "height": 480, "fps": 30.0, "focus": 40.0, "gain": 3.0, "exposure": 156.0}
    assert sensor.settings["requested"] == requested | {"colour": True} and sensor.settings["actual"] == requested
    assert sensor.settings["limits"] == {"dark_counts": 25.0, "blur_px": 3.0}
    assert fake.properties[39] == 0.0, "automatic focus must be off"


@pytest.mark.parametrize(
    ("ignored", "options", "message"),
    [
        (15, {"exposure": 50}, "exposure = 50 was requested, but the device has 156"),
        (28, {"focus": 40}, "focus = 40 was requested, but the device has 0"),
        (3, {"width": 1280}, "width = 1280 was requested, but the device has 640"),
        (45, {"white_balance": 4600}, "white_balance = 4600 was requested, but the device has -1"),
        (44, {"white_balance": 4600}, r"automatic white balance cannot be switched off \(1\)"),
        (21, {}, r"automatic exposure cannot be switched off \(3\)"),
    ],
)
def test_a_camera_that_does_not_obey_is_refused(
    fake: FakeCapture, ignored: int, options: dict[str, Any], message: str
) -> None:
    fake.ignores = (ignored,)
    with pytest.raises(RigError, match=message):
        camera(fake, **options)
    assert fake.released == 1


def test_automatic_focus_is_refused(fake: FakeCapture) -> None:
    fake.properties[39] = 1.0
    with pytest.raises(RigError, match="the focus is automatic"):
        camera(fake)


def test_a_frozen_camera_is_detected(fake: FakeCapture) -> None:
    sensor = camera(fake)
    still = picture(1)
    fake.alter = lambda frame, image: still
    with pytest.raises(RigError, match=r"3 frames in a row are stuck.*froze"):
        for _ in range(2):
            sensor.read()


def test_a_dark_camera_is_refused_at_the_start(fake: FakeCapture) -> None:
    fake.alter = lambda frame, image: picture(frame, light=5)
    with pytest.raises(RigError, match="in a row are dark; check that the sensor's light is on"):
        camera(fake)
    assert fake.released == 1


def test_a_single_bad_frame_is_ignored(fake: FakeCapture) -> None:
    sensor = camera(fake)
    bad = [True]
    fake.alter = lambda frame, image: np.zeros_like(image) if bad and bad.pop() else image
    assert sensor.read().max() >= 200 and bad == []


def test_blur_is_detected_unless_the_check_is_off(fake: FakeCapture) -> None:
    import cv2

    fake.alter = lambda frame, image: (
        np.random.default_rng(frame).integers(0, 3, image.shape, np.uint8) + (cv2.GaussianBlur(image, (0, 0), 5))
    )
    with pytest.raises(RigError, match="blurred; check the focus of the lens"):
        camera(fake)
    assert camera(fake, blur_px=0).read().shape == (480, 640, 3)


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (picture(1, 320, 240), r"shape \(240, 320, 3\), uint8; requested was \(480, 640, 3\)"),
        (picture(1).astype(np.uint16), "uint16"),
        (np.zeros((480, 640, 2), dtype=np.uint8), r"\(480, 640, 2\)"),
        (None, "could not be decoded"),
    ],
)
def test_a_frame_of_another_shape_or_type_is_refused(fake: FakeCapture, image: Any, message: str) -> None:
    sensor = camera(fake)
    fake.alter = lambda frame, frame_image: image
    with pytest.raises(RigError, match=message):
        sensor.read()


def test_an_unplugged_camera_causes_a_device_error(fake: FakeCapture) -> None:
    sensor = camera(fake)
    fake.unplugged_at = fake.time.now + 0.01
    fake.time.now += 0.1
    with pytest.raises(DeviceLostError, match="check that it is plugged in"):
        sensor.read()
    sensor.close()
    with pytest.raises(DeviceLostError, match="is closed"):
        sensor.read()


def test_grey_frames(fake: FakeCapture) -> None:
    sensor = camera(fake, colour=False)
    fake.alter = lambda frame, image: image * np.array([0, 1, 0], dtype=np.uint8)
    assert sensor.shape == (480, 640)
    image = sensor.read()
    assert image.shape == (480, 640) and image.dtype == np.uint8
    assert image.max() == pytest.approx(0.587 * 203, abs=1)


def test_a_grey_camera_returns_the_requested_shape(fake: FakeCapture) -> None:
    fake.alter = lambda frame, image: image[..., 0]
    assert camera(fake).read().shape == (480, 640, 3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, r"\[sensor\] exposure: is missing"),
        ({"exposure": "auto"}, "exposure = 'auto': must be a finite number"),
        ({"exposure": 5, "exposures": 5}, 'unknown key; did you mean "exposure"'),
        ({"exposure": 5, "width": 0}, "width = 0: must be at least 8"),
        ({"exposure": 5, "blur_px": -1}, "blur_px = -1"),
    ],
)
def test_wrong_settings_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        open_camera(SensorSettings(driver="opencv", options=options))


# --- names of cameras ---


@pytest.fixture
def devices(tmp_path: Path) -> tuple[Path, Path]:
    """Make the device files of two cameras, one with a name from its manufacturer, and of nodes without images."""
    by_id, by_path = tmp_path / "by-id", tmp_path / "by-path"
    for folder in (by_id, by_path):
        folder.mkdir()
    for node in ("video0", "video1", "video2"):
        (tmp_path / node).touch()
    (by_id / "usb-ELP_A1-video-index0").symlink_to(tmp_path / "video0")
    (by_id / "usb-ELP_A1-video-index1").symlink_to(tmp_path / "video1")
    (by_path / "pci-1-video-index0").symlink_to(tmp_path / "video0")
    return (by_id, by_path)


@links_only
def test_each_camera_is_listed_once_by_its_best_name(devices: tuple[Path, Path]) -> None:
    (name,) = cameras(devices)
    assert name.endswith("by-id/usb-ELP_A1-video-index0")
    (devices[1] / "pci-2-video-index0").symlink_to(devices[0].parent / "video2")
    assert len(cameras(devices)) == 2


@links_only
def test_a_single_camera_is_used_and_several_are_refused(devices: tuple[Path, Path]) -> None:
    assert chosen_camera(None, devices).endswith("usb-ELP_A1-video-index0")
    (devices[1] / "pci-2-video-index0").symlink_to(devices[0].parent / "video2")
    with pytest.raises(InputError, match=r"exactly one camera is connected; cameras here: .*usb-ELP.*pci-2"):
        chosen_camera(None, devices)
    with pytest.raises(InputError, match="none with a stable name"):
        chosen_camera(None, ())


@links_only
def test_a_number_is_refused_if_the_camera_has_a_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert chosen_camera("3", ()) == "3"
    assert chosen_camera("/dev/video3", ()) == "/dev/video3"
    folder = tmp_path / "by-id"
    folder.mkdir()
    (folder / "usb-X-video-index0").symlink_to("/dev/video3")
    for device in ("3", "/dev/video3"):
        with pytest.raises(InputError, match=r"another camera after a restart; use '.*usb-X-video-index0'"):
            chosen_camera(device, (folder,))


@pytest.mark.parametrize("device", ["film.mp4", "rtsp://host/stream", "http://host/a.mjpg"])
def test_a_recording_is_refused(device: str) -> None:
    with pytest.raises(InputError, match="is a recording or a stream"):
        chosen_camera(device, ())


@links_only
def test_a_missing_camera_causes_a_device_error() -> None:
    settings = SensorSettings(driver="opencv", device="/dev/v4l/by-id/usb-none-video-index0", options={"exposure": 5})
    with pytest.raises(DeviceLostError, match="does not exist"):
        open_camera(settings)


@pytest.mark.parametrize("stamps", [True, False])
def test_moving_frames_come_at_the_rate_of_the_camera_with_their_age(stamps: bool) -> None:
    fake = FakeCapture(Time(), stamps=stamps)
    with camera(fake) as sensor:
        sensor.read()
        exposed, errors = [], []
        for _ in range(12):
            frame = sensor.grab()
            middle_s = fake.exposed_at + fake.period_s / 2.0
            exposed.append(middle_s)
            errors.append(fake.time.now - sensor.frame_age_s - middle_s)
            assert is_image(frame())
        np.testing.assert_allclose(np.diff(exposed), fake.period_s)
        # The first frames can be buffered ones, whose age is unknown without time stamps.
        assert np.max(np.abs(errors[0 if stamps else 5 :])) < 0.6 * fake.period_s
