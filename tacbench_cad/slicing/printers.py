"""Printers: how large their beds are, and what the paper printed on them. The paper's own, and a user's beside them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

from tacbench_cad.util.convert import Length, Word, read_toml
from tacbench_cad.util.errors import InputError, one_of, require_between

#: The paper's printers.
OWN_FILE = Path(__file__).with_name("printers.toml")


@dataclass(frozen=True, kw_only=True)
class Printer:
    """A printer's bed.

    Args:
        name: As run folders use it.
        bed_mm: Sides of the bed, x and y.
        height_mm: How high a print may be.
        margin_mm: What stays free along the bed's edge.
        keep_out_mm: Rectangles ``(x low, y low, x high, y high)`` in which nothing may lie.
        filaments: What is printed on it; the first is the usual one.

    Raises:
        InputError: A value is not allowed.
    """

    name: str = field(default="", metadata={"key": None})
    bed_mm: tuple[float, float]
    height_mm: float
    margin_mm: float = 5.0
    keep_out_mm: tuple[tuple[float, float, float, float], ...] = ()
    filaments: Annotated[tuple[Word, ...], Length(1)]

    def __post_init__(self) -> None:
        for key, side in (("bed_mm", self.bed_mm[0]), ("bed_mm", self.bed_mm[1]), ("height_mm", self.height_mm)):
            require_between(key, side, 10.0, 5000.0, " mm")
        if not 0.0 <= self.margin_mm < min(self.bed_mm) / 2.0:
            raise InputError("margin_mm", self.margin_mm, "must leave something of the bed")
        for x0, y0, x1, y1 in self.keep_out_mm:
            if not (x0 < x1 and y0 < y1):
                raise InputError("keep_out_mm", [x0, y0, x1, y1], "must be [x low, y low, x high, y high]")


@dataclass(frozen=True, kw_only=True)
class _Document:
    printer: Mapping[str, Printer]


def printers(own: Path | None = None) -> dict[str, Printer]:
    """The paper's printers by name, with those of a user's file in place of or beside them.

    Args:
        own: A file in the form of ``printers.toml``.

    Raises:
        InputError: The file cannot be read, or a key or value in it is not allowed.
    """
    files = [OWN_FILE] if own is None else [OWN_FILE, own]
    tables = [read_toml(path, _Document, "printers").printer for path in files]
    return {name: replace(printer, name=name) for table in tables for name, printer in table.items()}


def printer_named(name: str, known: dict[str, Printer]) -> Printer:
    """A printer by its name.

    Args:
        name: The name.
        known: The printers by their names.

    Raises:
        InputError: There is none of this name; the message has the nearest one.
    """
    return known[one_of("printer", name, known)]
