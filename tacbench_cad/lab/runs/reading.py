"""Reading run folders: lazily, typed, and without trust in what lies there. Needs NumPy, and OpenCV for images."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from pathlib import Path

from tacbench_cad.lab.rig.sensor import Reading
from tacbench_cad.lab.runs import schema
from tacbench_cad.lab.runs.info import SCHEMA, SCHEMA_VERSION, RunInfo
from tacbench_cad.lab.runs.npyfile import read_array
from tacbench_cad.lab.runs.pictures import decoded
from tacbench_cad.lab.runs.schema import PressKey, Row
from tacbench_cad.lab.runs.table import Lines, read_lines
from tacbench_cad.lab.study.presses import Press
from tacbench_cad.spec.printrecord import PrintRecord, read_record
from tacbench_cad.util.errors import CheckFailedError, InputError, one_of
from tacbench_cad.util.files import sha256


@dataclass(frozen=True, kw_only=True)
class Reference:
    """A reading without contact.

    Args:
        path: Its file, from the run folder.
        time_utc: When it was taken.
        after_press: Number of the press before it, 0 for none.
        image_sha256: SHA-256 of the file.
    """

    path: str
    time_utc: datetime
    after_press: int
    image_sha256: str


@dataclass(frozen=True, kw_only=True)
class Stationary:
    """A reading without motion.

    Args:
        path: Its file, from the run folder.
        when: ``start`` or ``end`` of the block.
        in_contact: At the middle force, or without contact.
        index: From 1.
        image_sha256: SHA-256 of the file.
    """

    path: str
    when: str
    in_contact: bool
    index: int
    image_sha256: str


@dataclass(frozen=True)
class Run:
    """A run folder. Only ``run.json`` is read at once; rows and readings when they are asked for.

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
        if not folder.is_dir():
            raise InputError("run", str(folder), "is not a folder" if folder.exists() else "there is no such folder")
        if not path.is_file():
            raise InputError("run", str(folder), f"is no run folder: it has no {schema.RUN_FILE}")
        try:
            document = json.loads(path.read_bytes())
        except OSError as error:
            raise InputError("run", str(path), f"cannot be read: {error.strerror}") from None
        except (ValueError, RecursionError):
            raise InputError("run", str(path), "is not valid JSON; put a copy of it back") from None
        if not isinstance(document, dict) or document.get("schema") != SCHEMA:
            raise InputError("run", str(path), f'is of another kind: "schema" must be "{SCHEMA}"')
        version = document.get("version")
        if version != SCHEMA_VERSION:
            raise InputError(
                "run",
                str(path),
                f"has schema version {version!r}, this program reads {SCHEMA_VERSION}; use the version that wrote it",
            )
        try:
            return cls(folder=folder, info=RunInfo.from_dict(document))
        except InputError as error:
            raise InputError(f"{path}: {error.field}", error.value, error.allowed) from None

    @cached_property
    def lines(self) -> Lines:
        """The lines of ``targets.csv`` as texts.

        Raises:
            InputError: See :func:`tacbench_cad.lab.runs.table.read_lines`.
        """
        return read_lines(self.folder / schema.TARGETS_FILE, schema.COLUMNS)

    @cached_property
    def rows(self) -> tuple[Row, ...]:
        """The presses in the order of ``targets.csv``, which may be any; a torn last line is left out.

        Raises:
            InputError: A row cannot be read, contradicts the run, or stands there twice; the message names its line.
        """
        return read_rows(self.info, self.folder / schema.TARGETS_FILE, self.lines.rows)

    @cached_property
    def by_key(self) -> dict[PressKey, Row]:
        """The rows by (force level, repeat, position)."""
        return {row.key: row for row in self.rows}

    @cached_property
    def references(self) -> tuple[Reference, ...]:
        """The readings without contact, the first one first.

        Raises:
            InputError: ``references.csv`` cannot be read.
        """
        path = self.folder / schema.REFERENCES_FILE
        return read_references(path, read_lines(path, schema.REFERENCE_COLUMNS).rows)

    @cached_property
    def stationary_readings(self) -> tuple[Stationary, ...]:
        """The readings without motion.

        Raises:
            InputError: ``stationary.csv`` cannot be read.
        """
        path = self.folder / schema.STATIONARY_FILE
        return read_stationary(path, read_lines(path, schema.STATIONARY_COLUMNS).rows)

    @cached_property
    def print_record(self) -> PrintRecord:
        """What ``print.toml`` says of the print.

        Raises:
            InputError: It is missing or damaged.
        """
        return read_record(self.folder / schema.PRINT_FILE)

    def reading(self, row: Row, verify: bool = False) -> Reading:
        """A press's reading.

        Args:
            row: Its row.
            verify: Compare the file with the row's checksum as well.

        Returns:
            An array of the sensor's shape; an image is uint8, BGR if it has colours.

        Raises:
            CheckFailedError: The file is missing, is no file, damaged, or of another shape; with ``verify`` also if it
                was changed.
        """
        return self.read(schema.reading_path(row.sensor_image), row.image_sha256 if verify else None)

    def reference(self, number: int = 0) -> Reading:
        """A reading without contact: the first one, or a later one.

        Raises:
            InputError: There is no such reference.
            CheckFailedError: As :meth:`reading`.
        """
        if not 0 <= number < len(self.references):
            raise InputError("reference", number, f"the run has {len(self.references)} of them, counted from 0")
        return self.read(self.references[number].path)

    def stationary(self, when: str, in_contact: bool) -> list[Reading]:
        """The readings without motion of one kind, in their order.

        Args:
            when: ``start`` or ``end`` of the sitting.
            in_contact: Of the pressed sensor, or of the free one.

        Raises:
            CheckFailedError: As :meth:`reading`.
        """
        wanted = [one for one in self.stationary_readings if one.when == when and one.in_contact == in_contact]
        return [self.read(one.path) for one in sorted(wanted, key=lambda one: one.index)]

    def read(self, path: str, digest: str | None = None) -> Reading:
        """A reading by its path from the run folder.

        Args:
            path: The path.
            digest: The SHA-256 that the file must have.

        Raises:
            CheckFailedError: As :meth:`reading`.
        """
        file = self.folder / path
        try:
            if digest is not None and sha256(file) != digest:
                raise CheckFailedError("is not the file that was written: its checksum differs")
            reading = decoded(file.read_bytes()) if file.suffix == ".png" else read_array(file)
        except CheckFailedError as error:
            raise CheckFailedError(f"{file}: {error}") from None
        except IsADirectoryError:
            raise CheckFailedError(f"{file}: is a folder") from None
        except OSError as error:
            raise CheckFailedError(f"{file}: cannot be read: {error.strerror}") from None
        wrong = shape_fault(self.info, reading)
        if wrong:
            raise CheckFailedError(f"{file}: {wrong}")
        return reading


def shape_fault(info: RunInfo, reading: Reading) -> str | None:
    """What is wrong with a reading's shape or type, or None."""
    shape = info.reading_shape
    if shape is not None and reading.shape != shape:
        return f"has shape {reading.shape}, the sensor gives {shape}"
    if reading.dtype.kind not in "iufb":
        return f"holds {reading.dtype}, not real numbers"
    return None


def read_rows(
    info: RunInfo,
    path: Path,
    lines: Sequence[tuple[int, dict[str, str]]],
    faults: list[InputError] | None = None,
) -> tuple[Row, ...]:
    """The typed rows of ``targets.csv``.

    Args:
        info: The run.
        path: The file, for messages.
        lines: Line numbers and texts.
        faults: A list to which bad rows are added, where they shall not be raised.

    Raises:
        InputError: See ``Run.rows``.
    """
    plan = {press.number: press for press in info.presses}
    rows: list[Row] = []
    seen: dict[PressKey, int] = {}
    for line, values in lines:
        try:
            with _naming(path, line):
                row = Row.of(values)
                _require_planned(info, row, plan.get(row.number), len(plan))
                if row.key in seen:
                    raise InputError("sensor_image", row.sensor_image, f"stands in line {seen[row.key]} already")
        except InputError as error:
            if faults is None:
                raise
            faults.append(error)
            continue
        seen[row.key] = line
        rows.append(row)
    return tuple(rows)


def read_references(path: Path, lines: Sequence[tuple[int, dict[str, str]]]) -> tuple[Reference, ...]:
    """The typed rows of ``references.csv``.

    Raises:
        InputError: A row cannot be read; the message names its line.
    """
    found = []
    for line, values in lines:
        with _naming(path, line):
            found.append(
                Reference(
                    path=_inside(values["reference"]),
                    time_utc=schema.moment("time_utc", values["time_utc"]),
                    after_press=schema.count("after_press", values["after_press"], least=0),
                    image_sha256=values["image_sha256"],
                )
            )
    return tuple(found)


def read_stationary(path: Path, lines: Sequence[tuple[int, dict[str, str]]]) -> tuple[Stationary, ...]:
    """The typed rows of ``stationary.csv``.

    Raises:
        InputError: A row cannot be read; the message names its line.
    """
    found = []
    for line, values in lines:
        with _naming(path, line):
            found.append(
                Stationary(
                    path=_inside(values["reading"]),
                    when=one_of("when", values["when"], ("start", "end")),
                    in_contact=schema.flag("in_contact", values["in_contact"]),
                    index=schema.count("index", values["index"]),
                    image_sha256=values["image_sha256"],
                )
            )
    return tuple(found)


def _require_planned(info: RunInfo, row: Row, press: Press | None, presses: int) -> None:
    if press is None:
        raise InputError("sensor_image", row.sensor_image, f"the protocol has {presses} presses")
    key = (press.force_level, press.repeat, press.position)
    if row.key != key:
        raise InputError(
            "force_level, repeat, position",
            row.key,
            f"contradicts the protocol, where press {press.number} is {key}",
        )
    if (row.texture, row.printer, row.filament, row.copy) != _block_of(info):
        raise InputError("texture", row.texture, f"the run is of {info.printed.name}")


def _block_of(info: RunInfo) -> tuple[str, str, str, int]:
    return (info.printed.texture, info.printed.printer, info.printed.filament, info.printed.copy)


def _inside(path: str) -> str:
    """A path of the run's own; a row cannot lead elsewhere."""
    parts = path.split("/")
    folders = (schema.IMAGE_FOLDER, schema.DATA_FOLDER, schema.REFERENCE_FOLDER, schema.STATIONARY_FOLDER)
    if len(parts) != 2 or parts[0] not in folders or parts[1] in ("", ".", "..") or "\\" in path:
        raise InputError("path", path, "must be a file in one of the run's own folders")
    return path


@contextmanager
def _naming(path: Path, line: int) -> Iterator[None]:
    """Put file and line in front of an error's field."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{path} line {line}: {error.field}", error.value, error.allowed) from None
