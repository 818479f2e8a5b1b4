"""Tables as CSV files, whole or not there."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from tacbench_cad.lab.runs.schema import cell
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.files import replacing


def write_csv(path: Path, columns: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> Path:
    """Write a table.

    Args:
        path: The file. Its folder must exist.
        columns: Heads, in their order.
        rows: One mapping a row, with exactly these keys. Floats are written with every digit that they have, None and
            NaN as empty, truth as ``true`` and ``false``.

    Returns:
        The path.

    Raises:
        InputError: The file cannot be written, or a row has other keys.
    """
    expected = set(columns)
    with replacing(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(columns)
        for row in rows:
            if set(row) != expected:
                raise InputError(path.name, sorted(expected ^ set(row)), "are columns that the row or the table lacks")
            writer.writerow([cell(row[name]) for name in columns])
    return path
