"""``scan.json``: the numbers of a scanned print, which analyses set beside the presses of the same print."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, is_dataclass
from pathlib import Path
from typing import Any, TypeVar, get_args, get_type_hints

from tacbench_cad.util.convert import from_plain
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.untrusted import read_document

T = TypeVar("T")
#: The name of the file beside ``print.toml`` in a run folder.
SCAN_FILE = "scan.json"
#: The first keys of the file.
KIND, SCHEMA = "tacbench scan", 1


@dataclass(frozen=True, kw_only=True)
class TopRecord:
    """The root mean square of the deviation of the top, with the name that it has in the file."""

    rms_mm: float


@dataclass(frozen=True, kw_only=True)
class ScanRecord:
    """The numbers of a scan that analyses use.

    Args:
        file: The name of the scan.
        block: The name of the block.
        simulated: Whether the scan was simulated.
        top: The deviation of the top; None if it is unknown.
        pin_shift_px: The shift of the pins that the deviation causes; None if it is unknown.
        seen_fraction: The fraction of the top that was scanned.
    """

    file: str
    block: str
    simulated: bool
    top: TopRecord | None
    pin_shift_px: float | None
    seen_fraction: float

    @property
    def top_rms_mm(self) -> float | None:
        """The root mean square of the deviation of the top; None if it is unknown."""
        return None if self.top is None else self.top.rms_mm


def read_scan_record(path: Path, kind: type[T], *, within: Path | None = None) -> T:
    """Read the numbers of a scan.

    Args:
        path: The file.
        kind: A dataclass with fields for the wanted numbers, such as :class:`ScanRecord`.
        within: A folder that the file must lie in, also if ``path`` is a link.

    Raises:
        InputError: The file cannot be read, is not the document of a scan, or lacks a number.
    """
    document = read_document(path, "scan", "json", within=within)
    if not isinstance(document, dict) or document.get("kind") != KIND:
        raise InputError("scan", str(path), f'must be a file that "tacbench scan" wrote, with "kind": "{KIND}"')
    if document.get("schema") != SCHEMA:
        raise InputError(
            "scan", str(path), f"has schema {document.get('schema')!r}, but this version reads only {SCHEMA}"
        )
    return scan_record(document, kind, str(path))


def scan_record(document: Mapping[str, Any], kind: type[T], path: str) -> T:
    """Return the numbers of a scan from its document; see :func:`read_scan_record`."""
    return from_plain(kind, _known(document, kind), f"{path}: ")


def _known(value: Any, kind: Any) -> Any:
    """Return a plain value without the keys for which a dataclass has no field."""
    if isinstance(value, list):
        return [_known(each, kind) for each in value]
    classes = [each for each in (kind, *get_args(kind)) if is_dataclass(each)]
    if not isinstance(value, Mapping) or not classes:
        return value
    return {name: _known(value[name], each) for name, each in get_type_hints(classes[0]).items() if name in value}
