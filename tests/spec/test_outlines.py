"""The area of closed outlines, and points inside them."""

from __future__ import annotations

import numpy as np
import pytest

from tacbench_cad.spec.outlines import area_mm2, is_inside

SQUARE = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 3.0], [0.0, 3.0]])
HOLE = np.array([[1.0, 1.0], [1.0, 2.0], [3.0, 2.0], [3.0, 1.0]])


def test_the_areas_of_clockwise_outlines_are_subtracted() -> None:
    assert area_mm2(SQUARE) == 12.0
    assert area_mm2(HOLE) == -2.0
    assert area_mm2(SQUARE, HOLE) == 10.0
    assert area_mm2() == 0.0


@pytest.mark.parametrize(
    ("x", "y", "inside"), [(0.5, 0.5, True), (2.0, 1.5, False), (5.0, 1.0, False), (2.0, -1.0, False)]
)
def test_points_in_a_hole_are_outside(x: float, y: float, inside: bool) -> None:
    assert is_inside(np.array([x, y]), [SQUARE, HOLE]) is inside
