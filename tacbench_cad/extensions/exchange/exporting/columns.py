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

from tacbench_cad.lab.runs import Row, cell, columns


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
        kind = kinds[0] if len(kinds) == 1 else str
        described_columns.append(ExportColumn(name=name, kind=kind, description=described.get(attribute.name, "")))
    return tuple(described_columns)


_ROW_COLUMNS = _row_columns()
#: The columns of every export. Unknown values are null.
COLUMNS = (
    ExportColumn(name="run", kind=str, description="The run folder; each recording of a print has its own."),
    ExportColumn(name="label", kind=str, description="The name of the texture, which classifiers learn."),
    *_ROW_COLUMNS,
    ExportColumn(name="simulated", kind=str, description="The simulated devices of the rig; empty if none is marked."),
)
_ATTRIBUTES = tuple(zip((attribute.name for attribute in fields(Row)), _ROW_COLUMNS, strict=True))


def values_of(run: str, row: Row, simulated: tuple[str, ...]) -> dict[str, Any]:
    """Return the values of a row by the names of :data:`COLUMNS`. A value has its column's type, or is None."""
    values: dict[str, Any] = {"run": run, "label": row.texture}
    for attribute, column in _ATTRIBUTES:
        value = getattr(row, attribute)
        unknown = value is None or (isinstance(value, float) and math.isnan(value))
        values[column.name] = None if unknown else str(value) if column.kind is str else value
    return {**values, "simulated": "; ".join(simulated)}


def json_values(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the same values for JSON, with times as texts in ISO 8601."""
    return {name: cell(value) if isinstance(value, datetime) else value for name, value in values.items()}
