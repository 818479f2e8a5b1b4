"""Tables of results, which can be written as CSV or JSON, printed in a terminal, or shown on the page of a report."""

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
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.files import replacing
from tacbench_cad.util.text import interval
from tacbench_cad.util.untrusted import read_document, read_table

T = TypeVar("T")

#: The values of a row; the keys are the names of the columns.
Row = Mapping[str, Any]


def shown(value: Any) -> str:
    """Format a value: whole numbers with thousands separators, other numbers with four significant digits."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}"
    if isinstance(value, float):
        return f"{value:.4g}" if abs(value) < 10_000.0 else f"{value:,.0f}"
    return str(value)


def percent(value: float) -> str:
    """Format a fraction as a percentage with one decimal, without the % sign."""
    return f"{100.0 * value:.1f}"


def truth(text: str) -> bool:
    """Convert ``true`` or ``false`` from a CSV file.

    Raises:
        ValueError: The text is neither ``true`` nor ``false``.
    """
    if text not in ("true", "false"):
        raise ValueError(f"{text!r} is neither true nor false")
    return text == "true"


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Args:
        name: The column's name in CSV files and its key in JSON.
        kind: A function that converts a text of a CSV file to a value; an empty text always becomes None.
        head: The heading in shown tables; None for the name with spaces.
        source: The attribute of a row's object that has the value (``outcome.p``), or a function that computes the
            value from the object. If empty, the attribute has the column's name.
        derived: A function that computes the value from the row's other values. Such a column is shown but not stored.
        text: A function that formats a value that is not None.
        right: Whether the column is aligned to the right; if None, a column is if all its values are numbers.
    """

    name: str
    kind: Callable[[str], Any] = str
    head: str | None = None
    source: str | Callable[[Any], Any] = ""
    derived: Callable[[Row], Any] | None = None
    text: Callable[[Any], str] = shown
    right: bool | None = None

    def value(self, row: Row) -> Any:
        """Return the column's value in a row."""
        return self.derived(row) if self.derived else row[self.name]


def interval_column(*, signed: bool = False, empty: str = "none") -> Column:
    """Return a column of 95 % intervals in %, derived from the fractions in ``low`` and ``high``.

    Args:
        signed: Whether positive ends have a sign.
        empty: The text of rows without an interval.
    """

    def ends(row: Row) -> str:
        low, high = row["low"], row["high"]
        return empty if low is None or high is None else interval(100.0 * low, 100.0 * high, signed=signed)

    return Column("interval", head="95 % interval", derived=ends, right=True)


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table of results.

    Args:
        columns: The columns.
        rows: The rows; each has a value for each stored column.
        title: The title.
    """

    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    title: str = ""

    @classmethod
    def of(cls, columns: Iterable[Column], items: Iterable[object], title: str = "") -> Table:
        """Make a table with a row for each object.

        Args:
            columns: The columns. Their values are read from the attributes of the objects.
            items: The objects, or mappings with the names of the columns as keys.
            title: The title.
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
        """Read a table from a CSV file that an analysis wrote; other columns of the file are ignored.

        Raises:
            InputError: The file is missing, has no such column or contains a wrong value.
        """
        kept = tuple(columns)
        stored = [column for column in kept if column.derived is None]
        heads, lines = read_table(path, "table")
        missing = [column.name for column in stored if column.name not in heads]
        if missing:
            raise InputError("table", str(path), f"has no column {missing[0]}; run the analysis again")
        places = [(column, heads.index(column.name)) for column in stored]
        try:
            rows = [{column.name: column.kind(line[i]) if line[i] else None for column, i in places} for line in lines]
        except ValueError as error:
            raise InputError("table", str(path), f"contains a wrong value: {error}; run the analysis again") from None
        return cls(columns=kept, rows=tuple(rows), title=title)

    def write(self, path: Path, simulated: Sequence[str] | None = None) -> Path:
        """Write the table as CSV, completely or not at all: numbers with all digits, None and NaN as empty texts.

        Args:
            path: The file.
            simulated: The simulated parts of the data. The last column, ``simulated``, is true in every row if there
                are any. If None, the file has no such column.

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
        """Return the stored values of the rows, for JSON."""
        names = [column.name for column in self.columns if column.derived is None]
        return [{name: row[name] for name in names} for row in self.rows]

    def select(self, *columns: str | Column, title: str | None = None) -> Table:
        """Return the table with some of its columns, or with columns derived from them, in the given order."""
        known = {column.name: column for column in self.columns}
        kept = tuple(known[column] if isinstance(column, str) else column for column in columns)
        return replace(self, columns=kept, title=self.title if title is None else title)

    def where(self, chosen: Callable[[Row], bool]) -> Table:
        """Return the table with the chosen rows only."""
        return replace(self, rows=tuple(row for row in self.rows if chosen(row)))

    @property
    def heads(self) -> list[str]:
        """The headings of the shown columns."""
        return [column.name.replace("_", " ") if column.head is None else column.head for column in self.columns]

    @property
    def right(self) -> list[bool]:
        """Whether each column is aligned to the right; columns of numbers are."""
        return [
            all(isinstance(value, int | float | None) for value in map(column.value, self.rows))
            if column.right is None
            else column.right
            for column in self.columns
        ]

    def texts(self, empty: str = "") -> Iterator[list[str]]:
        """Yield the formatted values of each row.

        Args:
            empty: The text for None.
        """
        for row in self.rows:
            values = [(column, column.value(row)) for column in self.columns]
            yield [empty if value in (None, "") else column.text(value) for column, value in values]


def read_settings(path: Path, kind: type[T]) -> T:
    """Read the settings of an analysis from the file that it wrote beside its tables.

    Raises:
        InputError: The file is missing or damaged.
    """
    return from_plain(kind, read_document(path, "settings", "json"), f"{path}: ")


def write_settings(path: Path, settings: object) -> Path:
    """Write the settings of an analysis; the name of the analysis and the program's version come first.

    Returns:
        The path.

    Raises:
        InputError: The file cannot be written.
    """
    document = {"analysis": "", "version": "", **to_plain(settings)}
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    return path
