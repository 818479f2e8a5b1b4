"""Calibration of a load cell with known masses: a straight line through the raw counts, and the quality of the fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Interval, Len

from tacbench_cad.util import untrusted
from tacbench_cad.util.convert import Checked, check_fields, from_plain, to_plain
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.files import write_json

#: The standard acceleration of free fall, in m/s^2: the weight of 1 kg, in N.
STANDARD_GRAVITY = 9.80665
#: The number of different masses that a fit needs. A line through two masses has no residual that could show an error.
MIN_MASSES = 3
#: The schema of the file.
_SCHEMA = 1
_KIND = "tacbench force calibration"
#: A fit with a larger residual than this fraction of the whole span causes a warning.
_POOR_FRACTION = 0.01


@dataclass(frozen=True, kw_only=True)
class CalibrationPoint(Checked):
    """The samples of the load cell under one mass, summarised.

    Args:
        mass_g: The mass in g; 0 for no load.
        counts: The mean of the raw counts.
        spread_counts: The standard deviation of the raw counts (ddof 0).
        samples: The number of samples.
    """

    mass_g: Annotated[float, Interval(ge=0.0, le=10_000.0)]
    counts: float
    spread_counts: Annotated[float, Ge(0.0)]
    samples: Annotated[int, Ge(1)]


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """The scale of a load cell: F = newtons_per_count (counts - zero_counts).

    Args:
        newtons_per_count: The slope; negative for a cell whose counts decrease under load.
        zero_counts: The counts without load on the day of the calibration. A tare shifts the zero later.
        residual_n: The root mean square distance of the points from the line in N, with n - 2 degrees of freedom.
        worst_n: The largest distance of a point from the line, in N.
        date_utc: The time of the calibration, ISO 8601.
        device: The stable name of the load cell's port.
        points: The points of the fit.
    """

    newtons_per_count: float
    zero_counts: float
    residual_n: Annotated[float, Ge(0.0)]
    worst_n: Annotated[float, Ge(0.0)]
    date_utc: str
    device: str
    points: Annotated[tuple[CalibrationPoint, ...], Len(1, 10_000)]

    def __post_init__(self) -> None:
        check_fields(self)
        if self.newtons_per_count == 0.0:
            raise InputError("newtons_per_count", self.newtons_per_count, "must be a finite number other than 0")

    def newtons(self, counts: float) -> float:
        """Return the force for a raw count in N, before any tare."""
        return self.newtons_per_count * (counts - self.zero_counts)

    @property
    def noise_n(self) -> float:
        """The largest standard deviation of the samples under one mass, in N."""
        return max(point.spread_counts for point in self.points) * abs(self.newtons_per_count)

    @property
    def span_n(self) -> float:
        """The weight of the heaviest mass, in N."""
        return weight_n(max(point.mass_g for point in self.points))

    @property
    def warnings(self) -> tuple[str, ...]:
        """The problems of the fit, one sentence each."""
        warnings = []
        if self.residual_n > _POOR_FRACTION * self.span_n:
            mass_g, distance_n = _farthest(self.points)
            warnings.append(
                f"the point at {mass_g:g} g is {distance_n:.3g} N ({distance_n / STANDARD_GRAVITY * 1e3:.3g} g) away "
                f"from the line through the other points, and all points are {self.residual_n:.3g} N (rms) away from "
                "theirs; check for a wrong mass, a mass that moved or is off the centre, and friction"
            )
        if all(point.mass_g > 0.0 for point in self.points):
            warnings.append("there is no point without load, so forces near zero are extrapolated")
        return tuple(warnings)


def fit(points: Sequence[CalibrationPoint], *, date_utc: str, device: str, falling: bool = False) -> Calibration:
    """Fit a straight line of force against counts to known masses, by least squares.

    The masses are exact and the counts are noisy, so the function fits counts against force and inverts the line.

    Args:
        points: The points; they must include at least three different masses.
        date_utc: The time of the calibration, ISO 8601.
        device: The stable name of the load cell's port.
        falling: Whether counts that decrease under load are accepted.

    Raises:
        InputError: There are too few masses, the counts do not follow them, or the counts decrease under load.
    """
    masses = [point.mass_g for point in points]
    if len(set(masses)) < MIN_MASSES:
        raise InputError("masses", masses, f"must include at least {MIN_MASSES} different masses, best with 0 g")
    force = np.array([weight_n(mass) for mass in masses])
    counts = np.array([point.counts for point in points])
    slope, zero = _line(force, counts)
    noise = max(point.spread_counts for point in points)
    if abs(slope) * float(np.ptp(force)) <= 3.0 * noise or slope == 0.0:
        raise InputError(
            "masses",
            masses,
            f"the counts hardly change with the mass ({float(np.ptp(counts)):.6g} counts, noise {noise:.3g}); check "
            "the wiring of the cell and that the masses are on it",
        )
    if slope < 0.0 and not falling:
        raise InputError(
            "masses",
            masses,
            "the counts decrease as the mass increases: the order of the masses differs from the typed one, the "
            "signal wires of the cell are swapped, or the cell is upside down; if this is intended, use --falling",
        )
    distance = np.abs(counts - (zero + slope * force)) / abs(slope)
    return Calibration(
        newtons_per_count=1.0 / slope,
        zero_counts=zero,
        residual_n=float(np.sqrt(np.sum(distance**2) / (len(points) - 2))),
        worst_n=float(distance.max()),
        date_utc=date_utc,
        device=device,
        points=tuple(points),
    )


def write_calibration(path: Path, calibration: Calibration) -> None:
    """Write a calibration as JSON, completely or not at all.

    Raises:
        InputError: The folder cannot be written.
    """
    write_json(path, {"kind": _KIND, "schema": _SCHEMA, **to_plain(calibration)})


def read_calibration(path: Path) -> Calibration:
    """Read a calibration that :func:`write_calibration` wrote.

    Raises:
        InputError: The file is missing, is not a calibration, or contains a value that is not allowed.
    """
    hint = "`tacbench rig calibrate-force` writes one"
    if not path.exists():
        raise InputError("calibration", str(path), f"does not exist; {hint}")
    document = untrusted.read_document(path, "calibration", "json")
    if not isinstance(document, dict) or document.pop("kind", None) != _KIND:
        raise InputError("calibration", str(path), f"is not a force calibration; {hint}")
    schema = document.pop("schema", None)
    if schema != _SCHEMA:
        raise InputError(f"calibration {path}: schema", schema, f"must be {_SCHEMA} for this version of tacbench")
    return from_plain(Calibration, document, f"calibration {path}: ")


def weight_n(mass_g: float) -> float:
    """Return the weight of a mass in g, in N."""
    return mass_g * 1e-3 * STANDARD_GRAVITY


def _line(force: Any, counts: Any) -> tuple[float, float]:
    """Fit a line and return its slope in counts per newton and its counts without load."""
    design = np.column_stack((force, np.ones_like(force)))
    slope, zero = np.linalg.lstsq(design, counts, rcond=None)[0]
    return float(slope), float(zero)


def _farthest(points: Sequence[CalibrationPoint]) -> tuple[float, float]:
    """Return the mass in g of the worst point and its distance in N from the line through the other points.

    A point near an end bends the line towards itself. Its distance from the line through all points is therefore
    divided by the square root of 1 minus its leverage (the studentized residual).
    """
    force, counts = np.array([(weight_n(point.mass_g), point.counts) for point in points]).T
    slope, zero = _line(force, counts)
    square = (force - force.mean()) ** 2
    leverage = 1.0 / len(points) + square / square.sum()
    worst = int((np.abs(counts - zero - slope * force) / np.sqrt(1.0 - leverage)).argmax())
    slope, zero = _line(np.delete(force, worst), np.delete(counts, worst))
    return points[worst].mass_g, abs(float(counts[worst] - zero - slope * force[worst]) / slope)
