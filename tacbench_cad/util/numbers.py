"""Tables of numbers in text files, as instruments, spreadsheets and point cloud programs write them."""

from __future__ import annotations

import codecs
import io
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tacbench_cad.util.errors import InputError, one_line
from tacbench_cad.util.types import Floats
from tacbench_cad.util.untrusted import read_bytes

#: The words that mean that a cell has no value.
MISSING = frozenset({"", "-", "--", "---", "*", "**", "***", "bad", "void", "nodata", "n/a", "#n/a", "null", "none"})
_COMMENTS = ("#", "//")


@dataclass(frozen=True, kw_only=True)
class Layout:
    """How the numbers of a table are written.

    Args:
        skipped: The number of lines above the first line of numbers.
        names: The letters of the column names in the last of these lines, in lower case and without units in brackets.
        columns: The number of columns.
        separator: The character between the columns; None for blanks.
    """

    skipped: int
    names: tuple[str, ...]
    columns: int
    separator: str | None

    def places(self, names: Sequence[str]) -> list[int] | None:
        """Return the columns with some names; None if the header does not name each of them."""
        known = len(self.names) == self.columns and set(names) <= set(self.names)
        return [self.names.index(name) for name in names] if known else None


def layout(data: bytes, fewest: int = 1) -> Layout | None:
    """Find the first line of numbers in a table; None if there is none.

    The columns are separated by semicolons, tabs, commas or blanks. Except between commas, numbers can have a decimal
    comma.

    Args:
        data: The table, or its beginning.
        fewest: The smallest number of columns. If it is above 1, later columns can be text.
    """
    header = ""
    for skipped, raw in enumerate(io.BytesIO(data)):
        line = raw.decode("utf-8", "replace").lstrip("\ufeff").rstrip("\r\n")
        for separator in (*(mark for mark in ";\t," if mark in line), None):
            words = (line if separator == "," else line.replace(",", ".")).split(separator)
            if len(words) >= fewest and _are_numbers(words[: fewest if fewest > 1 else None]):
                titles = header.lstrip("#/ ").split(separator)
                return Layout(
                    skipped=skipped,
                    names=tuple(re.sub(r"[\[(].*|[^a-z]", "", title.lower()) for title in titles),
                    columns=len(words),
                    separator=separator,
                )
        header = line if line.strip() else header
    return None


def _are_numbers(words: Sequence[str]) -> bool:
    """Check whether no word is text, and at least one is a number."""
    try:
        return bool(np.isfinite([_number(word) for word in words]).any())
    except ValueError:
        return False


def _number(word: str) -> float:
    return math.nan if word.strip().lower() in MISSING else float(word)


def read_numbers(path: Path, what: str, kind: str, axes: Sequence[str] = ()) -> Floats:
    """Read a table of numbers; see :func:`layout`. Lines above the numbers and comments (``#``, ``//``) are left out.

    Args:
        path: The file.
        what: The kind of document, for error messages: ``scan``.
        kind: The kind of file, for its largest size: a key of :data:`.untrusted.MAX_MB`.
        axes: The names of the columns to read. If the header does not name them, the first columns are read. Default:
            all columns.

    Returns:
        The numbers, shape (lines, columns). Cells without a number are nan.

    Raises:
        InputError: The file cannot be read, or has no such table.
    """
    data = read_bytes(path, what, kind).removeprefix(codecs.BOM_UTF8)
    found = layout(data, max(1, len(axes)))
    if found is None:
        wrong = "is not a table of numbers: it has no line of numbers"
        if axes:
            wrong = f"has no line that begins with the numbers {', '.join(axes[:-1])} and {axes[-1]}"
        raise InputError(what, str(path), wrong)
    options: dict[str, Any] = {
        "delimiter": found.separator,
        "skiprows": found.skipped,
        "usecols": (found.places(axes) or range(len(axes))) if axes else None,
        "comments": _COMMENTS,
        "ndmin": 2,
    }
    if found.separator != ",":
        data = data.replace(b",", b".")
    try:
        try:
            return np.asarray(np.loadtxt(io.BytesIO(data), **options))
        except ValueError:  # converters are slow, and most tables do not need them
            return np.asarray(np.loadtxt(io.BytesIO(data), converters=_number, encoding="utf-8", **options))
    except ValueError as error:
        detail = one_line(str(error).partition(";")[0], 120)
        raise InputError(what, str(path), f"is not a table with the same columns in every line: {detail}") from None
