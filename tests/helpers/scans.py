"""Simulated scans with a fit that is their truth, for tests of what is computed from a fit."""

from __future__ import annotations

import numpy as np

from tacbench_cad.extensions.scan.cloud import Cloud
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
