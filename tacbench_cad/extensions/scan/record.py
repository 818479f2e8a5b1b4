"""``scan.json``: the numbers of a scanned print, which analyses set beside the presses of the same print."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tacbench_cad.util.errors import InputError
from tacbench_cad.util.untrusted import read_document

#: The name of the file beside ``print.toml`` in a run folder.
SCAN_FILE = "scan.json"
#: The first keys of the file.
KIND, SCHEMA = "tacbench scan", 1


@dataclass(frozen=True, kw_only=True)
class ScanRecord:
    """The numbers of a scan that analyses use.

    Args:
        file: The name of the scan.
        block: The name of the block.
        simulated: Whether the scan was simulated.
        top_rms_mm: The root mean square of the deviation of the top; None if it is unknown.
        pin_shift_px: The shift of the pins that the deviation causes; None if it is unknown.
        seen_fraction: The fraction of the top that was scanned.
    """

    file: str
    block: str
    simulated: bool
    top_rms_mm: float | None
    pin_shift_px: float | None
    seen_fraction: float


def read_scan_document(path: Path, *, within: Path | None = None) -> dict[str, Any]:
    """Read the document of a scan as plain values.

    Raises:
        InputError: The file cannot be read, or is not such a document.
    """
    document = read_document(path, "scan", "json", within=within)
    if not isinstance(document, dict) or document.get("kind") != KIND:
        raise InputError("scan", str(path), f'must be a file that "tacbench scan" wrote, with "kind": "{KIND}"')
    if document.get("schema") != SCHEMA:
        raise InputError(
            "scan", str(path), f"has schema {document.get('schema')!r}, but this version reads only {SCHEMA}"
        )
    return document


def read_scan_record(path: Path, *, within: Path | None = None) -> ScanRecord:
    """Read the numbers of a scan.

    Args:
        path: The file.
        within: A folder that the file must lie in, also if ``path`` is a link.

    Raises:
        InputError: The file cannot be read, is not the document of a scan, or lacks a number.
    """
    document = read_scan_document(path, within=within)
    top = document.get("top")

    def number(name: str, value: Any) -> float | None:
        if value is not None and (isinstance(value, bool) or not isinstance(value, int | float)):
            raise InputError(f"{path}: {name}", value, "must be a number or null")
        return value

    seen = number("seen_fraction", document.get("seen_fraction"))
    return ScanRecord(
        file=str(document.get("file")),
        block=str(document.get("block")),
        simulated=document.get("simulated") is True,
        top_rms_mm=number("top: rms_mm", top.get("rms_mm")) if isinstance(top, dict) else None,
        pin_shift_px=number("pin_shift_px", document.get("pin_shift_px")),
        seen_fraction=0.0 if seen is None else seen,
    )
