"""Import of frames of videos, with a table of their times.

The frame at a time is the frame whose own time is nearest, and the earlier one if two are equally near. The own time of
a frame is the time that the file states for it: the first frame is at 0 s, and frame ``n`` of a video with a constant
rate is at ``n`` divided by the rate.
"""

from __future__ import annotations

import threading
from bisect import bisect_left
from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacbench_cad.lab.runs import (
    ImportFormat,
    ImportOptions,
    LeftOutFile,
    Loaded,
    Paths,
    Rows,
    Sample,
    Source,
    name_fault,
)
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.packages import require
from tacbench_cad.util.untrusted import open_input

#: The largest number of times that the warning about times far from every frame names.
MAX_FAR = 5
#: The difference of two times that is only rounding, in s.
TIE_S = 1e-6
#: The suffixes of videos.
SUFFIXES = (".mp4", ".avi", ".mov", ".mkv", ".m4v", ".mpg", ".mpeg", ".webm")


class Video:
    """A video whose frames are read in order. Reading an earlier frame opens the video again.

    The times of the frames are read ahead, as far as they are needed.

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
        open_input(path, "video", kind="array").close()
        self._ahead: Any = self._opened()
        self._capture: Any = None
        self._next = 0
        self._times_s: list[float] = []
        import cv2

        self.frames_per_s = float(self._ahead.get(cv2.CAP_PROP_FPS))
        if not 0.0 < self.frames_per_s < 1e5:
            raise InputError("video", str(path), "does not state its number of frames per second")

    def _opened(self) -> Any:
        import cv2

        capture = cv2.VideoCapture(str(self.path.absolute()))
        if not capture.isOpened():
            raise InputError("video", str(self.path), "is not a video that OpenCV can read")
        return capture

    def nearest(self, time_s: float) -> tuple[int, float]:
        """Return the number of the frame that is nearest to a time in s, from 0, and its own time.

        Raises:
            InputError: The video ends more than one frame before this time.
        """
        import cv2

        times_s, period_s = self._times_s, 1.0 / self.frames_per_s
        while self._ahead is not None and (not times_s or times_s[-1] < time_s):
            if not self._ahead.grab():
                self._ahead = None
                break
            stated_s = self._ahead.get(cv2.CAP_PROP_POS_MSEC) / 1000.0
            # A file without times states 0 for every frame.
            times_s.append(stated_s if not times_s or stated_s > times_s[-1] else times_s[-1] + period_s)
        if not times_s or time_s > times_s[-1] + period_s:
            end = f"its last frame is at {times_s[-1]:.6g} s" if times_s else "no frame can be read"
            raise InputError("video", self.path.name, f"has no frame at {time_s:g} s; {end}")
        after = min(bisect_left(times_s, time_s), len(times_s) - 1)
        before = max(0, after - 1)
        index = before if time_s - times_s[before] <= times_s[after] - time_s + TIE_S else after
        return index, times_s[index]

    def frame(self, index: int) -> NDArray[Any]:
        """Return the frame with a number from 0: uint8, (height, width, 3), BGR.

        Raises:
            CheckFailedError: The video is damaged.
        """
        with self._lock:
            if self._capture is None or index < self._next:
                self._capture, self._next = self._opened(), 0
            while self._next < index and self._capture.grab():
                self._next += 1
            read, image = self._capture.read() if self._next == index else (False, None)
            if not read or image is None:
                raise CheckFailedError(f"frame {index} cannot be read; the file is damaged")
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
    opened = cache(Video)
    samples: list[Sample] = []
    left_out: list[LeftOutFile] = []
    far: list[str] = []
    for row, fields, texts in rows.rows:
        name, text = fields.pop("video", first), fields.pop("time", "")
        shown = f"{Path(name).name} at {text} s"
        path = paths[0] if "video" not in rows.columns else named.get(name, table.parent / name)
        try:
            fault = "" if path in paths else name_fault(name, "video")
            time_s = _seconds(text)
            if fault:
                raise InputError("video", name, fault)
            video = opened(path)
            index, own_s = video.nearest(time_s)
        except InputError as error:
            left_out.append(LeftOutFile(where=f"{row} ({shown})", reason=str(error)))
            continue
        if abs(time_s - own_s) > 0.5 / video.frames_per_s + TIE_S:
            far.append(f"{row}: {time_s:g} s, nearest frame at {own_s:.6g} s")
        load: Callable[[], Loaded] = partial(video.frame, index)
        samples.append(
            Sample(
                name=shown,
                row=row,
                fields=fields,
                load=load,
                file=path,
                index=index,
                columns=texts,
                channels="bgr",
            )
        )
    notes = [rows.note]
    if far:
        count = "1 time is" if len(far) == 1 else f"{len(far):,} times are"
        named_far = "; ".join(far[:MAX_FAR])
        notes.append(f"warning: {count} more than half a frame from every frame of the video: {named_far}")
    return Source(
        kind="videos with a table of times",
        path=table,
        samples=samples,
        left_out=tuple(left_out),
        files=tuple(dict.fromkeys(sample.file for sample in samples)),
        facts={"columns": dict(rows.columns)},
        notes=tuple(notes),
    )


def _seconds(text: str) -> float:
    try:
        seconds = float(text)
    except ValueError:
        seconds = -1.0
    if not 0.0 <= seconds < 1e7:
        raise InputError("time", text, "must be a number of seconds from the beginning of the video")
    return seconds


def _read(path: Path, paths: Paths, options: ImportOptions) -> Source:
    named = paths.with_suffix(*SUFFIXES) if path.suffix.lower() in (".csv", *SUFFIXES) else ()
    if path.is_dir():
        named = tuple(sorted(each for each in path.iterdir() if each.suffix.lower() in SUFFIXES))
    return of_videos(named, paths.table(path), options.columns)


def _recognises(path: Path, paths: Paths, options: ImportOptions) -> bool:
    """Return whether a path is a video, or belongs to a table of times that has no images."""
    if path.is_dir() or path.suffix.lower() == ".csv":
        table = paths.table(path)
        columns = {} if table is None else Rows.read(table, options.columns).columns
        return "time" in columns and "image" not in columns
    return path.suffix.lower() in SUFFIXES


FORMAT = ImportFormat(recognises=_recognises, read=_read, suffixes=SUFFIXES, together=True)
