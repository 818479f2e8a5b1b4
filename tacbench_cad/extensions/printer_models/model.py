"""The measured model of a printer and a filament: how much smaller, wider and smoother prints are than their files.

``tacbench printer-model`` computes it from scans of prints and writes it as TOML. ``tacbench correct`` and
``tacbench simulate --printers`` read it.
"""

from __future__ import annotations

import hashlib
import itertools
import math
import re
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, Interval, Len

from tacbench_cad.spec import Circle, Outline
from tacbench_cad.util.convert import Checked, read_toml, to_plain
from tacbench_cad.util.errors import InputError, require_between
from tacbench_cad.util.files import write_text
from tacbench_cad.util.text import toml_item

#: The first key of a file, which tells a printer model from other TOML files.
FORMAT = "tacbench-printer-model-1"
#: The largest difference between the sides of a printed disc or ring that can be corrected, in mm.
MAX_OVAL_MM = 0.02
#: The rules for the relief of corrected prints: equal to that of the formula, or free.
ReliefRule = Literal["formula", "free"]


@dataclass(frozen=True, kw_only=True)
class Measured(Checked):
    """A measured number with its interval of 95 %.

    Args:
        value: The number.
        low: The lower end of the interval.
        high: The upper end.
    """

    value: float
    low: float
    high: float

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.low <= self.value <= self.high:
            raise InputError(
                "value", self.value, f"must lie in its interval from low {self.low:g} to high {self.high:g}"
            )


@dataclass(frozen=True, kw_only=True)
class TransferPoint(Checked):
    """A point of the transfer function.

    Args:
        wavelength_mm: The wavelength in the print.
        factor: The amplitude of a wave in the print, divided by its amplitude in the file.
        low: The lower end of the factor's interval of 95 %.
        high: The upper end.
    """

    wavelength_mm: Annotated[float, Interval(ge=1e-4, le=1e6)]
    factor: Annotated[float, Interval(ge=-10.0, le=10.0)]
    low: float
    high: float

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.low <= self.factor <= self.high:
            allowed = f"must lie in its interval from low {self.low:g} to high {self.high:g}"
            raise InputError("factor", self.factor, allowed)


Transfer = Annotated[tuple[TransferPoint, ...], Len(0, 10_000)]


@dataclass(frozen=True, kw_only=True)
class PrinterModel(Checked):
    """A printer with a filament, as its prints were measured. A number that no scan determines is None.

    In the print's own frame, with its lower corner at (0, 0), a print of a file has these properties:

    - A side of length s along x has the length ``scale_x s + 2 offset_mm``, and along y likewise.
    - A point of the texture at x has the position ``scale_x x + offset_mm``.
    - For an outline that is not a rectangle, the walls are likewise ``offset_mm`` outside of the scaled outline.
    - The mean height z of the texture above the underside becomes ``scale_z z``.
    - A wave of amplitude a has the amplitude ``transfer(wavelength, direction) a``.

    Args:
        name: The name, which corrected files contain: ``ender-3_pla-plus``.
        printer: The name of the printer.
        filament: The name of the filament.
        nozzle_mm: The diameter of the nozzle (of the laser's spot for resin).
        prints: The number of different prints that were scanned.
        scans: The files of the scans.
        simulated: Whether a scan was simulated.
        scale_x: The scale along x; 0.996 for a print that is 0.4 % too small.
        scale_y: The scale along y.
        scale_z: The scale along z.
        skew_xy_deg: The angle by which the y side leans towards x.
        offset_mm: The distance of the walls outside of their position.
        repeatability_mm: The standard deviation between prints of the height at a point.
        transfer_x: The transfer function of waves along x, by increasing wavelength.
        transfer_y: The transfer function of waves along y.
        relief_rule: How files are corrected. With ``formula``, the relief of the print is equal to that of the formula:
            waves that can be corrected also make up for those that cannot. With ``free``, each wave is only corrected
            for its own error.

    Raises:
        InputError: A field has a value that is not allowed.
    """

    name: str
    printer: str
    filament: str
    nozzle_mm: Annotated[float, Interval(ge=0.01, le=5.0)]
    prints: Annotated[int, Ge(1)]
    scans: tuple[str, ...] = ()
    simulated: bool = False
    scale_x: Measured | None = None
    scale_y: Measured | None = None
    scale_z: Measured | None = None
    skew_xy_deg: Measured | None = None
    offset_mm: Measured | None = None
    repeatability_mm: Measured | None = None
    transfer_x: Transfer = ()
    transfer_y: Transfer = ()
    relief_rule: ReliefRule = "formula"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not re.fullmatch(r"[A-Za-z0-9._+-]{1,80}", self.name):
            raise InputError("name", self.name, "must have 1 to 80 letters, digits, hyphens, dots and underscores")
        for axis in "xyz":
            measured: Measured | None = getattr(self, f"scale_{axis}")
            if measured is not None:  # larger errors are mistakes of units or of the slicer
                require_between(f"[scale_{axis}] value", measured.value, 0.8, 1.2)
        if self.offset_mm is not None and abs(self.offset_mm.value) > 1.0:
            raise InputError("[offset_mm] value", self.offset_mm.value, "must be from -1 to 1 mm")
        if self.repeatability_mm is not None and self.repeatability_mm.value < 0.0:
            raise InputError("[repeatability_mm] value", self.repeatability_mm.value, "must be at least 0 mm")
        for name in ("transfer_x", "transfer_y"):
            lengths = [point.wavelength_mm for point in getattr(self, name)]
            if any(a >= b for a, b in itertools.pairwise(lengths)):
                raise InputError(f"[[{name}]] wavelength_mm", None, "must increase from point to point")

    @property
    def fingerprint(self) -> str:
        """The name with a hash of all values: ``ender-3_pla-plus-1a2b3c``. Another model has another fingerprint."""
        return f"{self.name}-{hashlib.sha256(toml_text(self).encode()).hexdigest()[:6]}"

    @property
    def scale(self) -> tuple[float, float, float]:
        """The scales along x, y and z; 1 along an axis that no scan determines."""
        x, y, z = (
            1.0 if measured is None else measured.value for measured in (self.scale_x, self.scale_y, self.scale_z)
        )
        return (x, y, z)

    @property
    def wall_offset_mm(self) -> float:
        """The offset of the walls; 0 if no scan determines it."""
        return 0.0 if self.offset_mm is None else self.offset_mm.value

    def print_size_mm(self, sides_mm: tuple[float, float]) -> tuple[float, float]:
        """Return the sides x, y of a print from those of its file, for a rectangle."""
        x, y = sides_mm
        return (self.scale[0] * x + 2.0 * self.wall_offset_mm, self.scale[1] * y + 2.0 * self.wall_offset_mm)

    def file_size_mm(self, sides_mm: tuple[float, float]) -> tuple[float, float]:
        """Return the sides x, y of the file from those of its print, for a rectangle."""
        x, y = sides_mm
        return ((x - 2.0 * self.wall_offset_mm) / self.scale[0], (y - 2.0 * self.wall_offset_mm) / self.scale[1])

    def file_outline(self, outline: Outline, scale: float) -> Outline:
        """Return the outline of the file from that of its print, both before scaling.

        Args:
            outline: The outline of the print.
            scale: The factor that multiplies both.

        Raises:
            InputError: Circles would be printed as ovals, or a side is too short for the offset of the walls.
        """
        x, y, _ = self.scale
        oval_mm = abs(x - y) * outline.size_mm[0] * scale
        if isinstance(outline.loops[0], Circle) and oval_mm > MAX_OVAL_MM:
            oval = f"an oval whose sides differ by {oval_mm:.3f} mm"
            allowed = f"prints the {outline} as {oval}; at most {MAX_OVAL_MM:g} mm can be corrected"
            raise InputError("printer model", self.name, allowed)
        return outline.moved_outwards(-self.wall_offset_mm / scale).stretched(1.0 / x, 1.0 / y)

    def file_key_mm(self, key_mm: float | None) -> float | None:
        """Return the leg of the key in the file from that in the print; None for no key."""
        return None if key_mm is None else key_mm / math.sqrt(self.scale[0] * self.scale[1])

    def transfer(self, wavelength_mm: float, direction_deg: float) -> float:
        """Return the factor of a wave's amplitude in the print.

        The function is interpolated between the measured wavelengths, on a logarithmic scale. Beyond the shortest and
        the longest of them it keeps their factor. An oblique wave gets the mean of the factors along x and y, weighted
        by the squares of cosine and sine. Along an axis without any measured wave the factor is 1.

        Args:
            wavelength_mm: The wavelength in the print, at right angles to the crests.
            direction_deg: The angle from the x axis of the direction in which the height changes: 0 for a wave along
                x, 90 for a wave along y.
        """
        along_x = math.cos(math.radians(direction_deg)) ** 2
        return along_x * _at(self.transfer_x, wavelength_mm) + (1.0 - along_x) * _at(self.transfer_y, wavelength_mm)


def _at(points: tuple[TransferPoint, ...], wavelength_mm: float) -> float:
    if not points:
        return 1.0
    lengths = np.log([point.wavelength_mm for point in points])
    return float(np.interp(math.log(wavelength_mm), lengths, [point.factor for point in points]))


@dataclass(frozen=True, kw_only=True)
class _Document(PrinterModel):
    """The document of a model's file."""

    format: Literal["tacbench-printer-model-1"]


def read_printer_model(path: Path) -> PrinterModel:
    """Read the model of a printer from a TOML file.

    Raises:
        InputError: The file cannot be read, or a key or a value is not allowed.
    """
    document = read_toml(path, _Document, "printer model")
    return PrinterModel(**{field.name: getattr(document, field.name) for field in fields(PrinterModel)})


def write_printer_model(model: PrinterModel, path: Path) -> None:
    """Write the model of a printer to a TOML file, completely or not at all.

    Raises:
        InputError: The file cannot be written.
    """
    write_text(path, toml_text(model))


def toml_text(model: PrinterModel) -> str:
    """Return the model of a printer as the text of a TOML file."""
    import tomlkit  # imported here, because most commands write no such file

    plain: dict[str, Any] = to_plain(model, without_none=True)
    tables = {name: plain.pop(name) for name in ("transfer_x", "transfer_y")}
    return tomlkit.dumps({"format": FORMAT, **{key: toml_item(value) for key, value in plain.items()}, **tables})
