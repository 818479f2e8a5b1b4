"""``manifest.json``: a row for each file of a print set.

It contains no times, paths or host names, so that the same print set always gives the same bytes.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from tacbench_cad.util.errors import InputError
from tacbench_cad.util.files import MANIFEST_NAME, replacing, sha256
from tacbench_cad.util.text import at_most
from tacbench_cad.util.untrusted import parse_json, read_bytes

#: The version of the manifest's layout. It changes when a key changes its meaning.
SCHEMA = 1

Row = Mapping[str, Any]


def read_rows(folder: Path) -> list[Row]:
    """Read the rows of a folder's manifest. A folder without a manifest has no rows.

    Raises:
        InputError: The file is not a manifest, or has another schema. The file is not changed.
    """
    path = folder / MANIFEST_NAME
    if not path.exists():
        return []
    wrong = "is not a manifest of a print set; move it away or choose another output folder"
    data = read_bytes(path, "manifest", "json")
    try:
        document = parse_json(data, "manifest", str(path))
    except InputError:
        raise InputError("manifest", str(path), wrong) from None
    rows = document.get("files") if isinstance(document, dict) else None
    if not isinstance(rows, list) or not all(isinstance(row, dict) and _named(row) for row in rows):
        raise InputError("manifest", str(path), wrong)
    if document.get("schema") != SCHEMA:
        raise InputError(
            "manifest", str(path), f"has schema {document.get('schema')!r}, but this version reads only {SCHEMA}"
        )
    return rows


def largest_distance(row: Row) -> str:
    """Return the largest distance of a file from its formula in mm, rounded up; nothing for a part without a formula.

    It is the bound of the certificate. The distance that was measured at the points of the check is smaller, and only
    counts for a part without a certificate.
    """
    certificate = row["certificate"]
    distance = row["deviation_mm"] if certificate is None else certificate["distance_mm"]
    return "" if distance is None else at_most(distance, 2)


def _named(row: Row) -> bool:
    """Return whether a row names a file directly in the folder, and its hash."""
    name = row.get("file")
    return isinstance(name, str) and Path(name).name == name and isinstance(row.get("sha256"), str)


def unchanged(folder: Path, rows: Iterable[Row]) -> list[Row]:
    """Return the rows of files that are still in the folder with the same SHA-256."""
    return [row for row in rows if (folder / row["file"]).is_file() and sha256(folder / row["file"]) == row["sha256"]]


def write_manifest(folder: Path, rows: Iterable[Row]) -> Path:
    """Write the manifest completely or not at all, with its rows sorted by file name.

    Args:
        folder: The output folder.
        rows: Plain JSON values with finite numbers. Each row must have the keys ``file`` and ``sha256``.

    Raises:
        InputError: The folder cannot be written.
    """
    path = folder / MANIFEST_NAME
    document = {"schema": SCHEMA, "units": "mm", "files": sorted(rows, key=lambda row: str(row["file"]))}
    text = json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")
    return path


def merge(old: Iterable[Row], new: Iterable[Row]) -> list[Row]:
    """Merge rows by file name, sorted. A new row replaces the old row of the same file."""
    rows = {str(row["file"]): row for row in old}
    rows.update({str(row["file"]): row for row in new})
    return [rows[name] for name in sorted(rows)]
