"""Writing a run folder so that it can be interrupted at any instant and gone on with.

A reading's file is forced to the disk, with its folder, before its row is written; the row is forced to the disk before
the next press may begin. A reading without a row therefore counts as never taken, and its press is made again.
"""

from __future__ import annotations

import json
import os
import platform
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any, Literal

from tacbench_cad import __version__
from tacbench_cad.lab.rig.errors import SensorError
from tacbench_cad.lab.rig.gauge import Force
from tacbench_cad.lab.rig.sensor import Reading
from tacbench_cad.lab.runs import params, schema
from tacbench_cad.lab.runs.info import SCHEMA, SCHEMA_VERSION, RunInfo
from tacbench_cad.lab.runs.pictures import encoded, sha256
from tacbench_cad.lab.runs.reading import Run, read_references, read_rows, read_stationary
from tacbench_cad.lab.runs.table import GrowingTable, sync_folder
from tacbench_cad.lab.study.presses import Press
from tacbench_cad.lab.study.spec import Point
from tacbench_cad.spec.printrecord import form
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.files import locked, refusing, replacing

When = Literal["start", "end"]


class RunWriter:
    """A run folder that is being written. Made by :meth:`open`, which holds the folder's lock.

    Args:
        folder: The run folder.
        info: The run.
        durable: See :meth:`open`.
        tables: Targets, references and stationary readings, open.

    Attributes:
        info: The run.
        done: Numbers of the presses that are there.
        notes: What was repaired when the folder was opened, for the person.
        seconds: Time spent so far in ``encode`` (readings to bytes, checksums) and ``sync`` (writing to the disk).
        reference_time: When the last reference was read, or None.
    """

    def __init__(
        self,
        folder: Path,
        info: RunInfo,
        durable: bool,
        tables: tuple[GrowingTable, GrowingTable, GrowingTable],
    ) -> None:
        self.folder = folder
        self.info = info
        self.seconds = {"encode": 0.0, "sync": 0.0}
        self._durable = durable
        self._targets, self._references, self._stationary = tables
        rows = read_rows(info, self._targets.path, self._targets.rows)
        self.done = {row.number for row in rows}
        self._last_press = rows[-1].number if rows else 0
        references = read_references(self._references.path, self._references.rows)
        self._reference_count = len(references)
        self.reference_time: datetime | None = references[-1].time_utc if references else None
        still = read_stationary(self._stationary.path, self._stationary.rows)
        self._still = {(one.when, one.in_contact, one.index) for one in still}
        self.notes = tuple(
            f"{table.path.relative_to(folder)}: cut off a torn last row of {len(table.torn)} bytes; it is taken again"
            for table in tables
            if table.torn
        )
        _require_files(folder, [row.sensor_image for row in rows])

    @classmethod
    @contextmanager
    def open(cls, folder: Path, info: RunInfo, *, durable: bool = True) -> Iterator[RunWriter]:
        """Begin a run, or go on with one.

        Args:
            folder: The run folder; it is made if it is not there.
            info: The run as it is to be made.
            durable: Force every file to the disk. False for what can be made again from its source (simulations,
                imports): a kill then still loses nothing, a power cut may.

        Yields:
            The writer.

        Raises:
            InputError: The folder is held by another process, holds a run that differs (the message names what), a
                run of another schema version or something else, or cannot be written. Nothing is lost.
        """
        with locked(folder), ExitStack() as stack:
            begun = (folder / schema.RUN_FILE).exists()
            if begun:
                _require_same(Run.open(folder).info, info)
            else:
                _begin(folder, info)
            with refusing(folder):
                for name in (schema.IMAGE_FOLDER, schema.REFERENCE_FOLDER, schema.STATIONARY_FOLDER):
                    (folder / name).mkdir(exist_ok=True)
                if durable:
                    sync_folder(folder)
                    sync_folder(folder.parent)
            tables = (
                stack.enter_context(GrowingTable(folder / schema.TARGETS_FILE, schema.COLUMNS, durable=durable)),
                stack.enter_context(
                    GrowingTable(folder / schema.REFERENCES_FILE, schema.REFERENCE_COLUMNS, durable=durable)
                ),
                stack.enter_context(
                    GrowingTable(folder / schema.STATIONARY_FILE, schema.STATIONARY_COLUMNS, durable=durable)
                ),
            )
            writer = cls(folder, info, durable, tables)
            _record_sitting(folder, info)
            yield writer

    def missing(self, plan: Sequence[Press]) -> tuple[Press, ...]:
        """The presses of a plan that are not there yet, in the plan's order."""
        return tuple(press for press in plan if press.number not in self.done)

    def stationary_missing(self, when: When, in_contact: bool, count: int) -> tuple[int, ...]:
        """Which of ``count`` stationary readings (numbered from 1) are not there yet."""
        return tuple(index for index in range(1, count + 1) if (when, in_contact, index) not in self._still)

    def reference(self, reading: Reading, time_utc: datetime) -> None:
        """Keep a reading without contact.

        Args:
            reading: The reading.
            time_utc: When it was taken.

        Raises:
            SensorError: The reading has another shape than the sensor's.
            InputError: The disk is full, or the folder cannot be written.
        """
        data, image = self._encoded(reading)
        count = self._reference_count
        name = schema.reference_path(count, image)
        self._store(name, data)
        self._append(self._references, (name, time_utc, self._last_press, sha256(data)))
        self._reference_count = count + 1
        self.reference_time = time_utc

    def stationary(self, when: When, in_contact: bool, index: int, reading: Reading) -> None:
        """Keep one of the readings without motion.

        Args:
            when: Before the first press or after the last one.
            in_contact: At the middle force, or without contact.
            index: From 1.
            reading: The reading.

        Raises:
            SensorError: The reading has another shape than the sensor's.
            InputError: It is there already, the disk is full, or the folder cannot be written.
        """
        if (when, in_contact, index) in self._still:
            raise InputError("stationary reading", f"{when} {index}", "is in the run already")
        data, image = self._encoded(reading)
        name = schema.stationary_path(when, in_contact, index, image)
        self._store(name, data)
        self._append(self._stationary, (name, when, in_contact, index, sha256(data)))
        self._still.add((when, in_contact, index))

    def press(
        self,
        press: Press,
        pose_mm: Point,
        reading: Reading,
        measured: Force | None = None,
        after: Force | None = None,
        in_band: bool | None = None,
        time_utc: datetime | None = None,
    ) -> None:
        """Keep a press: its reading, then its row.

        Args:
            press: The press, from the run's plan.
            pose_mm: Where the sensor's summit was, in the work frame; z is nan where nobody measured it.
            reading: The reading.
            measured: Force before the reading.
            after: Force after the reading.
            in_band: Whether the target was reached; None without a gauge.
            time_utc: When the reading was taken.

        Raises:
            SensorError: The reading has another shape than the sensor's.
            InputError: The press is there already, the disk is full, or the folder cannot be written.
        """
        if press.number in self.done:
            raise InputError("press", press.number, "is in the run already")
        data, image = self._encoded(reading)
        began = time.perf_counter()
        digest = sha256(data)
        self.seconds["encode"] += time.perf_counter() - began
        name = schema.reading_name(press.number, image)
        self._store(schema.reading_path(name), data)
        age = None
        if time_utc is not None and self.reference_time is not None:
            age = (time_utc - self.reference_time).total_seconds()
        values = schema.press_values(
            self.info.printed,
            press,
            name=name,
            pose_mm=pose_mm,
            measured=measured,
            after=after,
            in_band=None if in_band is None else bool(in_band),
            time_utc=time_utc,
            sha256=digest,
            reference_age_s=age,
        )
        self._append(self._targets, values)
        self.done.add(press.number)
        self._last_press = press.number

    def _encoded(self, reading: Reading) -> tuple[bytes, bool]:
        shape = self.info.reading_shape
        if shape is not None and reading.shape != shape:
            raise SensorError(f"the sensor gave a reading of shape {reading.shape} where the run has {shape}")
        began = time.perf_counter()
        made = encoded(reading, self.info.simulated)
        self.seconds["encode"] += time.perf_counter() - began
        return made

    def _store(self, name: str, data: bytes) -> None:
        """Write a reading's file; with ``durable`` it and its folder's entry are on the disk afterwards."""
        path = self.folder / name
        began = time.perf_counter()
        with refusing(path.parent):
            # What is no image has a folder of its own, made when the first such reading comes.
            if not path.parent.exists():
                path.parent.mkdir()
                if self._durable:
                    sync_folder(self.folder)
            with path.open("wb") as stream:
                stream.write(data)
                if self._durable:
                    stream.flush()
                    os.fsync(stream.fileno())
                    sync_folder(path.parent)
        self.seconds["sync"] += time.perf_counter() - began

    def _append(self, table: GrowingTable, values: Sequence[Any]) -> None:
        began = time.perf_counter()
        table.append(values)
        self.seconds["sync"] += time.perf_counter() - began


def software() -> dict[str, str]:
    """Versions of what a run is made with."""
    versions = {"tacbench-cad": __version__, "python": platform.python_version(), "system": sys.platform}
    for package in ("numpy", "scipy", "opencv-python-headless", "opencv-python", "pyserial"):
        try:
            versions[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    return versions


def _require_same(begun: RunInfo, info: RunInfo) -> None:
    differences = begun.differences(info)
    if differences:
        shown = "; ".join(differences[:6]) + (f"; and {len(differences) - 6} more" if len(differences) > 6 else "")
        raise InputError(
            "run", info.printed.name, f"was begun with other settings: {shown}; restore them or name another folder"
        )


def _require_files(folder: Path, names: Sequence[str]) -> None:
    there = {
        sub: {entry.name for entry in os.scandir(folder / sub) if entry.is_file()}
        for sub in (schema.IMAGE_FOLDER, schema.DATA_FOLDER)
        if (folder / sub).is_dir()
    }
    for name in names:
        path = schema.reading_path(name)
        if name not in there.get(path.partition("/")[0], ()):
            raise InputError(
                str(folder / path),
                None,
                "is no file though targets.csv has its row; put it back, or delete the row to press again",
            )


def _begin(folder: Path, info: RunInfo) -> None:
    """Write what a new run begins with; ``run.json`` comes last and makes the folder a run."""
    targets = folder / schema.TARGETS_FILE
    if targets.exists() and targets.stat().st_size > 0:
        raise InputError("run folder", str(folder), "holds a targets.csv but no run.json; name another folder")
    writers: tuple[tuple[str, Callable[[RunInfo], Mapping[str, Any]]], ...] = (
        (params.COLLECT_FILE, params.collect_params),
        (params.ENVIRONMENT_FILE, params.environment_params),
        (params.SENSOR_FILE, params.sensor_params),
    )
    for name, write in writers:
        write_json(folder / name, write(info))
    if not (folder / schema.PRINT_FILE).is_file():
        printed = info.printed
        record = form(f"Record of the print {printed.name}.", printed.printer, printed.filament)
        with replacing(folder / schema.PRINT_FILE) as path:
            path.write_text(record, encoding="utf-8")
    head = {"schema": SCHEMA, "version": SCHEMA_VERSION, "name": info.printed.name, "simulated": list(info.simulated)}
    write_json(folder / schema.RUN_FILE, {**head, **info.as_dict(), "sittings": []})
    with refusing(folder):
        sync_folder(folder)


def _record_sitting(folder: Path, info: RunInfo) -> None:
    """Note in ``run.json`` when, and with which software and devices, the run was gone on with."""
    path = folder / schema.RUN_FILE
    document = json.loads(path.read_text(encoding="utf-8"))
    sittings = document["sittings"]
    devices = {"stage": info.stage, "gauge": info.gauge, "sensor": info.sensor}
    sitting = {
        "software": software(),
        "devices": {name: device.get("identity", device.get("name")) for name, device in devices.items()},
    }
    if sittings and {key: value for key, value in sittings[-1].items() if key != "begun_utc"} == sitting:
        return
    sittings.append({"begun_utc": schema.cell(datetime.now(UTC)), **sitting})
    write_json(path, document)


def write_json(path: Path, document: Mapping[str, Any]) -> None:
    """Write a JSON file that is whole or not there.

    Raises:
        InputError: The folder cannot be written, or is full.
    """
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(document, indent=2, allow_nan=False) + "\n", encoding="utf-8")
