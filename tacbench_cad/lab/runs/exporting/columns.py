"""What every format says of a frame: the columns of ``targets.csv``, and what else is known of its run."""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, fields
from datetime import datetime
from types import NoneType
from typing import Any, get_args, get_type_hints

from tacbench_cad.lab.runs.schema import Row, cell, columns


@dataclass(frozen=True, kw_only=True)
class Column:
    """A column.

    Args:
        name: Its name.
        kind: ``str``, ``int``, ``float``, ``bool`` or ``datetime``.
        description: What it says.
    """

    name: str
    kind: type
    description: str


def _row_columns() -> tuple[Column, ...]:
    hints = get_type_hints(Row)
    described = dict(re.findall(r"^ {4}(\w+): (.+)$", inspect.getdoc(Row) or "", re.MULTILINE))
    described_columns = []
    for attribute, name in zip(fields(Row), columns(Row), strict=True):
        kinds = [kind for kind in get_args(hints[attribute.name]) if kind is not NoneType] or [hints[attribute.name]]
        kind = kinds[0] if len(kinds) == 1 else str
        described_columns.append(Column(name=name, kind=kind, description=described.get(attribute.name, "")))
    return tuple(described_columns)


_ROW_COLUMNS = _row_columns()
#: The columns of every export; what is unknown of a frame is null.
COLUMNS = (
    Column(name="run", kind=str, description="The run folder: one for each recording of a print."),
    Column(name="label", kind=str, description="What classifiers learn: the name of the texture."),
    *_ROW_COLUMNS,
    Column(name="simulated", kind=str, description="What of the rig was simulated; empty where nothing is marked so."),
)
_ATTRIBUTES = tuple(zip((attribute.name for attribute in fields(Row)), _ROW_COLUMNS, strict=True))


def values_of(run: str, row: Row, simulated: tuple[str, ...]) -> dict[str, Any]:
    """The values of a row by the names of :data:`COLUMNS`, each of its column's kind, or None."""
    values: dict[str, Any] = {"run": run, "label": row.texture}
    for attribute, column in _ATTRIBUTES:
        value = getattr(row, attribute)
        unknown = value is None or (isinstance(value, float) and math.isnan(value))
        values[column.name] = None if unknown else str(value) if column.kind is str else value
    return {**values, "simulated": "; ".join(simulated)}


def json_values(values: Mapping[str, Any]) -> dict[str, Any]:
    """The same for JSON: a time is its text in ISO 8601."""
    return {name: cell(value) if isinstance(value, datetime) else value for name, value in values.items()}
