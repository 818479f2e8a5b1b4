"""Reading run folders: lazily, typed, and without trust in what lies there. Needs NumPy, and OpenCV for images."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.runs import schema
from tacbench_cad.lab.runs.info import IMPORTED_VERSION, SCHEMA, SCHEMA_VERSION, RunInfo
from tacbench_cad.lab.runs.pictures import decoded, sha256
from tacbench_cad.lab.runs.schema import PressKey, Reference, Row, Stationary
from tacbench_cad.lab.runs.table import RunTable, read_table
from tacbench_cad.spec.printrecord import PrintRecord, read_record
from tacbench_cad.util import door
from tacbench_cad.util.errors import CheckFailedError, InputError


@dataclass(frozen=True)
class Run:
    """A run folder. Only ``run.json`` is read at once; rows and frames when they are asked for.

    Args:
        folder: The folder.
        info: What its ``run.json`` says.
    """

    folder: Path
    info: RunInfo

    @classmethod
    def open(cls, folder: Path) -> Run:
        """Open a run folder.

        Raises:
            InputError: It is no run folder, of another schema version, or its ``run.json`` is damaged.
        """
        path = folder / schema.RUN_FILE
        _require_folder(folder)
        if not path.is_file():
            raise InputError("run", str(folder), f"is no run folder: it has no {schema.RUN_FILE}")
        document = door.read_document(path, "run", "json", within=folder)
        if not isinstance(document, dict) or document.get("schema") != SCHEMA:
            raise InputError("run", str(path), f'is of another kind: "schema" must be "{SCHEMA}"')
        version = document.get("version")
        if version not in (SCHEMA_VERSION, IMPORTED_VERSION):
            raise InputError(
                "run",
                str(path),
                f"has schema version {version!r}, this program reads {SCHEMA_VERSION} and {IMPORTED_VERSION}; "
                "use the version that wrote it",
            )
        return cls(folder=folder, info=RunInfo.from_dict(document, f"{path}: "))

    @cached_property
    def targets(self) -> RunTable[Row]:
        """``targets.csv``: its rows and their texts; a torn last line is left out.

        Raises:
            InputError: A row cannot be read, contradicts the run, or occurs twice; the message names its line.
        """
        return read_table(self.folder, Row, planned(self.info))

    @property
    def rows(self) -> tuple[Row, ...]:
        """The presses in the order of ``targets.csv``, which may be any.

        Raises:
            InputError: As :attr:`targets`.
        """
        return self.targets.rows

    @cached_property
    def by_key(self) -> dict[PressKey, Row]:
        """The rows by (force level, repeat, position)."""
        return {row.key: row for row in self.rows}

    @cached_property
    def references(self) -> tuple[Reference, ...]:
        """The frames without contact, the first one first.

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
    def print_record(self) -> PrintRecord:
        """What ``print.toml`` says of the print.

        Raises:
            InputError: It is missing or damaged.
        """
        return read_record(self.folder / schema.PRINT_FILE, within=self.folder)

    def parameters(self, name: str) -> Any:
        """The plain values of one of the JSON files that TacTip toolchains look for.

        Raises:
            InputError: It is missing or damaged.
        """
        return door.read_document(self.folder / name, "parameters", "json", within=self.folder)

    def frame(self, row: Row, verify: bool = False) -> Frame:
        """The frame of a press.

        Args:
            row: Its row.
            verify: Compare the file with the row's checksum as well.

        Returns:
            An array of the sensor's shape; an image is uint8, BGR if it has colours.

        Raises:
            CheckFailedError: The file is missing, damaged, or of another shape; with ``verify`` also if it was changed.
        """
        return self.read(row.path, row.image_sha256 if verify else None)

    def reference(self, number: int = 0) -> Frame:
        """A frame without contact: the first one, or a later one.

        Raises:
            InputError: There is no such reference.
            CheckFailedError: As :meth:`frame`.
        """
        if not 0 <= number < len(self.references):
            raise InputError("reference", number, f"the run has {len(self.references)} of them, counted from 0")
        return self.read(self.references[number].path)

    def stationary(self, when: str, in_contact: bool) -> list[Frame]:
        """The frames without motion of one group, in their order.

        Args:
            when: ``start`` or ``end`` of the session.
            in_contact: Of the pressed sensor, or of the free one.

        Raises:
            CheckFailedError: As :meth:`frame`.
        """
        group = [frame for frame in self.stationary_frames if (frame.when, frame.in_contact) == (when, in_contact)]
        return [self.read(frame.path) for frame in sorted(group, key=lambda frame: frame.index)]

    def read(self, path: str, digest: str | None = None) -> Frame:
        """A frame by its path from the run folder.

        Args:
            path: The path.
            digest: The SHA-256 that the file must have.

        Raises:
            CheckFailedError: As :meth:`frame`.
        """
        data = self.read_bytes(path, digest)
        try:
            frame = decoded(data, path)
        except CheckFailedError as error:
            raise CheckFailedError(f"{self.folder / path}: {error}") from None
        fault = shape_fault(self.info, frame)
        if fault:
            raise CheckFailedError(f"{self.folder / path}: {fault}")
        return frame

    def read_bytes(self, path: str, digest: str | None = None) -> bytes:
        """The bytes of a frame's file, by its path from the run folder.

        Args:
            path: The path.
            digest: The SHA-256 that the file must have.

        Raises:
            CheckFailedError: It cannot be read, is too large, is a link that leads out of the folder, or was changed.
        """
        try:
            data = door.read_bytes(self.folder / path, "frame", "image", within=self.folder)
        except InputError as error:
            raise CheckFailedError(f"{self.folder / path}: {error.allowed}") from None
        if digest is not None and sha256(data) != digest:
            raise CheckFailedError(f"{self.folder / path}: is not the file that was written: its checksum differs")
        return data


def shape_fault(info: RunInfo, frame: Frame) -> str | None:
    """What is wrong with a frame's shape or type, or None."""
    shape = info.frame_shape
    if shape is not None and frame.shape != shape:
        return f"has shape {frame.shape}, the sensor gives {shape}"
    if frame.dtype.kind not in "iufb":
        return f"holds {frame.dtype}, not real numbers"
    return None


def planned(info: RunInfo) -> Callable[[int, Any], None]:
    """A check of one row of ``targets.csv`` after another: it is of the run's plan and block, and not there already.

    The rows of a run without a protocol are its plan.
    """
    plan = {press.number: press for press in info.presses}
    block = info.printed
    seen: dict[PressKey | int, int] = {}

    def check(line: int, row: Row) -> None:
        press = plan.get(row.number)
        if press is None and info.protocol is not None:
            raise InputError("sensor_image", row.sensor_image, f"the protocol has {len(plan)} presses")
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
        if any(getattr(row, name) != getattr(block, name) for name in ("texture", "printer", "filament", "copy")):
            raise InputError("texture", row.texture, f"the run is of {block.name}")
        for key in (row.key, row.number):
            if seen.setdefault(key, line) != line:
                raise InputError("sensor_image", row.sensor_image, f"stands in line {seen[key]} already")

    return check


def find_runs(folders: Iterable[Path]) -> list[Path]:
    """The run folders among and below some folders, each once, in order.

    Args:
        folders: Run folders, or folders that contain some.

    Raises:
        InputError: One is no folder, or has no run in it.
    """
    runs: dict[Path, None] = {}
    for folder in folders:
        _require_folder(folder)
        here = sorted(_walk(folder))
        if not here:
            raise InputError("run", str(folder), f"has no run folder in it (none has a {schema.RUN_FILE})")
        runs.update(dict.fromkeys(here))
    return list(runs)


def _walk(folder: Path) -> Iterator[Path]:
    for here, below, files in os.walk(folder):
        if schema.RUN_FILE in files or schema.TARGETS_FILE in files:
            below.clear()
            yield Path(here)


def _require_folder(folder: Path) -> None:
    if not folder.is_dir():
        raise InputError("run", str(folder), "is not a folder" if folder.exists() else "there is no such folder")
