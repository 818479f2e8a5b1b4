"""The table ``source.csv`` of an imported run: everything that the source says about each frame."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from tacbench_cad.util import untrusted
from tacbench_cad.util.files import replacing

#: The table. It has a row for each frame of ``targets.csv``.
ORIGINS_FILE = "source.csv"
#: Its first columns: the name of the frame as in ``targets.csv``, the file that it came from, and its number in this
#: file, from 0, if the file has several frames. The other columns are those of the source, with unchanged texts.
IMAGE, FILE, INDEX = "sensor_image", "source_file", "source_frame"
_OWN = (IMAGE, FILE, INDEX)


def write_origins(folder: Path, origins: Sequence[Mapping[str, str]]) -> None:
    """Write the table of a run, completely or not at all.

    Args:
        folder: The run folder.
        origins: The texts of each row by column.

    Raises:
        InputError: The table cannot be written.
    """
    names = list(dict.fromkeys([*_OWN, *(name for origin in origins for name in origin)]))
    with (
        replacing(folder / ORIGINS_FILE) as path,
        path.open("w", encoding="utf-8", errors="backslashreplace", newline="") as stream,
    ):
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(map(_readable, names))
        table.writerows([_readable(origin.get(name, "")) for name in names] for origin in origins)


def read_origins(folder: Path) -> dict[str, dict[str, str]]:
    """Return the rows of the table by the names of the frames; empty if the run has no such table.

    Raises:
        InputError: The table cannot be read.
    """
    path = folder / ORIGINS_FILE
    if not path.is_file():
        return {}
    header, rows = untrusted.read_table(path, "table", within=folder)
    texts = (dict(zip(header, row, strict=True)) for row in rows)
    return {row.get(IMAGE, ""): row for row in texts}


def _readable(text: str) -> str:
    """Return a text without the characters that would make the table unreadable."""
    return re.sub(r"\r\n?", "\n", text.replace("\0", ""))


def column_of(name: str) -> str:
    """Return the column for a column of the source. The names of our own columns get ``source_`` in front."""
    return f"source_{name}" if name in _OWN else name
