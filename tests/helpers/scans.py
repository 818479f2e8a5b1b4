"""Simulated scans with their true fit, height maps from above, and scans of objects that are not a block."""

from __future__ import annotations

import numpy as np

from tacbench_cad.extensions.scan.cloud import Cloud, HeightGrid
from tacbench_cad.extensions.scan.estimates import Estimate, ScanFit, WaveEstimate, wave_direction_deg
from tacbench_cad.extensions.scan.simulating import ScanTruth, simulate_scan
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.waves import WaveSum


def true_scan(block: Block, truth: ScanTruth) -> tuple[Cloud, ScanFit]:
    """Simulate a scan, and return it with its true pose as if a fit had found it."""
    cloud = simulate_scan(block, truth)
    points = truth.pose.to_block(cloud.points_mm)
    x, y, z = points.T
    sides = np.stack([-x, x - block.size_mm[0], -y, y - block.size_mm[1]])
    height = z - block.height_at(x, y)
    slope = np.hypot(*block.surface.gradient(x, y))
    on_walls = bool(truth.walls) & (np.min(np.abs(sides), axis=0) < 4.0 * truth.noise_mm + 1e-6)
    on_top = ~on_walls & (np.abs(height) < 1.0)
    nearest = np.take_along_axis(sides, np.argmin(np.abs(sides), axis=0)[None], axis=0)[0]
    deviation = np.where(on_top, height / np.sqrt(1.0 + slope**2), np.where(on_walls, nearest, np.nan))
    scales = np.diag(truth.pose.stretch)
    parameters = [
        Estimate(name=f"scale_{axis}", value=float(scale), standard_error=1e-4, determined=True)
        for axis, scale in zip("xyz", scales, strict=True)
    ]
    skew = float(truth.pose.stretch[0, 1])
    parameters.append(Estimate(name="skew_xy", value=skew, standard_error=2e-4, determined=True))
    parameters.append(Estimate(name="skew_xz", value=0.0, standard_error=np.inf, determined=False))
    return cloud, ScanFit(
        fit="square",
        pose=truth.pose,
        parameters=tuple(parameters),
        on_top=on_top,
        on_walls=on_walls,
        used=on_top | on_walls,
        deviation_mm=deviation,
        noise_mm=truth.noise_mm,
        half_turn="decided",
        waves=tuple(_waves(block, truth)),
    )


def _waves(block: Block, truth: ScanTruth) -> list[WaveEstimate]:
    assert isinstance(block.surface, WaveSum)
    estimates = []
    for wave in block.surface.waves:
        length = 2.0 * np.pi / np.hypot(wave.f, wave.g)
        ratio = 1.0 if truth.transfer_x is None else truth.transfer_x(float(length))
        estimates.append(
            WaveEstimate(
                wave=wave,
                wavelength_mm=float(length),
                direction_deg=wave_direction_deg(wave),
                amplitude_ratio=ratio,
                ratio_low=ratio - 0.02,
                ratio_high=ratio + 0.02,
                standard_error=0.01,
                phase_deg=0.5,
                phase_low_deg=-1.0,
                phase_high_deg=2.0,
            )
        )
    return estimates


def height_map(
    block: Block, *, noise_mm: float, step_mm: float, seed: int = 0, turn_deg: float = 0.0, holes: int = 0
) -> Cloud:
    """Scan a block with an instrument that measures heights on a grid, from above.

    Args:
        block: The block.
        noise_mm: The standard deviation of the noise.
        step_mm: The distance of neighbouring pixels.
        seed: The seed of the noise and the holes.
        turn_deg: The angle by which the block is turned under the instrument.
        holes: The number of round holes of 2 mm. Pixels in them and beside the block are NaN.
    """
    rng = np.random.default_rng((seed, 0))
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    turned = np.array([[c, -s], [s, c]])
    size = np.array(block.size_mm)
    corners = (size * [(0, 0), (1, 0), (1, 1), (0, 1)]) @ turned.T
    low = corners.min(axis=0)
    columns, rows = np.ceil((corners.max(axis=0) - low) / step_mm).astype(int) + 1
    places = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1) * step_mm + low
    places = places @ turned
    seen = np.all((places >= 0.0) & (places <= size), axis=-1)
    for centre in rng.uniform((0.0, 0.0), size, (holes, 2)):
        seen &= np.linalg.norm(places - centre, axis=-1) > 1.0
    heights = np.where(seen, block.height_at(places[..., 0], places[..., 1]), np.nan)
    grid = HeightGrid(heights_mm=heights + noise_mm * rng.standard_normal(heights.shape), step_mm=(step_mm, step_mm))
    return Cloud(points_mm=grid.points_mm(), source=f"height map, seed {seed}", simulated=True, grid=grid)


#: Objects that are not a block.
FOREIGN = ("flat", "box", "sphere", "cylinder", "rough", "stairs", "plane waves")


def foreign_scan(kind: str, *, points: int = 50_000, noise_mm: float = 0.02, seed: int = 0) -> Cloud:
    """Scan an object of 25 mm that is not a textured block: it must be refused.

    Args:
        kind: One of :data:`FOREIGN`.
        points: The number of points.
        noise_mm: The standard deviation of the noise along z.
        seed: The seed of the shape, the pose and the noise.
    """
    size = 25.0
    rng = np.random.default_rng((seed, 2, FOREIGN.index(kind)))
    x, y = rng.uniform(0.0, size, (2, points))
    height = np.zeros(points)
    if kind == "cylinder":
        height = np.sqrt(np.maximum((size / 2.0) ** 2 - (x - size / 2.0) ** 2, 0.0))
    elif kind == "stairs":
        height = np.floor(x / size * 6.0) * rng.uniform(0.3, 0.8)
    elif kind in ("rough", "plane waves"):
        count, shortest = (60, 0.5) if kind == "rough" else (4, 3.0)
        for _ in range(count):
            k, angle, phase = rng.uniform(0.0, 2.0 * np.pi / shortest), *rng.uniform(0.0, 2.0 * np.pi, 2)
            height += np.sin(k * (x * np.cos(angle) + y * np.sin(angle)) + phase) / np.sqrt(count)
    shape = np.column_stack([x, y, height])
    if kind == "sphere":
        direction = rng.standard_normal((points, 3))
        shape = size / 2.0 * direction / np.linalg.norm(direction, axis=1, keepdims=True)
        shape[:, 2] = np.abs(shape[:, 2])
    elif kind == "box":
        shape = rng.uniform(0.0, size, (points, 3)) * (1.0, 1.0, 0.3)
        side = rng.integers(0, 5, points)
        for axis in range(2):
            ends = side // 2 == axis
            shape[ends, axis] = size * (side[ends] % 2)
        shape[side == 4, 2] = 0.3 * size
    shape[:, 2] += noise_mm * rng.standard_normal(points)
    pose = ScanTruth(seed=seed).with_random_pose().pose
    return Cloud(points_mm=pose.to_scan(shape), source=f"{kind}, seed {seed}", simulated=True)
