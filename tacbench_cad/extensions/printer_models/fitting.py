"""The model of a printer from the scans of its prints.

Scans of the same print are combined with the inverse of their squared standard errors. The values of several prints
are combined by a random-effects mean: prints differ by more than the scans explain, and the interval contains this
difference. The variance between prints follows DerSimonian and Laird (1986), and the interval Hartung and Knapp (2001),
but it is never narrower than without their factor. With a single print, the interval says nothing about other prints.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from tacbench_cad.extensions.printer_models.model import Measured, PrinterModel, ReliefRule, TransferPoint
from tacbench_cad.extensions.scan.estimates import HALF_WIDTH
from tacbench_cad.extensions.scan.record import SCAN_FILE, read_scan_record, scan_record
from tacbench_cad.util.convert import NOT_STORED
from tacbench_cad.util.errors import InputError

#: Waves whose factor has a larger standard error say nothing about the transfer function.
MAX_ERROR = 0.2
#: Wavelengths of the same direction that differ by less than this fraction give one point of the transfer function.
_SAME_LENGTH = 0.01
#: The largest angle between a wave and an axis to whose transfer function it belongs, in degrees.
_ALONG_DEG = 10.0


@dataclass(frozen=True, kw_only=True)
class FittedParameter:
    """A parameter of the fit, with those fields of a scan's ``Estimate`` that a model needs."""

    name: str
    value: float | None
    standard_error: float | None
    determined: bool


@dataclass(frozen=True, kw_only=True)
class PrintedWave:
    """A printed wave, with those fields of a scan's ``WaveEstimate`` that a model needs."""

    wavelength_mm: float
    direction_deg: float
    amplitude_mm: float
    amplitude_ratio: float | None
    standard_error: float | None
    phase_deg: float | None = None


@dataclass(frozen=True, kw_only=True)
class Geometry:
    """The base and the mean height of the formula's block, in mm."""

    base_mm: float
    datum_mm: float


@dataclass(frozen=True, kw_only=True)
class PrintScan:
    """The numbers of ``scan.json`` that the model of a printer uses.

    Args:
        block: The name of the block.
        parameters: The fitted parameters.
        waves: The printed waves.
        simulated: Whether the scan was simulated.
        printer: The printer; None if it is unknown.
        filament: The filament; None if it is unknown.
        copy: The copy of the print; None if it is unknown.
        nozzle_mm: The diameter of the nozzle; None if it is unknown.
        geometry: The base and the mean height of the formula's block; None if they are unknown.
        printed_from: The name of the block in the printed file, if it differs from ``block``.
        path: The file.
    """

    block: str
    parameters: tuple[FittedParameter, ...]
    waves: tuple[PrintedWave, ...] = ()
    simulated: bool = False
    printer: str | None = None
    filament: str | None = None
    copy: int | str | None = None
    nozzle_mm: float | None = None
    geometry: Geometry | None = None
    printed_from: str | None = None
    path: str = field(default="", metadata=NOT_STORED)

    @property
    def print_name(self) -> str:
        """The name of the print, which several scans can share. Without a copy, each file is a print of its own."""
        return f"{self.block} copy {self.copy}" if self.copy is not None else self.path

    def known(self, name: str) -> tuple[float, float] | None:
        """Return the value and the standard error of a parameter; None if the scan does not determine it."""
        for each in self.parameters:
            if each.name == name and each.determined and each.value is not None and each.standard_error is not None:
                return (each.value, each.standard_error)
        return None

    @property
    def relief_scale(self) -> tuple[float, float]:
        """The factor by which the fit multiplied all amplitudes, and its standard error."""
        return self.known("scale_z") or (1.0, 0.0)

    def height_scale(self) -> tuple[float, float] | None:
        """Return the scale of the mean height above the underside, and its standard error; None if it is unknown."""
        base = self.known("base_mm")
        if base is None or self.geometry is None:
            return None
        (scale, error), datum = self.relief_scale, self.geometry.datum_mm
        height = (datum + base[0] - self.geometry.base_mm) / datum
        return (scale * height, math.hypot(error * height, scale * base[1] / datum))

    def printed_waves(self) -> list[tuple[PrintedWave, complex, float]]:
        """Return each measured wave with its complex factor (amplitude and phase) and the factor's standard error."""
        scale, scale_error = self.relief_scale
        result = []
        for wave in self.waves:
            if wave.amplitude_ratio is None or wave.standard_error is None:
                continue
            factor = cmath.rect(scale * wave.amplitude_ratio, math.radians(wave.phase_deg or 0.0))
            error = math.hypot(scale * wave.standard_error, wave.amplitude_ratio * scale_error)
            result.append((wave, factor, error))
        return result


def read_print_scan(path: Path) -> PrintScan:
    """Read the numbers of a scan from the JSON file that ``tacbench scan`` wrote.

    Raises:
        InputError: The file cannot be read, is not such a file, or a number is missing.
    """
    return replace(read_scan_record(path, PrintScan), path=str(path))


def print_scan(document: Mapping[str, Any], path: str) -> PrintScan:
    """Return the numbers of a scan from its document.

    Args:
        document: The values of ``scan.json``.
        path: The name of the file.

    Raises:
        InputError: A number is missing.
    """
    return replace(scan_record(document, PrintScan, path), path=path)


def find_scans(paths: Sequence[Path]) -> list[Path]:
    """Return the files of scans: the files themselves, and every ``scan.json`` in folders and their subfolders.

    Raises:
        InputError: A folder contains no scan.
    """
    files: list[Path] = []
    for path in paths:
        inside = sorted(path.rglob(SCAN_FILE)) if path.is_dir() else [path]
        if not inside:
            raise InputError("SCANS", str(path), f"has no {SCAN_FILE}; scan a print with tacbench scan")
        files += inside
    return list(dict.fromkeys(files))


def printer_model(
    scans: Sequence[PrintScan],
    *,
    printer: str | None = None,
    filament: str | None = None,
    nozzle_mm: float | None = None,
    name: str | None = None,
    relief_rule: ReliefRule = "formula",
) -> PrinterModel:
    """Compute the model of a printer from scans of plain prints.

    Args:
        scans: The scans, all of one printer and filament.
        printer: The printer, if the scans do not name it.
        filament: The filament, if the scans do not name it.
        nozzle_mm: The diameter of the nozzle, if the scans do not say it.
        name: The name of the model; None for printer and filament.
        relief_rule: The rule for the relief of corrected prints.

    Raises:
        InputError: There is no scan, the scans are of several printers or filaments or of corrected prints, or the
            printer, the filament or the nozzle is unknown.
    """
    if not scans:
        raise InputError("SCANS", None, "needs at least one scan")
    for scan in scans:
        if scan.printed_from is not None:
            allowed = f"is the file of this print of {scan.block}; a model needs scans of prints of plain files"
            raise InputError(f"{scan.path}: printed_from", scan.printed_from, allowed)
    printer = _common(scans, "printer", printer, "--printer NAME")
    filament = _common(scans, "filament", filament, "--filament NAME")
    nozzle = _common(scans, "nozzle_mm", nozzle_mm, "--nozzle MM")
    prints: dict[str, list[PrintScan]] = {}
    for scan in scans:
        prints.setdefault(scan.print_name, []).append(scan)
    groups = list(prints.values())

    def parameter(name: str) -> Measured | None:
        return over_prints(lambda scan: scan.known(name))

    def over_prints(value: Callable[[PrintScan], tuple[float, float] | None]) -> Measured | None:
        each = [_within([known for scan in group if (known := value(scan))]) for group in groups]
        return _measured([known for known in each if known is not None])

    scale_x, scale_y = parameter("scale_x"), parameter("scale_y")
    scales = (scale_x.value if scale_x else 1.0, scale_y.value if scale_y else 1.0)
    return PrinterModel(
        name=name or f"{printer}_{filament}",
        printer=printer,
        filament=filament,
        nozzle_mm=nozzle,
        prints=len(groups),
        scans=tuple(scan.path for scan in scans),
        simulated=any(scan.simulated for scan in scans),
        scale_x=scale_x,
        scale_y=scale_y,
        scale_z=over_prints(PrintScan.height_scale),
        skew_xy_deg=_in_degrees(parameter("skew_xy")),
        offset_mm=parameter("wall_offset_mm"),
        repeatability_mm=_repeatability(groups),
        transfer_x=_transfer(groups, 0.0, scales[0]),
        transfer_y=_transfer(groups, 90.0, scales[1]),
        relief_rule=relief_rule,
    )


def _common(scans: Sequence[PrintScan], name: str, given: Any, option: str) -> Any:
    """Return the value that all scans share, or the given value."""
    known = [] if given is None else [(given, option)]
    known += [(value, scan.path) for scan in scans if (value := getattr(scan, name)) is not None]
    if not known:
        raise InputError(option, None, f"is missing; {scans[0].path} does not name the {name.removesuffix('_mm')}")
    expected, where = known[0]
    for value, path in known[1:]:
        if value != expected:
            allowed = (
                f"differs from {expected!r} ({where}); a model needs scans of one printer, one filament and one nozzle"
            )
            raise InputError(f"{path}: {name}", value, allowed)
    return expected


def _within(values: Sequence[tuple[float, float]]) -> tuple[float, float] | None:
    """Combine scans of one print; None without any."""
    if not values:
        return None
    table = np.array(values)
    weight = 1.0 / np.maximum(table[:, 1], 1e-9) ** 2
    return (float(weight @ table[:, 0] / weight.sum()), float(1.0 / math.sqrt(weight.sum())))


def _measured(values: Sequence[tuple[float, float]]) -> Measured | None:
    """Combine prints; None without any."""
    if not values:
        return None
    table = np.array(values)
    x, variance = table[:, 0], np.maximum(table[:, 1], 1e-9) ** 2
    count = len(x)
    if count == 1:
        half = HALF_WIDTH * math.sqrt(float(variance[0]))
        return Measured(value=float(x[0]), low=float(x[0]) - half, high=float(x[0]) + half)
    from scipy.stats import t

    weight = 1.0 / variance
    mean = weight @ x / weight.sum()
    heterogeneity = weight @ (x - mean) ** 2 - (count - 1)
    between = max(0.0, heterogeneity / (weight.sum() - (weight @ weight) / weight.sum()))
    weight = 1.0 / (variance + between)
    mean = float(weight @ x / weight.sum())
    factor = max(1.0, float(weight @ (x - mean) ** 2) / (count - 1))
    half = float(t.ppf(0.975, count - 1)) * math.sqrt(factor / float(weight.sum()))
    return Measured(value=mean, low=mean - half, high=mean + half)


def _in_degrees(ratio: Measured | None) -> Measured | None:
    if ratio is None:
        return None
    value, low, high = (math.degrees(math.atan(each)) for each in (ratio.value, ratio.low, ratio.high))
    return Measured(value=value, low=low, high=high)


def _transfer(groups: Sequence[Sequence[PrintScan]], axis_deg: float, scale: float) -> tuple[TransferPoint, ...]:
    """Return the transfer function of waves along an axis, by their wavelength in the print."""
    measured: list[tuple[float, int, float, float]] = []
    for i, group in enumerate(groups):
        for scan in group:
            for wave, factor, error in scan.printed_waves():
                turn = abs((wave.direction_deg - axis_deg + 90.0) % 180.0 - 90.0)
                if turn <= _ALONG_DEG and error <= MAX_ERROR:
                    value = abs(factor) if abs(cmath.phase(factor)) <= math.pi / 2.0 else -abs(factor)
                    measured.append((wave.wavelength_mm, i, value, error))
    measured.sort()
    points = []
    while measured:
        same = [row for row in measured if row[0] <= measured[0][0] * (1.0 + _SAME_LENGTH)]
        measured = measured[len(same) :]
        by_print: dict[int, list[tuple[float, float]]] = {}
        for _, i, value, error in same:
            by_print.setdefault(i, []).append((value, error))
        mean = _measured([known for rows in by_print.values() if (known := _within(rows))])
        assert mean is not None
        length = math.exp(float(np.mean([math.log(row[0]) for row in same]))) * scale
        points.append(TransferPoint(wavelength_mm=length, factor=mean.value, low=mean.low, high=mean.high))
    return tuple(points)


def _repeatability(groups: Sequence[Sequence[PrintScan]]) -> Measured | None:
    """Return the standard deviation of the height at a point between prints of the same block; None without any.

    A wave whose complex amplitude has the variance v between prints contributes v / 2 to the mean square of the height.
    The part of v that the scans' own errors explain is subtracted.
    """
    blocks: dict[str, list[PrintScan]] = {}
    for group in groups:
        blocks.setdefault(group[0].block, []).append(group[0])
    square, freedom = 0.0, 0
    for copies in blocks.values():
        if len(copies) < 2:
            continue
        total = 0.0
        rows = [{(w.wavelength_mm, w.direction_deg): (w, z, e) for w, z, e in copy.printed_waves()} for copy in copies]
        for key in set.intersection(*(set(row) for row in rows)):
            amplitude = rows[0][key][0].amplitude_mm
            factors = np.array([row[key][1] for row in rows])
            noise = float(np.mean([2.0 * row[key][2] ** 2 for row in rows]))
            spread = float(np.sum(np.abs(factors - factors.mean()) ** 2)) / (len(rows) - 1)
            total += amplitude**2 * max(0.0, spread - noise) / 2.0
        square += (len(copies) - 1) * total
        freedom += len(copies) - 1
    if freedom == 0:
        return None
    from scipy.stats import chi2

    value = math.sqrt(square / freedom)
    low, high = (value * math.sqrt(freedom / float(chi2.ppf(level, freedom))) for level in (0.975, 0.025))
    return Measured(value=value, low=low, high=high)


def facts(model: PrinterModel) -> list[tuple[str, str, str]]:
    """Return the rows of a table: what was measured, the value, and the interval."""
    rows = []

    def row(what: str, measured: Measured | None, unit: str, factor: float = 1.0, digits: int = 5) -> None:
        if measured is None:
            rows.append((what, "not determined", ""))
            return
        value, low, high = (factor * each for each in (measured.value, measured.low, measured.high))
        rows.append((what, f"{value:.{digits}f}{unit}", f"{low:.{digits}f} to {high:.{digits}f}"))

    for axis in "xyz":
        row(f"scale along {axis}", getattr(model, f"scale_{axis}"), "")
    row("skew", model.skew_xy_deg, " degrees", digits=3)
    row("walls outside of their position", model.offset_mm, " µm", 1000.0, 1)
    row("repeatability between prints", model.repeatability_mm, " µm", 1000.0, 1)
    for axis, points in (("x", model.transfer_x), ("y", model.transfer_y)):
        for point in points:
            what = f"waves of {point.wavelength_mm:.3f} mm along {axis}"
            rows.append((what, f"{point.factor:.3f}", f"{point.low:.3f} to {point.high:.3f}"))
        if not points:
            rows.append((f"waves along {axis}", "not determined", ""))
    return rows
