"""Proved bounds: never below the error at dense points, and not far above it."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.cases import mostly_long
from helpers.tops import deviations

from tacbench_cad.geometry.block_mesh import mesh_block
from tacbench_cad.geometry.meshing.certify import prove_axis
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.sampling import SampleGrid, Tolerance
from tacbench_cad.spec.sines import Sines


@pytest.mark.long
@pytest.mark.parametrize("name", ["diamond", "ridges", "chevron"])
def test_sample_grids_across_creases_have_a_finite_bound_that_holds(name: str) -> None:
    block = Block.of(name, sampling=SampleGrid(nx=95, ny=101))
    mesh, certificate = mesh_block(block)
    distance, vertical = deviations(block, mesh, 10)
    assert distance <= certificate.distance_mm < 3.0 * vertical
    assert vertical <= certificate.vertical_mm


@pytest.mark.parametrize("number", mostly_long(range(1, 7), 1, 2))
def test_tight_within_a_tolerance(number: int) -> None:
    block = Block.of(number, sampling=Tolerance(mm=0.02))
    mesh, certificate = mesh_block(block)
    # strips along a flat axis are 30 mm long, so the lattice must be fine across them
    distance, vertical = deviations(block, mesh, 96 if len(mesh.faces) < 2000 else 10)
    assert distance <= certificate.distance_mm <= 1.03 * distance
    assert vertical <= certificate.vertical_mm <= 1.05 * vertical


@pytest.mark.parametrize(
    ("number", "sampling"),
    mostly_long([*((number, "grid") for number in range(1, 7)), (4, SampleGrid(nx=95, ny=101))], (2, "grid")),
)
def test_tight_on_a_grid(number: int, sampling: str | SampleGrid) -> None:
    block = Block.of(number, sampling=sampling)  # type: ignore[arg-type]
    mesh, certificate = mesh_block(block)
    distance, vertical = deviations(block, mesh, 8, max_points=1_500_000)
    assert distance <= certificate.distance_mm == certificate.vertical_mm
    assert vertical <= certificate.vertical_mm <= 1.10 * vertical


def test_a_wrong_height_increases_the_bound() -> None:
    sines = Sines.of([(1.0, 1.0, 0.0)])
    at = np.linspace(0.0, 6.0, 40)
    heights = sines(at)
    before = prove_axis(sines, at, heights)
    heights[17] += 0.05
    after = prove_axis(sines, at, heights)
    assert before.above.max() < 0.01
    assert 0.05 < after.above.max() < 0.06
