"""Test taxels over a serial port: a sample or a series without gaps, new samples only, and stuck arrays."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.errors import RigError
from tacbench_cad.lab.rig.sensor import Sensor, is_image
from tacbench_cad.lab.rig.taxels import TaxelOptions, TaxelSensor
from tacbench_cad.util.convert import from_plain
from tacbench_cad.util.errors import InputError


class Array:
    """The lines of an array of four taxels; the first number counts the samples."""

    def __init__(self, alter: Callable[[int, str], str | None] = lambda i, line: line) -> None:
        self.alter = alter
        self.sent = 0
        self.closed = 0

    def now_s(self) -> float:
        return time.monotonic()

    def read_line(self, timeout_s: float) -> str | None:
        self.sent += 1
        return self.alter(self.sent, f"{self.sent},20,30,40")

    def forget(self) -> None:
        self.sent += 100

    def close(self) -> None:
        self.closed += 1


def taxels(array: Array, **options: Any) -> TaxelSensor:
    chosen = from_plain(TaxelOptions, {"columns": 4, "latency_s": 0.0, "timeout_s": 0.1} | options, "[sensor] ")
    return TaxelSensor(array, name="taxels", options=chosen, clock=Clock())


def test_a_single_sample_is_a_row() -> None:
    array = Array()
    with taxels(array, units="kPa") as sensor:
        assert isinstance(sensor, Sensor)
        frame = sensor.read()
        assert frame.shape == sensor.shape == (4,) and frame.dtype == np.float64
        assert not is_image(frame)
        assert (sensor.units, sensor.simulated) == ("kPa", "")
        assert sensor.settings["requested"] == {"columns": 4, "samples": 1, "baud": 115200}
    assert array.closed == 1


def test_samples_are_new_and_complete() -> None:
    array = Array()
    sensor = taxels(array)
    before = array.sent
    # The old input is discarded, and the next line may be incomplete.
    assert sensor.read()[0] == before + 102


def test_a_series_has_no_gaps() -> None:
    array = Array()
    sensor = taxels(array, samples=25)
    hole = array.sent + 100 + 10
    array.alter = lambda i, line: "1,2,3" if i == hole else line
    series = sensor.read()
    assert series[0, 0] > hole and np.all(np.diff(series[:, 0]) == 1.0)
    assert sensor.garbled == 1


def test_a_series_that_is_never_complete_causes_an_error() -> None:
    array = Array()
    sensor = taxels(array, samples=25)
    array.alter = lambda i, line: "?" if i % 10 == 0 else line
    with pytest.raises(RigError, match="5 series in a row contained a damaged line"):
        sensor.read()


@pytest.mark.parametrize("line", ["1,2,3", "1,2,3,4,5", "", "a,b,c,d", "1,2,,4"])
def test_lines_of_another_length_are_not_samples(line: str) -> None:
    array = Array()
    sensor = taxels(array)
    array.alter = lambda i, sound: line if i % 7 == 0 else sound
    for _ in range(20):
        assert sensor.read()[1:].tolist() == [20.0, 30.0, 40.0]
    array.alter = lambda i, sound: line
    with pytest.raises(RigError, match="garbled"):
        sensor.read()


def test_a_stuck_array_is_detected() -> None:
    array = Array(lambda i, line: "1,2,3,4")
    sensor = taxels(array)
    with pytest.raises(RigError, match="50 samples in a row are 1, 2, 3, 4, so the device is stuck"):
        for _ in range(60):
            sensor.read()
    assert taxels(Array(lambda i, line: "1,2,3,4"), samples=200, stuck_samples=0).read().shape == (200, 4)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "columns: is missing"),
        ({"columns": 0}, "columns = 0"),
        ({"columns": 4, "sample": 2}, 'did you mean "samples"'),
        ({"columns": 4, "stuck_samples": 1}, "at least 2, or 0"),
        ({"columns": 4, "timeout_s": 0}, "timeout_s = 0"),
    ],
)
def test_wrong_settings_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        from_plain(TaxelOptions, options, "[sensor] ")
