"""The parts of a page as plain values. The document of ``--json`` contains them, and the page shows them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import pandas as pd

from tacbench_cad.lab.analysis.tables import Shown

#: The number of columns of numbers that fit on a sheet of paper, and the number of rows shown of a long table.
_MAX_COLUMNS, MAX_ROWS = 8, 50
#: A part of a page. Its ``kind`` is ``text``, ``heading``, ``code``, ``list``, ``table`` or ``figure``.
Part = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class ReportSection:
    """A section of a page. A section without parts is left out.

    Args:
        title: The title.
        parts: The parts, in the order of the page.
        tables: The tables of the section, by the names of their CSV files.
    """

    title: str
    parts: Sequence[Part] = ()
    tables: Mapping[str, pd.DataFrame] = field(default_factory=dict)


def text_part(words: object, kind: str = "text") -> Part:
    """Return a paragraph or a heading with normalized spaces, or ``code`` unchanged."""
    return {"kind": kind, "text": str(words) if kind == "code" else " ".join(str(words).split())}


def list_part(texts: Iterable[str]) -> Part:
    """Return a list with one item for each text."""
    return {"kind": "list", "items": list(texts)}


def table_part(table: Shown, file: str = "") -> Part:
    """Return a table with formatted values.

    Args:
        table: The table.
        file: The CSV file with all digits of the values, relative to the folder of the page's files.
    """
    return {
        "kind": "table",
        "title": table.title,
        "heads": table.heads,
        "right": table.right,
        "rows": table.texts,
        "files": [file] if file else [],
    }


def long_part(table: Shown, file: str) -> Part:
    """Return a table with at most ``MAX_ROWS`` rows."""
    count = len(table.frame)
    title = table.title if count <= MAX_ROWS else f"{table.title} (the first {MAX_ROWS} of {count:,})"
    return table_part(Shown(title, table.frame.head(MAX_ROWS)), file)


def wide_parts(table: Shown, file: str) -> Iterator[Part]:
    """Split a table with a column for each texture into several tables that are narrow enough for a sheet of paper."""
    first, frame = [*table.right, True].index(True), table.frame
    for start in range(first, max(len(frame.columns), first + 1), _MAX_COLUMNS):
        columns = [*range(first), *range(start, min(start + _MAX_COLUMNS, len(frame.columns)))]
        yield table_part(Shown(table.title, frame.iloc[:, columns]), file)


def figure_part(stem: str, caption: str, *tables: str) -> Part:
    """Return a figure. All paths are relative to the folder of the page's files.

    Args:
        stem: The path of the figure without suffix.
        caption: The caption.
        tables: The paths of the tables from which the figure was drawn.
    """
    return {"kind": "figure", "caption": caption, "files": [f"{stem}.png", f"{stem}.pdf", *tables]}
