"""The contents of the watch page, which follow from the run folders and from the progress file.

Nothing here writes a file or opens a device.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tacbench_cad.extensions.watch.events import KEPT_PRESSES, Progress, ProgressReader
from tacbench_cad.lab.acquire import PROGRESS_FILE
from tacbench_cad.lab.rig import is_image
from tacbench_cad.lab.runs import (
    IMAGE_SUFFIXES,
    REFERENCES_FILE,
    RUN_FILE,
    TARGETS_FILE,
    Finding,
    Row,
    Run,
    check_run,
    find_runs,
    region_of,
)
from tacbench_cad.lab.study import Press
from tacbench_cad.util.errors import InputError, TacbenchError, one_line
from tacbench_cad.util.files import LOCK_NAME

if TYPE_CHECKING:
    from tacbench_cad.extensions.markers import MarkerFeatures

#: The shortest time between two searches for run folders, in s.
SEARCH_S = 2.0
#: After slow work, the page waits for this multiple of the time that the work took, so that a run keeps its processor.
MARKERS_REST, CHECK_REST = 2.0, 10.0
#: The findings that every run has until it is complete.
_UNFINISHED = ("gap", "extra", "torn")
#: The largest number of findings and of values of a frame that is not an image, which are shown.
MAX_FINDINGS, MAX_VALUES = 50, 500


@dataclass
class _Shown:
    """A run folder, as it was read last.

    Args:
        folder: The folder.
    """

    folder: Path
    run: Run | None = None
    fault: str = ""
    rows: tuple[Row, ...] = ()
    plan: tuple[Press, ...] = ()
    reference: str = ""
    markers: dict[str, Any] | None = None
    features: MarkerFeatures | None = None
    has_markers: bool = True
    findings: list[Finding] | None = None
    checked: Any = None
    _seen: Any = field(default=None, repr=False)

    @property
    def files(self) -> tuple[float, ...]:
        """The times and sizes of the tables, which change with every press."""
        return tuple(itertools.chain(*(_stat(self.folder / n) for n in (RUN_FILE, TARGETS_FILE, REFERENCES_FILE))))

    @property
    def newest(self) -> str:
        """The path of the newest frame of a press; empty without a press."""
        return self.rows[-1].path if self.rows else ""

    @property
    def total(self) -> int:
        """The number of presses of the run."""
        return len(self.plan) or len(self.rows)

    def read(self) -> None:
        """Read the tables if they have changed."""
        files = self.files
        if files == self._seen:
            return
        self._seen, self.fault = files, ""
        try:
            self.run = Run.open(self.folder)
            self.plan = self.plan or self.run.info.presses
            self.rows = self.run.rows
            self.reference = self.run.references[-1].path if self.run.references else ""
        except TacbenchError as error:
            self.fault = one_line(error)


class Watched:
    """The runs of a folder, for a page that is open.

    Args:
        folder: A run folder, or a folder that contains run folders. It may be missing until the first run begins.
        now_s: Returns a time in seconds that never decreases.
    """

    def __init__(self, folder: Path, *, now_s: Callable[[], float] = time.monotonic) -> None:
        is_run = (folder / RUN_FILE).is_file()
        self.folder = folder
        self.root = folder.parent if is_run else folder
        self._lock = self.root / LOCK_NAME
        self._reader = ProgressReader(self.root / PROGRESS_FILE)
        self._now_s = now_s
        self._runs: dict[str, _Shown] = {}
        self._searched_s = -math.inf
        self._pool = ThreadPoolExecutor(1)
        self._work: Future[None] | None = None
        self._rest_s: dict[str, float] = {}

    @property
    def question(self) -> dict[str, Any] | None:
        """The block that the last contents of the page asked for, with its ``run`` and ``label``; None for no block."""
        return None if self._reader.progress is None else self._reader.progress.question

    def state(self, name: str = "", *, wait: bool = False) -> dict[str, Any]:
        """Return the contents of the page as plain values.

        Args:
            name: The name of the run to show; empty for the run that is pressed now, or was pressed last.
            wait: Wait for the markers and the findings, which are otherwise calculated in the background.
        """
        progress = self._reader.read()
        under_way = self._lock.exists()
        if progress is not None and (progress.over is not None or progress.is_killed):
            under_way = False
        self._search(progress)
        shown = self._chosen(name, progress)
        if shown is not None:
            shown.read()
            while self._work_on(shown, under_way) and wait:
                assert self._work is not None
                self._work.result()
        live = progress if shown is None or (progress is not None and progress.run == shown.folder.name) else None
        return {
            "folder": str(self.folder),
            "under_way": under_way,
            "session": None if progress is None else _session(progress, under_way),
            "runs": [self._line(run) for run in self._runs.values()],
            "run": None if shown is None or shown.run is None else self._run(shown, live, under_way),
            "fault": "" if shown is None else shown.fault,
        }

    def frame(self, name: str, which: str) -> tuple[bytes, str]:
        """Return the file of the newest frame or of its reference, and its media type.

        Args:
            name: The name of the run.
            which: ``newest`` or ``reference``.

        Raises:
            TacbenchError: There is no such run, the run has no such frame, or the file is damaged.
        """
        shown = self._runs.get(name)
        path = "" if shown is None else shown.newest if which == "newest" else shown.reference
        if shown is None or shown.run is None or not path.endswith(IMAGE_SUFFIXES):
            raise InputError("frame", f"{name}/{which}", "does not exist")
        return shown.run.read_bytes(path), "image/png" if path.endswith(".png") else "image/jpeg"

    def _search(self, progress: Progress | None) -> None:
        """Search for run folders, at most every two seconds, and at once when a run begins."""
        now = self._now_s()
        known = progress is None or not progress.run or progress.run in self._runs
        if now - self._searched_s < SEARCH_S and known:
            return
        self._searched_s = now
        try:
            folders = find_runs([self.folder])
        except InputError:  # there is no run yet
            return
        self._runs = {folder.name: self._runs.get(folder.name) or _Shown(folder) for folder in folders}

    def _chosen(self, name: str, progress: Progress | None) -> _Shown | None:
        if name in self._runs:
            return self._runs[name]
        if progress is not None and progress.run in self._runs:
            return self._runs[progress.run]
        changed = {run: _stat(shown.folder / TARGETS_FILE)[0] for run, shown in self._runs.items()}
        return self._runs[max(changed, key=lambda run: changed[run])] if changed else None

    def _line(self, shown: _Shown) -> dict[str, Any]:
        shown.read()
        return {"name": shown.folder.name, "done": len(shown.rows), "total": shown.total}

    def _run(self, shown: _Shown, progress: Progress | None, under_way: bool) -> dict[str, Any]:
        """Return the contents of the page that belong to one run."""
        run = shown.run
        assert run is not None
        plan = {press.number: press for press in shown.plan}
        press = plan.get(progress.press) if progress is not None else None
        tops = {row.number: row for row in shown.rows}
        findings, is_growing = shown.findings or [], under_way or shown.checked != shown.files
        return {
            "name": shown.folder.name,
            "simulated": list(run.info.simulated),
            "done": len(shown.rows),
            "total": shown.total,
            "newest": self._frame(shown, shown.newest),
            "reference": self._frame(shown, shown.reference),
            "markers": shown.markers,
            "press": None
            if press is None
            else {"number": press.number, "position": press.position, "target": press.target_n, "band": press.band_n},
            "curve": [] if progress is None else _curve(progress.curve),
            "curves": [] if progress is None else [_curve(curve) for _, curve in progress.curves],
            "points": [
                [round(-row.pose_z, 4), row.measured_force_n]
                for row in shown.rows[-KEPT_PRESSES:]
                if row.pose_z is not None and row.measured_force_n is not None
            ],
            "map": _map(plan, tops, press.position if press is not None else 0),
            "findings": None
            if shown.findings is None
            else [
                {"where": finding.where, "text": finding.text}
                for finding in findings
                if not (is_growing and finding.kind in _UNFINISHED)
            ][:MAX_FINDINGS],
            "missed": sum(row.in_band is False for row in shown.rows),
        }

    def _frame(self, shown: _Shown, path: str) -> dict[str, Any] | None:
        """Return the name of a frame, and its values if it is not an image."""
        if not path or shown.run is None:
            return None
        frame: dict[str, Any] = {"path": path, "image": path.endswith(IMAGE_SUFFIXES)}
        if not frame["image"]:
            try:
                values = shown.run.read(path).astype(np.float64).ravel()
            except TacbenchError as error:
                return {**frame, "fault": one_line(error)}
            frame["values"] = [float(f"{value:.5g}") for value in values[:MAX_VALUES]]
        return frame

    def _work_on(self, shown: _Shown, under_way: bool) -> bool:
        """Start slow work if there is any and the last has ended; return whether work is under way."""
        if self._work is not None and not self._work.done():
            return True
        now, newest = self._now_s() if under_way else math.inf, shown.newest
        wants_markers = shown.has_markers and newest and (shown.markers or {}).get("path") != newest
        if wants_markers and now >= self._rest_s.get("markers", -math.inf):
            self._work = self._pool.submit(self._timed, "markers", MARKERS_REST, lambda: _track(shown))
        elif shown.run is not None and shown.checked != shown.files and now >= self._rest_s.get("check", -math.inf):
            self._work = self._pool.submit(self._timed, "check", CHECK_REST, lambda: _check(shown))
        else:
            return False
        return True

    def _timed(self, name: str, rest: float, work: Callable[[], None]) -> None:
        start = self._now_s()
        work()
        now = self._now_s()
        self._rest_s[name] = now + rest * (now - start)


def _session(progress: Progress, under_way: bool) -> dict[str, Any]:
    """Return the contents of the page that belong to the session."""
    press_s = progress.press_s if under_way and not progress.question else None
    return {
        "pressing": progress.pressing,
        "paused": progress.paused,
        "question": progress.question,
        "over": progress.over,
        "killed": progress.is_killed,
        "messages": list(progress.messages),
        "blocks": progress.blocks,
        "saved": progress.saved,
        "planned": progress.planned,
        "run": progress.run,
        "run_s": None if press_s is None else round(press_s * (progress.total - progress.done)),
        "study_s": None if press_s is None else round(press_s * (progress.planned - progress.saved)),
        "time": progress.time_s,
        "temperature_c": progress.temperature_c,
    }


def _curve(points: list[tuple[float, float]]) -> list[list[float]]:
    """Return the depths in mm below the highest point of the block, and the forces in N."""
    return [[round(-z, 4), n] for z, n in points]


def _map(plan: Mapping[int, Any], rows: Mapping[int, Row], now: int) -> list[dict[str, Any]]:
    """Return the positions of the press grid with the largest force error so far, in half widths of the band."""
    positions: dict[int, dict[str, Any]] = {}
    for press in plan.values():
        place = positions.setdefault(
            press.position,
            {
                "position": press.position,
                "x": press.x_mm,
                "y": press.y_mm,
                "done": 0,
                "planned": 0,
                "error": None,
                "now": press.position == now,
            },
        )
        place["planned"] += 1
        row = rows.get(press.number)
        if row is None:
            continue
        place["done"] += 1
        if row.measured_force_n is not None and press.target_n is not None and press.band_n:
            error = round((row.measured_force_n - press.target_n) / press.band_n, 2)
            if place["error"] is None or abs(error) > abs(place["error"]):
                place["error"] = error
    return [positions[number] for number in sorted(positions)]


def _track(shown: _Shown) -> None:
    """Find the markers of the newest frame and their displacements, if the extension for markers was not deleted."""
    try:
        from tacbench_cad.extensions.markers import MIN_FOUND, MarkerFeatures
    except ModuleNotFoundError:
        shown.has_markers = False
        return
    run, path = shown.run, shown.newest
    assert run is not None
    try:
        if shown.features is None:
            shown.features = MarkerFeatures.learn([run], region=region_of([run]))
        frame = run.read(path)
        if not is_image(frame):
            raise InputError("frame", path, "is not an image")
        track = shown.features.track(run.folder, frame)
    except TacbenchError:
        if shown.features is None:
            shown.has_markers = False
        shown.markers = {"path": path, "lines": []}
        return
    start = shown.features.trackers[str(run.folder)].reference_px
    length = np.hypot(*track.displacement_px.T)
    lines = np.column_stack([start, start + track.displacement_px])[track.found]
    good = track.found.mean() >= MIN_FOUND
    shown.markers = {
        "path": path,
        "size": [shown.features.shape[1], shown.features.shape[0]],
        "lines": np.round(lines, 1).tolist() if good else [],
        "found": int(track.found.sum()),
        "count": len(start),
        "origin": shown.features.origin,
        "median_px": round(float(np.median(length)), 2),
        "max_px": round(float(length.max()), 2),
    }


def _check(shown: _Shown) -> None:
    files = shown.files
    try:
        shown.findings = list(check_run(shown.folder, workers=1).findings)
    except TacbenchError as error:
        shown.findings = [Finding(kind="unreadable", where=RUN_FILE, text=one_line(error))]
    shown.checked = files


def _stat(path: Path) -> tuple[float, float]:
    try:
        status = path.stat()
    except OSError:
        return (0.0, 0.0)
    return (status.st_mtime, status.st_size)
