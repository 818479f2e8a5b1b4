"""The stated distance of a file against the file itself: its triangles or poles, and a formula from NumPy or SciPy."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from helpers.cases import mostly_long
from helpers.own_formulas import (
    Case,
    largest_distance,
    points_of,
    random_case,
    top_of,
    waves,
)
from helpers.solid_reference import points_of_top
from scipy.spatial import KDTree

from tacbench_cad.checks.meshcheck import read_mesh
from tacbench_cad.formats import FORMATS
from tacbench_cad.formats.step import read_step, write_step
from tacbench_cad.formats.stl import write_stl
from tacbench_cad.geometry.block_part import block_part
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.families import plane_waves
from tacbench_cad.spec.sampling import SampleGrid, Tolerance
from tacbench_cad.spec.textures import Texture

#: The rounding of the test's own arithmetic, in mm.
ROUNDING_MM = 1e-9


def check(case: Case, path: Path) -> None:
    """Check that the top of the file of a block is not further from the formula than stated."""
    part, block = block_part(case.block), case.block
    certificate = part.mesh[1].certificate
    assert certificate is not None
    FORMATS[path.suffix[1:]].write(part, path)
    distance, at = largest_distance(
        points_of(top_of(read_mesh(path).triangle_points)),
        lambda x, y: case.height(x, y, block.datum_mm),
        block.size_mm,
        certificate.distance_mm,
    )
    where = f"{case.kind}: {distance} mm at {at}, but {certificate.distance_mm} mm are stated"
    assert distance <= certificate.distance_mm + ROUNDING_MM, where
    if isinstance(block.sampling, Tolerance):
        assert certificate.distance_mm <= block.sampling.mm


@pytest.mark.parametrize(("number", "tolerance"), mostly_long([(4, 0.1), (6, 0.01), (4, 0.3)], (4, 0.3)))
def test_steep_textures(number: int, tolerance: float, tmp_path: Path) -> None:
    block = Block.of(number, sampling=Tolerance(mm=tolerance))
    terms = [(wave.amplitude, wave.f, wave.g, wave.phase) for wave in block.texture.surface.waves]  # type: ignore[attr-defined]
    check(Case("catalogue", block, waves(terms), block.mm_per_unit), tmp_path / "block.stl")


@pytest.mark.parametrize("seed", mostly_long([*range(14), *range(1000, 1420)], *range(4)))
def test_random_blocks(seed: int, tmp_path: Path) -> None:
    check(random_case(seed), tmp_path / ("block.3mf" if seed % 5 == 0 else "block.stl"))


def test_a_crest_above_the_samples_beside_the_key_counts(tmp_path: Path) -> None:
    # the surface rises towards the corner that the key cuts off, so its highest part is on the cut, between samples
    terms = ((2.0, 0.3, -0.3, 0.0), (0.05, 2.0, 1.0, 0.4))
    texture = Texture(name="ramp", equation="ramp", surface=plane_waves(*terms))
    for step in (21, 34):
        block = Block.of(
            texture,
            mm_per_unit=(1.0, 1.0, 1.0),
            size_mm=(6.0, 6.0),
            height_mm=12.0,
            key_mm=1.93,
            sampling=SampleGrid(nx=step, ny=step),
        )
        check(Case("ramp", block, waves(terms), block.mm_per_unit), tmp_path / "block.stl")


@pytest.mark.parametrize(
    "seed", [0, 31, 35, *(pytest.param(seed, marks=pytest.mark.long) for seed in range(2000, 2210, 7))]
)
def test_no_part_of_a_formula_is_left_out(seed: int, tmp_path: Path) -> None:
    """A separable mesh is near every point of the formula, also at the bottom of grooves that are narrow."""
    case = random_case(seed)
    block = replace(case.block, key_mm=None, nominal_outline=None, sampling=Tolerance(mm=10.0 ** (-0.5 - seed % 3)))
    assert block.surface.is_separable
    part = block_part(block)
    write_stl(part, tmp_path / "block.stl")
    top = top_of(read_mesh(tmp_path / "block.stl").triangle_points)
    rng = np.random.default_rng(seed)
    x, y = (np.append(rng.uniform(0.0, side, 20_000), side * rng.integers(0, 2, 1000)) for side in block.size_mm)
    formula = np.stack([x, y, case.height(x, y, block.datum_mm)], axis=1)
    away, _ = KDTree(points_of(top)).query(formula)
    certificate = part.mesh[1].certificate
    assert certificate is not None
    low, high = top.min(axis=1), top.max(axis=1)
    for i in np.argsort(-away)[:300]:
        near = top[((low <= formula[i] + away[i]) & (high >= formula[i] - away[i])).all(axis=1)]
        nearest = trimesh.triangles.closest_point(near, np.broadcast_to(formula[i], (len(near), 3)))
        exact = float(np.linalg.norm(nearest - formula[i], axis=1).min())
        assert exact <= certificate.distance_mm + ROUNDING_MM, f"{case.kind}: {exact} mm at {formula[i]}"


@pytest.mark.parametrize(
    "seed", [1, 2, 10, 13, *(pytest.param(seed, marks=pytest.mark.long) for seed in range(3000, 3060))]
)
def test_random_solids(seed: int, tmp_path: Path) -> None:
    """Points of the faces in the STEP file."""
    case = random_case(seed)
    block = replace(case.block, sampling=Tolerance(mm=0.2), step_tolerance_mm=max(case.block.step_tolerance_mm, 0.002))
    part = block_part(block)
    if part.no_solid is not None:
        pytest.skip(part.no_solid)
    certificate = part.solid[1].certificate
    assert certificate is not None
    write_step(part, tmp_path / "block.step")
    points = points_of_top(read_step(tmp_path / "block.step"), 61)
    worst = np.abs(points[:, 2] - case.height(points[:, 0], points[:, 1], block.solid_datum_mm)).max()
    assert worst <= certificate.distance_mm + ROUNDING_MM, f"{case.kind}: {worst} mm"
