"""Test the virtual carriage: trapezoids, end stops, the ends of the axes, slipping and stalled motors."""

from __future__ import annotations

import math
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacbench_cad.extensions.virtual_rig.machine import MotorAxis, Stroke, VirtualCarriage

AXIS = MotorAxis(low_mm=0.0, high_mm=100.0, home=-1, switch_mm=1.0, steps_per_mm=100.0)


def carriage(at: tuple[float, float, float] = (50.0, 50.0, 50.0), scatter_mm: float = 0.0) -> VirtualCarriage:
    return VirtualCarriage((AXIS, AXIS, AXIS), at, random.Random(1), switch_scatter_mm=scatter_mm)


def run(body: VirtualCarriage, until_s: float) -> list[int]:
    closed = []
    while (when := body.next_event_s()) is not None and when <= until_s:
        axis = body.advance(when)
        if axis is not None:
            closed.append(axis)
    return closed


positive = st.floats(0.01, 500.0)


@given(length=st.floats(1e-4, 300.0), peak=positive, acceleration=positive)
def test_stroke_is_a_trapezoid(length: float, peak: float, acceleration: float) -> None:
    stroke = Stroke(
        start=(0.0, 0.0, 0.0), end=(length, 0.0, 0.0), peak_mm_s=peak, acceleration_mm_s2=acceleration, begin_s=1.0
    )
    duration = stroke.end_s - 1.0
    reached = min(peak, math.sqrt(acceleration * length))
    assert duration == pytest.approx(length / reached + reached / acceleration, rel=1e-9)
    times = [1.0 + duration * i / 40 for i in range(41)]
    travel = [stroke.travelled_mm(t) for t in times]
    assert travel[0] == 0.0 and travel[-1] == pytest.approx(length) and travel == sorted(travel)
    assert max(stroke.speed_mm_s(t) for t in times) <= reached * (1 + 1e-9)
    # The travelled distance is the integral of the speed.
    fine = [1.0 + duration * (i + 0.5) / 2000 for i in range(2000)]
    assert sum(stroke.speed_mm_s(t) for t in fine) * duration / 2000 == pytest.approx(length, rel=1e-3)
    middle = stroke.when_s(length / 3.0)
    assert stroke.travelled_mm(middle) == pytest.approx(length / 3.0, rel=1e-6)


@given(when=st.floats(0.0, 3.0))
def test_pausing_and_resuming_reaches_the_target(when: float) -> None:
    body = carriage()
    body.go((20.0, 10.0, 0.0), 15.0, 50.0, 0.0)
    run(body, when)
    unfinished = body.slow_down(when)
    run(body, 1e3)
    assert not body.moving
    stood = body.counted(1e3)
    assert 0.0 <= stood[0] <= 20.0 and stood[1] == pytest.approx(stood[0] / 2.0, abs=0.02)
    for stroke in unfinished:
        body.go(stroke.end, stroke.peak_mm_s, stroke.acceleration_mm_s2, 1e3)
    run(body, 1e4)
    assert body.counted(1e4) == (20.0, 10.0, 0.0)


def test_end_stop_closes_at_its_position_and_the_frame_stops_the_carriage() -> None:
    body = carriage((5.0, 50.0, 50.0))
    body.go((-20.0, 0.0, 0.0), 5.0, 1e6, 0.0)
    when = body.next_event_s()
    assert when == pytest.approx(6.0 / 5.0, rel=1e-3)
    assert run(body, 100.0) == [0]
    assert body.true(100.0)[0] == -3.0 and body.counted(100.0)[0] == -20.0
    assert body.pressed(100.0) == (0,)
    body.go((-15.0, 0.0, 0.0), 5.0, 1e6, 100.0)
    run(body, 200.0)
    assert body.true(200.0)[0] == 2.0, "steps against the frame are lost"
