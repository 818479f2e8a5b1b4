"""Which camera, and opening it. Names that stay the same are asked for: numbers change with every restart.

A recording or a network stream is refused as a device: its frames know nothing of the press. Tests of what reads a
camera give a :class:`Capture` of their own.
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

#: Where Linux keeps names of cameras that stay the same: by maker and serial number, or by the socket they are in.
STABLE_FOLDERS = (Path("/dev/v4l/by-id"), Path("/dev/v4l/by-path"))
#: A camera offers several nodes; the first one gives pictures, the others descriptions of them.
_PICTURES = "-video-index0"


class Capture(Protocol):
    """What is used of ``cv2.VideoCapture``."""

    def isOpened(self) -> bool:  # noqa: N802 (OpenCV's name)
        """Whether the camera is there."""

    def set(self, prop: int, value: float, /) -> bool:
        """Ask for a setting. What comes of it is known only by :meth:`get`."""

    def get(self, prop: int, /) -> float:
        """A setting as it is now."""

    def grab(self) -> bool:
        """Take the next frame; False where none came."""

    def retrieve(self) -> tuple[bool, Any]:
        """The frame that was taken last, BGR uint8 (height, width, 3), and whether it could be read."""

    def release(self) -> None:
        """Let go of the camera."""


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
    # Not every build of OpenCV opens a camera by its path, every one does by its number.
    number = re.fullmatch(r"(?:/dev/video)?(\d{1,4})", device if device.isdecimal() else str(Path(device).resolve()))
    if number is None or (device.startswith("/dev/") and not Path(device).exists()):
        raise DeviceLostError(f"camera {device}: is not there; `tacbench rig probe` lists those that are")
    return cv2.VideoCapture(int(number[1]), cv2.CAP_V4L2 if sys.platform.startswith("linux") else cv2.CAP_ANY)


def cameras(folders: tuple[Path, ...] = STABLE_FOLDERS) -> tuple[str, ...]:
    """Stable names of the cameras that are plugged in: one for each, by id where it has one. Linux only."""
    names: dict[Path, str] = {}
    for folder in folders:
        for link in sorted(folder.glob(f"*{_PICTURES}")):
            names.setdefault(link.resolve(), str(link))
    return tuple(sorted(names.values()))


def chosen_camera(device: str | None, folders: tuple[Path, ...] = STABLE_FOLDERS) -> str:
    """The device to open.

    Args:
        device: What ``[sensor] device`` says: a path in ``/dev/v4l/by-id``, the last part of one, or a number where
            the system has no stable names; None to take the only camera there is.
        folders: Where the stable names are.

    Raises:
        InputError: It is a recording or a stream, an unstable name of a camera that has a stable one, or it is not
            given and there is not exactly one camera.
    """
    known = cameras(folders)
    listed = "; cameras here: " + (", ".join(known) if known else "none with a stable name")
    if device is None:
        if len(known) != 1:
            raise InputError("[sensor] device", None, f"is missing, and there is not exactly one camera{listed}")
        return known[0]
    if device.isdecimal() or device.startswith("/dev/video"):
        node = Path(f"/dev/video{device}" if device.isdecimal() else device)
        stable = next((name for name in known if Path(name).resolve() == node.resolve()), None)
        if stable is not None:
            raise InputError("[sensor] device", device, f"may be another camera after a restart; write {stable!r}")
        return device
    inside = [folder / device for folder in folders if (folder / device).exists()]
    if device.startswith("/dev/") or inside:
        return str(inside[0]) if inside else device
    what = "names no camera" if "://" not in device and not Path(device).suffix else "is a recording or a stream"
    raise InputError(
        "[sensor] device", device, f"{what}; name a camera that is plugged in, as in /dev/v4l/by-id/{listed}"
    )
