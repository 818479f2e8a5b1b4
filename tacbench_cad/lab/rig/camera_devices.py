"""Names of cameras, and opening a camera. Stable names are required, since camera numbers change with every restart.

A recording or a network stream is refused as a device, since its frames are unrelated to the press. Tests pass their
own :class:`Capture` to the code that reads a camera.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

from tacbench_cad.lab.rig.errors import DeviceLostError
from tacbench_cad.util.errors import InputError, MissingToolError
from tacbench_cad.util.packages import quiet_opencv

#: The folders with Linux's stable names of cameras: by manufacturer and serial number, or by USB socket.
STABLE_FOLDERS = (Path("/dev/v4l/by-id"), Path("/dev/v4l/by-path"))
#: A camera has several device nodes. The first delivers pictures, the others metadata.
_PICTURES = "-video-index0"


class Capture(Protocol):
    """The part of ``cv2.VideoCapture`` that the lab uses."""

    def isOpened(self) -> bool:  # noqa: N802 (OpenCV's name)
        """Return whether the camera is open."""

    def set(self, prop: int, value: float, /) -> bool:
        """Request a setting. Only :meth:`get` shows whether the camera accepted it."""

    def get(self, prop: int, /) -> float:
        """Return the present value of a setting."""

    def grab(self) -> bool:
        """Take the next frame; return False if none came."""

    def retrieve(self) -> tuple[bool, Any]:
        """Return whether the last frame could be decoded, and the frame: BGR uint8 (height, width, 3)."""

    def release(self) -> None:
        """Close the camera."""


#: A function that opens a camera by its name.
Opener = Callable[[str], Capture]


def open_capture(device: str) -> Capture:
    """Open a device through OpenCV.

    Args:
        device: A path below ``/dev``, or a number as text.

    Raises:
        DeviceLostError: There is no such device.
        MissingToolError: OpenCV is not installed.
    """
    try:
        import cv2
    except ImportError:
        raise MissingToolError("a camera needs OpenCV: pip install tacbench-cad[lab]") from None
    quiet_opencv()
    # Not every build of OpenCV opens a camera by its path, but every build does by its number.
    number = re.fullmatch(r"(?:/dev/video)?(\d{1,4})", device if device.isdecimal() else str(Path(device).resolve()))
    if number is None or (device.startswith("/dev/") and not Path(device).exists()):
        raise DeviceLostError(f"camera {device}: does not exist; `tacbench rig probe` lists the connected cameras")
    return cv2.VideoCapture(int(number[1]), cv2.CAP_V4L2 if sys.platform.startswith("linux") else cv2.CAP_ANY)


def cameras(folders: tuple[Path, ...] = STABLE_FOLDERS) -> tuple[str, ...]:
    """Return a stable name for each connected camera, by id if it has one. Linux only."""
    names: dict[Path, str] = {}
    for folder in folders:
        for link in sorted(folder.glob(f"*{_PICTURES}")):
            names.setdefault(link.resolve(), str(link))
    return tuple(sorted(names.values()))


def chosen_camera(device: str | None, folders: tuple[Path, ...] = STABLE_FOLDERS) -> str:
    """Choose the device to open.

    Args:
        device: The value of ``[sensor] device``: a path in ``/dev/v4l/by-id``, the last part of such a path, or a
            number if the system has no stable names; None for the only camera.
        folders: The folders with the stable names.

    Raises:
        InputError: The device is a recording or a stream, it is an unstable name of a camera that also has a stable
            one, or it is None and the number of cameras is not one.
    """
    known = cameras(folders)
    listed = "; cameras here: " + (", ".join(known) if known else "none with a stable name")
    if device is None:
        if len(known) != 1:
            raise InputError("[sensor] device", None, f"is required unless exactly one camera is connected{listed}")
        return known[0]
    if device.isdecimal() or device.startswith("/dev/video"):
        node = Path(f"/dev/video{device}" if device.isdecimal() else device)
        stable = next((name for name in known if Path(name).resolve() == node.resolve()), None)
        if stable is not None:
            raise InputError("[sensor] device", device, f"may be another camera after a restart; use {stable!r}")
        return device
    inside = [folder / device for folder in folders if (folder / device).exists()]
    if device.startswith("/dev/") or inside:
        return str(inside[0]) if inside else device
    what = "is not a camera" if "://" not in device and not Path(device).suffix else "is a recording or a stream"
    raise InputError(
        "[sensor] device", device, f"{what}; name a connected camera by its link in /dev/v4l/by-id/{listed}"
    )
