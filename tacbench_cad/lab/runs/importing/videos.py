"""Import of frames of videos, with a table of their times."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacbench_cad.lab.runs.importing.images import name_fault
from tacbench_cad.lab.runs.importing.samples import LeftOut, Loaded, Rows, Sample, Source
from tacbench_cad.util import door
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.packages import require

#: The suffixes of videos.
SUFFIXES = (".mp4", ".avi", ".mov", ".mkv", ".m4v", ".mpg", ".mpeg", ".webm")


class Video:
    """A video whose frames are read in order. Reading an earlier frame opens the video again.

    Args:
        path: The file.

    Raises:
        InputError: The file cannot be read.
        MissingToolError: OpenCV is not installed.
    """

    def __init__(self, path: Path) -> None:
        require("the import of videos", "cv2")
        self.path = path
        self._lock = threading.Lock()
        door.open_input(path, "video", kind="array").close()
        self._open()
        import cv2

        self.frames_per_s = float(self._capture.get(cv2.CAP_PROP_FPS))
        if not 0.0 < self.frames_per_s < 1e5:
            raise InputError("video", str(path), "does not state its number of frames per second")

    def _open(self) -> None:
        import cv2

        self._capture = cv2.VideoCapture(str(self.path.absolute()))
        self._next = 0
        if not self._capture.isOpened():
            raise InputError("video", str(self.path), "is not a video that OpenCV can read")

    def frame(self, time_s: float) -> NDArray[Any]:
        """Return the frame at a time, in s: uint8, (height, width, 3), BGR.

        Raises:
            CheckFailedError: The video is shorter, or is damaged.
        """
        index = int(time_s * self.frames_per_s + 1e-6)
        with self._lock:
            if index < self._next:
                self._open()
            while self._next < index and self._capture.grab():
                self._next += 1
            read, image = self._capture.read() if self._next == index else (False, None)
            if not read or image is None:
                seconds = self._next / self.frames_per_s
                raise CheckFailedError(f"has no frame at {time_s:g} s; it can be read up to {seconds:.6g} s")
            self._next += 1
            return np.asarray(image)


def of_videos(paths: Sequence[Path], table: Path | None, columns: Mapping[str, str]) -> Source:
    """Read the frames of videos at the times in a table.

    Args:
        paths: The videos. If there is no path, the videos are in the folder of the table, and its column ``video`` has
            their names.
        table: The table.
        columns: The columns, by field.

    Raises:
        InputError: There is no table, or it has no column of times. There are several videos, and the table has no
            column with their names.
    """
    first = str(paths[0]) if paths else ""
    if table is None:
        raise InputError("video", first, "needs a table of times; also give a CSV file with a row for each frame")
    rows = Rows.read(table, columns)
    if "time" not in rows.columns:
        raise InputError("table", str(table), "has no column of times in seconds; choose it with --columns time=COLUMN")
    if "video" not in rows.columns and len(paths) != 1:
        raise InputError("table", str(table), "has no column of videos; choose it with --columns video=COLUMN")
    named = {path.name: path for path in paths}
    videos: dict[Path, Video | InputError] = {}
    samples: list[Sample] = []
    left_out: list[LeftOut] = []
    for row, fields in rows.rows:
        name, text = fields.pop("video", first), fields.pop("time", "")
        shown = f"{Path(name).name} at {text} s"
        path = paths[0] if "video" not in rows.columns else named.get(name, table.parent / name)
        try:
            fault = "" if path in paths else name_fault(name, "video")
            time_s = _seconds(text)
            if fault:
                raise InputError("video", name, fault)
            if path not in videos:
                videos[path] = _video(path)
            video = videos[path]
            if isinstance(video, InputError):
                raise video
        except InputError as error:
            left_out.append(LeftOut(where=f"{row} ({shown})", reason=str(error)))
            continue
        load: Callable[[], Loaded] = partial(video.frame, time_s)
        samples.append(Sample(name=shown, row=row, fields=fields, load=load))
    return Source(
        kind="videos with a table of times",
        path=table,
        samples=samples,
        left_out=tuple(left_out),
        files=tuple(path for path, video in videos.items() if isinstance(video, Video)),
        facts={"columns": dict(rows.columns)},
        notes=(rows.note,),
    )


def _video(path: Path) -> Video | InputError:
    try:
        return Video(path)
    except InputError as error:
        return error


def _seconds(text: str) -> float:
    try:
        seconds = float(text)
    except ValueError:
        seconds = -1.0
    if not 0.0 <= seconds < 1e7:
        raise InputError("time", text, "must be a number of seconds from the beginning of the video")
    return seconds
