"""Estimates and their intervals."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tacbench_cad.extensions.scan.estimates import Estimate, ScanFit, wave_direction_deg
from tacbench_cad.extensions.scan.pose import Pose
from tacbench_cad.spec.sines import Wave
from tacbench_cad.util.errors import InputError


def test_an_estimate_has_an_interval_and_a_fit_its_names() -> None:
    scale = Estimate(name="scale_x", value=0.996, standard_error=1e-4, determined=True)
    shift = Estimate(name="shift_y_mm", value=0.0, standard_error=math.inf, determined=False)
    assert (scale.low, scale.high) == pytest.approx((0.995804, 0.996196))
    assert shift.high == math.inf
    none = np.zeros(0, dtype=bool)
    fit = ScanFit(
        fit="scale",
        pose=Pose(rotation=np.eye(3), shift_mm=np.zeros(3), stretch=np.eye(3)),
        parameters=(scale, shift),
        on_top=none,
        on_walls=none,
        used=none,
        deviation_mm=np.zeros(0),
        noise_mm=0.02,
        half_turn="decided",
    )
    assert fit.parameter("scale_x") is scale
    assert fit.undetermined == ("shift_y_mm",)
    with pytest.raises(InputError, match="parameter = 'scale_q': must be one of scale_x, shift_y_mm"):
        fit.parameter("scale_q")


@pytest.mark.parametrize(
    ("f", "g", "angle"), [(1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, -2.0, 90.0), (1.0, -1.0, -45.0)]
)
def test_opposite_directions_are_the_same(f: float, g: float, angle: float) -> None:
    assert wave_direction_deg(Wave(amplitude=1.0, f=f, g=g)) == pytest.approx(angle)
