"""The columns of every export format: those of ``targets.csv``, and some values of the run."""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, fields
from datetime import datetime
from types import NoneType
from typing import Any, get_args, get_type_hints

from tacbench_cad.lab.runs import Row, RunInfo, cell, columns


@dataclass(frozen=True, kw_only=True)
class ExportColumn:
    """A column.

    Args:
        name: The name.
        kind: ``str``, ``int``, ``float``, ``bool`` or ``datetime``.
        description: The meaning of the values.
    """

    name: str
    kind: type
    description: str


def _row_columns() -> tuple[ExportColumn, ...]:
    hints = get_type_hints(Row)
    described = dict(re.findall(r"^ {4}(\w+): (.+)$", inspect.getdoc(Row) or "", re.MULTILINE))
    described_columns = []
    for attribute, name in zip(fields(Row), columns(Row), strict=True):
        kinds = [kind for kind in get_args(hints[attribute.name]) if kind is not NoneType] or [hints[attribute.name]]
        kind = kinds[0] if len(kinds) == 1 and isinstance(kinds[0], type) else str
        described_columns.append(ExportColumn(name=name, kind=kind, description=described.get(attribute.name, "")))
    return tuple(described_columns)


_ROW_COLUMNS = _row_columns()
#: The columns of every export. Unknown values are null.
COLUMNS = (
    ExportColumn(name="run", kind=str, description="The run folder; each recording of a print has its own."),
    ExportColumn(name="label", kind=str, description="The name of the texture, which classifiers learn."),
    ExportColumn(name="object_label", kind=str, description="1 to 6, or the name of another texture."),
    ExportColumn(name="printer", kind=str, description="The printer."),
    ExportColumn(name="filament", kind=str, description="The filament."),
    ExportColumn(name="copy", kind=str, description="The copy, from 1, or the name of an imported print."),
    ExportColumn(name="preset", kind=str, description="The block's preset."),
    ExportColumn(name="scale", kind=float, description="The block's scale."),
    *_ROW_COLUMNS,
    ExportColumn(name="simulated", kind=str, description="The simulated devices of the rig; empty if none is marked."),
)
_ATTRIBUTES = tuple(zip((attribute.name for attribute in fields(Row)), _ROW_COLUMNS, strict=True))


def values_of(run: str, row: Row, info: RunInfo) -> dict[str, Any]:
    """Return the values of a row by the names of :data:`COLUMNS`. A value has its column's type, or is None."""
    printed = info.printed
    values: dict[str, Any] = {
        "run": run,
        "label": printed.texture,
        "object_label": None if printed.object_label is None else str(printed.object_label),
        "printer": printed.printer,
        "filament": printed.filament,
        "copy": None if printed.copy is None else str(printed.copy),
        "preset": printed.block and printed.block.preset,
        "scale": printed.block and printed.block.scale,
    }
    for attribute, column in _ATTRIBUTES:
        value = getattr(row, attribute)
        unknown = value is None or (isinstance(value, float) and math.isnan(value))
        values[column.name] = None if unknown else str(value) if column.kind is str else value
    return {**values, "simulated": "; ".join(info.simulated)}


def json_values(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the same values for JSON, with times as texts in ISO 8601."""
    return {name: cell(value) if isinstance(value, datetime) else value for name, value in values.items()}
