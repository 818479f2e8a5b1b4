"""Tables of results: put together once, then written as CSV, given as JSON, shown on a screen or set into a page."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from pathlib import Path
from typing import Any, TypeVar

from tacbench_cad.lab.runs import schema
from tacbench_cad.util.convert import from_plain, to_plain
from tacbench_cad.util.door import read_document, read_table
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.files import replacing
from tacbench_cad.util.text import interval

T = TypeVar("T")

#: What columns and settings in the files of earlier versions are called now.
FORMER_NAMES = {"rung": "hold_out", "rungs": "hold_out", "share": "fraction", "spread": "standard_deviation"}

#: Values by the names of their columns.
Row = Mapping[str, Any]


def shown(value: Any) -> str:
    """A value for people: whole numbers with thousands separators, others with four significant digits."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}"
    if isinstance(value, float):
        return f"{value:.4g}" if abs(value) < 10_000.0 else f"{value:,.0f}"
    return str(value)


def percent(value: float) -> str:
    """A fraction in per cent with one decimal."""
    return f"{100.0 * value:.1f}"


def truth(text: str) -> bool:
    """What ``true`` or ``false`` in a CSV file means.

    Raises:
        ValueError: It is neither.
    """
    if text not in ("true", "false"):
        raise ValueError(f"{text!r} is neither true nor false")
    return text == "true"


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Args:
        name: Head in CSV files, key in JSON.
        kind: Turns a text of a CSV file into a value; an empty text is always None.
        head: Head for people; None for the name with spaces.
        source: Attribute of the object behind a row (``outcome.p``), or makes the value from it. Empty for the name.
        derived: Makes the value from the row's other values. Such a column is shown to people only, not stored.
        text: Makes the text for people from a value that is not None.
        right: Whether the column is set flush right; None: if all its values are numbers.
    """

    name: str
    kind: Callable[[str], Any] = str
    head: str | None = None
    source: str | Callable[[Any], Any] = ""
    derived: Callable[[Row], Any] | None = None
    text: Callable[[Any], str] = shown
    right: bool | None = None

    def value(self, row: Row) -> Any:
        """The column's value in a row."""
        return self.derived(row) if self.derived else row[self.name]


def interval_column(*, signed: bool = False, empty: str = "none") -> Column:
    """A column of 95 % intervals in per cent, derived from the fractions in ``low`` and ``high``.

    Args:
        signed: Write the sign of positive ends too.
        empty: What stands where there is no interval.
    """

    def ends(row: Row) -> str:
        low, high = row["low"], row["high"]
        return empty if low is None or high is None else interval(100.0 * low, 100.0 * high, signed=signed)

    return Column("interval", head="95 % interval", derived=ends, right=True)


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table.

    Args:
        columns: Its columns.
        rows: Values by the names of the columns.
        title: What it shows.
    """

    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    title: str = ""

    @classmethod
    def of(cls, columns: Iterable[Column], items: Iterable[object], title: str = "") -> Table:
        """The table of some objects, a row for each.

        Args:
            columns: The columns; what is stored in them is read from the objects' attributes.
            items: The objects, or mappings by the names of the columns.
            title: What it shows.
        """
        kept = tuple(columns)
        stored = {
            column.name: column.source if callable(column.source) else attrgetter(column.source or column.name)
            for column in kept
            if column.derived is None
        }
        rows = (
            {name: item[name] for name in stored}
            if isinstance(item, Mapping)
            else {name: get(item) for name, get in stored.items()}
            for item in items
        )
        return cls(columns=kept, rows=tuple(rows), title=title)

    @classmethod
    def read(cls, path: Path, columns: Iterable[Column], title: str = "") -> Table:
        """The table in a CSV file that an analysis wrote; columns that are not asked for are passed over.

        Raises:
            InputError: The file is missing, lacks a column or holds a wrong value.
        """
        kept = tuple(columns)
        stored = [column for column in kept if column.derived is None]
        heads, lines = read_table(path, "table")
        heads = [FORMER_NAMES.get(head, head) for head in heads]
        lacking = [column.name for column in stored if column.name not in heads]
        if lacking:
            raise InputError("table", str(path), f"has no column {lacking[0]}; run the analysis again")
        places = [(column, heads.index(column.name)) for column in stored]
        try:
            rows = [{column.name: column.kind(line[i]) if line[i] else None for column, i in places} for line in lines]
        except ValueError as error:
            raise InputError("table", str(path), f"holds a wrong value: {error}") from None
        return cls(columns=kept, rows=tuple(rows), title=title)

    def write(self, path: Path, simulated: Sequence[str] | None = None) -> Path:
        """Write it as CSV, whole or not at all: numbers with every digit, None and NaN as empty texts.

        Args:
            path: The file.
            simulated: What of the data was simulated. The last column ``simulated`` says in each row whether anything
                was; without this column if it is None.

        Returns:
            The path.

        Raises:
            InputError: The file cannot be written.
        """
        with replacing(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as stream:
            writer = csv.writer(stream, lineterminator="\n")
            more = {} if simulated is None else {"simulated": bool(simulated)}
            writer.writerow([*(column.name for column in self.columns if column.derived is None), *more])
            rows = ({**record, **more} for record in self.records())
            writer.writerows([schema.cell(value) for value in row.values()] for row in rows)
        return path

    def records(self) -> list[dict[str, Any]]:
        """The rows with what is stored of them, as JSON has it."""
        names = [column.name for column in self.columns if column.derived is None]
        return [{name: row[name] for name in names} for row in self.rows]

    def select(self, *columns: str | Column, title: str | None = None) -> Table:
        """The table with some of its columns, or with others made from these, in this order."""
        known = {column.name: column for column in self.columns}
        kept = tuple(known[column] if isinstance(column, str) else column for column in columns)
        return replace(self, columns=kept, title=self.title if title is None else title)

    def where(self, chosen: Callable[[Row], bool]) -> Table:
        """The table with some of its rows."""
        return replace(self, rows=tuple(row for row in self.rows if chosen(row)))

    @property
    def heads(self) -> list[str]:
        """The heads of the columns, for people."""
        return [column.name.replace("_", " ") if column.head is None else column.head for column in self.columns]

    @property
    def right(self) -> list[bool]:
        """Which columns are set flush right: those of numbers."""
        return [
            all(isinstance(value, int | float | None) for value in map(column.value, self.rows))
            if column.right is None
            else column.right
            for column in self.columns
        ]

    def texts(self, empty: str = "") -> Iterator[list[str]]:
        """The texts of each row, for people.

        Args:
            empty: What stands for None.
        """
        for row in self.rows:
            values = [(column, column.value(row)) for column in self.columns]
            yield [empty if value in (None, "") else column.text(value) for column, value in values]


def read_settings(path: Path, kind: type[T]) -> T:
    """What an analysis was asked for, from the file that it left beside its tables.

    Raises:
        InputError: The file is missing or damaged.
    """
    document = read_document(path, "settings", "json")
    if isinstance(document, dict):
        document = {FORMER_NAMES.get(key, key): value for key, value in document.items()}
        if document.get("protocol") == "sound":
            document["protocol"] = "leak-free"
    return from_plain(kind, document, f"{path}: ")


def write_settings(path: Path, settings: object) -> Path:
    """Write what an analysis was asked for, which and of what version first.

    Returns:
        The path.

    Raises:
        InputError: The file cannot be written.
    """
    document = {"analysis": "", "version": "", **to_plain(settings)}
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    return path
