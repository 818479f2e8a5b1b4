"""Test the courses of motions: the summit, the centre of the dome and the angles on the way."""

from __future__ import annotations

import math

import pytest

from tacbench_cad.lab.study.motion import course_of
from tacbench_cad.lab.study.rotation import above, lowest, tilt
from tacbench_cad.lab.study.spec import Point, Protocol

START: Point = (5.0, 20.0, -1.5)
ANGLE = math.radians(12.0)


def test_a_slide_keeps_its_height_and_its_angles() -> None:
    course = course_of(Protocol(motion="slide", slide_length_mm=6.0, slide_speed_mm_s=3.0), START)
    assert course.seconds == pytest.approx(2.0)
    assert course.at(0.5) == (pytest.approx((5.0, 23.0, -1.5)), (0.0, 0.0, 0.0))


@pytest.mark.parametrize("direction", [0.0, 135.0])
def test_in_a_roll_the_dome_touches_at_its_own_height_and_moves_by_the_arc(direction: float) -> None:
    protocol = Protocol(motion="roll", turn_angle_deg=12.0, turn_direction_deg=direction, turn_speed_deg_s=6.0)
    course = course_of(protocol, START)
    assert course.seconds == pytest.approx(2.0)
    x, y = math.cos(math.radians(direction)), math.sin(math.radians(direction))
    for part in (0.0, 0.25, 1.0):
        summit, angles = course.at(part)
        length = 20.0 * part * ANGLE
        assert tilt(angles) == pytest.approx(12.0 * part, abs=1e-6)
        assert above(summit, angles, 20.0) == pytest.approx((5.0 + length * x, 20.0 + length * y, 18.5))
        assert lowest(summit, angles) == pytest.approx((5.0 + length * x, 20.0 + length * y, -1.5))


def test_in_a_tilt_the_summit_stays_and_the_dome_dips() -> None:
    protocol = Protocol(motion="tilt", turn_angle_deg=12.0, turn_direction_deg=90.0)
    for part in (0.0, 0.5, 1.0):
        summit, angles = course_of(protocol, START).at(part)
        assert summit == pytest.approx(START)
        assert angles == pytest.approx((-12.0 * part, 0.0, 0.0))
        _, y, z = lowest(summit, angles)
        assert y == pytest.approx(20.0 + 20.0 * math.sin(part * ANGLE))
        assert z == pytest.approx(-1.5 - 20.0 * (1.0 - math.cos(part * ANGLE)))
    assert -1.5 - z == pytest.approx(protocol.dip_mm)
