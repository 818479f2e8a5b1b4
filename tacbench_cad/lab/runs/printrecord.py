"""The print record: a form that the person at the printer fills in. The program writes it once and never changes it."""

from __future__ import annotations

import datetime
import json
from collections.abc import Mapping
from dataclasses import dataclass, make_dataclass
from pathlib import Path
from typing import Annotated, Any

from annotated_types import Interval

from tacbench_cad.util import untrusted
from tacbench_cad.util.convert import from_plain

#: The fields of the form, each with its explanation. An empty string means that a field is not filled in.
FIELDS: Mapping[str, str] = {
    "printer": "the printer",
    "printer_serial": "its serial number",
    "filament": "material and maker of the filament or resin",
    "filament_batch": "batch number on the spool or bottle",
    "slicer": "slicer with its version",
    "slicer_profile": "name of the profile; keep the profile's file too",
    "nozzle_mm": "diameter of the nozzle in mm",
    "layer_height_mm": "layer height in mm",
    "nozzle_temperature_c": "temperature of the nozzle in degrees Celsius",
    "bed_temperature_c": "temperature of the bed in degrees Celsius",
    "infill_percent": "infill in percent",
    "orientation": "orientation of the block: relief up, turned by ... degrees",
    "bed_position": "position on the bed: centre, or x, y in mm",
    "date": "day of the print, for example 2026-01-31",
    "humidity_percent": "relative humidity at the printer in percent",
    "stringing_score": "0 to 3, see above",
    "peaks_score": "0 to 3, see above",
    "photos": 'a list of files in this folder: ["top.jpg"]',
}
#: The meaning of the values of the two visual scores.
SCORES: Mapping[str, tuple[str, ...]] = {
    "stringing_score": (
        "0: no strings, also when seen from near",
        "1: single hairs that you can wipe off with a finger",
        "2: strings across some valleys that you cannot wipe off with a finger",
        "3: strings or blobs over most of the relief",
    ),
    "peaks_score": (
        "0: every peak is there and looks like its neighbours",
        "1: tips are slightly rounded or unevenly glossy",
        "2: some peaks visibly lower, split or missing",
        "3: most peaks lower, split or missing",
    ),
}


@dataclass(frozen=True, kw_only=True)
class PrintRecord:
    """A print's record.

    Args:
        values: The values of the fields that are filled in, by the names of :data:`FIELDS`.
        empty: The names of the empty fields, in the order of :data:`FIELDS`.
    """

    values: Mapping[str, Any]
    empty: tuple[str, ...]


def form(about: str, **known: str | float) -> str:
    """Return a form in which the known fields are filled in.

    Args:
        about: The object that is printed, for the comment at the top (one or several lines).
        **known: The values of fields.

    Returns:
        The text of a TOML file.
    """
    lines = [
        *(f"# {line}" for line in about.splitlines()),
        '# Fill in what you know, and leave "" for the rest. Reports name the empty fields.',
        "# Write numbers without quotes. tacbench never changes this file.",
        "",
    ]
    for name, meaning in FIELDS.items():
        for step in SCORES.get(name, ()):
            lines.append(f"#   {step}")
        empty = "[]" if name == "photos" else '""'
        value = json.dumps(known[name]) if name in known else empty
        lines.append(f"{name} = {value}  # {meaning}")
    return "\n".join(lines) + "\n"


def read_record(path: Path, *, within: Path | None = None) -> PrintRecord:
    """Read a print record.

    Args:
        path: The file.
        within: A folder that the file must lie in, also if ``path`` is a link.

    Raises:
        InputError: The file is missing or not TOML, or a field is unknown or has a wrong type.
    """
    document = untrusted.read_document(path, "print record", "toml", within=within)
    values = {name: value for name, value in document.items() if name not in FIELDS or value not in ("", [])}
    from_plain(_Fields, values, f"{path}: ")
    empty = tuple(name for name in FIELDS if name not in values)
    return PrintRecord(values={name: values[name] for name in FIELDS if name in values}, empty=empty)


_Date = Annotated[datetime.date, Interval(ge=datetime.date(1970, 1, 1), le=datetime.date(2200, 1, 1))]


def _kind(name: str) -> Any:
    if name in SCORES:
        return Annotated[int, Interval(ge=0, le=3)]
    if name == "photos":
        return tuple[str, ...]
    return float if name.endswith(("_mm", "_c", "_percent")) else str | float | bool | _Date


#: The document as a dataclass, in which every field may be left out.
_Fields = make_dataclass("_Fields", [(name, _kind(name) | None, None) for name in FIELDS], kw_only=True)
