"""The scan simulator: points lie on the printed surface, the truth is exact, and the seed determines everything."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from tacbench_cad.extensions.scan.simulating import (
    ScanTruth,
    Wall,
    low_pass,
    printed_waves,
    simulate_scan,
    stretch,
)
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.waves import WaveSum
from tacbench_cad.util.errors import InputError

BLOCK = Block.of(2)
STRETCH = stretch((0.996, 0.998, 1.003), (0.001, 0.0, 0.002))


def truth(**values: object) -> ScanTruth:
    start = ScanTruth(points=5000, noise_mm=0.0, seed=7).with_random_pose()
    start = replace(start, pose=replace(start.pose, stretch=STRETCH))
    return replace(start, **values)  # type: ignore[arg-type]


def test_points_of_the_top_lie_on_the_formula_once_the_pose_is_undone() -> None:
    wanted = truth(walls=())
    cloud = simulate_scan(BLOCK, wanted)
    x, y, z = wanted.pose.to_block(cloud.points_mm).T
    assert len(cloud) == 5000
    assert cloud.simulated
    np.testing.assert_allclose(z, BLOCK.height_at(x, y), atol=1e-12)
    assert x.min() > 0.0
    assert y.max() < BLOCK.size_mm[1]


def test_each_wave_gets_its_factor() -> None:
    half = low_pass(7.565973)
    wanted = truth(walls=(), transfer_x=half, transfer_y=None)
    x, y, z = wanted.pose.to_block(simulate_scan(BLOCK, wanted).points_mm).T
    assert isinstance(BLOCK.surface, WaveSum)
    along_x, along_y = BLOCK.surface.waves
    for wave, factor in ((along_x, 0.5), (along_y, 1.0)):
        z = z - factor * wave.amplitude * np.sin(wave.f * x + wave.g * y + wave.phase)
    np.testing.assert_allclose(z, BLOCK.datum_mm, atol=1e-6)
    assert printed_waves(BLOCK, half, None).waves[0].amplitude == pytest.approx(0.5)


@pytest.mark.parametrize("key_mm", [None, 3.0])
def test_points_of_walls_lie_on_their_planes(key_mm: float | None) -> None:
    block = Block.of(2, key_mm=key_mm)
    width, depth = block.size_mm
    walls: tuple[Wall, ...] = ("x-", "x+", "y-", "y+", *(("key",) if key_mm else ()))  # type: ignore[assignment]
    wanted = truth(walls=walls)
    x, y, z = wanted.pose.to_block(simulate_scan(block, wanted).points_mm).T
    on_wall = np.abs(z - block.height_at(x, y)) > 1e-6
    planes = [x, x - width, y, y - depth, *([x - y - (width - key_mm)] if key_mm else [])]
    nearest = np.min(np.abs(planes), axis=0)
    np.testing.assert_allclose(nearest[on_wall], 0.0, atol=1e-9)
    for plane in planes:
        assert np.count_nonzero(np.abs(plane[on_wall]) < 1e-9) > 100
    if key_mm:
        assert np.all(x - y <= width - key_mm + 1e-9)


def test_noise_holes_outliers_and_partial_views_have_the_size_asked_for() -> None:
    wanted = truth(walls=(), noise_mm=0.05, top_fraction=0.5, points=40_000, holes=3, hole_mm=2.0)
    cloud = simulate_scan(BLOCK, wanted)
    x, y, z = (wanted.pose.to_print(cloud.points_mm) @ np.linalg.inv(STRETCH).T).T
    assert np.std(z - BLOCK.height_at(x, y)) == pytest.approx(0.05, rel=0.02)
    cells, _, _ = np.histogram2d(x, y, bins=(20, 20), range=[(0.0, BLOCK.size_mm[0]), (0.0, BLOCK.size_mm[1])])
    assert 0.35 < np.mean(cells > 20) < 0.6
    wanted = truth(walls=(), outlier_fraction=0.1)
    x, y, z = wanted.pose.to_block(simulate_scan(BLOCK, wanted).points_mm).T
    off = np.abs(z - BLOCK.height_at(x, y)) > 0.01
    assert np.mean(off) == pytest.approx(0.1, abs=0.005)


def test_the_seed_determines_the_scan() -> None:
    first, same, other = (simulate_scan(BLOCK, truth(seed=seed)).points_mm for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, same)
    assert not np.array_equal(first, other)
    rotation = ScanTruth(seed=3).with_random_pose().pose.rotation
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)


def test_walls_of_a_disc_and_waves_of_a_spline_are_refused() -> None:
    with pytest.raises(InputError, match="need a rectangular block"):
        simulate_scan(Block.of(2, outline="disc"), ScanTruth(points=100))
    assert len(simulate_scan(Block.of(2, outline="disc"), ScanTruth(points=100, walls=()))) == 100
    with pytest.raises(InputError, match="key"):
        simulate_scan(BLOCK, ScanTruth(points=100, walls=("key",)))
    assert math.isclose(low_pass(2.0)(2.0), 0.5)
