"""Test the calibration: the line through known masses, its warnings, and the file."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacbench_cad.lab.rig.calibration import (
    Calibration,
    CalibrationPoint,
    fit,
    read_calibration,
    write_calibration,
)
from tacbench_cad.util.errors import InputError

DATE = "2026-01-02T03:04:05Z"


def points(
    masses: tuple[float, ...] = (0.0, 50.0, 100.0, 200.0),
    slope: float = 4_000.0,
    zero: float = 81_000.0,
    noise: float = 0.0,
    seed: int = 0,
) -> list[CalibrationPoint]:
    """Return the points of a cell with ``slope`` counts per gram."""
    random = np.random.default_rng(seed)
    return [
        CalibrationPoint(
            mass_g=mass,
            counts=zero + slope * mass + float(random.normal(0.0, noise)),
            spread_counts=40.0,
            samples=80,
        )
        for mass in masses
    ]


def fitted(measured: list[CalibrationPoint], falling: bool = False) -> Calibration:
    return fit(measured, date_utc=DATE, device="cell", falling=falling)


@given(
    slope=st.floats(100.0, 1e5),
    zero=st.floats(-1e6, 1e6),
    masses=st.lists(st.integers(0, 500), min_size=3, max_size=8, unique=True),
)
def test_exact_counts_recover_the_masses(slope: float, zero: float, masses: list[int]) -> None:
    measured = points(tuple(float(mass) for mass in masses), slope, zero)
    calibration = fitted(measured)
    for point in measured:
        assert calibration.newtons(point.counts) == pytest.approx(point.mass_g * 9.80665e-3, abs=1e-5)
    assert calibration.worst_n < 1e-5


def test_the_residual_has_two_fewer_degrees_of_freedom() -> None:
    measured = points(noise=900.0)
    calibration = fitted(measured)
    force = np.array([point.mass_g * 9.80665e-3 for point in measured])
    counts = np.array([point.counts for point in measured])
    slope, zero = np.polyfit(force, counts, 1)
    off = (counts - zero - slope * force) / slope
    assert calibration.residual_n == pytest.approx(float(np.sqrt(np.sum(off**2) / 2)))
    assert calibration.worst_n == pytest.approx(float(np.abs(off).max()))


@pytest.mark.parametrize("masses", [(), (0.0,), (0.0, 100.0), (100.0, 100.0, 0.0)])
def test_too_few_masses_are_refused(masses: tuple[float, ...]) -> None:
    with pytest.raises(InputError, match="at least 3 different masses"):
        fitted(points(masses))


def test_falling_counts_are_explained_and_can_be_allowed() -> None:
    measured = points(slope=-4_000.0)
    with pytest.raises(
        InputError, match=r"counts decrease as the mass increases.*order.*swapped.*upside down.*--falling"
    ):
        fitted(measured)
    calibration = fitted(measured, falling=True)
    assert calibration.newtons_per_count < 0.0
    assert calibration.newtons(measured[3].counts) == pytest.approx(1.96133)


@pytest.mark.parametrize("slope", [0.0, 0.1])
def test_a_cell_that_does_not_react_is_refused(slope: float) -> None:
    with pytest.raises(InputError, match="hardly change"):
        fitted(points(slope=slope))


@pytest.mark.parametrize("wrong", range(5))
def test_a_single_wrong_mass_is_reported(wrong: int) -> None:
    masses = (0.0, 50.0, 100.0, 150.0, 200.0)
    measured = points(masses, noise=20.0)
    bad = measured[wrong]
    measured[wrong] = CalibrationPoint(
        mass_g=bad.mass_g, counts=bad.counts + 4_000.0 * 20.0, spread_counts=40.0, samples=80
    )
    (warning,) = fitted(measured).warnings
    assert warning.startswith(f"the point at {masses[wrong]:g} g is 0.19") or "0.2 N" in warning
    assert "(20 g)" in warning or "(19.9 g)" in warning or "(20.1 g)" in warning


def test_a_nonlinear_cell_causes_a_warning() -> None:
    measured = [
        CalibrationPoint(mass_g=mass, counts=4_000.0 * mass + 8.0 * mass**2, spread_counts=40.0, samples=80)
        for mass in (0.0, 50.0, 100.0, 150.0, 200.0)
    ]
    assert any("from the line" in warning for warning in fitted(measured).warnings)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"mass_g": -1.0}, "mass_g = -1.0: must be at least 0"),
        ({"mass_g": float("nan")}, "mass_g"),
        ({"counts": float("inf")}, "counts"),
        ({"samples": 0}, "samples = 0"),
        ({"spread_counts": -1.0}, "spread_counts"),
    ],
)
def test_invalid_points_are_refused(values: dict[str, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        CalibrationPoint(**({"mass_g": 1.0, "counts": 5.0, "spread_counts": 0.0, "samples": 1} | values))  # type: ignore[arg-type]


def test_the_file_round_trips(tmp_path: Path) -> None:
    calibration = fitted(points(noise=30.0))
    path = tmp_path / "gauge.json"
    write_calibration(path, calibration)
    assert read_calibration(path) == calibration
    document = json.loads(path.read_text())
    assert document["date_utc"] == DATE and document["device"] == "cell" and len(document["points"]) == 4


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is not valid JSON"),
        ("[" * 100_000, "is not valid JSON"),
        ("[]", "is not a force calibration"),
        ('{"kind": "other"}', "is not a force calibration"),
        ('{"kind": "tacbench force calibration", "schema": 2}', "schema = 2: must be 1 for this version"),
        ('{"kind": "tacbench force calibration", "schema": 1}', "newtons_per_count|points"),
    ],
)
def test_other_files_are_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "gauge.json"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_calibration(path)


@pytest.mark.parametrize(
    ("key", "value"),
    [("newtons_per_count", 0), ("newtons_per_count", "1"), ("zero_counts", None), ("points", []), ("slope", 1.0)],
)
def test_edited_values_are_refused_by_name(tmp_path: Path, key: str, value: object) -> None:
    path = tmp_path / "gauge.json"
    write_calibration(path, fitted(points()))
    path.write_text(json.dumps(json.loads(path.read_text()) | {key: value}))
    with pytest.raises(InputError, match=rf"calibration .*gauge\.json: .*{key}"):
        read_calibration(path)
