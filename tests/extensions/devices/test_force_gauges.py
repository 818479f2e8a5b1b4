"""Test the drivers of handheld force gauges against emulated gauges. No real gauge was tried."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator

import pytest

pytest.importorskip("tty")
from helpers import emulated_gauges
from helpers.emulated_gauges import EmulatedGauge

from tacbench_cad.extensions.conformance.checks import check_gauge
from tacbench_cad.extensions.devices.force_gauges import MARK_10, AskedGauge, GaugeOptions
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.devices import open_gauge
from tacbench_cad.lab.rig.errors import NoAnswerError, RigError
from tacbench_cad.lab.study.spec import GaugeSettings
from tacbench_cad.util.errors import InputError

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pseudo-terminals")
CLOCK = Clock(speed=8.0)
MAKES = {"mark-10": emulated_gauges.mark_10, "sauter": emulated_gauges.sauter, "imada": emulated_gauges.imada}


@pytest.fixture
def started() -> Iterator[Callable[[str], EmulatedGauge]]:
    gauges = []

    def start(make: str) -> EmulatedGauge:
        gauges.append(MAKES[make]())
        return gauges[-1]

    yield start
    for gauge in gauges:
        gauge.close()


def opened(make: str, gauge: EmulatedGauge, **options: object) -> AskedGauge:
    settings = GaugeSettings(driver=make, port=gauge.port, timeout_s=0.2, options=options)
    return open_gauge(settings, CLOCK)  # type: ignore[return-value]


@pytest.mark.parametrize("make", MAKES)
def test_each_make_conforms(make: str, started: Callable[[str], EmulatedGauge]) -> None:
    emulated = started(make)
    gauge = opened(make, emulated)
    assert make in gauge.identity and emulated.asked == 1
    checks = check_gauge(gauge, CLOCK, load=emulated.put)
    assert [check for check in checks if check.result != "passed"] == []


@pytest.mark.parametrize(
    ("make", "answer", "force_n"),
    [
        ("mark-10", b"-18.78 lbF\r\n", -18.78 * 4.4482216),
        ("mark-10", b"4.285 N\r\n", 4.285),
        ("mark-10", b"4.285\r\n", 4.285),
        ("sauter", b"0011.70", 11.70),
        ("sauter", b"1021.15", -21.15),
        ("imada", b"-12.34KTL\r", -12.34 * 9.80665),
    ],
)
def test_answers_of_the_manuals_are_read(
    make: str, answer: bytes, force_n: float, started: Callable[[str], EmulatedGauge]
) -> None:
    emulated = started(make)
    emulated.answer = lambda force: answer
    with opened(make, emulated) as gauge:
        assert gauge.read(0.0).mean_n == pytest.approx(force_n)
    with opened(make, emulated, compression="negative") as gauge:
        assert gauge.read(0.0).mean_n == pytest.approx(-force_n)


@pytest.mark.parametrize(
    ("make", "answer", "message"),
    [
        ("imada", b"+0001.17NPO\r", "shows the peak"),
        ("mark-10", b"1.2 Nm\r\n", "shows Nm, which is no unit of force"),
        ("mark-10", b"5000 N\r\n", "5000 N is not possible"),
    ],
)
def test_impossible_values_are_refused(
    make: str, answer: bytes, message: str, started: Callable[[str], EmulatedGauge]
) -> None:
    emulated = started(make)
    emulated.answer = lambda force: answer
    with pytest.raises(RigError, match=message):
        opened(make, emulated)


def test_a_silent_or_another_gauge_is_noticed(started: Callable[[str], EmulatedGauge]) -> None:
    emulated = started("mark-10")
    with opened("mark-10", emulated) as gauge:
        emulated.silent = True
        with pytest.raises(NoAnswerError, match="does not answer as a mark-10 gauge does"):
            gauge.read(0.1)
        emulated.silent = False
        assert gauge.read(0.1).samples >= 3, "it can be used again"
    emulated.answer = lambda force: b"*10\r\n"
    with pytest.raises(NoAnswerError):
        AskedGauge(emulated.port, MARK_10, GaugeOptions(), timeout_s=0.05)


def test_a_calibration_is_refused(started: Callable[[str], EmulatedGauge]) -> None:
    settings = GaugeSettings(driver="sauter", port="x", calibration="gauge.json")
    with pytest.raises(InputError, match="must be left out: a sauter gauge sends forces"):
        open_gauge(settings, Clock())
