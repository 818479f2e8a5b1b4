"""Checking run folders: what is missing, extra, doubled, unreadable, dark, blurred, stuck or changed, all by name."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tacbench_cad.lab.rig.frames import FrameLimits
from tacbench_cad.lab.rig.sensor import is_image
from tacbench_cad.lab.runs import params, schema
from tacbench_cad.lab.runs.info import RunInfo
from tacbench_cad.lab.runs.pictures import decoded, sha256
from tacbench_cad.lab.runs.quality import Judge, Measured, beside_each_other
from tacbench_cad.lab.runs.reading import Run, planned, shape_fault
from tacbench_cad.lab.runs.schema import Reference, Row, Stationary
from tacbench_cad.lab.runs.table import cut_torn_line, read_table
from tacbench_cad.lab.vision.region import REGION_FILE, SURE, Region
from tacbench_cad.lab.vision.resting import found_region, region_of
from tacbench_cad.util.convert import to_plain
from tacbench_cad.util.door import read_bytes
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.files import locked
from tacbench_cad.util.text import counted

#: Called with the number of frames examined so far and the number of all.
FramesExamined = Callable[[int, int], None]


@dataclass(frozen=True, kw_only=True)
class Finding:
    """Something wrong with a run.

    Args:
        kind: ``missing``, ``extra``, ``duplicate``, ``unreadable``, ``dark``, ``blurred``, ``saturated``,
            ``brightness``, ``flicker``, ``drift``, ``moved``, ``stuck``, ``checksum``, ``shape``, ``gap``, ``row``,
            ``torn`` or ``record``.
        where: File from the run folder, or what of the protocol.
        text: What is wrong, as the end of a sentence.
    """

    kind: str
    where: str
    text: str


@dataclass(frozen=True, kw_only=True)
class RunReport:
    """The result of checking a run.

    Args:
        folder: The run folder.
        name: Name of its block.
        simulated: What of its rig was simulated.
        planned: Presses in its protocol.
        presses: Rows that are there.
        references: Frames without contact.
        stationary: Frames without motion.
        out_of_band: Rows that say that the target was not reached (no fault: they say so).
        findings: What is wrong.
        repaired: What was repaired.
        empty_fields: Fields of ``print.toml`` that nobody filled in (no fault).
    """

    folder: Path
    name: str
    simulated: tuple[str, ...]
    planned: int
    presses: int = 0
    references: int = 0
    stationary: int = 0
    out_of_band: int = 0
    findings: tuple[Finding, ...] = ()
    repaired: tuple[str, ...] = ()
    empty_fields: tuple[str, ...] = field(default=(), metadata={"key": "empty_print_fields"})

    @property
    def ok(self) -> bool:
        """Whether nothing is wrong."""
        return not self.findings

    def as_dict(self) -> dict[str, Any]:
        """Plain values for ``--json``."""
        return {"folder": str(self.folder), "name": self.name, "ok": self.ok, **to_plain(self)}


def check_run(
    folder: Path, *, repair: bool = False, workers: int | None = None, progress: FramesExamined | None = None
) -> RunReport:
    """Examine a run folder and every frame in it.

    Args:
        folder: The run folder.
        repair: Cut off a torn last row. Nothing else is ever changed.
        workers: Threads that read, decode and judge; one for each core if None.
        progress: Called after each frame.

    Raises:
        InputError: It is no run folder, of another schema version, or its ``run.json`` is damaged; with ``repair`` also
            if another process writes to it.
    """
    run = Run.open(folder)
    check = _Check(run)
    targets, references, still = check.tables(repair)
    check.extra_files()
    check.frames(workers or os.cpu_count() or 1, progress)
    empty = check.print_record()
    check.parameters()
    return RunReport(
        folder=folder,
        name=run.info.printed.name,
        simulated=run.info.simulated,
        planned=len(run.info.presses) if run.info.protocol else len(targets),
        presses=len(targets),
        references=len(references),
        stationary=len(still),
        out_of_band=sum(row.in_band is False for row in targets),
        findings=tuple(check.findings),
        repaired=tuple(check.repaired),
        empty_fields=empty,
    )


@dataclass
class _Check:
    """The findings of a run so far, and the checksums that its rows give for the paths of frames."""

    run: Run
    findings: list[Finding] = field(default_factory=list)
    repaired: list[str] = field(default_factory=list)
    expected: list[tuple[str, str]] = field(default_factory=list)
    in_time: list[str] = field(default_factory=list)
    still: dict[str, list[str]] = field(default_factory=dict)

    def add(self, kind: str, where: str, text: str) -> None:
        self.findings.append(Finding(kind=kind, where=where, text=text))

    def tables(self, repair: bool) -> list[tuple[Any, ...]]:
        """Examine the three CSV files and compare them with the protocol; their rows, as far as they can be read."""
        rows: dict[type[Any], tuple[Any, ...]] = {}
        for kind in schema.TABLES:
            faults: list[InputError] = []
            try:
                table = read_table(self.run.folder, kind, planned(self.run.info) if kind is Row else None, faults)
                rows[kind] = table.rows
                if table.text.torn and repair:
                    length = _cut(self.run.folder, kind)
                    self.repaired.append(f"{kind.FILE}: cut off a torn last row of {length} bytes")
                elif table.text.torn:
                    text = "ends in a torn row; --repair cuts it off, and its press is then made again"
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
            self.in_time = [row.path for row in sorted(presses, key=lambda row: row.time_utc)]
        for row in rows.get(Stationary, ()):
            contact = "in contact" if row.in_contact else "without contact"
            self.still.setdefault(f"{schema.STATIONARY_FOLDER} ({contact}, {row.when})", []).append(row.path)
        self.expected = [(row.path, row.image_sha256) for kind_rows in read for row in kind_rows]
        if rows.get(Reference) == () and not self.run.info.source:
            self.add("gap", "references", "there is no reading without contact")
        if Stationary in rows:
            self._stationary_gaps({row.key for row in rows[Stationary]})
        return read

    def _press_gaps(self, present: set[int]) -> None:
        presses = self.run.info.presses
        missing = [press.number for press in presses if press.number not in present]
        if missing:
            text = f"{len(missing)} of {counted(len(presses), 'press')} missing: {ranges(missing)}"
            self.add("gap", "protocol", text)

    def _stationary_gaps(self, present: set[tuple[str, bool, int]]) -> None:
        count = self.run.info.protocol.stationary_frames if self.run.info.protocol else 0
        for when, in_contact in schema.STATIONARY:
            missing = sum((when, in_contact, index) not in present for index in range(1, count + 1))
            if missing:
                contact = "in contact" if in_contact else "without contact"
                text = f"{missing} of {count} readings {contact} at the {when} missing"
                self.add("gap", schema.STATIONARY_FOLDER, text)

    def extra_files(self) -> None:
        """Find files that no row names, and rows that name the same file."""
        named = Counter(path for path, _ in self.expected)
        for path, times in named.items():
            if times > 1:
                self.add("duplicate", path, f"is named by {times} rows")
        for name in schema.FRAME_FOLDERS:
            sub = self.run.folder / name
            if not sub.is_dir():
                continue
            for path in (f"{name}/{entry.name}" for entry in sorted(sub.iterdir())):
                if path not in named and path not in (kind.FILE for kind in schema.TABLES):
                    self.add(
                        "extra", path, "has no row: an interrupted press (made again when the run goes on) or yours"
                    )

    def frames(self, workers: int, progress: FramesExamined | None) -> None:
        """Read and judge every frame; two images with the same bytes come from a camera that hangs."""
        expected = dict(self.expected)
        judge = Judge(limits=limits_of(self.run.info), region=self.region())
        first: dict[str, str] = {}
        measured: dict[str, Measured] = {}
        with ThreadPoolExecutor(workers) as pool:
            judged = pool.map(lambda path: _judge(self.run, path, expected[path], judge), expected)
            for number, (path, (digest, faults, values)) in enumerate(zip(expected, judged, strict=True), start=1):
                for kind, text in faults:
                    self.add(kind, path, text)
                if values is not None and not faults:
                    measured[path] = values
                if digest and digest in first:
                    self.add("stuck", path, f"is identical to {first[digest]}: the camera gave an old frame again")
                elif digest:
                    first[digest] = path
                if progress is not None:
                    progress(number, len(expected))
        for kind, where, text in beside_each_other(measured, self.in_time, self.still):
            self.add(kind, where, text)

    def region(self) -> Region | None:
        """The region of interest that is kept with the run, or the one that its frames show, if that is sure."""
        try:
            region = region_of([self.run]) or found_region([self.run])
        except InputError as error:
            if (self.run.folder / REGION_FILE).exists():
                self.add("unreadable", REGION_FILE, str(error))
            return None
        fits = region.mask.shape == (self.run.info.frame_shape or ())[:2]
        return region if region.sureness >= SURE and fits else None

    def print_record(self) -> tuple[str, ...]:
        """Examine ``print.toml``; the result is its empty fields."""
        try:
            record = self.run.print_record
        except InputError as error:
            self.add("record", schema.PRINT_FILE, str(error))
            return ()
        for photo in record.values.get("photos", ()):
            if not (self.run.folder / photo).is_file():
                self.add("record", schema.PRINT_FILE, f"names the photo {photo}, which is not in the run folder")
        return record.empty

    def parameters(self) -> None:
        """Examine the files that TacTip toolchains look for."""
        for name in params.PARAMETERS:
            if not (self.run.folder / name).is_file():
                self.add("missing", name, "is not there; TacTip toolchains look for it")
                continue
            try:
                self.run.parameters(name)
            except InputError:
                self.add("unreadable", name, "is not valid JSON")


def _cut(folder: Path, kind: type[Any]) -> int:
    """Cut off a torn last row while nobody else writes; return its length."""
    with locked(folder):
        text = read_table(folder, kind, None, []).text
        cut_torn_line(folder / kind.FILE, text)
        return len(text.torn)


def _judge(
    run: Run, path: str, expected: str, judge: Judge
) -> tuple[str | None, list[tuple[str, str]], Measured | None]:
    """The checksum of a frame (of an image; else None), its faults by kind and text, and what was measured of it."""
    if not os.path.lexists(run.folder / path):
        return None, [("missing", "is not there though a row names it")], None
    try:
        data = read_bytes(run.folder / path, "frame", "image", within=run.folder)
    except InputError as error:
        return None, [("unreadable", error.allowed)], None
    digest = sha256(data)
    faults = []
    if digest != expected:
        faults.append(("checksum", "is not the file that was written: its checksum differs from its row's"))
    try:
        frame = decoded(data, path)
    except CheckFailedError as error:
        return None, [*faults, ("unreadable", str(error))], None
    fault = shape_fault(run.info, frame)
    if fault:
        faults.append(("shape", fault))
    if not path.endswith(schema.IMAGE_SUFFIXES):
        return None, faults, None
    if not is_image(frame):
        faults.append(("shape", f"is an image of {frame.dtype}, shape {frame.shape}; uint8, grey or BGR belong here"))
        return digest, faults, None
    if fault:
        return digest, faults, None
    measured = judge.measure(frame)
    return digest, [*faults, *judge.faults(measured)], measured


def limits_of(info: RunInfo) -> FrameLimits:
    """When an image of this run is dark or blurred: as set for its camera, else the default.

    Raises:
        InputError: A limit in ``run.json`` is not allowed.
    """
    try:
        limits = info.sensor.get("settings", {}).get("limits", {})
        return FrameLimits(**{name: float(limits[name]) for name in ("dark_counts", "blur_px") if name in limits})
    except (AttributeError, TypeError, ValueError):
        raise InputError("run.json sensor.settings.limits", None, "must be dark_counts and blur_px, numbers") from None


def ranges(numbers: Sequence[int], max_parts: int = 8) -> str:
    """Rising numbers for people: ``3, 7 to 25, 31``."""
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
