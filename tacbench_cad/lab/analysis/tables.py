"""Tables of results: DataFrames, the CSV files in which they are stored, and their texts for terminals and pages."""

from __future__ import annotations

import numbers
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from tacbench_cad.util.convert import to_plain
from tacbench_cad.util.files import replacing, write_json
from tacbench_cad.util.text import interval


class Shown(NamedTuple):
    """A table for readers.

    Args:
        title: The title.
        frame: The values, with the headings as names of the columns. Texts are shown unchanged, missing values as empty
            texts, and numbers as by :func:`shown`.
    """

    title: str
    frame: pd.DataFrame

    @property
    def heads(self) -> list[str]:
        """The headings."""
        return [str(name) for name in self.frame.columns]

    @property
    def texts(self) -> list[list[str]]:
        """The texts of each row."""
        columns = [list(map(shown, values)) for _, values in self.frame.items()]
        return [list(row) for row in zip(*columns, strict=True)]

    @property
    def right(self) -> list[bool]:
        """Whether each column is aligned to the right: columns of numbers are, also if these are already texts."""
        columns: Iterable[tuple[str, ...]] = (
            zip(*self.texts, strict=True) if len(self.frame) else [()] * len(self.heads)
        )
        return [all(re.match(r"[-+±]?\d|none$|too few|$", text) for text in texts) and any(texts) for texts in columns]


def frame_of(rows: Iterable[object], columns: Sequence[str]) -> pd.DataFrame:
    """Return a DataFrame with a row for each object or mapping, whose attributes or values are the columns."""
    return pd.DataFrame(
        [[row[name] if isinstance(row, Mapping) else getattr(row, name) for name in columns] for row in rows],
        columns=list(columns),
    )


def records(frame: pd.DataFrame) -> list[dict[str, Any]]:
    """Return the rows as dictionaries of plain values, in which a missing value is None."""
    rows: list[dict[str, Any]] = frame.astype(object).where(frame.notna(), None).to_dict("records")  # type: ignore[assignment]
    return rows


def shown(value: Any) -> str:
    """Format a value: whole numbers with thousands separators, other numbers with four significant digits."""
    if isinstance(value, str):
        return value
    if value is None or value is pd.NA or value != value:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, numbers.Integral):
        return f"{int(value):,}"
    if isinstance(value, numbers.Real):
        return f"{float(value):.4g}" if abs(float(value)) < 10_000.0 else f"{float(value):,.0f}"
    return str(value)


def percent(value: float) -> str:
    """Format a fraction as a percentage with one decimal, without the % sign; NaN as an empty text."""
    return "" if pd.isna(value) else f"{100.0 * value:.1f}"


def intervals(frame: pd.DataFrame, *, signed: bool = False, empty: str = "none") -> list[str]:
    """Format the fractions in ``low`` and ``high`` as 95 % intervals in %.

    Args:
        frame: The table.
        signed: Whether positive ends have a sign.
        empty: The text of rows without an interval.
    """
    ends = zip(frame["low"], frame["high"], strict=True)
    return [empty if pd.isna(low) else interval(100.0 * low, 100.0 * high, signed=signed) for low, high in ends]


def write_csv(path: Path, frame: pd.DataFrame, simulated: Sequence[str] | None = None) -> Path:
    """Write a table as CSV, completely or not at all: numbers with all digits, missing values as empty texts.

    Args:
        path: The file.
        frame: The table.
        simulated: The simulated parts of the data. The last column, ``simulated``, is true in every row if there are
            any. If None, the file has no such column.

    Returns:
        The path.

    Raises:
        InputError: The file cannot be written.
    """
    if simulated is not None:
        frame = frame.assign(simulated=bool(simulated))
    flags = frame.select_dtypes("bool")
    written = frame.assign(**{str(name): flags[name].map({True: "true", False: "false"}) for name in flags})
    with replacing(path) as temporary:
        temporary.write_text(written.to_csv(index=False, lineterminator="\n"), encoding="utf-8", newline="")
    return path


def write_settings(path: Path, settings: object) -> Path:
    """Write the settings of an analysis; the name of the analysis and the program's version come first.

    Returns:
        The path.

    Raises:
        InputError: The file cannot be written.
    """
    write_json(path, {"analysis": "", "version": "", **to_plain(settings)})
    return path
