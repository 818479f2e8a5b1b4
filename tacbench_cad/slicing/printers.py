"""Printers: how large their beds are, and what the paper printed on them. The paper's own, and a user's beside them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tacbench_cad.util.errors import InputError, nearest
from tacbench_cad.util.settings import Table, read_toml

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

    name: str
    bed_mm: tuple[float, float]
    height_mm: float
    margin_mm: float
    keep_out_mm: tuple[tuple[float, ...], ...] = ()
    filaments: tuple[str, ...]

    def __post_init__(self) -> None:
        for side in (*self.bed_mm, self.height_mm):
            if not 10.0 <= side <= 5000.0:
                raise InputError(f"printer {self.name}", side, "sides and height must be from 10 to 5000 mm")
        if not 0.0 <= self.margin_mm < min(self.bed_mm) / 2.0:
            raise InputError(f"printer {self.name} margin_mm", self.margin_mm, "must leave something of the bed")
        for x0, y0, x1, y1 in self.keep_out_mm:
            if not (x0 < x1 and y0 < y1):
                low_high = "must be [x low, y low, x high, y high]"
                raise InputError(f"printer {self.name} keep_out_mm", [x0, y0, x1, y1], low_high)


def printers(own: Path | None = None) -> dict[str, Printer]:
    """The paper's printers by name, with those of a user's file in place of or beside them.

    Args:
        own: A file in the form of ``printers.toml``.

    Raises:
        InputError: The file cannot be read, or a key or value in it is not allowed.
    """
    found = read_toml(OWN_FILE, "printers", _printers)
    return found if own is None else {**found, **read_toml(own, "printers", _printers)}


def printer_named(name: str, known: dict[str, Printer]) -> Printer:
    """A printer by its name.

    Args:
        name: The name.
        known: The printers by their names.

    Raises:
        InputError: There is none of this name; the message has the nearest one.
    """
    if name not in known:
        raise InputError("printer", name, nearest(name, known))
    return known[name]


def _printers(document: Table) -> dict[str, Printer]:
    document.only("printer")
    tables = document.table("printer")
    found = {}
    for name in tables.values:
        one = tables.table(name).named(f"[printer.{name}] ")
        one.only("bed_mm", "height_mm", "margin_mm", "keep_out_mm", "filaments")
        found[name] = Printer(
            name=name,
            bed_mm=one.numbers("bed_mm", 2),
            height_mm=one.number("height_mm"),
            margin_mm=one.number("margin_mm", 5.0),
            keep_out_mm=one.rows("keep_out_mm", None, 4, ()),
            filaments=one.texts("filaments"),
        )
    return found
