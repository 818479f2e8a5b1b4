"""Checks of run folders, which name each file that is missing, extra, duplicate, unreadable, dark or blurred."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from tacbench_cad.lab.rig.frames import FrameLimits
from tacbench_cad.lab.rig.sensor import is_image
from tacbench_cad.lab.runs import schema
from tacbench_cad.lab.runs.frame_files import decoded, sha256
from tacbench_cad.lab.runs.info import RunInfo
from tacbench_cad.lab.runs.quality import MIN_FRAMES, Judge, MeasuredRun, beside_each_other
from tacbench_cad.lab.runs.reading import Run, good_checks, planned, shape_fault
from tacbench_cad.lab.runs.region import REGION_FILE, SURE, Region
from tacbench_cad.lab.runs.region_search import found_region, region_of
from tacbench_cad.lab.runs.run_tables import cut_torn_line, read_table
from tacbench_cad.lab.runs.schema import Reference, Row, Stationary
from tacbench_cad.lab.runs.series import series_rows
from tacbench_cad.lab.runs.typical_frame import TypicalFrame
from tacbench_cad.util.convert import from_plain, to_plain
from tacbench_cad.util.errors import CheckFailedError, InputError, one_line
from tacbench_cad.util.files import locked
from tacbench_cad.util.text import counted
from tacbench_cad.util.untrusted import read_bytes

#: The largest number of frames for the typical frame of a run.
TYPICAL_FRAMES = 25
#: A function that is called with the number of frames examined so far and the number of all frames.
FramesExamined = Callable[[int, int], None]


@dataclass(frozen=True, kw_only=True)
class Finding:
    """A fault of a run.

    Args:
        kind: ``missing``, ``extra``, ``duplicate``, ``unreadable``, ``dark``, ``blurred``, ``saturated``,
            ``brightness``, ``flicker``, ``drift``, ``moved``, ``noise``, ``orientation``, ``colour``, ``stuck``,
            ``checksum``, ``shape``, ``gap``, ``row``, ``torn``, ``slip``, ``record`` or ``camera``.
        where: The file, relative to the run folder, or the part of the protocol.
        text: The fault, as the end of a sentence that begins with ``where``.
    """

    kind: str
    where: str
    text: str


@dataclass(frozen=True, kw_only=True)
class RunReport:
    """The result of checking a run.

    Args:
        folder: The run folder.
        name: The name of the block.
        simulated: The simulated devices of the rig.
        planned: The number of presses in the protocol.
        presses: The number of rows in ``targets.csv``.
        references: The number of frames without contact.
        stationary: The number of frames without motion.
        series: The number of presses with a complete series of moving frames.
        out_of_band: The number of presses that did not reach their target force. The rows record this, so it is not a
            fault.
        unchecked: The number of presses that no good check of the position has followed. This is not a fault.
        unchecked_sideways: The number of the other presses whose check did not compare x and y with the end stops.
        findings: The faults.
        repaired: The repairs.
        empty_fields: The empty fields of ``print.toml``, which are not a fault.
    """

    folder: Path
    name: str
    simulated: tuple[str, ...]
    planned: int
    presses: int = 0
    references: int = 0
    stationary: int = 0
    series: int = 0
    out_of_band: int = 0
    unchecked: int = 0
    unchecked_sideways: int = 0
    findings: tuple[Finding, ...] = ()
    repaired: tuple[str, ...] = ()
    empty_fields: tuple[str, ...] = field(default=(), metadata={"alias": "empty_print_fields"})

    @property
    def ok(self) -> bool:
        """Whether the run has no faults."""
        return not self.findings

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for ``--json``."""
        return {"folder": str(self.folder), "name": self.name, "ok": self.ok, **to_plain(self)}


def check_run(
    folder: Path, *, repair: bool = False, workers: int | None = None, progress: FramesExamined | None = None
) -> RunReport:
    """Examine a run folder and every frame in it.

    Args:
        folder: The run folder.
        repair: Remove the last row of a table if it is incomplete. Nothing else is ever changed.
        workers: The number of threads that examine frames; one for each core if None.
        progress: A function that is called after each frame.

    Raises:
        InputError: The folder is not a run folder or has another schema version, or its ``run.json`` is damaged. With
            ``repair``: another process is writing to the folder.
    """
    run = Run.open(folder)
    check = _Check(run)
    targets, references, still = check.tables(repair)
    series = check.series(targets)
    unchecked, unchecked_sideways = check.position(targets)
    check.extra_files()
    check.frames(workers or os.cpu_count() or 1, progress)
    empty = check.print_record()
    check.camera()
    return RunReport(
        folder=folder,
        name=run.info.printed.name,
        simulated=run.info.simulated,
        planned=len(run.info.presses) if run.info.protocol else len(targets),
        presses=len(targets),
        references=len(references),
        stationary=len(still),
        series=series,
        out_of_band=sum(row.in_band is False for row in targets),
        unchecked=unchecked,
        unchecked_sideways=unchecked_sideways,
        findings=tuple(check.findings),
        repaired=tuple(check.repaired),
        empty_fields=empty,
    )


@dataclass
class _Check:
    """The findings of a run so far, and the paths of its frames with their recorded checksums."""

    run: Run
    findings: list[Finding] = field(default_factory=list)
    repaired: list[str] = field(default_factory=list)
    expected: list[tuple[str, str]] = field(default_factory=list)
    in_time: list[str] = field(default_factory=list)
    still: dict[str, list[str]] = field(default_factory=dict)

    def add(self, kind: str, where: str, text: str) -> None:
        self.findings.append(Finding(kind=kind, where=where, text=text))

    def tables(self, repair: bool) -> list[tuple[Any, ...]]:
        """Compare the three CSV files with the protocol, and return their readable rows."""
        rows: dict[type[Any], tuple[Any, ...]] = {}
        for kind in schema.TABLES:
            faults: list[InputError] = []
            try:
                table = read_table(self.run.folder, kind, planned(self.run.info) if kind is Row else None, faults)
                rows[kind] = table.rows
                if table.torn and repair:
                    length = _cut(self.run.folder, kind)
                    self.repaired.append(f"{kind.FILE}: removed an incomplete last row of {length} bytes")
                elif table.torn:
                    text = "ends with an incomplete row; --repair removes it, and the press is repeated on resuming"
                    self.add("torn", kind.FILE, text)
            except InputError as error:
                faults.append(error)
            if kind is Row and kind in rows:
                self._press_gaps({row.number for row in rows[kind]})
            for fault in faults:
                kind_of_fault = "duplicate" if "already" in fault.allowed else "row"
                self.add(kind_of_fault, kind.FILE, str(fault).removeprefix(f"{self.run.folder}{os.sep}"))
        read = [rows.get(kind, ()) for kind in schema.TABLES]
        presses = rows.get(Row, ())
        if all(row.time_utc for row in presses):
            # With a protocol, the presses are made in the order of their numbers. The clock may have been set back.
            has_plan = self.run.info.protocol is not None
            in_time = sorted(presses, key=lambda row: row.number if has_plan else row.time_utc)
            self.in_time = [row.path for row in in_time]
        for row in rows.get(Stationary, ()):
            contact = "in contact" if row.in_contact else "without contact"
            self.still.setdefault(f"{schema.STATIONARY_FOLDER} ({contact}, {row.when})", []).append(row.path)
        self.expected = [(row.path, row.image_sha256) for kind_rows in read for row in kind_rows]
        if rows.get(Reference) == () and not self.run.info.source:
            self.add("gap", "references", "has no frame without contact")
        if Stationary in rows:
            self._stationary_gaps({row.key for row in rows[Stationary]})
        return read

    def _press_gaps(self, present: set[int]) -> None:
        presses = self.run.info.presses
        missing = [press.number for press in presses if press.number not in present]
        if missing:
            text = f"is not complete: the run lacks {len(missing)} of {counted(len(presses), 'press')}"
            self.add("gap", "protocol", f"{text} ({ranges(missing)})")

    def _stationary_gaps(self, present: set[tuple[str, bool, int]]) -> None:
        count = self.run.info.protocol.checks.stationary_frames if self.run.info.protocol else 0
        for when, in_contact in schema.STATIONARY:
            missing = sum((when, in_contact, index) not in present for index in range(1, count + 1))
            if missing:
                contact = "in contact" if in_contact else "without contact"
                text = f"lacks {missing} of {counted(count, 'frame')} {contact} at the {when} of the run"
                self.add("gap", schema.STATIONARY_FOLDER, text)

    def series(self, rows: Sequence[Row]) -> int:
        """Examine the series of moving frames, whose frames are then examined like all others.

        Returns:
            The number of complete series.
        """
        run, expected, complete = self.run, {f"press_{row.number}": row for row in rows}, 0
        count = run.info.series_frames
        folder = run.folder / schema.SERIES_FOLDER
        for name in sorted(entry.name for entry in folder.iterdir()) if folder.is_dir() else ():
            if not count or name not in expected:
                text = "has no row: it comes from an interrupted press, which is repeated when you resume the run"
                self.add("extra", f"{schema.SERIES_FOLDER}/{name}", f"{text}, or you added it")
        for row in rows if count else ():
            below = schema.series_folder(row.number)
            try:
                moving = series_rows(run.folder, row.number, count)
            except (InputError, CheckFailedError) as error:
                present = (run.folder / below / schema.SERIES_FILE).exists()
                text = str(error).removeprefix(f"{run.folder}{os.sep}").removeprefix(f"{below}/{schema.SERIES_FILE}: ")
                self.add("row" if present else "missing", f"{below}/{schema.SERIES_FILE}", text)
                continue
            complete += 1
            self.expected += [(f"{below}/{each.frame}", each.sha256) for each in moving]
            known = {schema.SERIES_FILE, *(each.frame for each in moving)}
            for entry in sorted((run.folder / below).iterdir()):
                if entry.name not in known:
                    self.add("extra", f"{below}/{entry.name}", "has no row in the table of the series")
        return complete

    def position(self, rows: Sequence[Row]) -> tuple[int, int]:
        """Examine the checks of the position.

        Returns:
            The number of presses without a good check after them, and of the others without one of x and y.
        """
        try:
            checks = self.run.position_checks
        except InputError as error:
            self.add("row", schema.CHECKS_FILE, str(error).removeprefix(f"{self.run.folder}{os.sep}"))
            return 0, 0
        if checks and not checks[-1].ok:
            last = checks[-1]
            if last.reason == "first":
                text = f"the first press, repeated at the end, ended {last.height_change_mm:+.2f} mm away"
                self.add("slip", schema.CHECKS_FILE, f"{text}; the sensor, the block or the gauge has changed")
            else:
                text = "ends with presses that were set aside; resume the run to repeat them"
                self.add("slip", schema.CHECKS_FILE, text)
        if self.run.info.protocol is None:
            return 0, 0
        checked = good_checks(rows, checks)
        return len(rows) - len(checked), sum(not check.covers_all_axes for check in checked.values())

    def extra_files(self) -> None:
        """Find files without a row, and files with several rows."""
        named = Counter(path for path, _ in self.expected)
        for path, times in named.items():
            if times > 1:
                self.add("duplicate", path, f"appears in {times} rows")
        for name in schema.FRAME_FOLDERS:
            sub = self.run.folder / name
            if not sub.is_dir():
                continue
            for path in (f"{name}/{entry.name}" for entry in sorted(sub.iterdir())):
                if path not in named and path not in (kind.FILE for kind in schema.TABLES):
                    text = "has no row: it comes from an interrupted press, which is repeated when you resume the run"
                    self.add("extra", path, f"{text}, or you added the file")

    def frames(self, workers: int, progress: FramesExamined | None) -> None:
        """Examine every frame. Two images with the same bytes show that the camera repeated a frame."""
        expected = dict(self.expected)
        judge = Judge(
            limits=limits_of(self.run.info),
            region=self.region(),
            typical=self.typical_frame(),
            any_kind=bool(self.run.info.source),
        )
        first: dict[str, str] = {}
        measured: dict[str, MeasuredRun] = {}
        with ThreadPoolExecutor(workers) as pool:
            judged = pool.map(lambda path: _judge(self.run, path, expected[path], judge), expected)
            for number, (path, (digest, faults, values)) in enumerate(zip(expected, judged, strict=True), start=1):
                for kind, text in faults:
                    self.add(kind, path, text)
                added = judge.any_kind and path.startswith(f"{schema.REFERENCE_FOLDER}/")
                if values is not None and not faults and not added:  # the user added these frames, of another time
                    measured[path] = values
                if digest and digest in first:
                    self.add("stuck", path, f"is identical to {first[digest]}; the camera probably repeated a frame")
                elif digest:
                    first[digest] = path
                if progress is not None:
                    progress(number, len(expected))
        for kind, where, text in beside_each_other(measured, self.in_time, self.still):
            self.add(kind, where, text)

    def typical_frame(self) -> TypicalFrame | None:
        """Return the typical frame of the run from some frames; None if fewer than eight can be read."""
        paths = [path for path, _ in self.expected if path.endswith(schema.IMAGE_SUFFIXES)]
        frames = []
        for at in np.unique(np.linspace(0, len(paths) - 1, TYPICAL_FRAMES).astype(int)) if paths else ():
            try:
                frame = self.run.read(paths[at])
            except CheckFailedError:
                continue  # it is reported when the frame is judged
            if is_image(frame):
                frames.append(frame)
        return TypicalFrame(frames=frames) if len(frames) >= MIN_FRAMES else None

    def region(self) -> Region | None:
        """Return the run's stored region of interest, or the region found in its frames if that is certain enough."""
        try:
            region = region_of([self.run]) or found_region([self.run])
        except InputError as error:
            if (self.run.folder / REGION_FILE).exists():
                self.add("unreadable", REGION_FILE, str(error))
            return None
        fits = region.mask.shape == (self.run.info.frame_shape or ())[:2]
        return region if region.sureness >= SURE and fits else None

    def print_record(self) -> tuple[str, ...]:
        """Examine ``print.toml`` and return its empty fields."""
        try:
            record = self.run.print_record
        except InputError as error:
            self.add("record", schema.PRINT_FILE, str(error))
            return ()
        for photo in record.values.get("photos", ()):
            if not (self.run.folder / photo).is_file():
                self.add("record", schema.PRINT_FILE, f"lists the photo {photo}, which is missing in the run folder")
        return record.empty

    def camera(self) -> None:
        """Look for automatic controls that the camera did not switch off."""
        actual = self.run.info.sensor.get("settings", {}).get("actual", {})
        automatic = actual.get("automatic", ()) if isinstance(actual, Mapping) else ()
        for control in automatic if isinstance(automatic, list) else ():
            shown = one_line(str(control).replace("_", " "), 40)
            text = (
                f"says that the automatic {shown} of the camera was on, so that frames may change without the contact"
            )
            self.add("camera", schema.RUN_FILE, text)


def _cut(folder: Path, kind: type[Any]) -> int:
    """Remove an incomplete last row while no other process writes, and return its length in bytes."""
    with locked(folder):
        table = read_table(folder, kind, None, [])
        cut_torn_line(folder / kind.FILE, table)
        return len(table.torn)


def _judge(
    run: Run, path: str, expected: str, judge: Judge
) -> tuple[str | None, list[tuple[str, str]], MeasuredRun | None]:
    """Return the checksum of an image (else None), the kinds and texts of a frame's faults, and its measurements."""
    if not os.path.lexists(run.folder / path):
        text = "is missing, but a row refers to it; restore the file, or delete its row and resume the run"
        return None, [("missing", text)], None
    try:
        data = read_bytes(run.folder / path, "frame", "image", within=run.folder)
    except InputError as error:
        return None, [("unreadable", error.allowed)], None
    digest = sha256(data)
    faults = []
    if digest != expected:
        faults.append(("checksum", "was changed: its checksum differs from the checksum in its row"))
    try:
        frame = decoded(data)
    except CheckFailedError as error:
        return None, [*faults, ("unreadable", str(error))], None
    fault = shape_fault(run.info, frame)
    if fault:
        faults.append(("shape", fault))
    if not path.endswith(schema.IMAGE_SUFFIXES):
        return None, faults, None
    if not is_image(frame):
        text = f"is an image of {frame.dtype} with shape {frame.shape}; it must be uint8, in grey or in BGR colours"
        faults.append(("shape", text))
        return digest, faults, None
    if fault:
        return digest, faults, None
    measured = judge.measure(frame)
    return digest, [*faults, *judge.faults(measured)], measured


def limits_of(info: RunInfo) -> FrameLimits:
    """Return the limits for dark and blurred images: those in the camera's settings, or the defaults.

    Raises:
        InputError: A limit in ``run.json`` is not allowed.
    """
    limits = info.sensor.get("settings", {}).get("limits", {})
    names = [each.name for each in fields(FrameLimits)]
    known = {name: limits[name] for name in names if name in limits} if isinstance(limits, Mapping) else limits
    return from_plain(FrameLimits, known, "run.json sensor.settings.limits ")


def ranges(numbers: Sequence[int], max_parts: int = 8) -> str:
    """Write increasing numbers as ranges: ``3, 7 to 25, 31``."""
    parts: list[list[int]] = []
    for number in numbers:
        if parts and number == parts[-1][1] + 1:
            parts[-1][1] = number
        else:
            parts.append([number, number])
    shown = [str(low) if low == high else f"{low} to {high}" for low, high in parts[:max_parts]]
    if len(parts) > max_parts:
        shown.append(f"and {sum(high - low + 1 for low, high in parts[max_parts:])} more")
    return ", ".join(shown)
