"""Calibration of a load cell: known masses, a straight line through the raw counts, and how well it fits."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tacbench_cad.util import files
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.settings import Table

#: Standard acceleration of free fall, m/s^2: a mass of 1 kg weighs so many newtons.
STANDARD_GRAVITY = 9.80665
#: Different masses that a fit needs: a line through two has no residual that could show a mistake.
LEAST_MASSES = 3
#: Heaviest mass, in grams: beyond the force limit of any run by far.
_MOST_G = 10_000.0
#: Schema of the file.
_SCHEMA = 1
_KIND = "tacbench force calibration"
#: Residual, as a share of the whole span, from which on a fit is worth a warning.
_POOR_SHARE = 0.01
#: A point is an outlier if it lies this many times further from the others' line than they do ...
_OUTLIER_TIMES = 5.0
#: ... and further than this share of the span.
_OUTLIER_SHARE = 0.005


@dataclass(frozen=True, kw_only=True)
class CalibrationPoint:
    """What the load cell said under one mass.

    Args:
        mass_g: The mass in grams, 0 for nothing on it.
        counts: Mean of the raw counts.
        spread_counts: Their standard deviation (ddof 0).
        samples: How many there were.
    """

    mass_g: float
    counts: float
    spread_counts: float
    samples: int

    def __post_init__(self) -> None:
        if not 0.0 <= self.mass_g <= _MOST_G:
            raise InputError("mass_g", self.mass_g, f"must be from 0 to {_MOST_G:g} g")
        if not math.isfinite(self.counts):
            raise InputError("counts", self.counts, "must be a finite number")
        if not (math.isfinite(self.spread_counts) and self.spread_counts >= 0.0):
            raise InputError("spread_counts", self.spread_counts, "must be 0 or more")
        if self.samples < 1:
            raise InputError("samples", self.samples, "must be at least 1")


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
    residual_n: float
    worst_n: float
    date_utc: str
    device: str
    points: tuple[CalibrationPoint, ...]

    def __post_init__(self) -> None:
        if not (math.isfinite(self.newtons_per_count) and self.newtons_per_count != 0.0):
            raise InputError("newtons_per_count", self.newtons_per_count, "must be a finite number other than 0")
        if not math.isfinite(self.zero_counts):
            raise InputError("zero_counts", self.zero_counts, "must be a finite number")
        for name in ("residual_n", "worst_n"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) >= 0.0):
                raise InputError(name, getattr(self, name), "must be 0 or more")

    def newtons(self, counts: float) -> float:
        """The force for a raw count, before any tare."""
        return self.newtons_per_count * (counts - self.zero_counts)

    @property
    def noise_n(self) -> float:
        """Largest standard deviation of the samples under one mass, in newtons."""
        return max(one.spread_counts for one in self.points) * abs(self.newtons_per_count)

    @property
    def span_n(self) -> float:
        """Weight of the heaviest mass, in newtons."""
        return weight_n(max(one.mass_g for one in self.points))

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is odd about the fit, a sentence each."""
        found = [_outlier_sentence(point, distance) for point, distance in _outliers(self.points)]
        if not found and self.residual_n > _POOR_SHARE * self.span_n:
            found.append(
                f"the points lie {self.residual_n:.3g} N from the line (rms), above {_POOR_SHARE:.0%} of the span: "
                "friction, a mass off the middle, or a wrong mass"
            )
        if all(one.mass_g > 0.0 for one in self.points):
            found.append("no point without load: forces near zero are extrapolated")
        return tuple(found)

    def as_dict(self) -> dict[str, Any]:
        """Plain values for the file and for ``run.json``."""
        return asdict(self) | {"points": [asdict(one) for one in self.points]}


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
    masses = [one.mass_g for one in points]
    if len(set(masses)) < LEAST_MASSES:
        raise InputError("masses", masses, f"at least {LEAST_MASSES} different ones are needed, one of them 0 at best")
    force = np.array([weight_n(one) for one in masses])
    counts = np.array([one.counts for one in points])
    slope, zero = _line(force, counts)
    noise = max(one.spread_counts for one in points)
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
    document = {"kind": _KIND, "schema": _SCHEMA, **calibration.as_dict()}
    with files.replacing(path) as temporary:
        temporary.write_text(json.dumps(document, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def read_calibration(path: Path) -> Calibration:
    """Read what :func:`write_calibration` wrote.

    Raises:
        InputError: The file is missing, is no calibration, or has a value that is not allowed.
    """
    field = f"calibration {path}"
    if not path.is_file():
        wrong = "is a folder" if path.is_dir() else "there is no such file"
        raise InputError("calibration", str(path), f"{wrong}; `tacbench rig calibrate-force` writes one")
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError("calibration", str(path), f"cannot be read: {error.strerror}") from None
    except (ValueError, RecursionError):
        raise InputError("calibration", str(path), "is not JSON; `tacbench rig calibrate-force` writes it") from None
    if not isinstance(document, Mapping) or document.get("kind") != _KIND:
        raise InputError("calibration", str(path), "is no force calibration; `tacbench rig calibrate-force` writes one")
    if document.get("schema") != _SCHEMA:
        raise InputError(f"{field}: schema", document.get("schema"), f"this tacbench reads schema {_SCHEMA}")
    try:
        return _calibration(Table(document))
    except InputError as error:
        raise InputError(f"{field}: {error.field}", error.value, error.allowed) from None


def _calibration(table: Table) -> Calibration:
    numbers = ("newtons_per_count", "zero_counts", "residual_n", "worst_n")
    table.only("kind", "schema", *numbers, "date_utc", "device", "points")
    points = tuple(
        CalibrationPoint(
            mass_g=one.number("mass_g"),
            counts=one.number("counts"),
            spread_counts=one.number("spread_counts"),
            samples=one.whole("samples"),
        )
        for one in table.tables("points")
    )
    return Calibration(
        newtons_per_count=table.number("newtons_per_count"),
        zero_counts=table.number("zero_counts"),
        residual_n=table.number("residual_n"),
        worst_n=table.number("worst_n"),
        date_utc=table.text("date_utc"),
        device=table.text("device"),
        points=points,
    )


def weight_n(mass_g: float) -> float:
    """Weight of a mass in grams, in newtons."""
    return mass_g * 1e-3 * STANDARD_GRAVITY


def _line(force: Any, counts: Any) -> tuple[float, float]:
    """Slope in counts per newton and counts without load."""
    design = np.column_stack((force, np.ones_like(force)))
    slope, zero = np.linalg.lstsq(design, counts, rcond=None)[0]
    return float(slope), float(zero)


def _outliers(points: Sequence[CalibrationPoint]) -> list[tuple[CalibrationPoint, float]]:
    """The point that spoils the fit, if there is one, with its distance in newtons from the line through the others.

    Each point in turn is left out. Only the furthest is named: a bad point bends every line that it is part of.
    """
    if len(points) <= LEAST_MASSES:
        return []
    force = np.array([weight_n(one.mass_g) for one in points])
    counts = np.array([one.counts for one in points])
    span = float(np.ptp(force))
    worst: tuple[float, CalibrationPoint, float] | None = None
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
        far = distance > _OUTLIER_TIMES * floor and distance > _OUTLIER_SHARE * span
        if far and (worst is None or distance / max(floor, 1e-12) > worst[0]):
            worst = (distance / max(floor, 1e-12), point, distance)
    return [] if worst is None else [(worst[1], worst[2])]


def _outlier_sentence(point: CalibrationPoint, distance_n: float) -> str:
    return (
        f"the point at {point.mass_g:g} g lies {distance_n:.3g} N ({distance_n / STANDARD_GRAVITY * 1e3:.3g} g) from "
        "the line through the others: was it this mass, and did it lie still?"
    )
