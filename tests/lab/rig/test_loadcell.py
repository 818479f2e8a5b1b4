"""Test the load cell: conversion of counts to newtons, new samples only, and every fault of a cell."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
import pytest

from tacbench_cad.lab.rig.calibration import Calibration, CalibrationPoint, fit
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.devices import open_gauge
from tacbench_cad.lab.rig.errors import DeviceLostError, NoAnswerError, RigError
from tacbench_cad.lab.rig.gauge import Gauge
from tacbench_cad.lab.rig.loadcell import LoadCell, LoadCellOptions
from tacbench_cad.lab.study.spec import GaugeSettings
from tacbench_cad.util.errors import InputError

#: The counts per newton and the counts without load of the cell of these tests.
SLOPE = 400_000.0
ZERO = 81_000.0
RATE_HZ = 80.0


class Time:
    """A clock that only advances when the cell sends a line."""

    speed = 1.0

    def __init__(self) -> None:
        self.now = 0.0

    def sleep(self, seconds: float) -> None:
        self.now += seconds

    def now_s(self) -> float:
        return self.now


class Cell:
    """A cell that sends lines at 80 Hz."""

    def __init__(self, clock: Time, force_n: Callable[[float], float] = lambda t: 0.0) -> None:
        self.clock = clock
        self.force_n = force_n
        self.random = np.random.default_rng(1)
        self.alter: Callable[[int, str], str | None] = lambda i, line: line
        self.sent = 0
        self.forgotten = 0
        self.closed = 0

    def now_s(self) -> float:
        return time.monotonic()

    def read_line(self, timeout_s: float) -> str | None:
        self.clock.now += 1.0 / RATE_HZ
        self.sent += 1
        counts = round(ZERO + SLOPE * self.force_n(self.clock.now) + self.random.normal(0.0, 100.0))
        return self.alter(self.sent, str(counts))

    def forget(self) -> None:
        self.forgotten += 1

    def close(self) -> None:
        self.closed += 1


def calibration() -> Calibration:
    points = [
        CalibrationPoint(mass_g=mass, counts=ZERO + SLOPE * mass * 9.80665e-3, spread_counts=100.0, samples=80)
        for mass in (0.0, 100.0, 200.0)
    ]
    return fit(points, date_utc="2026-01-02", device="cell")


def load_cell(cell: Cell, scale: Calibration | None = None, name: str = "", **options: Any) -> LoadCell:
    chosen = LoadCellOptions(latency_s=0.0, **options)
    return LoadCell(
        cell,  # type: ignore[arg-type]
        name="cell",
        options=chosen,
        timeout_s=0.1,
        clock=cell.clock,  # type: ignore[arg-type]
        calibration=scale,
        calibration_name=name,
    )


def gauge(cell: Cell, **options: Any) -> LoadCell:
    return load_cell(cell, calibration(), "gauge.json", **options)


def test_the_load_cell_is_a_gauge_in_newtons() -> None:
    cell = Cell(Time(), lambda t: 1.913)
    with gauge(cell) as cell_gauge:
        assert isinstance(cell_gauge, Gauge)
        force = cell_gauge.read(1.0)
        assert force.mean_n == pytest.approx(1.913, abs=5e-4)
        assert force.spread_n == pytest.approx(100.0 / SLOPE, rel=0.3)
        assert force.samples in (80, 81)
        assert cell_gauge.calibration["file"] == "gauge.json" and cell_gauge.calibration[
            "zero_counts"
        ] == pytest.approx(ZERO)
        assert "2026-01-02" in cell_gauge.identity and cell_gauge.simulated == ""
    cell_gauge.close()
    assert cell.closed == 2


def test_the_window_begins_at_the_call() -> None:
    cell = Cell(Time(), lambda t: 0.0 if t < 5.0 else 2.0)
    cell_gauge = gauge(cell)
    cell.clock.now = 5.0
    before = cell.forgotten
    force = cell_gauge.read(0.1)
    assert force.mean_n == pytest.approx(2.0, abs=1e-3) and force.samples >= 8
    assert cell.forgotten == before + 1


@pytest.mark.parametrize("line", ["8100", "810000"])
def test_a_third_sample_shows_which_of_two_is_damaged(line: str) -> None:
    cell = Cell(Time(), lambda t: 2.0)
    opened = gauge(cell)
    damaged = cell.sent + 3
    cell.alter = lambda i, sound: line if i == damaged else sound
    force = opened.read(0.0)
    assert cell.sent == damaged + 1, "the rest of a line, a sample, the damaged one, and the third"
    assert force.mean_n == pytest.approx(2.0, abs=1e-3) and force.samples == 2


def test_a_tare_makes_the_current_force_zero() -> None:
    cell = Cell(Time(), lambda t: 0.7)
    cell_gauge = gauge(cell)
    cell_gauge.tare()
    assert cell_gauge.read(0.5).mean_n == pytest.approx(0.0, abs=1e-3)
    cell.force_n = lambda t: 1.0
    assert cell_gauge.read(0.5).mean_n == pytest.approx(0.3, abs=1e-3)
    cell_gauge.tare()
    assert cell_gauge.read(0.5).mean_n == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("damage", [lambda line: line[:-1], lambda line: line[1:], lambda line: line + line[-1]])
def test_a_lost_or_doubled_digit_does_not_change_the_mean(damage: Callable[[str], str]) -> None:
    cell = Cell(Time(), lambda t: 1.0)
    cell_gauge = gauge(cell)
    cell.alter = lambda i, line: damage(line) if i % 8 == 0 else line
    force = cell_gauge.read(1.0)
    assert force.mean_n == pytest.approx(1.0, abs=1e-3)
    assert cell_gauge.garbled >= 8


@pytest.mark.parametrize("line", ["", "\ufffd\ufffd", "12 34", "nan"])
def test_garbled_lines_alone_are_an_error(line: str) -> None:
    cell = Cell(Time())
    cell_gauge = gauge(cell)
    cell.alter = lambda i, sound: line
    with pytest.raises(RigError, match="garbled"):
        cell_gauge.read(0.1)


@pytest.mark.parametrize("value", ["99999999999", "-9000000", "197.7123"])
def test_impossible_forces_mean_saturation(value: str) -> None:
    cell = Cell(Time())
    cell_gauge = gauge(cell) if "." not in value else load_cell(cell, unit="newtons")
    random = np.random.default_rng(3)
    cell.alter = lambda i, line: f"{float(value) + random.integers(0, 9):.10g}"
    with pytest.raises(RigError, match="saturated, 5 samples in a row"):
        cell_gauge.read(0.1)


def test_a_column_can_be_chosen() -> None:
    cell = Cell(Time(), lambda t: 1.0)
    cell.alter = lambda i, line: f"{i * 12},{line},25.5"
    assert gauge(cell, columns=3, column=2).read(0.5).mean_n == pytest.approx(1.0, abs=1e-3)


def test_a_falling_cell_gives_positive_forces() -> None:
    points = [
        CalibrationPoint(mass_g=mass, counts=ZERO - SLOPE * mass * 9.80665e-3, spread_counts=100.0, samples=80)
        for mass in (0.0, 100.0, 200.0)
    ]
    falling = fit(points, date_utc="2026-01-02", device="cell", falling=True)
    cell = Cell(Time())
    cell.alter = lambda i, line: str(2 * round(ZERO) - int(line))
    cell.force_n = lambda t: 1.0
    force = load_cell(cell, falling).read(0.5)
    assert force.mean_n == pytest.approx(1.0, abs=1e-3) and force.spread_n > 0.0


@pytest.mark.parametrize(
    ("options", "calibrated", "message"),
    [
        ({"rate": 80}, True, "unknown key"),
        ({"column": 2}, True, "column = 2: must be from 1 to 1"),
        ({"stuck_samples": 1}, True, "stuck_samples = 1"),
        ({"unit": "grams"}, True, "unit = 'grams'"),
        ({"unit": "counts"}, False, "needs .*calibration"),
        ({"unit": "newtons"}, True, "must not be combined"),
        ({"low_counts": 5.0, "high_counts": 4.0}, True, "must be below high_counts"),
    ],
)
def test_wrong_options_are_refused(options: dict[str, Any], calibrated: bool, message: str) -> None:
    with pytest.raises(InputError, match=message):
        LoadCellOptions.of(options, calibrated=calibrated)


def first_good_force(gauge: Gauge, error: type[Exception]) -> float:
    """Return the first force in N after a fault. On a busy machine the port may still hold samples of the fault."""
    for _ in range(40):
        with suppress(error):
            return gauge.read(0.1).mean_n
    raise AssertionError("the gauge did not recover")


@pytest.mark.usefixtures("rig_time")
def test_the_virtual_rigs_faults_cause_specific_errors_and_the_gauge_recovers() -> None:
    from tacbench_cad.extensions.virtual_rig import launch
    from tacbench_cad.extensions.virtual_rig.faults import Fault

    spring = {"flat_z_mm": 10.0, "n_per_mm": 0.2}
    with launch("grbl", speed=50.0, seed=3, gauge={"newtons": True}, stimulus=spring) as rig:
        settings = GaugeSettings(driver="serial", port=rig.gauge_port, timeout_s=0.6)
        with open_gauge(settings, Clock(speed=50.0)) as cell_gauge:
            for kind in ("drop", "double", "garble"):
                rig.inject(Fault(kind=kind, where="gauge", chance=0.005, seconds=20.0))
            force = rig.force_n()
            for _ in range(60):
                assert cell_gauge.read(0.1).mean_n == pytest.approx(force, abs=0.004)
            for kind, error, seconds in (
                ("stuck", RigError, 20.0),
                ("saturated", RigError, 20.0),
                ("silence", NoAnswerError, 60.0),
            ):
                until = rig.now_s() + seconds
                rig.inject(Fault(kind=kind, where="gauge", seconds=seconds))
                with pytest.raises(error):
                    for _ in range(40):
                        cell_gauge.read(0.1)
                Clock(speed=50.0).sleep(until - rig.now_s() + 15.0)
                assert first_good_force(cell_gauge, error) == pytest.approx(force, abs=0.004)
            rig.inject(Fault(kind="unplug", where="gauge"))
            with pytest.raises(DeviceLostError):
                for _ in range(40):
                    cell_gauge.read(0.1)
