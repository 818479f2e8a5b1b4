"""Test the positions of a stage during a move: reported, estimated, and interpolated afterwards."""

from __future__ import annotations

import numpy as np
import pytest

from tacbench_cad.extensions.motions.track import StageTrack
from tacbench_cad.lab.rig.clock import Clock


class SetClock(Clock):
    """A clock whose time a test sets."""

    time_s = 0.0

    def now_s(self) -> float:
        return SetClock.time_s


def at(time_s: float) -> None:
    SetClock.time_s = time_s


def track_of(length_mm: float = 10.0, speed_mm_s: float = 5.0) -> StageTrack:
    return StageTrack((0.0, 0.0, 1.0), (length_mm, 0.0, 1.0), speed_mm_s, SetClock())


def test_reported_positions_are_interpolated() -> None:
    track = track_of()
    at(100.0)
    track.begin()
    for time_s, x in ((100.5, 0.0), (101.5, 5.0), (102.5, 10.0)):
        at(time_s)
        track.report((x, 0.0, 1.0))
    track.end()
    assert track.is_reported
    places = track.at_mm(np.array([99.0, 100.5, 101.0, 102.0, 104.0]))
    np.testing.assert_allclose(places[:, 0], [0.0, 0.0, 2.5, 7.5, 10.0])
    np.testing.assert_array_equal(places[:, 1:], [[0.0, 1.0]] * 5)


@pytest.mark.parametrize("reports_arrival", [True, False])
def test_without_reports_on_the_way_the_speed_counts_as_constant_until_the_arrival(reports_arrival: bool) -> None:
    track = track_of()
    at(100.0)
    track.begin()
    at(100.01)
    track.report((0.0, 0.0, 1.0))  # a position at the start says nothing about the motion
    at(102.4)
    if reports_arrival:
        track.report(track.end_mm)
        at(102.6)
    track.end()
    assert not track.is_reported
    places = track.at_mm(np.array([100.1, 100.4, 101.4, 102.4, 102.6]))
    np.testing.assert_allclose(places[:, 0], [0.0, 0.0, 5.0, 10.0, 10.0], atol=1e-9)


def test_the_present_position_is_estimated_from_the_last_report_and_the_speed() -> None:
    track = track_of()
    assert track.now_mm() == track.start_mm
    at(100.0)
    track.begin()
    at(100.4)
    assert track.now_mm() == pytest.approx((2.0, 0.0, 1.0))
    track.report((1.0, 0.0, 1.0))
    at(100.6)
    assert track.now_mm() == pytest.approx((2.0, 0.0, 1.0))
    at(200.0)
    assert track.now_mm() == track.end_mm
    track.end()
    track.report((3.0, 0.0, 1.0))  # too late
    assert track.now_mm() == track.end_mm
