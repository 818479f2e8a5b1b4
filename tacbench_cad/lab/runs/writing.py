"""Writing a run folder so that it can be interrupted at any instant and resumed.

A frame's file is forced to the disk, with its folder, before its row is written; the row is forced to the disk before
the next press may begin. A frame without a row therefore counts as never taken, and its press is made again.
"""

from __future__ import annotations

import os
import platform
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any

from tacbench_cad import __version__
from tacbench_cad.lab.rig.errors import SensorError
from tacbench_cad.lab.rig.gauge import Force
from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.runs import params, schema
from tacbench_cad.lab.runs.info import SCHEMA, RunInfo
from tacbench_cad.lab.runs.pictures import encoded, sha256
from tacbench_cad.lab.runs.reading import Run, planned
from tacbench_cad.lab.runs.schema import Reference, Row, Stationary, T, When
from tacbench_cad.lab.runs.table import GrowingTable, sync_folder
from tacbench_cad.lab.study.presses import Press
from tacbench_cad.lab.study.spec import Point
from tacbench_cad.spec.printrecord import form
from tacbench_cad.util import door
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.files import locked, refusing, write_json, write_text
from tacbench_cad.util.packages import version


@dataclass(frozen=True, kw_only=True)
class FrameFile:
    """A frame as it is stored.

    Args:
        data: The bytes of its file.
        suffix: The ending of its name: ``.png``, ``.jpg`` or ``.npy``.
        sha256: Their SHA-256.
    """

    data: bytes
    suffix: str
    sha256: str

    @classmethod
    def of(cls, data: bytes, suffix: str) -> FrameFile:
        """The file with some bytes."""
        return cls(data=data, suffix=suffix, sha256=sha256(data))


class RunWriter:
    """A run folder that is being written. Made by :meth:`open`, which holds the folder's lock.

    Args:
        folder: The run folder.
        info: The run.
        durable: See :meth:`open`.
        stack: Closes the tables.

    Attributes:
        info: The run.
        done: Numbers of the presses that are there.
        notes: What was repaired when the folder was opened, for the person.
        seconds: Time spent so far in ``encode`` (frames to bytes, checksums) and ``sync`` (writing to the disk).
        reference_time: Time of the last reference, or None.
    """

    def __init__(self, folder: Path, info: RunInfo, durable: bool, stack: ExitStack) -> None:
        def table(kind: type[T], check: Callable[[int, T], None] | None = None) -> GrowingTable[T]:
            return stack.enter_context(GrowingTable(folder, kind, check, durable=durable))

        self.folder = folder
        self.info = info
        self.seconds = {"encode": 0.0, "sync": 0.0}
        self._durable = durable
        self._targets = table(Row, planned(info))
        self._references = table(Reference)
        self._stationary = table(Stationary)
        rows, references = self._targets.rows, self._references.rows
        self.done = {row.number for row in rows}
        self._last_press = rows[-1].number if rows else 0
        self._reference_count = len(references)
        self.reference_time: datetime | None = references[-1].time_utc if references else None
        self._still = {frame.key for frame in self._stationary.rows}
        self.notes = tuple(
            f"{table.path.relative_to(folder)}: cut off a torn last row of {len(table.torn)} bytes; it is taken again"
            for table in (self._targets, self._references, self._stationary)
            if table.torn
        )
        lost = next((folder / row.path for row in rows if not (folder / row.path).is_file()), None)
        if lost is not None:
            advice = "put it back, or delete the row to press again"
            raise InputError(str(lost), None, f"is no file though targets.csv has its row; {advice}")

    @classmethod
    @contextmanager
    def open(cls, folder: Path, info: RunInfo, *, durable: bool = True) -> Iterator[RunWriter]:
        """Begin a run, or resume one.

        Args:
            folder: The run folder; it is made if it does not exist.
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
            if (folder / schema.RUN_FILE).exists():
                Run.open(folder).info.require_same(info, info.printed.name, "restore them or name another folder")
            else:
                _begin(folder, info, durable)
            with refusing(folder):
                for name in (schema.IMAGE_FOLDER, schema.REFERENCE_FOLDER, schema.STATIONARY_FOLDER):
                    (folder / name).mkdir(exist_ok=True)
                if durable:
                    sync_folder(folder)
                    sync_folder(folder.parent)
            writer = cls(folder, info, durable, stack)
            _record_session(folder, info, durable)
            yield writer

    def missing(self, plan: Sequence[Press]) -> tuple[Press, ...]:
        """The presses of a plan that are not there yet, in the plan's order."""
        return tuple(press for press in plan if press.number not in self.done)

    def stationary_missing(self, when: When, in_contact: bool, count: int) -> tuple[int, ...]:
        """Which of ``count`` frames without motion of one group (numbered from 1) are not there yet."""
        return tuple(index for index in range(1, count + 1) if (when, in_contact, index) not in self._still)

    def reference(self, frame: Frame, time_utc: datetime) -> None:
        """Keep a frame without contact.

        Args:
            frame: The frame.
            time_utc: When it was taken.

        Raises:
            SensorError: The frame has another shape than the sensor's.
            InputError: The disk is full, or the folder cannot be written.
        """
        file = self._encoded(frame)
        path = schema.reference_path(self._reference_count, file.suffix)
        self._store(file, path)
        row = Reference(path=path, time_utc=time_utc, after_press=self._last_press, image_sha256=file.sha256)
        self._append(self._references, row)
        self._reference_count += 1
        self.reference_time = time_utc

    def stationary(self, when: When, in_contact: bool, index: int, frame: Frame) -> None:
        """Keep one of the frames without motion.

        Args:
            when: Before the first press or after the last one.
            in_contact: At the middle force, or without contact.
            index: From 1.
            frame: The frame.

        Raises:
            SensorError: The frame has another shape than the sensor's.
            InputError: It is there already, the disk is full, or the folder cannot be written.
        """
        if (when, in_contact, index) in self._still:
            raise InputError("stationary frame", f"{when} {index}", "is in the run already")
        file = self._encoded(frame)
        path = schema.stationary_path(when, in_contact, index, file.suffix)
        self._store(file, path)
        row = Stationary(path=path, when=when, in_contact=in_contact, index=index, image_sha256=file.sha256)
        self._append(self._stationary, row)
        self._still.add(row.key)

    def press(
        self,
        press: Press,
        pose_mm: Point,
        frame: Frame,
        measured: Force | None = None,
        after: Force | None = None,
        in_band: bool | None = None,
        time_utc: datetime | None = None,
    ) -> str:
        """Keep a press: its frame, then its row.

        Args:
            press: The press, from the run's plan.
            pose_mm: The sensor's summit in the work frame; z is nan where nobody measured it.
            frame: The frame.
            measured: Force before the frame.
            after: Force after the frame.
            in_band: Whether the target was reached; None without a gauge.
            time_utc: When the frame was taken.

        Returns:
            The path of the frame's file from the run folder.

        Raises:
            SensorError: The frame has another shape than the sensor's.
            InputError: The press is there already, the disk is full, or the folder cannot be written.
        """
        age_s = None
        if time_utc is not None and self.reference_time is not None:
            age_s = (time_utc - self.reference_time).total_seconds()
        x, y, z = (round(float(value), 6) for value in pose_mm)
        return self.sample(
            press.number,
            self._encoded(frame),
            pose_x=x,
            pose_y=y,
            pose_z=z,
            position=press.position,
            force_level=press.force_level,
            target_force_n=press.target_n,
            measured_force_n=None if measured is None else round(measured.mean_n, 6),
            force_after_n=None if after is None else round(after.mean_n, 6),
            in_band=None if in_band is None else bool(in_band),
            repeat=press.repeat,
            time_utc=time_utc,
            reference_age_s=None if age_s is None else round(age_s, 3),
        )

    def sample(self, number: int, file: FrameFile, **values: Any) -> str:
        """Keep a frame as the bytes of its file, then its row.

        Args:
            number: Its number, from 1.
            file: The file.
            **values: The fields of its row that the run does not say.

        Returns:
            The path of the file from the run folder.

        Raises:
            InputError: The number is there already, the disk is full, or the folder cannot be written.
        """
        if number in self.done:
            raise InputError("press", number, "is in the run already")
        name = schema.frame_name(number, file.suffix)
        row = Row(**schema.block_values(self.info.printed), sensor_image=name, image_sha256=file.sha256, **values)
        self._store(file, row.path)
        self._append(self._targets, row)
        self.done.add(number)
        self._last_press = number
        return row.path

    def _encoded(self, frame: Frame) -> FrameFile:
        """A frame as its file.

        Raises:
            SensorError: It has another shape than the sensor's.
        """
        shape = self.info.frame_shape
        if shape is not None and frame.shape != shape:
            raise SensorError(f"the sensor gave a frame of shape {frame.shape} where the run has {shape}")
        with timed(self.seconds, "encode"):
            return FrameFile.of(*encoded(frame, self.info.simulated))

    def _store(self, file: FrameFile, name: str) -> None:
        """Write a frame's file; with ``durable`` it and its folder's entry are on the disk afterwards.

        Args:
            file: The file.
            name: Its path from the run folder.
        """
        path = self.folder / name
        with timed(self.seconds, "sync"), refusing(path.parent):
            # What is no image has a folder of its own, made when the first such frame comes.
            if not path.parent.exists():
                path.parent.mkdir()
                if self._durable:
                    sync_folder(self.folder)
            with path.open("wb") as stream:
                stream.write(file.data)
                if self._durable:
                    stream.flush()
                    os.fsync(stream.fileno())
                    sync_folder(path.parent)

    def _append(self, table: GrowingTable[T], row: T) -> None:
        with timed(self.seconds, "sync"):
            table.append(row)


@contextmanager
def timed(seconds: dict[str, float], what: str) -> Iterator[None]:
    """Add the time that the body takes to one of the sums."""
    began = time.perf_counter()
    yield
    seconds[what] += time.perf_counter() - began


@cache
def software() -> dict[str, str]:
    """Versions of what a run is made with."""
    versions = {"tacbench-cad": __version__, "python": platform.python_version(), "system": sys.platform}
    for package in ("numpy", "scipy", "opencv-python-headless", "opencv-python", "pyserial"):
        number = version(package)
        if number is not None:
            versions[package] = number
    return versions


def _begin(folder: Path, info: RunInfo, durable: bool) -> None:
    """Write what a new run begins with; ``run.json`` comes last and makes the folder a run."""
    targets = folder / schema.TARGETS_FILE
    if targets.exists() and targets.stat().st_size > 0:
        raise InputError("run folder", str(folder), "holds a targets.csv but no run.json; name another folder")
    for name, parameters in params.PARAMETERS.items():
        write_json(folder / name, parameters(info), durable=durable)
    if not (folder / schema.PRINT_FILE).is_file():
        printed = info.printed
        record = form(f"Record of the print {printed.name}.", printed.printer or "", printed.filament or "")
        write_text(folder / schema.PRINT_FILE, record, durable=durable)
    head = {"schema": SCHEMA, "version": info.version, "name": info.printed.name, "simulated": list(info.simulated)}
    write_json(folder / schema.RUN_FILE, {**head, **info.as_dict(), "sittings": []}, durable=durable)
    if durable:
        with refusing(folder):
            sync_folder(folder)


def _record_session(folder: Path, info: RunInfo, durable: bool) -> None:
    """Note in ``run.json`` when, and with which software and devices, the run was resumed."""
    path = folder / schema.RUN_FILE
    document = door.read_document(path, "run", "json", within=folder)
    sessions = document["sittings"]
    devices = {"stage": info.stage, "gauge": info.gauge, "sensor": info.sensor}
    session = {
        "software": dict(software()),
        "devices": {name: device.get("identity", device.get("name")) for name, device in devices.items()},
    }
    if sessions and {key: value for key, value in sessions[-1].items() if key != "begun_utc"} == session:
        return
    sessions.append({"begun_utc": schema.cell(datetime.now(UTC)), **session})
    write_json(path, document, durable=durable)
