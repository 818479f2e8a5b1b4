"""The part of a surface that a nozzle can print."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tacbench_cad.spec.families import plane_waves
from tacbench_cad.spec.interpolation import height_map
from tacbench_cad.spec.wavelengths import printable_heights

X, Y = np.linspace(0.0, 20.0, 401), np.linspace(0.0, 10.0, 201)
#: Wavelengths of 4 mm and of 0.5 mm.
WIDE, NARROW = (1.0, math.pi / 2.0, 0.0, math.pi / 2.0), (0.3, 0.0, 4.0 * math.pi, math.pi / 2.0)


@pytest.mark.parametrize(("nozzle", "kept"), [(0.2, (WIDE, NARROW)), (0.4, (WIDE,)), (2.5, ())])
def test_waves_with_ridges_narrower_than_the_nozzle_are_left_out(
    nozzle: float, kept: tuple[tuple[float, float, float, float], ...]
) -> None:
    heights = printable_heights(plane_waves(WIDE, NARROW), X, Y, nozzle)
    assert heights == pytest.approx(plane_waves(*kept).grid(X, Y), abs=1e-12)


@pytest.mark.parametrize("nozzle", [0.2, 0.4])
def test_a_spline_of_the_same_heights_gives_the_same(nozzle: float) -> None:
    formula = plane_waves(WIDE, NARROW)
    heights = printable_heights(height_map(formula.grid(X, Y).T[::-1], mm_per_pixel=0.05), X, Y, nozzle)
    assert np.abs(heights - printable_heights(formula, X, Y, nozzle)).max() < 0.02
