"""Printers: the sizes of their beds and their filaments, for the paper's printers and those of a user's file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

from annotated_types import Len

from tacbench_cad.util.convert import NOT_STORED, read_toml
from tacbench_cad.util.errors import InputError, one_of, require_between

#: The file with the paper's printers.
OWN_FILE = Path(__file__).with_name("printers.toml")


@dataclass(frozen=True, kw_only=True)
class Printer:
    """A printer and its bed.

    Args:
        name: The name, as used in run folders.
        bed_mm: The sides x and y of the bed.
        height_mm: The largest height of a print.
        margin_mm: The width of the edge of the bed that stays free.
        keep_out_mm: Rectangles ``(x low, y low, x high, y high)`` that must stay free.
        filaments: The names of the filaments. The first is the default.

    Raises:
        InputError: A value is not allowed.
    """

    name: str = field(default="", metadata=NOT_STORED)
    bed_mm: tuple[float, float]
    height_mm: float
    margin_mm: float = 5.0
    keep_out_mm: tuple[tuple[float, float, float, float], ...] = ()
    filaments: Annotated[tuple[str, ...], Len(1)]

    def __post_init__(self) -> None:
        for key, side in (("bed_mm", self.bed_mm[0]), ("bed_mm", self.bed_mm[1]), ("height_mm", self.height_mm)):
            require_between(key, side, 10.0, 5000.0, " mm")
        if not 0.0 <= self.margin_mm < min(self.bed_mm) / 2.0:
            raise InputError("margin_mm", self.margin_mm, "must be at least 0 and less than half of the bed's side")
        for x0, y0, x1, y1 in self.keep_out_mm:
            if not (x0 < x1 and y0 < y1):
                raise InputError("keep_out_mm", [x0, y0, x1, y1], "must be [x low, y low, x high, y high]")


@dataclass(frozen=True, kw_only=True)
class _Document:
    printer: Mapping[str, Printer]


def printers(own: Path | None = None) -> dict[str, Printer]:
    """Return the paper's printers and those of a user's file, by name.

    A printer of the user's file replaces a printer of the paper with the same name.

    Args:
        own: The user's file, in the format of ``printers.toml``; None for the paper's printers only.

    Raises:
        InputError: The file cannot be read, or a key or value in it is not allowed.
    """
    files = [OWN_FILE] if own is None else [OWN_FILE, own]
    tables = [read_toml(path, _Document, "printers").printer for path in files]
    return {name: replace(printer, name=name) for table in tables for name, printer in table.items()}


def printer_named(name: str, known: dict[str, Printer]) -> Printer:
    """Return the printer with a given name.

    Args:
        name: The name.
        known: The printers by their names.

    Raises:
        InputError: There is no printer with this name. The message suggests the nearest name.
    """
    return known[one_of("printer", name, known)]
