"""The files of a run folder: their names, the columns of the three tables, and the rows as dataclasses.

A press is identified by force level, repeat and position, or by its number if these are unknown. The order of the rows
has no meaning. Unknown values of an imported frame are empty in its row.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields
from datetime import UTC, datetime
from functools import cache, cached_property
from typing import Annotated, Any, ClassVar, Literal, TypeVar, get_args, get_type_hints

from annotated_types import Ge

from tacbench_cad.lab.study.spec import Point
from tacbench_cad.util.convert import from_plain
from tacbench_cad.util.errors import InputError

#: The description of the run, the table with one row for each press, and the print record that the user fills in.
RUN_FILE, TARGETS_FILE, PRINT_FILE = "run.json", "targets.csv", "print.toml"
#: The folders of images, of other arrays, of frames without contact, and of frames without motion.
IMAGE_FOLDER, DATA_FOLDER = "sensor_images", "sensor_data"
REFERENCE_FOLDER, STATIONARY_FOLDER = "references", "stationary"
FRAME_FOLDERS = (IMAGE_FOLDER, DATA_FOLDER, REFERENCE_FOLDER, STATIONARY_FOLDER)
#: The tables of the frames without contact and of the frames without motion.
REFERENCES_FILE = f"{REFERENCE_FOLDER}/references.csv"
STATIONARY_FILE = f"{STATIONARY_FOLDER}/stationary.csv"
#: The folder of the series of moving frames, with a folder for each press, and the table in each of these folders.
SERIES_FOLDER, SERIES_FILE = "series", "series.csv"
#: The table of the checks of the position. It exists from the first check on.
CHECKS_FILE = "position_checks.csv"
#: The folder of the presses that were set aside, since a check showed that the position was wrong.
ASIDE_FOLDER = "set_aside"

#: A number that is counted from 1.
Number = Annotated[int, Ge(1)]
#: (force level, repeat, position), each from 1. An unknown level or position is 0. If the position or the repeat is
#: unknown, the repeat is the number of the frame.
PressKey = tuple[int, int, int]
When = Literal["start", "end"]
#: The origin of a moving frame's pose: the positions that the stage reported during the motion, or the frame's time and
#: the planned motion.
PoseFrom = Literal["reports", "time"]
#: The reasons for a check of the position: presses that an earlier session left unchecked, the first press of a
#: session, the protocol's interval, an unexpected height of contact, a force where the sensor should be free, the end
#: of the block, and a run that was stopped. ``first`` is the repetition of the run's first press at its end, without
#: homing. ``repeated`` is no check: the press ``after_press``, whose row was deleted, is made again after the checks
#: before it.
Reason = Literal["resumed", "start", "interval", "height", "contact", "end", "stopped", "first", "repeated"]
#: The four groups of frames without motion, as (when, in contact), in the order in which they are taken.
STATIONARY: tuple[tuple[When, bool], ...] = (("start", True), ("start", False), ("end", True), ("end", False))

#: The suffixes of images: PNG, and JPEG for imported JPEG files. All other frames are NumPy files.
IMAGE_SUFFIXES = (".png", ".jpg")

_FRAME_NAME = re.compile(r"(?:image_(?P<image>0|[1-9]\d{0,8})\.(?:png|jpg)|reading_(?P<data>0|[1-9]\d{0,8})\.npy)")
_MOVING_NAME = re.compile(r"frame_\d{1,9}\.(?:png|npy)")
_SHA256 = re.compile(r"[0-9a-f]{64}")


def frame_name(number: int, suffix: str) -> str:
    """Return the file name of a press's frame: ``image_7.png`` or ``reading_7.npy``; 0 is the first reference."""
    return f"{'image' if suffix in IMAGE_SUFFIXES else 'reading'}_{number}{suffix}"


def frame_path(name: str) -> str:
    """Return the path of a press's frame, relative to the run folder: ``sensor_images/image_7.png``."""
    return f"{IMAGE_FOLDER if name.endswith(IMAGE_SUFFIXES) else DATA_FOLDER}/{name}"


def reference_path(count: int, suffix: str) -> str:
    """Return the path of a frame without contact. The first is stored with the presses' frames, as number 0."""
    if count == 0:
        return frame_path(frame_name(0, suffix))
    return f"{REFERENCE_FOLDER}/reference_{count}{suffix}"


def stationary_path(when: str, in_contact: bool, index: int, suffix: str) -> str:
    """Return the path of a frame without motion, for example ``stationary/start_contact_01.png``."""
    contact = "contact" if in_contact else "free"
    return f"{STATIONARY_FOLDER}/{when}_{contact}_{index:02d}{suffix}"


def series_folder(number: int) -> str:
    """Return the path of a press's series, relative to the run folder: ``series/press_7``."""
    return f"{SERIES_FOLDER}/press_{number}"


def moving_name(index: int, count: int, suffix: str) -> str:
    """Return the file name of a moving frame, numbered from 1: ``frame_07.png`` in a series of 12."""
    return f"frame_{index:0{max(2, len(str(count)))}d}{suffix}"


def pose_values(mm: Point) -> dict[str, float]:
    """Return the fields of a row for a position of the sensor, rounded to 1 nm."""
    return {f"pose_{axis}": round(float(value), 6) + 0.0 for axis, value in zip("xyz", mm, strict=True)}


class TableRow:
    """A row of a table. ``FILE`` is the path of the table, relative to the run folder."""

    FILE: ClassVar[str]


T = TypeVar("T", bound=TableRow)


#: A column that only some runs have: see :func:`columns`.
_OPTIONAL = {"optional": True}


@dataclass(frozen=True, kw_only=True)
class Row(TableRow):
    """A row of ``targets.csv``, which describes a press. What all presses of a run share is in ``run.json``.

    Unknown values are None, and so are those of columns that the run does not have.

    Args:
        sensor_image: The file name of the frame.
        pose_x: The x of the sensor's summit in the work frame, in mm.
        pose_y: The y of the sensor's summit in the work frame, in mm.
        pose_z: The z of the sensor's summit in the work frame, in mm.
        pose_rx: The rotation of the sensor around x, in degrees; only of imported frames.
        pose_ry: The rotation of the sensor around y, in degrees; only of imported frames.
        pose_rz: The rotation of the sensor around z, in degrees; only of imported frames.
        position: The position, from 1, row by row from the lowest y, and from the lowest x within a row.
        force_level: The level of the force or of the depth, from 1.
        repeat: The repeat, from 1.
        target_force_n: The target force in N; not in depth mode.
        in_band: Whether the target force was reached; not in depth mode.
        target_depth_mm: The target depth below the first contact, in mm; only in depth mode.
        touch_height_mm: The z of the first contact from which the depth was measured, in mm; only in depth mode.
        measured_force_n: The force before the frame, in N; only with a gauge.
        force_after_n: The force after the frame, in N; only with a gauge.
        pose_from: The origin of the poses of the series, see :data:`PoseFrom`; only in runs with a motion.
        time_utc: The time of the frame.
        reference_age_s: The age of the last reference in s; None without a reference.
        image_sha256: The SHA-256 of the frame's file.
    """

    FILE = TARGETS_FILE
    sensor_image: str
    pose_x: float | None
    pose_y: float | None
    pose_z: float | None
    pose_rx: float | None = field(default=None, metadata={"alias": "pose_Rx"} | _OPTIONAL)
    pose_ry: float | None = field(default=None, metadata={"alias": "pose_Ry"} | _OPTIONAL)
    pose_rz: float | None = field(default=None, metadata={"alias": "pose_Rz"} | _OPTIONAL)
    position: Number | None
    force_level: Number | None
    repeat: Number | None
    target_force_n: float | None = field(default=None, metadata=_OPTIONAL)
    in_band: bool | None = field(default=None, metadata=_OPTIONAL)
    target_depth_mm: float | None = field(default=None, metadata=_OPTIONAL)
    touch_height_mm: float | None = field(default=None, metadata=_OPTIONAL)
    measured_force_n: float | None = field(default=None, metadata=_OPTIONAL)
    force_after_n: float | None = field(default=None, metadata=_OPTIONAL)
    pose_from: PoseFrom | None = field(default=None, metadata=_OPTIONAL)
    time_utc: datetime | None = field(default=None, metadata=_OPTIONAL)
    reference_age_s: float | None = field(default=None, metadata=_OPTIONAL)
    image_sha256: str

    def __post_init__(self) -> None:
        if not self.number:
            raise InputError(
                "sensor_image",
                self.sensor_image,
                "must be image_<n>.png, image_<n>.jpg or reading_<n>.npy, where <n> is at least 1",
            )
        if not _SHA256.fullmatch(self.image_sha256):
            raise InputError("image_sha256", self.image_sha256, "must be 64 hexadecimal digits (0-9, a-f)")

    @cached_property
    def number(self) -> int:
        """The number of the press in the plan, from the file name; 0 if the name has another form."""
        name = _FRAME_NAME.fullmatch(self.sensor_image)
        return int(name["image"] or name["data"]) if name else 0

    @property
    def path(self) -> str:
        """The path of the frame's file, relative to the run folder."""
        return frame_path(self.sensor_image)

    @property
    def pose_mm(self) -> Point:
        """The position of the sensor's summit in the work frame, in mm; nan if it was not measured."""
        x, y, z = (math.nan if value is None else value for value in (self.pose_x, self.pose_y, self.pose_z))
        return (x, y, z)

    @property
    def key(self) -> PressKey:
        """The identity of the press, which occurs in only one row."""
        repeat = self.repeat if self.repeat and self.position else self.number
        return (self.force_level or 0, repeat, self.position or 0)


#: The fields of a row that must not be empty in a run with a protocol.
PLANNED = ("pose_x", "pose_y", "position", "force_level", "repeat")


class _FrameRow(TableRow):
    path: str

    def __post_init__(self) -> None:
        parts = self.path.split("/")
        if len(parts) != 2 or parts[0] not in FRAME_FOLDERS or parts[1] in ("", ".", "..") or "\\" in self.path:
            raise InputError("path", self.path, f"must be a file in one of the folders {', '.join(FRAME_FOLDERS)}")


@dataclass(frozen=True, kw_only=True)
class Reference(_FrameRow):
    """A frame without contact.

    Args:
        path: The path of the file, relative to the run folder.
        time_utc: The time of the frame; None if it is unknown.
        after_press: The number of the press before it; 0 if there is none.
        image_sha256: The SHA-256 of the file.
    """

    FILE = REFERENCES_FILE
    path: str = field(metadata={"alias": "reference"})
    time_utc: datetime | None
    after_press: Annotated[int, Ge(0)]
    image_sha256: str


@dataclass(frozen=True, kw_only=True)
class Stationary(_FrameRow):
    """A frame without motion.

    Args:
        path: The path of the file, relative to the run folder.
        when: ``start`` or ``end`` of the block.
        in_contact: True for a frame at the middle force, False for a frame without contact.
        index: The number within the group, from 1.
        image_sha256: The SHA-256 of the file.
    """

    FILE = STATIONARY_FILE
    path: str = field(metadata={"alias": "reading"})
    when: When
    in_contact: bool
    index: Number
    image_sha256: str

    @property
    def key(self) -> tuple[str, bool, int]:
        """The identity of the frame, which occurs in only one row."""
        return (self.when, self.in_contact, self.index)


@dataclass(frozen=True, kw_only=True)
class PositionCheck(TableRow):
    """A check of the position. Unknown values are None.

    Args:
        time_utc: The time of the check.
        reason: See :data:`Reason`.
        after_press: The highest number of a press before it.
        offset_x_mm: The true x minus the reported x, measured at the end stops; None if the stage cannot measure it.
        offset_y_mm: The same for y.
        offset_z_mm: The same for z.
        height_change_mm: The height of a repeated press minus its first height.
        ok: Whether none of the four numbers is above the protocol's ``slip_mm``. It is also false, without any number,
            if an earlier session left presses unchecked whose x and y cannot be checked any more.
    """

    FILE = CHECKS_FILE
    time_utc: datetime
    reason: Reason
    after_press: Annotated[int, Ge(0)]
    offset_x_mm: float | None = None
    offset_y_mm: float | None = None
    offset_z_mm: float | None = None
    height_change_mm: float | None = None
    ok: bool

    @property
    def covers_all_axes(self) -> bool:
        """Whether x, y and z were compared with the end stops."""
        return None not in (self.offset_x_mm, self.offset_y_mm, self.offset_z_mm)


@dataclass(frozen=True, kw_only=True)
class MovingRow(TableRow):
    """A row of a press's ``series.csv``, which describes a frame of the moving sensor in contact.

    Args:
        time_s: The time of the frame since the first frame of the series, in s of the rig's clock.
        pose_x: The x of the sensor's summit in the work frame at that time, in mm.
        pose_y: The y of the sensor's summit in the work frame at that time, in mm.
        pose_z: The z of the sensor's summit in the work frame at that time, in mm.
        force_n: The force at that time, in N, interpolated between two readings; None without a gauge.
        frame: The file name of the frame, in the folder of the table.
        sha256: The SHA-256 of the frame's file.
    """

    FILE = SERIES_FILE
    time_s: float
    pose_x: float
    pose_y: float
    pose_z: float
    force_n: float | None
    frame: str
    sha256: str

    def __post_init__(self) -> None:
        if not _MOVING_NAME.fullmatch(self.frame):
            raise InputError("frame", self.frame, "must be frame_<n>.png or frame_<n>.npy")
        if not _SHA256.fullmatch(self.sha256):
            raise InputError("sha256", self.sha256, "must be 64 hexadecimal digits (0-9, a-f)")

    @property
    def pose_mm(self) -> Point:
        """The position of the sensor's summit in the work frame, in mm."""
        return (self.pose_x, self.pose_y, self.pose_z)


#: The dataclasses of the rows of a run's three tables.
TABLES: tuple[type[Any], ...] = (Row, Reference, Stationary)


def columns(kind: type[Any], optional: Collection[str] | None = None) -> tuple[str, ...]:
    """Return the columns of a table.

    Args:
        kind: The dataclass of the rows.
        optional: The optional fields that the table has; None for all.
    """
    return tuple(
        column.metadata.get("alias", column.name)
        for column in fields(kind)
        if optional is None or column.name in optional or not column.metadata.get("optional")
    )


def parse_row(kind: type[T], texts: Mapping[str, str]) -> T:
    """Make a row from the texts of its columns. An empty text is None.

    Raises:
        InputError: A text is not valid. The message names the column.
    """
    values = {}
    for column, numeric in _columns(kind).items():  # type: ignore[arg-type]
        text = texts.get(column, "")
        values[column] = None if not text else _value(text) if numeric else text
    row = from_plain(kind, values)
    time = getattr(row, "time_utc", None)
    if time is not None and time.tzinfo is None:
        raise InputError("time_utc", texts["time_utc"], "must have a time zone, such as Z for UTC")
    return row


@cache
def _columns(kind: type[Any]) -> dict[str, bool]:
    """Return the columns of a table, and whether they have numbers or booleans."""
    hints = get_type_hints(kind)
    kinds = (hints[column.name] for column in fields(kind))
    return {
        column: bool({int, float, bool} & {hint, *get_args(hint)})
        for column, hint in zip(columns(kind), kinds, strict=True)
    }


def _value(text: str) -> Any:
    """Return the number or the boolean that a text says, or the text. A spreadsheet writes TRUE and FALSE."""
    for read in (int, float):
        with suppress(ValueError):
            return read(text)
    return {"true": True, "false": False}.get(text.lower(), text)


def cells(row: Any, names: Sequence[str]) -> list[str]:
    """Return the texts of a row in some columns."""
    values = {column.metadata.get("alias", column.name): getattr(row, column.name) for column in fields(row)}
    return [cell(values[name]) for name in names]


def cell(value: Any) -> str:
    """Return the text of a value in a CSV file.

    None and nan become an empty text, booleans ``true`` or ``false``, and times ISO 8601 in UTC (with ``Z``).
    """
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, datetime):
        return value.astimezone(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
    return repr(float(value)) if isinstance(value, float) else str(value)
