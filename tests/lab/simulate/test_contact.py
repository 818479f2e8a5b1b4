"""Compare force and depth of the simulated contact with closed forms and with each other."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tacbench_cad.lab.simulate.contact import FORCE_ERROR_N, DomeContact, contact_for
from tacbench_cad.lab.simulate.heights import HeightMap, flat_plate
from tacbench_cad.lab.study.spec import HolderRim, PrintedBlock
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.protocol import (
    DOME_RADIUS_MM,
    FORCE_SPREADS_N,
    FORCES_N,
    FOUNDATION_N_PER_MM3,
    contact_radius_mm,
)
from tacbench_cad.util.errors import InputError

PLATE = DomeContact(flat_plate())
PRINTED = PrintedBlock(block=Block.of(4), printer="bambu-p1p", filament="pla-minus")
BLOCK = contact_for(PRINTED, HolderRim())


def _cap_n(depth_mm: float) -> float:
    """Return the force on a flat plate in closed form: k times the volume of the spherical cap, in N."""
    return FOUNDATION_N_PER_MM3 * math.pi * depth_mm**2 * (DOME_RADIUS_MM - depth_mm / 3.0)


@pytest.mark.parametrize("depth_mm", [0.2, 0.5, 1.0, 2.0, 4.0, 7.0])
def test_the_force_on_a_flat_plate_equals_that_of_a_spherical_cap(depth_mm: float) -> None:
    for x, y in ((0.0, 0.0), (0.037, -0.021), (1.05, 2.0)):
        assert PLATE.force_n(x, y, -depth_mm) == pytest.approx(_cap_n(depth_mm), rel=2e-3)


@pytest.mark.parametrize("force_n", FORCES_N)
def test_the_measured_law_of_another_tactip_agrees_within_a_factor_of_two(force_n: float) -> None:
    depth = -PLATE.z_for_force(0.0, 0.0, force_n)
    assert 0.5 < 0.47 * depth**1.5 / force_n < 2.0


@pytest.mark.parametrize("force_n", FORCES_N)
def test_the_contact_width_matches_the_protocol(force_n: float) -> None:
    overlap = PLATE.overlap(0.0, 0.0, PLATE.z_for_force(0.0, 0.0, force_n))
    area = np.count_nonzero(overlap.depth_mm) * overlap.cell_mm**2
    assert math.sqrt(area / math.pi) == pytest.approx(contact_radius_mm(force_n), rel=0.03)


@settings(max_examples=60, deadline=None)
@given(
    x=st.floats(4.0, 9.0),
    y=st.floats(18.0, 23.0),
    force=st.one_of(st.sampled_from(FORCES_N), st.floats(1e-3, 10.0)),
)
def test_the_computed_pose_has_the_requested_force(x: float, y: float, force: float) -> None:
    z = BLOCK.z_for_force(x, y, force)
    assert abs(BLOCK.force_n(x, y, z) - force) <= FORCE_ERROR_N < min(FORCE_SPREADS_N) / 100.0
    assert z < BLOCK.first_touch(x, y)


@settings(max_examples=40, deadline=None)
@given(x=st.floats(-5.0, 30.0), y=st.floats(-5.0, 35.0))
def test_the_force_begins_at_first_touch_and_grows_with_depth(x: float, y: float) -> None:
    touch = BLOCK.first_touch(x, y)
    forces = [BLOCK.force_n(x, y, touch + dz) for dz in (1.0, 1e-9, -0.01, -0.1, -0.5, -2.0, -5.0)]
    assert forces[0] == forces[1] == 0.0
    assert forces[2] > 0.0
    assert forces == sorted(forces)


def test_the_result_does_not_depend_on_earlier_calls() -> None:
    fresh = contact_for(PRINTED, HolderRim()).force_n(6.0, 20.0, -2.0)
    BLOCK.first_touch(6.0, 20.0)
    BLOCK.force_n(6.0, 20.0, -5.0)
    assert BLOCK.force_n(6.0, 20.0, -2.0) == pytest.approx(fresh, rel=1e-12)


def test_smaller_cells_give_the_same_force() -> None:
    fine = DomeContact(flat_plate(cell_mm=0.05))
    for force in FORCES_N:
        assert fine.z_for_force(0.01, 0.02, force) == pytest.approx(PLATE.z_for_force(0.01, 0.02, force), abs=1e-3)


def test_the_rim_carries_some_of_the_force() -> None:
    high = contact_for(PRINTED, HolderRim(rim_mm=0.0))
    low = contact_for(PRINTED, HolderRim(rim_mm=5.0))
    assert high.z_for_force(4.0, 20.0, 3.0) > low.z_for_force(4.0, 20.0, 3.0) + 0.1


def test_outside_the_ground_there_is_no_contact_and_no_force() -> None:
    assert BLOCK.first_touch(500.0, 0.0) == -math.inf
    assert BLOCK.force_n(500.0, 0.0, -7.0) == 0.0
    with pytest.raises(InputError, match="cannot be reached"):
        BLOCK.z_for_force(500.0, 0.0, 1.0)
    nothing = DomeContact(HeightMap(z_mm=np.full((3, 3), -math.inf), x0_mm=0.0, y0_mm=0.0))
    assert nothing.first_touch(0.1, 0.1) == -math.inf


@pytest.mark.parametrize("force_n", [-1.0, math.nan, math.inf])
def test_invalid_forces_are_refused(force_n: float) -> None:
    with pytest.raises(InputError, match="force_n"):
        PLATE.z_for_force(0.0, 0.0, force_n)


def test_a_force_beyond_the_domes_equator_is_refused() -> None:
    with pytest.raises(InputError, match="the maximum is"):
        PLATE.z_for_force(0.0, 0.0, 1000.0)


def test_zero_force_means_first_touch() -> None:
    assert PLATE.z_for_force(0.0, 0.0, 0.0) == PLATE.first_touch(0.0, 0.0) == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("values", [{"radius_mm": 0.0}, {"stiffness_n_per_mm3": math.nan}])
def test_an_impossible_dome_is_refused(values: dict[str, float]) -> None:
    with pytest.raises(InputError):
        DomeContact(flat_plate(2.0), **values)
