"""Proved bounds: never below the error at dense points, and not far above it."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.cases import mostly_long
from helpers.tops import deviations, faults, random_texture

from tacbench_cad.geometry.block_mesh import mesh_block
from tacbench_cad.geometry.meshing.certify import derivatives, prove_axis
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.sampling import SampleGrid, Tolerance
from tacbench_cad.spec.sines import Sines


def random_block(seed: int) -> Block:
    rng = np.random.default_rng(seed)
    sampling: Tolerance | SampleGrid
    if rng.integers(2):
        sampling = Tolerance(mm=float(10.0 ** rng.uniform(-1.9, -0.8)))
    else:
        sampling = SampleGrid(nx=int(rng.integers(2, 90)), ny=int(rng.integers(2, 90)))
    return Block.of(
        random_texture(rng, oblique=bool(seed % 2)),
        ("paper", "released")[int(rng.integers(2))],
        sampling=sampling,
        scale=float(rng.choice([0.7, 1.0, 1.9])),
        key_mm=(None, float(rng.uniform(0.6, 5.0)))[int(rng.integers(2))],
    )


@pytest.mark.parametrize("seed", mostly_long([*range(26), *range(1000, 1240)], *range(10)))
def test_never_below_the_sampled_truth(seed: int) -> None:
    block = random_block(seed)
    mesh, certificate = mesh_block(block)
    assert faults(mesh) == []
    assert mesh.vertices[:, 2].max() == np.float32(block.height_mm)
    order = int(np.clip(np.sqrt(400_000 / len(mesh.faces)), 6, 60))
    distance, vertical = deviations(block, mesh, order, seed)
    assert distance <= certificate.distance_mm
    assert vertical <= certificate.vertical_mm
    assert certificate.distance_mm <= certificate.vertical_mm
    if isinstance(block.sampling, Tolerance):
        assert certificate.distance_mm <= block.sampling.mm


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


def test_several_derivatives_equal_single_derivatives() -> None:
    sines = Sines.of([(0.7, 1.3, 0.2), (-0.1, 9.0, 1.0), (0.4, 0.0, 0.5)])
    t = np.linspace(-3.0, 8.0, 50)
    for order, values in enumerate(derivatives(sines, t, range(6))):
        assert np.allclose(values, sines(t, order), rtol=1e-12, atol=1e-10)
