"""The fit of a scan: pose, scale, waves, what is undetermined, and what is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest
from helpers.cases import mostly_long
from helpers.scans import foreign_scan, height_map

from tacbench_cad.extensions.scan.cloud import Cloud, HeightGrid
from tacbench_cad.extensions.scan.estimates import ScanFit
from tacbench_cad.extensions.scan.fitting import fit_scan, identify
from tacbench_cad.extensions.scan.pose import Pose
from tacbench_cad.extensions.scan.refining import centre_of
from tacbench_cad.extensions.scan.simulating import (
    WALLS,
    ScanTruth,
    simulate_scan,
    stretch,
)
from tacbench_cad.spec.block import Block
from tacbench_cad.util.errors import InputError

SCALE = (0.996, 0.9975, 0.998)
SHRUNK = Pose(rotation=np.eye(3), shift_mm=np.zeros(3), stretch=stretch(SCALE))


def pose_errors(pose: Pose, truth: Pose, block: Block) -> tuple[float, np.ndarray]:
    """Return the angle between two poses in degrees, and the difference at the centre of the block, shape (3,)."""
    turn = pose.rotation @ truth.rotation.T
    centre = centre_of(block)
    place = pose.to_print(((centre - truth.shift_mm) @ truth.rotation)[None])[0]
    return math.degrees(math.acos(min(1.0, (np.trace(turn) - 1.0) / 2.0))), place - centre


def scanned(block: Block, fit: str = "scale", **truth: object) -> tuple[ScanFit, ScanTruth]:
    made = ScanTruth(**{"points": 6_000, "pose": SHRUNK, "seed": 1, **truth}).with_random_pose()  # type: ignore[arg-type]
    return fit_scan(simulate_scan(block, made), block, fit), made  # type: ignore[arg-type]


def test_a_whole_scan_gives_pose_scale_and_waves() -> None:
    block = Block.of(3)
    fit, truth = scanned(block, outlier_fraction=0.02, transfer_x=lambda length: 0.7 if length < 3.0 else 1.0)
    angle, place = pose_errors(fit.pose, truth.pose, block)
    assert angle < 0.02
    assert np.abs(place).max() < 0.005
    for name, value in zip(("scale_x", "scale_y", "scale_z"), SCALE, strict=True):
        estimate = fit.parameter(name)
        assert abs(estimate.value - value) < min(4.0 * estimate.standard_error, 0.001)
    assert fit.undetermined == ("base_mm",)
    assert fit.half_turn == "decided"
    assert fit.alternatives == ()
    assert fit.noise_mm == pytest.approx(0.02, rel=0.1)
    assert 0.93 < fit.used.mean() < 0.99
    second = next(wave for wave in fit.waves if wave.direction_deg == 0.0 and 2.5 < wave.wavelength_mm < 2.55)
    assert second.ratio_low - 0.01 < 0.7 < second.ratio_high + 0.01
    deviation = fit.deviation_mm[fit.on_walls & fit.used]
    assert abs(float(np.mean(deviation))) < 0.002
    assert np.isnan(fit.deviation_mm[~(fit.on_top | fit.on_walls)]).all()


def test_a_texture_along_x_says_nothing_along_y_without_a_wall() -> None:
    block = Block.of(1)
    fit, truth = scanned(block, walls=())
    assert {"shift_y_mm", "scale_y"} <= set(fit.undetermined)
    angle, place = pose_errors(fit.pose, truth.pose, block)
    assert angle < 0.05
    assert abs(place[0]) < 0.005
    seen, truth = scanned(block, walls=WALLS)
    assert "shift_y_mm" not in seen.undetermined
    assert abs(pose_errors(seen.pose, truth.pose, block)[1][1]) < 0.005


@pytest.mark.parametrize(
    ("texture", "walls", "offset", "seed"),
    mostly_long([("5", ("y-", "y+"), 0.03, 4), ("1", ("y+",), -0.05, 7)], ("5", ("y-", "y+"), 0.03, 4)),
)
def test_walls_at_the_ends_place_a_block_whose_texture_is_constant_between_them(
    texture: str, walls: tuple[str, ...], offset: float, seed: int
) -> None:
    block = Block.of(texture, scale=2.0)
    unit = Pose(rotation=np.eye(3), shift_mm=np.zeros(3), stretch=np.eye(3))
    about = {"points": 20_000, "pose": unit, "top_fraction": 0.6, "outlier_fraction": 0.04, "seed": seed}
    fit, truth = scanned(block, walls=walls, wall_offset_mm=offset, **about)
    angle, place = pose_errors(fit.pose, truth.pose, block)
    assert angle < 0.01
    # Without a wall at the side, an offset of the walls and a shift are the same.
    assert np.all(np.abs(place) < (0.005, abs(offset) + 0.005, 0.005))


def test_a_height_map_of_a_texture_along_x_with_few_pixels_below_the_top_is_fitted() -> None:
    scan = height_map(Block.of(1), noise_mm=0.005, seed=5, step_mm=0.2, turn_deg=7.0)
    assert fit_scan(scan, Block.of(1)).parameter("scale_x").value == pytest.approx(1.0, abs=2e-4)


def test_half_a_top_without_walls_lists_the_poses_that_it_cannot_tell_apart() -> None:
    block = Block.of(2)
    fit, truth = scanned(block, walls=(), top_fraction=0.5)
    assert fit.alternatives
    far = [pose_errors(pose, truth.pose, block) for pose in (fit.pose, *fit.alternatives)]
    assert any(angle < 0.1 and np.abs(place).max() < 0.02 for angle, place in far)


@pytest.mark.parametrize("kind", ["flat", "plane waves"])
def test_a_flat_or_another_object_is_refused(kind: str) -> None:
    with pytest.raises(InputError, match="does not show texture-2_paper_x1"):
        fit_scan(foreign_scan(kind, points=10_000), Block.of(2))


def test_the_block_is_found_among_others() -> None:
    blocks = [Block.of(1), Block.of(5)]
    truth = ScanTruth(points=3_000, pose=SHRUNK, walls=("x-",), seed=4).with_random_pose()
    block, fit = identify(simulate_scan(blocks[1], truth), blocks)
    assert block is blocks[1]
    angle, place = pose_errors(fit.pose, truth.pose, block)
    assert angle < 0.2 and np.abs(place[[0, 2]]).max() < 0.05


def test_a_key_decides_the_half_turn() -> None:
    block = Block.of(2, key_mm=4.0)
    fit, truth = scanned(block, points=10_000)
    assert fit.half_turn == "decided"
    assert pose_errors(fit.pose, truth.pose, block)[0] < 0.05


@pytest.mark.long
def test_an_outline_may_be_round() -> None:
    disc = Block.of(2, outline="disc")
    fit, truth = scanned(disc, points=10_000, walls=())
    assert pose_errors(fit.pose, truth.pose, disc)[0] < 0.05
    assert not fit.on_walls.any()


def test_a_lost_wave_has_an_interval_that_contains_0() -> None:
    block = Block.of(3)
    fit, _ = scanned(block, transfer_x=lambda length: 0.0 if length < 1.6 else 1.0)
    lost = [wave for wave in fit.waves if wave.direction_deg == 0.0 and wave.wavelength_mm < 1.6 and wave.determined]
    assert len(lost) == 11
    assert sum(wave.ratio_low > 0.0 for wave in lost) <= 2
    assert all(wave.ratio_low > 0.9 for wave in fit.waves if wave.wavelength_mm > 2.0)


@pytest.mark.parametrize(
    ("kind", "why"),
    mostly_long(
        [
            ("cloud", "one of its axes is reversed"),
            ("rows", "rows are in reversed order"),
            ("heights", "the wrong sign"),
        ],
        ("rows", "rows are in reversed order"),
    ),
)
def test_a_mirror_image_is_named_and_refused(kind: str, why: str) -> None:
    block, truth = Block.of(2), ScanTruth(points=12_000, seed=2, noise_mm=0.02)
    if kind == "cloud":
        scan = simulate_scan(block, truth.with_random_pose())
        scan = Cloud(points_mm=scan.points_mm * (1.0, -1.0, 1.0), source="mirrored.ply")
    else:
        grid = height_map(block, noise_mm=0.02, seed=2, step_mm=0.2).grid
        assert grid is not None
        heights = grid.heights_mm[::-1] if kind == "rows" else -grid.heights_mm
        grid = HeightGrid(heights_mm=heights, step_mm=grid.step_mm)
        scan = Cloud(points_mm=grid.points_mm(), source="mirrored.tif", grid=grid)
    with pytest.raises(InputError, match=f"shows the mirror image of texture-2_paper_x1: .*{why}"):
        fit_scan(scan, block)


@pytest.mark.long
def test_waves_below_two_pixels_are_undetermined_and_do_not_move_the_pose() -> None:
    block = Block.of(4, "released")
    scan = height_map(block, noise_mm=0.02, seed=4, step_mm=0.15)
    fit = fit_scan(scan, block)
    assert np.abs(np.diag(fit.pose.stretch)[:2] - 1.0).max() < 2e-5
    assert np.mean(fit.used) > 0.999
    short = [wave for wave in fit.waves if wave.wavelength_mm < 0.375]
    assert short
    assert not any(wave.determined for wave in short)
    assert all(wave.amplitude_ratio == 1.0 for wave in short)


@pytest.mark.long
def test_flanks_between_pixels_leave_the_scale_open_unless_the_block_is_turned() -> None:
    block = Block.of(6, "released")
    for turn_deg, widest in ((0.0, 0.0035), (7.0, 1e-4)):
        scan = height_map(block, noise_mm=0.005, seed=1, step_mm=0.15, turn_deg=turn_deg)
        scale = fit_scan(scan, block).parameter("scale_x")
        assert abs(scale.value - 1.0) < 2.0 * scale.standard_error < 2.0 * widest


@pytest.mark.long
@pytest.mark.parametrize(("texture", "other"), [("2", "1"), ("4", "6")])
def test_a_texture_without_the_waves_of_one_direction_is_refused(texture: str, other: str) -> None:
    scan = simulate_scan(Block.of(other), ScanTruth(points=12_000, seed=3).with_random_pose())
    with pytest.raises(InputError, match="does not show"):
        fit_scan(scan, Block.of(texture))
