"""Lazy, typed and safe reading of run folders. This module needs NumPy, and OpenCV for images."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from tacbench_cad.lab.rig.sensor import Frame, is_image
from tacbench_cad.lab.runs import schema
from tacbench_cad.lab.runs.frame_files import read_bytes, read_decoded, type_fault
from tacbench_cad.lab.runs.info import SCHEMA, SCHEMA_VERSION, RunInfo
from tacbench_cad.lab.runs.origins import read_origins
from tacbench_cad.lab.runs.printrecord import PrintRecord, read_record
from tacbench_cad.lab.runs.run_tables import RunTable, read_table
from tacbench_cad.lab.runs.schema import PositionCheck, PressKey, Reference, Row, Stationary
from tacbench_cad.lab.runs.series import Series, series_rows
from tacbench_cad.util import untrusted
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.text import natural


@dataclass(frozen=True)
class Run:
    """A run folder. ``run.json`` is read when it is opened; rows and frames are read when they are used.

    Args:
        folder: The folder.
        info: The contents of ``run.json``.
    """

    folder: Path
    info: RunInfo

    @classmethod
    def open(cls, folder: Path) -> Run:
        """Open a run folder.

        Raises:
            InputError: The folder is not a run folder or has another schema version, or its ``run.json`` is damaged.
        """
        path = folder / schema.RUN_FILE
        _require_folder(folder)
        if not path.is_file():
            raise InputError("run", str(folder), f"is not a run folder: it has no {schema.RUN_FILE}")
        document = untrusted.read_document(path, "run", "json", within=folder)
        if not isinstance(document, dict) or document.get("schema") != SCHEMA:
            raise InputError("run", str(path), f'does not describe a run: "schema" must be "{SCHEMA}"')
        version = document.get("version")
        if version != SCHEMA_VERSION:
            advice = "use the version of tacbench-cad that wrote the run"
            text = f"has schema version {version!r}, but this program reads {SCHEMA_VERSION}; {advice}"
            raise InputError("run", str(path), text)
        return cls(folder=folder, info=RunInfo.from_dict(document, f"{path}: "))

    @cached_property
    def targets(self) -> RunTable[Row]:
        """The table ``targets.csv``, without an incomplete last line.

        Raises:
            InputError: A row cannot be read, contradicts the run, or occurs twice. The message names the line.
        """
        return read_table(self.folder, Row, planned(self.info))

    @cached_property
    def origins(self) -> dict[str, dict[str, str]]:
        """What the source of an imported run says about each frame: the texts by column, by the name of the frame.

        The columns ``source_file`` and ``source_frame`` are the file that the frame came from, and its number in this
        file. All others have the names and the texts of the source. It is empty for a run that was not imported.

        Raises:
            InputError: ``source.csv`` cannot be read.
        """
        return read_origins(self.folder)

    @property
    def rows(self) -> tuple[Row, ...]:
        """The presses in the order of ``targets.csv``, which can be any order.

        Raises:
            InputError: Same as for :attr:`targets`.
        """
        return self.targets.rows

    @cached_property
    def by_key(self) -> dict[PressKey, Row]:
        """The rows, by (force level, repeat, position)."""
        return {row.key: row for row in self.rows}

    @cached_property
    def references(self) -> tuple[Reference, ...]:
        """The frames without contact, in the order in which they were taken.

        Raises:
            InputError: ``references.csv`` cannot be read.
        """
        return read_table(self.folder, Reference).rows

    @cached_property
    def stationary_frames(self) -> tuple[Stationary, ...]:
        """The frames without motion.

        Raises:
            InputError: ``stationary.csv`` cannot be read.
        """
        return read_table(self.folder, Stationary).rows

    @cached_property
    def position_checks(self) -> tuple[PositionCheck, ...]:
        """The checks of the position, in the order in which they were made.

        Raises:
            InputError: ``position_checks.csv`` cannot be read.
        """
        return read_table(self.folder, PositionCheck).rows

    @cached_property
    def print_record(self) -> PrintRecord:
        """The contents of ``print.toml``.

        Raises:
            InputError: The file is missing or damaged.
        """
        return read_record(self.folder / schema.PRINT_FILE, within=self.folder)

    def frame(self, row: Row, verify: bool = False) -> Frame:
        """Read the frame of a press.

        Args:
            row: The row of the press.
            verify: Compare the file with the checksum in the row.

        Returns:
            An array of the sensor's shape. An image is uint8; its colours are in the order blue, green, red.

        Raises:
            CheckFailedError: The file is missing or damaged, or has another shape. With ``verify``: it was changed.
        """
        return self.read(row.path, row.image_sha256 if verify else None)

    def series(self, row: Row, verify: bool = False) -> Series:
        """Read the frames of the moving sensor after a press.

        Args:
            row: The row of the press.
            verify: Compare each file with its checksum in the table.

        Returns:
            The series, with as many frames as :attr:`~tacbench_cad.lab.runs.info.RunInfo.series_frames` says.

        Raises:
            InputError: The run has no series, or the table of the series cannot be read.
            CheckFailedError: The series is missing or incomplete, or a frame is as in :meth:`frame`.
        """
        count = self.info.series_frames
        if not count:
            raise InputError("run", self.info.printed.name, "has no series: its protocol has no motion")
        rows = series_rows(self.folder, row.number, count)
        below = schema.series_folder(row.number)
        frames = [self.read(f"{below}/{each.frame}", each.sha256 if verify else None) for each in rows]
        return Series.of(rows, frames, row.pose_from)

    def series_files(self) -> dict[str, str]:
        """Return the paths of the frames of all series, relative to the run folder, with their recorded SHA-256.

        Raises:
            InputError: Same as for :meth:`series`.
            CheckFailedError: A series is missing or incomplete.
        """
        count = self.info.series_frames
        return {
            f"{schema.series_folder(row.number)}/{each.frame}": each.sha256
            for row in (self.rows if count else ())
            for each in series_rows(self.folder, row.number, count)
        }

    def reference(self, number: int = 0) -> Frame:
        """Read a frame without contact. The first has number 0.

        Raises:
            InputError: There is no frame with this number.
            CheckFailedError: Same as for :meth:`frame`.
        """
        if not 0 <= number < len(self.references):
            raise InputError("reference", number, f"the run has {len(self.references)} references, counted from 0")
        return self.read(self.references[number].path)

    def stationary(self, when: str, in_contact: bool) -> list[Frame]:
        """Read a group of frames without motion, in their order.

        Args:
            when: ``start`` or ``end`` of the run.
            in_contact: True for the pressed sensor, False for the free sensor.

        Raises:
            CheckFailedError: Same as for :meth:`frame`.
        """
        group = [frame for frame in self.stationary_frames if (frame.when, frame.in_contact) == (when, in_contact)]
        return [self.read(frame.path) for frame in sorted(group, key=lambda frame: frame.index)]

    def resting_frames(self, most: int) -> list[Frame]:
        """Return images without contact at regular intervals of the run.

        If the run has no frames without contact, other frames are returned. The list is empty if the sensor's frames
        are not images.

        Args:
            most: The largest number of frames.

        Raises:
            InputError: A table of the run cannot be read.
        """
        paths = [reference.path for reference in self.references]
        paths = paths or [row.path for row in sorted(self.rows, key=lambda row: row.number)]
        frames = []
        for at in np.unique(np.linspace(0, len(paths) - 1, most).astype(int)) if paths else ():
            try:
                frames.append(self.read(paths[at]))
            except CheckFailedError:
                continue  # check-runs reports the fault
        return [frame for frame in frames if is_image(frame)]

    def read(self, path: str, digest: str | None = None) -> Frame:
        """Read a frame.

        Args:
            path: The path of the file, relative to the run folder.
            digest: The expected SHA-256 of the file; None to skip the check.

        Raises:
            CheckFailedError: Same as for :meth:`frame`.
        """
        frame = read_decoded(self.folder / path, self.folder, digest)
        fault = shape_fault(self.info, frame)
        if fault:
            raise CheckFailedError(f"{self.folder / path}: {fault}")
        return frame

    def read_bytes(self, path: str, digest: str | None = None) -> bytes:
        """Read the bytes of a frame's file.

        Args:
            path: The path of the file, relative to the run folder.
            digest: The expected SHA-256 of the file; None to skip the check.

        Raises:
            CheckFailedError: The file cannot be read, is too large, is a link out of the folder, or was changed.
        """
        return read_bytes(self.folder / path, self.folder, digest)


def shape_fault(info: RunInfo, frame: Frame) -> str | None:
    """Describe a fault of a frame's shape or type; None if there is none."""
    shape = info.frame_shape
    if shape is not None and frame.shape != shape:
        return f"has shape {frame.shape}, but the frames of the sensor have shape {shape}"
    return type_fault(frame)


def planned(info: RunInfo) -> Callable[[int, Any], None]:
    """Return a function that checks the rows of ``targets.csv`` one by one.

    A row must occur only once. If the run has a protocol, the row must agree with it.
    """
    plan = info.press_by_number
    seen: dict[PressKey | int, int] = {}

    def check(line: int, row: Row) -> None:
        press = plan.get(row.number)
        if press is None and info.protocol is not None:
            raise InputError("sensor_image", row.sensor_image, f"is not planned: the protocol has {len(plan)} presses")
        empty = next((name for name in schema.PLANNED if getattr(row, name) is None), None)
        if press is not None and empty is not None:
            raise InputError(empty, "", "must not be empty in a run with a protocol")
        if press is not None and row.key != (press.force_level, press.repeat, press.position):
            raise InputError(
                "force_level, repeat, position",
                row.key,
                f"contradicts the protocol, where press {press.number} is "
                f"{(press.force_level, press.repeat, press.position)}",
            )
        for key in (row.key, row.number):
            if seen.setdefault(key, line) != line:
                raise InputError("sensor_image", row.sensor_image, f"is already in line {seen[key]}")

    return check


def find_runs(folders: Iterable[Path]) -> list[Path]:
    """Find run folders. Each is returned once, in the order of the folders and their names.

    Args:
        folders: Run folders, or folders that contain run folders.

    Raises:
        InputError: A path is not a folder, or the folder contains no run.
    """
    runs: dict[Path, None] = {}
    for folder in folders:
        _require_folder(folder)
        here = sorted(_walk(folder), key=lambda path: [natural(part) for part in path.parts])
        if not here:
            raise InputError("run", str(folder), f"contains no run folder (a folder with a {schema.RUN_FILE})")
        runs.update(dict.fromkeys(here))
    return list(runs)


def _walk(folder: Path) -> Iterator[Path]:
    for here, below, files in os.walk(folder):
        if schema.RUN_FILE in files or schema.TARGETS_FILE in files:
            below.clear()
            yield Path(here)


def _require_folder(folder: Path) -> None:
    if not folder.is_dir():
        raise InputError("run", str(folder), "is not a folder" if folder.exists() else "does not exist")


def good_checks(rows: Iterable[Row], checks: Iterable[PositionCheck]) -> dict[int, PositionCheck]:
    """Return the first good check of the position after each press, by the number of the press.

    Presses are made in the order of their numbers, and checks are stored in their order. The times say nothing about
    the order, since the computer's clock may be set back.
    """
    numbers = [row.number for row in rows]
    found: dict[int, PositionCheck] = {}
    for check in checks:
        if check.reason == "repeated":
            found.pop(check.after_press, None)
        elif check.ok and check.reason != "first":
            for number in numbers:
                if number <= check.after_press:
                    found.setdefault(number, check)
    return found


def since_good_check(rows: Sequence[Row], checks: Iterable[PositionCheck]) -> list[Row]:
    """Return the presses that no good check of the position has followed, in the order of ``rows``."""
    checked = good_checks(rows, checks)
    return [row for row in rows if row.number not in checked]
