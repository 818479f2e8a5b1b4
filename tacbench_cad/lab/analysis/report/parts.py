"""The pieces that a page is made of, as plain values: the document of ``--json`` holds them, the page shows them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any

from tacbench_cad.lab.analysis.tables import Table

#: Columns of numbers that fit on paper side by side, and rows of a long table that people are shown.
_MAX_COLUMNS, MAX_ROWS = 8, 50
#: A piece of a page. Its ``kind`` is ``text``, ``heading``, ``code``, ``list``, ``table`` or ``figure``.
Part = dict[str, Any]


def text_part(words: object, kind: str = "text") -> Part:
    """A paragraph, a heading, or, kept as it is, ``code``."""
    return {"kind": kind, "text": str(words) if kind == "code" else " ".join(str(words).split())}


def list_part(texts: Iterable[str]) -> Part:
    """A list."""
    return {"kind": "list", "items": list(texts)}


def table_part(table: Table, file: str = "") -> Part:
    """A table as people see it.

    Args:
        table: The table.
        file: The CSV file that has it with every digit, from the folder of the page's files.
    """
    return {
        "kind": "table",
        "title": table.title,
        "heads": table.heads,
        "right": table.right,
        "rows": list(table.texts()),
        "files": [file] if file else [],
    }


def long_part(table: Table, file: str) -> Part:
    """The first rows of a table that may be very long."""
    count = len(table.rows)
    title = table.title if count <= MAX_ROWS else f"{table.title} (the first {MAX_ROWS} of {count:,})"
    return table_part(replace(table, rows=table.rows[:MAX_ROWS], title=title), file)


def wide_parts(table: Table, file: str) -> Iterator[Part]:
    """A table with a column for each texture: as many tables one below the other as it takes to fit on paper."""
    first = [*table.right, True].index(True)
    for start in range(first, max(len(table.columns), first + 1), _MAX_COLUMNS):
        columns = (*table.columns[:first], *table.columns[start : start + _MAX_COLUMNS])
        yield table_part(replace(table, columns=columns), file)


def figure_part(stem: str, caption: str, *tables: str) -> Part:
    """A figure, by its path without suffix from the folder of the page's files, and the tables that it was drawn from.

    Args:
        stem: The path without suffix.
        caption: What it shows.
        tables: The tables' paths.
    """
    return {"kind": "figure", "caption": caption, "files": [f"{stem}.png", f"{stem}.pdf", *tables]}
