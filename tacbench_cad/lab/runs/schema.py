"""The files of a run folder: their names, the columns of ``targets.csv`` and what a row of it means.

A row's press key (force level, repeat, position) is unique; the order of the rows means nothing.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, TypeVar

from tacbench_cad.lab.rig.gauge import Force
from tacbench_cad.lab.study.presses import Press
from tacbench_cad.lab.study.spec import Point, PrintedBlock
from tacbench_cad.util.errors import InputError

T = TypeVar("T")

#: What has to stay the same in a run.
RUN_FILE = "run.json"
#: A row for each press.
TARGETS_FILE = "targets.csv"
#: What the person at the printer fills in.
PRINT_FILE = "print.toml"
#: Where readings lie that are images.
IMAGE_FOLDER = "sensor_images"
#: Where other readings lie.
DATA_FOLDER = "sensor_data"
#: Where readings without contact lie.
REFERENCE_FOLDER = "references"
#: A row for each reading without contact.
REFERENCES_FILE = f"{REFERENCE_FOLDER}/references.csv"
#: Where readings without motion lie.
STATIONARY_FOLDER = "stationary"
#: A row for each reading without motion.
STATIONARY_FILE = f"{STATIONARY_FOLDER}/stationary.csv"

#: Heads of a press's pose: mm and degrees, as the toolchains name them.
POSE_COLUMNS = ("pose_x", "pose_y", "pose_z", "pose_Rx", "pose_Ry", "pose_Rz")
#: Heads of a press's shear, which is always 0 here.
SHEAR_COLUMNS = ("shear_x", "shear_y", "shear_z", "shear_Rx", "shear_Ry", "shear_Rz")
#: The first fourteen are those of the TacTip toolchains, the others ours.
COLUMNS = (
    "sensor_image",
    "object_label",
    *POSE_COLUMNS,
    *SHEAR_COLUMNS,
    "texture",
    "preset",
    "scale",
    "printer",
    "filament",
    "copy",
    "position",
    "force_level",
    "target_force_n",
    "measured_force_n",
    "force_after_n",
    "in_band",
    "repeat",
    "time_utc",
    "image_sha256",
    "reference_age_s",
)
#: Heads of ``references.csv``.
REFERENCE_COLUMNS = ("reference", "time_utc", "after_press", "image_sha256")
#: Heads of ``stationary.csv``.
STATIONARY_COLUMNS = ("reading", "when", "in_contact", "index", "image_sha256")

#: (force level, repeat, position), each from 1.
PressKey = tuple[int, int, int]
_READING_NAME = re.compile(r"(?:image_(?P<image>0|[1-9]\d{0,8})\.png|reading_(?P<data>0|[1-9]\d{0,8})\.npy)")
_SHA256 = re.compile(r"[0-9a-f]{64}")


def reading_name(number: int, image: bool) -> str:
    """File name of a reading: ``image_7.png`` or ``reading_7.npy``; 0 is the first reference."""
    return f"image_{number}.png" if image else f"reading_{number}.npy"


def reading_path(name: str) -> str:
    """Where a reading lies in the run folder: ``sensor_images/image_7.png``."""
    return f"{IMAGE_FOLDER if name.endswith('.png') else DATA_FOLDER}/{name}"


def reference_path(count: int, image: bool) -> str:
    """Where a reading without contact lies: the first beside the others, as number 0, later ones in ``references/``."""
    if count == 0:
        return reading_path(reading_name(0, image))
    return f"{REFERENCE_FOLDER}/reference_{count}.{'png' if image else 'npy'}"


def stationary_path(when: str, in_contact: bool, index: int, image: bool) -> str:
    """Where a reading without motion lies: ``stationary/start_contact_01.png``, ``stationary/end_free_30.png``."""
    what = "contact" if in_contact else "free"
    return f"{STATIONARY_FOLDER}/{when}_{what}_{index:02d}.{'png' if image else 'npy'}"


def number_of_reading(name: str) -> int | None:
    """The number in a reading's file name, or None if it is not such a name."""
    found = _READING_NAME.fullmatch(name)
    return int(found["image"] or found["data"]) if found else None


@dataclass(frozen=True, kw_only=True)
class Row:
    """One press, as ``targets.csv`` has it.

    Args:
        sensor_image: File name of its reading.
        number: The press's number in the plan, from the file name.
        object_label: 1 to 6, or a user's texture's name.
        pose_mm: The sensor's summit in the work frame; z is nan where nobody measured it.
        texture: Texture's name.
        preset: Block's preset.
        scale: Block's scale.
        printer: Printer.
        filament: Filament.
        copy: Copy, from 1.
        position: From 1, row by row from low y, each row from low x.
        force_level: From 1.
        repeat: From 1.
        target_force_n: Target in N, None in depth mode.
        measured_force_n: Force before the reading in N, None without a gauge.
        force_after_n: Force after the reading in N, None without a gauge.
        in_band: Whether the target was reached, None without a gauge.
        time_utc: When, None where nobody knows.
        image_sha256: SHA-256 of the reading's file.
        reference_age_s: Age of the last reference, None without one.
    """

    sensor_image: str
    number: int
    object_label: int | str
    pose_mm: Point
    texture: str
    preset: str
    scale: float
    printer: str
    filament: str
    copy: int
    position: int
    force_level: int
    repeat: int
    target_force_n: float | None
    measured_force_n: float | None
    force_after_n: float | None
    in_band: bool | None
    time_utc: datetime | None
    image_sha256: str
    reference_age_s: float | None

    @property
    def key(self) -> PressKey:
        """What makes the row unique."""
        return (self.force_level, self.repeat, self.position)

    @classmethod
    def of(cls, values: Mapping[str, str]) -> Row:
        """Read a row.

        Args:
            values: The text of every column of :data:`COLUMNS`.

        Raises:
            InputError: A value is not one that this program writes; the message names the column.
        """
        name = values["sensor_image"]
        number = number_of_reading(name)
        if not number:
            raise InputError("sensor_image", name, "must be image_<n>.png or reading_<n>.npy, n from 1")
        for column in POSE_COLUMNS[3:] + SHEAR_COLUMNS:
            _number(column, values[column])
        x, y, z = (_optional(_number)(column, values[column]) for column in POSE_COLUMNS[:3])
        if x is None or y is None:
            raise InputError("pose_x, pose_y", None, "are empty")
        sha256 = values["image_sha256"]
        if not _SHA256.fullmatch(sha256):
            raise InputError("image_sha256", sha256, "must be 64 digits 0-9, a-f")
        label = values["object_label"]
        return cls(
            sensor_image=name,
            number=number,
            object_label=int(label) if re.fullmatch(r"[1-9]\d?", label) else label,
            pose_mm=(x, y, math.nan if z is None else z),
            scale=_number("scale", values["scale"]),
            copy=count("copy", values["copy"]),
            position=count("position", values["position"]),
            force_level=count("force_level", values["force_level"]),
            repeat=count("repeat", values["repeat"]),
            target_force_n=_optional(_number)("target_force_n", values["target_force_n"]),
            measured_force_n=_optional(_number)("measured_force_n", values["measured_force_n"]),
            force_after_n=_optional(_number)("force_after_n", values["force_after_n"]),
            in_band=_optional(flag)("in_band", values["in_band"]),
            time_utc=_optional(moment)("time_utc", values["time_utc"]),
            image_sha256=sha256,
            reference_age_s=_optional(_number)("reference_age_s", values["reference_age_s"]),
            **{name: values[name] for name in ("texture", "preset", "printer", "filament")},
        )


def press_values(
    printed: PrintedBlock,
    press: Press,
    *,
    name: str,
    pose_mm: Point,
    measured: Force | None,
    after: Force | None,
    in_band: bool | None,
    time_utc: datetime | None,
    sha256: str,
    reference_age_s: float | None,
) -> tuple[Any, ...]:
    """What a press's row holds, in the order of :data:`COLUMNS`; :func:`cell` makes text of each.

    Args:
        printed: The block.
        press: Which press of it.
        name: File name of the reading.
        pose_mm: Where the sensor stood, in mm of the work frame.
        measured: The force before the reading, None without a gauge.
        after: The force after it.
        in_band: Whether the force lies in its band.
        time_utc: When it was read.
        sha256: Of the reading's file.
        reference_age_s: Age of the newest reading without contact, in seconds.
    """
    return (
        name,
        printed.object_label,
        *(round(one, 6) for one in pose_mm),
        *(0.0,) * 9,
        printed.texture,
        printed.block.preset,
        printed.block.scale,
        printed.printer,
        printed.filament,
        printed.copy,
        press.position,
        press.force_level,
        press.target_n,
        None if measured is None else round(measured.mean_n, 6),
        None if after is None else round(after.mean_n, 6),
        in_band,
        press.repeat,
        time_utc,
        sha256,
        None if reference_age_s is None else round(reference_age_s, 3),
    )


def cell(value: Any) -> str:
    """The text of a value in a CSV file: empty for None and nan, ``true`` and ``false``, times in ISO 8601 with Z."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, datetime):
        return value.astimezone(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
    return repr(float(value)) if isinstance(value, float) else str(value)


def flag(column: str, text: str) -> bool:
    """``true`` or ``false``.

    Raises:
        InputError: It is something else. (A spreadsheet's TRUE and FALSE are accepted.)
    """
    if text.lower() not in ("true", "false"):
        raise InputError(column, text, "must be true, false or empty")
    return text.lower() == "true"


def moment(column: str, text: str) -> datetime:
    """A time of day and year, in UTC.

    Raises:
        InputError: It is not in ISO 8601, or has no time zone.
    """
    try:
        read = datetime.fromisoformat(text)
    except ValueError:
        raise InputError(column, text, "must be a time as 2026-01-31T12:00:00.000Z") from None
    if read.tzinfo is None:
        raise InputError(column, text, "must name its time zone, as 2026-01-31T12:00:00.000Z")
    return read.astimezone(UTC)


def _number(column: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(column, text, "must be a finite number")
    return value


def count(column: str, text: str, least: int = 1) -> int:
    """A whole number.

    Raises:
        InputError: It is something else, or too small.
    """
    if not re.fullmatch(r"\d{1,9}", text) or int(text) < least:
        raise InputError(column, text, f"must be a whole number from {least}")
    return int(text)


def _optional(read: Callable[[str, str], T]) -> Callable[[str, str], T | None]:
    return lambda column, text: read(column, text) if text else None
