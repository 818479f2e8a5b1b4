"""Compare rotations with SciPy's, and test the points of a turned dome."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tacbench_cad.lab.study.rotation import (
    UPRIGHT,
    above,
    angle_between,
    angles_of,
    from_vector,
    in_stage_frame,
    in_work_frame,
    lowest,
    matrix,
    tilt,
    to_vector,
    towards,
)
from tacbench_cad.lab.study.spec import Angles, WorkFrame

ANGLES = st.tuples(st.floats(-180.0, 180.0), st.floats(-89.9, 89.9), st.floats(-180.0, 180.0))
TILTS = st.tuples(st.floats(-360.0, 360.0), st.floats(0.0, 60.0))


@settings(max_examples=60, deadline=None)
@given(angles=ANGLES)
def test_angles_are_extrinsic_xyz_as_in_scipy(angles: Angles) -> None:
    turn = matrix(angles)
    assert turn == pytest.approx(Rotation.from_euler("xyz", angles, degrees=True).as_matrix(), abs=1e-12)
    assert matrix(angles_of(turn)) == pytest.approx(turn, abs=1e-9)
    assert from_vector(to_vector(turn)) == pytest.approx(turn, abs=1e-7)


@pytest.mark.parametrize("vector", [(math.pi, 0.0, 0.0), (0.0, -math.pi, 0.0), (0.0, 0.0, 0.0), (1e-9, 0.0, 2e-9)])
def test_vectors_of_no_turn_and_of_half_a_turn(vector: tuple[float, float, float]) -> None:
    turn = from_vector(vector)
    assert from_vector(to_vector(turn)) == pytest.approx(turn, abs=1e-12)


def test_a_sensor_leans_towards_its_direction() -> None:
    assert towards(0.0, 10.0) == pytest.approx((0.0, 10.0, 0.0))
    assert towards(90.0, 10.0) == pytest.approx((-10.0, 0.0, 0.0))
    x, y, z = above((1.0, 2.0, 3.0), towards(90.0, 30.0), 20.0)
    assert (x, y, z) == pytest.approx((1.0, 12.0, 3.0 + 20.0 * math.cos(math.radians(30.0))))


@settings(max_examples=40, deadline=None)
@given(lean=TILTS, turns=st.integers(0, 3))
def test_the_tilt_of_a_sensor_is_the_same_in_both_frames(lean: tuple[float, float], turns: int) -> None:
    frame, angles = WorkFrame(origin_mm=(0.0, 0.0, 0.0), quarter_turns=turns), towards(*lean)
    on_stage = in_stage_frame(frame, angles)
    assert tilt(on_stage) == pytest.approx(lean[1], abs=1e-5)
    assert angle_between(UPRIGHT, angles) == pytest.approx(lean[1], abs=1e-5)
    assert np.asarray(in_work_frame(frame, on_stage)) == pytest.approx(np.asarray(angles), abs=1e-9)
    # The top of the sensor is at the same place of the rig.
    assert frame.to_stage(above((0.0, 0.0, 0.0), angles, 20.0)) == pytest.approx(
        above((0.0, 0.0, 0.0), on_stage, 20.0), abs=1e-9
    )


def test_a_dome_that_tilts_about_its_summit_dips_below_it() -> None:
    assert lowest((1.0, 2.0, 3.0), UPRIGHT) == (1.0, 2.0, 3.0)
    angle = math.radians(10.0)
    dip = 20.0 * (1.0 - math.cos(angle))
    assert lowest((1.0, 2.0, 3.0), towards(0.0, 10.0)) == pytest.approx((1.0 + 20.0 * math.sin(angle), 2.0, 3.0 - dip))
