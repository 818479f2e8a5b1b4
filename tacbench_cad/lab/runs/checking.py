"""Checking run folders: what is missing, extra, doubled, unreadable, dark, blurred, stuck or changed, all by name."""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tacbench_cad.lab.rig.frames import FrameLimits, frame_faults
from tacbench_cad.lab.rig.sensor import is_image
from tacbench_cad.lab.runs import params, schema
from tacbench_cad.lab.runs.info import RunInfo
from tacbench_cad.lab.runs.npyfile import read_array
from tacbench_cad.lab.runs.pictures import decoded, sha256
from tacbench_cad.lab.runs.reading import Run, read_rows, shape_fault
from tacbench_cad.lab.runs.table import read_lines
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.files import locked, refusing
from tacbench_cad.util.text import counted

#: Called with the readings examined so far and their number in all.
Progress = Callable[[int, int], None]


@dataclass(frozen=True, kw_only=True)
class Finding:
    """Something wrong with a run.

    Args:
        kind: ``missing``, ``extra``, ``duplicate``, ``unreadable``, ``dark``, ``blurred``, ``stuck``, ``checksum``,
            ``shape``, ``gap``, ``row``, ``torn`` or ``record``.
        where: File from the run folder, or what of the protocol.
        text: What is wrong, as the end of a sentence.
    """

    kind: str
    where: str
    text: str

    def as_dict(self) -> dict[str, str]:
        """Plain values."""
        return {"kind": self.kind, "where": self.where, "text": self.text}


@dataclass(frozen=True, kw_only=True)
class RunReport:
    """What was found of a run.

    Args:
        folder: The run folder.
        name: Name of its block.
        simulated: What of its rig was simulated.
        planned: Presses in its protocol.
        presses: Rows that are there.
        references: Readings without contact.
        stationary: Readings without motion.
        out_of_band: Rows that say that the target was not reached (no fault: they say so).
        findings: What is wrong.
        repaired: What was repaired.
        empty_fields: Fields of ``print.toml`` that nobody filled in (no fault).
    """

    folder: Path
    name: str
    simulated: tuple[str, ...]
    planned: int
    presses: int
    references: int
    stationary: int
    out_of_band: int
    findings: tuple[Finding, ...]
    repaired: tuple[str, ...]
    empty_fields: tuple[str, ...]

    @property
    def ok(self) -> bool:
        """Whether nothing is wrong."""
        return not self.findings

    def as_dict(self) -> dict[str, Any]:
        """Plain values for ``--json``."""
        return {
            "folder": str(self.folder),
            "name": self.name,
            "ok": self.ok,
            "simulated": list(self.simulated),
            "planned": self.planned,
            "presses": self.presses,
            "references": self.references,
            "stationary": self.stationary,
            "out_of_band": self.out_of_band,
            "findings": [one.as_dict() for one in self.findings],
            "repaired": list(self.repaired),
            "empty_print_fields": list(self.empty_fields),
        }


@dataclass(frozen=True, kw_only=True)
class _Expected:
    """A reading that must be there: its path from the run folder and its checksum."""

    path: str
    digest: str


@dataclass
class _Draft:
    """A report in the making."""

    run: Run
    findings: list[Finding] = field(default_factory=list)
    repaired: list[str] = field(default_factory=list)
    expected: list[_Expected] = field(default_factory=list)
    counts: Counter[str] = field(default_factory=Counter)

    def add(self, kind: str, where: str, text: str) -> None:
        self.findings.append(Finding(kind=kind, where=where, text=text))


def check_run(
    folder: Path, *, repair: bool = False, workers: int | None = None, progress: Progress | None = None
) -> RunReport:
    """Examine a run folder, every reading in it.

    Args:
        folder: The run folder.
        repair: Cut off a torn last row. Nothing else is ever changed.
        workers: Threads that read, decode and judge; one for each core if None.
        progress: Told how far it is.

    Raises:
        InputError: It is no run folder, of another schema version, or its ``run.json`` is damaged; with ``repair`` also
            if another process writes to it.
    """
    draft = _Draft(run=Run.open(folder))
    _tables(draft, repair)
    _protocol(draft)
    _extra(draft)
    _readings(draft, workers or os.cpu_count() or 1, progress)
    empty = _record(draft)
    for name in (params.COLLECT_FILE, params.ENVIRONMENT_FILE, params.SENSOR_FILE):
        if not (folder / name).is_file():
            draft.add("missing", name, "is not there; TacTip toolchains look for it")
        elif not _is_json(folder / name):
            draft.add("unreadable", name, "is not valid JSON")
    return RunReport(
        folder=folder,
        name=draft.run.info.printed.name,
        simulated=draft.run.info.simulated,
        planned=len(draft.run.info.presses),
        presses=draft.counts["presses"],
        references=draft.counts["references"],
        stationary=draft.counts["stationary"],
        out_of_band=draft.counts["out_of_band"],
        findings=tuple(draft.findings),
        repaired=tuple(draft.repaired),
        empty_fields=empty,
    )


def _record(draft: _Draft) -> tuple[str, ...]:
    """What is wrong with ``print.toml``; the fields that are empty."""
    try:
        record = draft.run.print_record
    except InputError as error:
        draft.add("record", schema.PRINT_FILE, str(error))
        return ()
    for photo in record.values.get("photos", ()):
        if not (draft.run.folder / photo).is_file():
            draft.add("record", schema.PRINT_FILE, f"names the photo {photo}, which is not in the run folder")
    return record.empty


def _is_json(path: Path) -> bool:
    try:
        json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError):
        return False
    return True


def _tables(draft: _Draft, repair: bool) -> None:
    """The three CSV files: their rows, and what is wrong with single rows."""
    run, folder = draft.run, draft.run.folder
    for name, columns in (
        (schema.TARGETS_FILE, schema.COLUMNS),
        (schema.REFERENCES_FILE, schema.REFERENCE_COLUMNS),
        (schema.STATIONARY_FILE, schema.STATIONARY_COLUMNS),
    ):
        path = folder / name
        faults: list[InputError] = []
        try:
            lines = read_lines(path, columns, faults)
            if lines.torn and repair:
                draft.repaired.append(f"{name}: cut off a torn last row of {_cut(folder, path, columns)} bytes")
            elif lines.torn:
                draft.add("torn", name, "ends in a torn row; --repair cuts it off, and its press is then made again")
            if name == schema.TARGETS_FILE:
                rows = read_rows(run.info, path, lines.rows, faults)
                draft.expected += [
                    _Expected(path=schema.reading_path(row.sensor_image), digest=row.image_sha256) for row in rows
                ]
                draft.counts["out_of_band"] = sum(row.in_band is False for row in rows)
                draft.counts["presses"] = len(rows)
                _gaps(draft, {row.number for row in rows})
            else:
                others = run.references if name == schema.REFERENCES_FILE else run.stationary_readings
                draft.expected += [_Expected(path=one.path, digest=one.image_sha256) for one in others]
        except InputError as error:
            faults.append(error)
        for fault in faults:
            kind = "duplicate" if "already" in fault.allowed else "row"
            draft.add(kind, name, str(fault).removeprefix(f"{folder}{os.sep}"))


def _cut(folder: Path, path: Path, columns: Sequence[str]) -> int:
    """Cut off a torn last row while nobody else writes; return its length."""
    with locked(folder):
        lines = read_lines(path, columns, [])
        with refusing(path.parent), path.open("rb+") as stream:
            stream.truncate(lines.whole_bytes)
            stream.flush()
            os.fsync(stream.fileno())
        return len(lines.torn)


def _gaps(draft: _Draft, there: set[int]) -> None:
    missing = [press.number for press in draft.run.info.presses if press.number not in there]
    if missing:
        planned = len(draft.run.info.presses)
        draft.add("gap", "protocol", f"{len(missing)} of {counted(planned, 'press')} missing: {ranges(missing)}")


def _protocol(draft: _Draft) -> None:
    """References and stationary readings that the protocol asks for; imported runs have none."""
    info = draft.run.info
    try:
        draft.counts["references"] = len(draft.run.references)
        still = draft.run.stationary_readings
    except InputError:
        return
    draft.counts["stationary"] = len(still)
    if not draft.run.references and not info.source:
        draft.add("gap", "references", "there is no reading without contact")
    for when in ("start", "end"):
        for in_contact in (True, False):
            have = {one.index for one in still if one.when == when and one.in_contact == in_contact}
            lacking = sorted(set(range(1, info.protocol.stationary_frames + 1)) - have)
            if lacking:
                what = "in contact" if in_contact else "without contact"
                draft.add(
                    "gap",
                    schema.STATIONARY_FOLDER,
                    f"{len(lacking)} of {info.protocol.stationary_frames} readings {what} at the {when} missing",
                )


def _extra(draft: _Draft) -> None:
    """Files that no row names; and rows that name the same file."""
    counted = Counter(one.path for one in draft.expected)
    for path, times in counted.items():
        if times > 1:
            draft.add("duplicate", path, f"is named by {times} rows")
    tables = (schema.REFERENCES_FILE, schema.STATIONARY_FILE)
    for name in (schema.IMAGE_FOLDER, schema.DATA_FOLDER, schema.REFERENCE_FOLDER, schema.STATIONARY_FOLDER):
        sub = draft.run.folder / name
        if not sub.is_dir():
            continue
        for entry in sorted(os.scandir(sub), key=lambda one: one.name):
            path = f"{name}/{entry.name}"
            if path not in counted and path not in tables:
                draft.add("extra", path, "has no row: an interrupted press (made again when the run goes on) or yours")


def _readings(draft: _Draft, workers: int, progress: Progress | None) -> None:
    expected = list({one.path: one for one in draft.expected}.values())
    limits = limits_of(draft.run.info)
    first: dict[str, str] = {}
    with ThreadPoolExecutor(workers) as pool:
        judged = pool.map(lambda one: _judge(draft.run, one, limits), expected)
        for number, (one, (digest, findings)) in enumerate(zip(expected, judged, strict=True), start=1):
            draft.findings += findings
            if digest and digest in first:
                draft.add("stuck", one.path, f"is identical to {first[digest]}: the camera gave an old frame again")
            elif digest:
                first[digest] = one.path
            if progress is not None:
                progress(number, len(expected))


def _judge(run: Run, expected: _Expected, limits: FrameLimits) -> tuple[str | None, list[Finding]]:
    """A reading's own checksum (of an image; else None) and what is wrong with it."""
    path = run.folder / expected.path
    found: list[Finding] = []

    def add(kind: str, text: str) -> None:
        found.append(Finding(kind=kind, where=expected.path, text=text))

    try:
        data = path.read_bytes()
    except FileNotFoundError:
        add("missing", "is not there though a row names it")
        return None, found
    except OSError as error:
        add("unreadable", "is a folder" if path.is_dir() else f"cannot be read: {error.strerror}")
        return None, found
    digest = sha256(data)
    if digest != expected.digest:
        add("checksum", "is not the file that was written: its checksum differs from its row's")
    try:
        reading = decoded(data) if path.suffix == ".png" else read_array(path)
    except (CheckFailedError, OSError) as error:
        add("unreadable", str(error))
        return None, found
    wrong = shape_fault(run.info, reading)
    if wrong:
        add("shape", wrong)
    if path.suffix != ".png":
        return None, found
    if not is_image(reading):
        add("shape", f"is an image of {reading.dtype}, shape {reading.shape}; uint8, grey or BGR belong here")
        return digest, found
    for fault in frame_faults(reading, limits=limits):
        add(fault, f"is {fault}")
    return digest, found


def limits_of(info: RunInfo) -> FrameLimits:
    """When an image of this run is dark or blurred: what its camera was told, else the usual.

    Raises:
        InputError: A limit in ``run.json`` is not allowed.
    """
    try:
        told = info.sensor.get("settings", {}).get("limits", {})
        return FrameLimits(**{name: float(told[name]) for name in ("dark_counts", "blur_px") if name in told})
    except (AttributeError, TypeError, ValueError):
        raise InputError("run.json sensor.settings.limits", None, "must be dark_counts and blur_px, numbers") from None


def ranges(numbers: Sequence[int], most: int = 8) -> str:
    """Rising numbers for people: ``3, 7 to 25, 31``."""
    parts: list[list[int]] = []
    for number in numbers:
        if parts and number == parts[-1][1] + 1:
            parts[-1][1] = number
        else:
            parts.append([number, number])
    shown = [str(low) if low == high else f"{low} to {high}" for low, high in parts[:most]]
    if len(parts) > most:
        shown.append(f"and {sum(high - low + 1 for low, high in parts[most:])} more")
    return ", ".join(shown)
