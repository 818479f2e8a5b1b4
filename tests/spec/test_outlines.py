"""The area of closed outlines."""

from __future__ import annotations

import numpy as np

from tacbench_cad.spec.outlines import area_mm2

SQUARE = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 3.0], [0.0, 3.0]])
HOLE = np.array([[1.0, 1.0], [1.0, 2.0], [3.0, 2.0], [3.0, 1.0]])


def test_the_areas_of_clockwise_outlines_are_subtracted() -> None:
    assert area_mm2(SQUARE) == 12.0
    assert area_mm2(HOLE) == -2.0
    assert area_mm2(SQUARE, HOLE) == 10.0
    assert area_mm2() == 0.0
