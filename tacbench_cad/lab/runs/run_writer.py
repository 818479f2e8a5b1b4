"""Writing of run folders, which can be interrupted at any time and resumed.

The file of a frame, and the entry of the file in its folder, are forced to the disk before the row is written. The row
is forced to the disk before the next press starts. A frame without a row is ignored, and its press is repeated. The
series of a press is written before the frame of the press.
"""

from __future__ import annotations

import platform
import shutil
import sys
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any

from tacbench_cad import __version__
from tacbench_cad.lab.rig.errors import RigError
from tacbench_cad.lab.rig.gauge import Force
from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.runs import schema
from tacbench_cad.lab.runs.frame_files import FrameFile, encoded
from tacbench_cad.lab.runs.info import SCHEMA, SCHEMA_VERSION, RunInfo
from tacbench_cad.lab.runs.printrecord import form
from tacbench_cad.lab.runs.reading import Run, planned, since_good_check
from tacbench_cad.lab.runs.run_tables import GrowingTable, read_table, sync_folder, table_text
from tacbench_cad.lab.runs.schema import PositionCheck, Reference, Row, Stationary, T, When
from tacbench_cad.lab.runs.series import MovingFrame, require_complete, write_series
from tacbench_cad.lab.study.presses import Press
from tacbench_cad.lab.study.spec import NO_GAUGE, Point
from tacbench_cad.util import untrusted
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.files import locked, refusing, write_json, write_text
from tacbench_cad.util.packages import version


class RunWriter:
    """A run folder that is being written. Use :meth:`open`, which holds the folder's lock, to make one.

    Args:
        folder: The run folder.
        info: The description of the run.
        durable: Same as for :meth:`open`.
        stack: The exit stack that closes the tables.
        optional: Same as for :meth:`open`.

    Attributes:
        info: The description of the run.
        done: The numbers of the presses that the run has.
        notes: Notes for the user about repairs that were made when the folder was opened.
        reference_time: The time of the last reference; None if there is none.
    """

    def __init__(self, folder: Path, info: RunInfo, durable: bool, stack: ExitStack, optional: Collection[str]) -> None:
        self.folder = folder
        self.info = info
        self._durable = durable
        self._stack = stack
        self._optional = optional
        self._targets = self._table(Row, planned(info), optional)
        self._references = self._table(Reference)
        self._stationary = self._table(Stationary)
        self._checks: GrowingTable[PositionCheck] | None = None
        rows, references = self._targets.rows, self._references.rows
        self.done = {row.number for row in rows}
        #: The rows in the order of the presses, and the checks of the position.
        self.rows = list(rows)
        self.checks = list(read_table(folder, PositionCheck).rows)
        self._last_press = rows[-1].number if rows else 0
        self._reference_count = len(references)
        self.reference_time: datetime | None = references[-1].time_utc if references else None
        self._still = {frame.key for frame in self._stationary.rows}
        self.notes = tuple(
            f"{table.path.relative_to(folder)}: removed an incomplete last row of {len(table.torn)} bytes; "
            "its frame is taken again"
            for table in (self._targets, self._references, self._stationary)
            if table.torn
        )
        needed = [path for row in rows for path in self._paths(row)]
        lost = next((folder / path for path in needed if not (folder / path).is_file()), None)
        if lost is not None:
            advice = "restore the file, or delete its row to repeat the press"
            raise InputError(str(lost), None, f"is missing, but targets.csv has a row for it; {advice}")
        # The last session may have ended between a bad check and its consequence.
        if self.checks and not self.checks[-1].ok:
            self._set_aside(self._still_wrong())

    def _paths(self, row: Row) -> list[str]:
        """Return the paths of a press's frame and, if the run has series, of its table."""
        table = f"{schema.series_folder(row.number)}/{schema.SERIES_FILE}"
        return [row.path, table] if self.info.series_frames else [row.path]

    def _table(
        self, kind: type[T], check: Callable[[int, T], None] | None = None, optional: Collection[str] = ()
    ) -> GrowingTable[T]:
        table = GrowingTable(self.folder, kind, check, durable=self._durable, optional=optional)
        return self._stack.enter_context(table)

    @classmethod
    @contextmanager
    def open(
        cls, folder: Path, info: RunInfo, *, durable: bool = True, optional: Collection[str] | None = None
    ) -> Iterator[RunWriter]:
        """Start a run or resume it.

        Args:
            folder: The run folder, which is created if it does not exist.
            info: The description of the run.
            durable: Force every file to the disk. Use False for runs that can be made again (simulations, imports):
                no data are lost if the process is killed, but a power cut may lose some.
            optional: The optional fields of :class:`~tacbench_cad.lab.runs.schema.Row` that the rows have; None for
                those that follow from the protocol.

        Yields:
            The writer.

        Raises:
            InputError: Another process is writing to the folder; the folder contains a run with other settings (which
                the message names) or of another schema version, or something else; or it cannot be written. No data
                are lost.
        """
        with locked(folder), ExitStack() as stack:
            if (folder / schema.RUN_FILE).exists():
                advice = "restore these settings, or choose another folder"
                Run.open(folder).info.require_same(info, info.printed.name, advice)
            else:
                _begin(folder, info, durable)
            with refusing(folder):
                for name in (schema.IMAGE_FOLDER, schema.REFERENCE_FOLDER, schema.STATIONARY_FOLDER):
                    (folder / name).mkdir(exist_ok=True)
                if durable:
                    sync_folder(folder)
                    sync_folder(folder.parent)
            writer = cls(folder, info, durable, stack, planned_fields(info) if optional is None else optional)
            _record_session(folder, info, durable)
            yield writer

    def missing(self, plan: Sequence[Press]) -> tuple[Press, ...]:
        """Return the presses of a plan that the run does not have yet, in the order of the plan."""
        return tuple(press for press in plan if press.number not in self.done)

    def stationary_missing(self, when: When, in_contact: bool, count: int) -> tuple[int, ...]:
        """Return the numbers, from 1 to ``count``, of a group's frames without motion that are still missing."""
        return tuple(index for index in range(1, count + 1) if (when, in_contact, index) not in self._still)

    def reference(self, frame: Frame, time_utc: datetime | None) -> None:
        """Store a frame without contact.

        Args:
            frame: The frame.
            time_utc: The time of the frame; None if it is unknown.

        Raises:
            RigError: The frame has another shape than the sensor's.
            InputError: The disk is full, or the folder cannot be written.
        """
        file = self._encoded(frame)
        path = schema.reference_path(self._reference_count, file.suffix)
        self._store(file, path)
        row = Reference(path=path, time_utc=time_utc, after_press=self._last_press, image_sha256=file.sha256)
        self._references.append(row)
        self._reference_count += 1
        self.reference_time = time_utc

    def stationary(self, when: When, in_contact: bool, index: int, frame: Frame) -> None:
        """Store a frame without motion.

        Args:
            when: ``start`` (before the first press) or ``end`` (after the last press).
            in_contact: True for a frame at the middle force, False for a frame without contact.
            index: The number within the group, from 1.
            frame: The frame.

        Raises:
            RigError: The frame has another shape than the sensor's.
            InputError: The run already has this frame, the disk is full, or the folder cannot be written.
        """
        if (when, in_contact, index) in self._still:
            raise InputError("stationary frame", f"{when} {index}", "is already in the run")
        file = self._encoded(frame)
        path = schema.stationary_path(when, in_contact, index, file.suffix)
        self._store(file, path)
        row = Stationary(path=path, when=when, in_contact=in_contact, index=index, image_sha256=file.sha256)
        self._stationary.append(row)
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
        moving: Sequence[MovingFrame] = (),
        reference_age_s: float | None = None,
        touch_mm: float | None = None,
    ) -> str:
        """Store a press: first its series, then its frame, then its row.

        Args:
            press: The press, from the run's plan.
            pose_mm: The position of the sensor's summit in the work frame; z is nan if it was not measured.
            frame: The frame.
            measured: The force before the frame.
            after: The force after the frame.
            in_band: Whether the target force was reached; None without a gauge.
            time_utc: The time of the frame.
            moving: The frames of the series, in a run with a motion.
            reference_age_s: The age of the last reference in s; None to compute it from the times.
            touch_mm: The height of the first contact from which a depth was measured, in mm of the work frame.

        Returns:
            The path of the frame's file, relative to the run folder.

        Raises:
            RigError: The frame has another shape than the sensor's.
            InputError: The run already has this press, the disk is full, or the folder cannot be written.
        """
        age_s = reference_age_s
        if age_s is None and time_utc is not None and self.reference_time is not None:
            age_s = (time_utc - self.reference_time).total_seconds()
        require_complete(press.number, moving, self.info.series_frames)
        if moving and press.number not in self.done:
            files = [self._encoded(each.frame) for each in moving]
            with refusing(self.folder):
                write_series(self.folder, press.number, moving, files, self._durable)
        return self.sample(
            press.number,
            self._encoded(frame),
            **schema.pose_values(pose_mm),
            position=press.position,
            force_level=press.force_level,
            target_force_n=press.target_n,
            target_depth_mm=press.depth_mm,
            touch_height_mm=None if touch_mm is None else round(touch_mm, 6),
            pose_from=moving[0].pose_from if moving else None,
            measured_force_n=None if measured is None else round(measured.mean_n, 6),
            force_after_n=None if after is None else round(after.mean_n, 6),
            in_band=None if in_band is None else bool(in_band),
            repeat=press.repeat,
            time_utc=time_utc,
            reference_age_s=None if age_s is None else round(age_s, 3),
        )

    def sample(self, number: int, file: FrameFile, **values: Any) -> str:
        """Store the file of a frame, then its row.

        Args:
            number: The number of the frame, from 1.
            file: The file.
            **values: The fields of the row that do not follow from the run.

        Returns:
            The path of the file, relative to the run folder.

        Raises:
            InputError: The run already has this number, the disk is full, or the folder cannot be written.
        """
        if number in self.done:
            raise InputError("press", number, "is already in the run")
        if any(check.ok and check.after_press >= number for check in self.checks):
            # The user has deleted the row of a press that was checked. The check says nothing about the new press.
            self._check(PositionCheck(time_utc=datetime.now(UTC), reason="repeated", after_press=number, ok=True))
        name = schema.frame_name(number, file.suffix)
        row = Row(sensor_image=name, image_sha256=file.sha256, **values)
        self._store(file, row.path)
        self._targets.append(row)
        self.rows.append(row)
        self.done.add(number)
        self._last_press = number
        return row.path

    @property
    def unchecked(self) -> list[Row]:
        """The rows of the presses since the last good check of the position."""
        return since_good_check(self.rows, self.checks)

    def position_check(
        self,
        reason: schema.Reason,
        offset_mm: Point | None,
        height_change_mm: float | None,
        ok: bool,
        time_utc: datetime,
    ) -> int:
        """Store a check of the position. After a bad one, set aside all presses since the last good one.

        Their rows, frames and series are moved to ``set_aside/NN``, where NN is the number of the check. The presses
        are then missing in the run.

        Args:
            reason: The reason for the check.
            offset_mm: The true minus the reported position, measured at the end stops; None if it is unknown.
            height_change_mm: The height of a repeated press minus its first height; None if it is unknown.
            ok: Whether the position was right.
            time_utc: The time of the check.

        Returns:
            The number of presses that were set aside.

        Raises:
            InputError: The disk is full, or the folder cannot be written.
        """
        x, y, z = (None,) * 3 if offset_mm is None else (round(value, 4) for value in offset_mm)
        check = PositionCheck(
            time_utc=time_utc,
            reason=reason,
            after_press=max(self.done, default=0),
            offset_x_mm=x,
            offset_y_mm=y,
            offset_z_mm=z,
            height_change_mm=None if height_change_mm is None else round(height_change_mm, 4),
            ok=ok,
        )
        wrong = [] if ok else self.unchecked
        self._check(check)
        self._set_aside(wrong)
        return len(wrong)

    def _check(self, check: PositionCheck) -> None:
        if self._checks is None:
            self._checks = self._table(PositionCheck)
        self._checks.append(check)
        self.checks.append(check)

    def _still_wrong(self) -> list[Row]:
        """Return the presses that the last check has found wrong and that are still in the run."""
        aside = self._aside
        if not (aside / schema.TARGETS_FILE).exists():
            return self.unchecked
        # A press may have been made again since.
        wrong = {row.image_sha256 for row in read_table(aside, Row).rows}
        return [row for row in self.unchecked if row.image_sha256 in wrong]

    @property
    def _aside(self) -> Path:
        """The folder of the presses that the last check has found wrong."""
        return self.folder / schema.ASIDE_FOLDER / f"{len(self.checks):02d}"

    def _set_aside(self, wrong: Sequence[Row]) -> None:
        """Move presses out of the run. This can be interrupted at any moment and is then completed on resuming."""
        if not wrong:
            return
        aside, numbers = self._aside, {row.number for row in wrong}
        kept, names = [row for row in self.rows if row.number not in numbers], self._targets.columns
        with refusing(self.folder):
            aside.mkdir(parents=True, exist_ok=True)
            for row in wrong:
                shutil.copyfile(self.folder / row.path, aside / row.sensor_image)
                below = schema.series_folder(row.number)
                if (self.folder / below).is_dir():
                    shutil.copytree(self.folder / below, aside / below, dirs_exist_ok=True)
            write_text(aside / schema.TARGETS_FILE, table_text(names, wrong), durable=self._durable)
            self._targets.close()
            write_text(self.folder / schema.TARGETS_FILE, table_text(names, kept), durable=self._durable)
            for row in wrong:
                (self.folder / row.path).unlink()
                shutil.rmtree(self.folder / schema.series_folder(row.number), ignore_errors=True)
        self._targets = self._table(Row, planned(self.info), self._optional)
        self.rows = kept
        self.done -= numbers
        self._last_press = kept[-1].number if kept else 0

    def _encoded(self, frame: Frame) -> FrameFile:
        """Encode a frame.

        Raises:
            RigError: The frame has another shape than the sensor's.
        """
        shape = self.info.frame_shape
        if shape is not None and frame.shape != shape:
            stated = f"but the shape of its driver is {shape} (height, width, and channels of colour)"
            raise RigError(f"the sensor returned a frame of shape {frame.shape}, {stated}")
        return FrameFile.of(*encoded(frame, self.info.simulated))

    def _store(self, file: FrameFile, name: str) -> None:
        """Write a frame's file. With ``durable``, the file and its entry in the folder are then on the disk.

        Args:
            file: The file.
            name: The path, relative to the run folder.
        """
        path = self.folder / name
        with refusing(path.parent):
            # Frames that are not images have their own folder. It is created for the first of them.
            if not path.parent.exists():
                path.parent.mkdir()
                if self._durable:
                    sync_folder(self.folder)
            file.write(path, durable=self._durable)
            if self._durable:
                sync_folder(path.parent)


def planned_fields(info: RunInfo) -> set[str]:
    """Return the optional fields that the rows of a run with a protocol have."""
    targets = info.plan.protocol.targets
    names = {"time_utc", "reference_age_s"}
    names |= {"target_force_n", "in_band"} if targets.contact == "force" else {"target_depth_mm", "touch_height_mm"}
    names |= {"measured_force_n", "force_after_n"} if info.gauge.get("identity") != NO_GAUGE else set()
    return names | ({"pose_from"} if info.series_frames else set())


@cache
def software() -> dict[str, str]:
    """Return the versions of the software that records a run."""
    versions = {"tacbench-cad": __version__, "python": platform.python_version(), "system": sys.platform}
    for package in ("numpy", "scipy", "opencv-python-headless", "opencv-python", "pyserial"):
        number = version(package)
        if number is not None:
            versions[package] = number
    return versions


def _begin(folder: Path, info: RunInfo, durable: bool) -> None:
    """Write the files of a new run. ``run.json`` is written last, because it makes the folder a run folder."""
    targets = folder / schema.TARGETS_FILE
    if targets.exists() and targets.stat().st_size > 0:
        raise InputError("run folder", str(folder), "has a targets.csv but no run.json; choose another folder")
    if not (folder / schema.PRINT_FILE).is_file():
        printed = info.printed
        record = form(
            f"Record of the print {printed.name}.", printer=printed.printer or "", filament=printed.filament or ""
        )
        write_text(folder / schema.PRINT_FILE, record, durable=durable)
    head = {"schema": SCHEMA, "version": SCHEMA_VERSION, "name": info.printed.name, "simulated": list(info.simulated)}
    write_json(folder / schema.RUN_FILE, {**head, **info.as_dict(), "sessions": []}, durable=durable)
    if durable:
        with refusing(folder):
            sync_folder(folder)


def _record_session(folder: Path, info: RunInfo, durable: bool) -> None:
    """Record in ``run.json`` when the run was started or resumed, and with which software and devices."""
    path = folder / schema.RUN_FILE
    document = untrusted.read_document(path, "run", "json", within=folder)
    sessions = document.setdefault("sessions", [])
    devices = {"stage": info.stage, "gauge": info.gauge, "sensor": info.sensor}
    session = {
        "software": dict(software()),
        "devices": {name: device.get("identity", device.get("name")) for name, device in devices.items()},
    }
    if sessions and {key: value for key, value in sessions[-1].items() if key != "begun_utc"} == session:
        return
    sessions.append({"begun_utc": schema.cell(datetime.now(UTC)), **session})
    write_json(path, document, durable=durable)
