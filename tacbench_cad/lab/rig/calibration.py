"""Calibration of a load cell: known masses, a straight line through the raw counts, and how well it fits."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from tacbench_cad.util import door
from tacbench_cad.util.convert import Bounds, Checked, Length, check_fields, from_plain, to_plain
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.files import write_json

#: Standard acceleration of free fall, m/s^2: a mass of 1 kg weighs so many newtons.
STANDARD_GRAVITY = 9.80665
#: Different masses that a fit needs: a line through two has no residual that could show a mistake.
MIN_MASSES = 3
#: Schema of the file.
_SCHEMA = 1
_KIND = "tacbench force calibration"
#: Residual, as a fraction of the whole span, from which on a fit is worth a warning.
_POOR_FRACTION = 0.01
#: A point is an outlier if it lies this many times further from the others' line than they do ...
_OUTLIER_TIMES = 5.0
#: ... and further than this fraction of the span.
_OUTLIER_FRACTION = 0.005


@dataclass(frozen=True, kw_only=True)
class CalibrationPoint(Checked):
    """What the load cell said under one mass.

    Args:
        mass_g: The mass in grams, 0 for nothing on it.
        counts: Mean of the raw counts.
        spread_counts: Their standard deviation (ddof 0).
        samples: How many there were.
    """

    mass_g: Annotated[float, Bounds(0.0, 10_000.0)]
    counts: float
    spread_counts: Annotated[float, Bounds(0.0)]
    samples: Annotated[int, Bounds(1)]


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """A load cell's scale: F = newtons_per_count (counts - zero_counts).

    Args:
        newtons_per_count: Slope; negative for a cell whose counts fall under load.
        zero_counts: Counts without load on the day of the calibration; a tare moves it.
        residual_n: Root mean square distance of the points from the line, n - 2 degrees of freedom.
        worst_n: Largest such distance.
        date_utc: When it was made, ISO 8601.
        device: What was calibrated: its port's stable name.
        points: What the line was fitted to.
    """

    newtons_per_count: float
    zero_counts: float
    residual_n: Annotated[float, Bounds(0.0)]
    worst_n: Annotated[float, Bounds(0.0)]
    date_utc: str
    device: str
    points: Annotated[tuple[CalibrationPoint, ...], Length(1, 10_000)]

    def __post_init__(self) -> None:
        check_fields(self)
        if self.newtons_per_count == 0.0:
            raise InputError("newtons_per_count", self.newtons_per_count, "must be a finite number other than 0")

    def newtons(self, counts: float) -> float:
        """The force for a raw count, before any tare."""
        return self.newtons_per_count * (counts - self.zero_counts)

    @property
    def noise_n(self) -> float:
        """Largest standard deviation of the samples under one mass, in newtons."""
        return max(point.spread_counts for point in self.points) * abs(self.newtons_per_count)

    @property
    def span_n(self) -> float:
        """Weight of the heaviest mass, in newtons."""
        return weight_n(max(point.mass_g for point in self.points))

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is odd about the fit, a sentence each."""
        warnings = []
        if outlier := _outlier(self.points):
            mass_g, distance_n = outlier
            warnings.append(
                f"the point at {mass_g:g} g lies {distance_n:.3g} N ({distance_n / STANDARD_GRAVITY * 1e3:.3g} g) from "
                "the line through the others: was it this mass, and did it lie still?"
            )
        elif self.residual_n > _POOR_FRACTION * self.span_n:
            warnings.append(
                f"the points lie {self.residual_n:.3g} N from the line (rms), above {_POOR_FRACTION:.0%} of the span: "
                "friction, a mass off the middle, or a wrong mass"
            )
        if all(point.mass_g > 0.0 for point in self.points):
            warnings.append("no point without load: forces near zero are extrapolated")
        return tuple(warnings)


def fit(points: Sequence[CalibrationPoint], *, date_utc: str, device: str, falling: bool = False) -> Calibration:
    """Fit a straight line of force over counts to known masses, by least squares.

    The masses are exact and the counts are noisy, so counts are fitted over force and the line is turned round.

    Args:
        points: At least three different masses.
        date_utc: ISO 8601.
        device: The load cell's port.
        falling: Accept counts that fall under load.

    Raises:
        InputError: Too few masses, counts that do not follow them, or counts that fall under load.
    """
    masses = [point.mass_g for point in points]
    if len(set(masses)) < MIN_MASSES:
        raise InputError("masses", masses, f"at least {MIN_MASSES} different ones are needed, one of them 0 at best")
    force = np.array([weight_n(mass) for mass in masses])
    counts = np.array([point.counts for point in points])
    slope, zero = _line(force, counts)
    noise = max(point.spread_counts for point in points)
    if abs(slope) * float(np.ptp(force)) <= 3.0 * noise or slope == 0.0:
        raise InputError(
            "masses",
            masses,
            f"the counts hardly change with them ({float(np.ptp(counts)):.6g} counts, noise {noise:.3g}): is the cell "
            "wired, and do the masses lie on it?",
        )
    if slope < 0.0 and not falling:
        raise InputError(
            "masses",
            masses,
            "the counts fall as the mass grows: the masses were put on in another order than typed, or the cell's "
            "signal wires are swapped, or it lies upside down; if it is meant to be so, say --falling",
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
    """Write a calibration as JSON, whole or not at all.

    Raises:
        InputError: The folder cannot be written.
    """
    write_json(path, {"kind": _KIND, "schema": _SCHEMA, **to_plain(calibration)})


def read_calibration(path: Path) -> Calibration:
    """Read what :func:`write_calibration` wrote.

    Raises:
        InputError: The file is missing, is no calibration, or has a value that is not allowed.
    """
    hint = "`tacbench rig calibrate-force` writes one"
    if not path.exists():
        raise InputError("calibration", str(path), f"there is no such file; {hint}")
    document = door.read_document(path, "calibration", "json")
    if not isinstance(document, dict) or document.pop("kind", None) != _KIND:
        raise InputError("calibration", str(path), f"is no force calibration; {hint}")
    schema = document.pop("schema", None)
    if schema != _SCHEMA:
        raise InputError(f"calibration {path}: schema", schema, f"this tacbench reads schema {_SCHEMA}")
    return from_plain(Calibration, document, f"calibration {path}: ")


def weight_n(mass_g: float) -> float:
    """Weight of a mass in grams, in newtons."""
    return mass_g * 1e-3 * STANDARD_GRAVITY


def _line(force: Any, counts: Any) -> tuple[float, float]:
    """Slope in counts per newton and counts without load."""
    design = np.column_stack((force, np.ones_like(force)))
    slope, zero = np.linalg.lstsq(design, counts, rcond=None)[0]
    return float(slope), float(zero)


def _outlier(points: Sequence[CalibrationPoint]) -> tuple[float, float] | None:
    """Mass in g of the point that spoils the fit, and its distance in N from the line through the others.

    Each point in turn is left out. Only the furthest is named: a bad point bends every line that it is part of.
    """
    if len(points) <= MIN_MASSES:
        return None
    force = np.array([weight_n(point.mass_g) for point in points])
    counts = np.array([point.counts for point in points])
    span = float(np.ptp(force))
    worst: tuple[float, float, float] | None = None
    for i, point in enumerate(points):
        rest = np.delete(np.arange(len(points)), i)
        if len(set(force[rest])) < 2:
            continue
        slope, zero = _line(force[rest], counts[rest])
        if slope == 0.0:
            continue
        others = float(np.sqrt(np.sum((counts[rest] - zero - slope * force[rest]) ** 2) / (len(rest) - 2))) / abs(slope)
        distance = abs(point.counts - zero - slope * float(force[i])) / abs(slope)
        # Noise alone may let the others lie on their line by chance: they are credited with what the samples spread.
        floor = max(others, point.spread_counts / abs(slope) / math.sqrt(point.samples))
        far = distance > _OUTLIER_TIMES * floor and distance > _OUTLIER_FRACTION * span
        if far and (worst is None or distance / max(floor, 1e-12) > worst[0]):
            worst = (distance / max(floor, 1e-12), point.mass_g, distance)
    return worst and worst[1:]
