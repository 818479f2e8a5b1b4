"""The pieces that a page is made of, as plain values: the document of ``--json`` holds them, the page shows them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from tacbench_cad.lab.analysis.tables import Table

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


def figure_part(stem: str, caption: str, *tables: str) -> Part:
    """A figure, by its path without suffix from the folder of the page's files, and the tables that it was drawn from.

    Args:
        stem: The path without suffix.
        caption: What it shows.
        tables: The tables' paths.
    """
    return {"kind": "figure", "caption": caption, "files": [f"{stem}.png", f"{stem}.pdf", *tables]}
