"""The map of the top and the deviations of the walls, against the truth of simulated scans."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.scans import true_scan

from tacbench_cad.extensions.scan.deviations import noise_of_repeat, top_map, wall_points
from tacbench_cad.extensions.scan.fitting import fit_scan
from tacbench_cad.extensions.scan.simulating import (
    ScanTruth,
    low_pass,
    printed_waves,
    simulate_scan,
    stretch,
)
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.skin import shift_px_per_mm
from tacbench_cad.util.errors import InputError

BLOCK = Block.of(1, scale=0.5)
TRUTH = ScanTruth(points=20_000, noise_mm=0.01, seed=5).with_random_pose()


def test_the_map_of_an_exact_print_is_the_noise_of_its_cells() -> None:
    top = top_map(*_scan(TRUTH), layer_mm=0.2)
    assert top.seen_fraction > 0.98
    assert top.summary is not None
    assert top.summary.rms_mm == pytest.approx(top.noise_rms_mm, rel=0.15)
    assert (top.peaks.missed, top.valleys.missed) == (0, 0)
    walls = wall_points(*_scan(TRUTH)).summary
    assert walls is not None and walls.rms_mm == pytest.approx(0.01, rel=0.1)


def test_a_repeated_scan_gives_the_noise_of_the_map() -> None:
    first = top_map(*_scan(TRUTH), layer_mm=0.2)
    second = top_map(*_scan(replace(TRUTH, seed=6)), layer_mm=0.2, cell_mm=first.cell_mm)
    assert noise_of_repeat(first, second) == pytest.approx(first.noise_rms_mm, rel=0.2)
    other = top_map(*_scan(TRUTH), layer_mm=0.2, cell_mm=2.0 * first.cell_mm)
    with pytest.raises(InputError, match="same grid"):
        noise_of_repeat(first, other)


def test_a_lost_wave_lowers_the_crests_and_moves_the_pins() -> None:
    kept = 0.8
    top = top_map(*_scan(replace(TRUTH, transfer_x=lambda _: kept)), layer_mm=0.05)
    wave = max(BLOCK.surface.waves, key=lambda wave: abs(wave.amplitude))  # type: ignore[attr-defined]
    assert top.peaks.missed == top.peaks.count > 0
    assert top.peaks.mean_mm == pytest.approx((1.0 - kept) * BLOCK.extremes.high, rel=0.15)
    expected = (1.0 - kept) * abs(wave.amplitude) * float(shift_px_per_mm(2.0 * np.pi / wave.f)) / np.sqrt(2.0)
    assert top.pin_shift_px == pytest.approx(expected, rel=0.25)


def test_height_errors_are_vertical_where_the_nearest_place_is_beside_the_point() -> None:
    block = Block.of(4)
    lossy = replace(TRUTH, points=40_000, noise_mm=0.0, transfer_x=low_pass(0.9), transfer_y=low_pass(0.9))
    cloud = simulate_scan(block, lossy)
    top = top_map(cloud, block, fit_scan(cloud, block, "pose"), layer_mm=0.2, cell_mm=0.2)
    printed = printed_waves(block, low_pass(0.9), low_pass(0.9))
    expected = printed.grid(top.x_mm, top.y_mm) - block.surface.grid(top.x_mm, top.y_mm)
    rms = float(np.sqrt(np.mean(expected[top.compared] ** 2)))
    assert float(np.sqrt(np.mean(top.height_error_mm[top.compared] ** 2))) == pytest.approx(rms, rel=0.1)
    assert top.summary is not None and top.summary.rms_mm < rms / 2.0


def test_the_sensor_and_the_holder_feel_the_scale_but_the_deviation_does_not_contain_it() -> None:
    larger = replace(TRUTH, pose=replace(TRUTH.pose, stretch=stretch((1.02, 1.02, 1.0))))
    top, walls = top_map(*_scan(larger), layer_mm=0.2), wall_points(*_scan(larger))
    exact = top_map(*_scan(TRUTH), layer_mm=0.2)
    assert top.summary is not None and exact.summary is not None
    assert top.summary.rms_mm == pytest.approx(exact.summary.rms_mm, rel=0.2)
    assert top.pin_shift_px is not None and exact.pin_shift_px is not None
    assert top.pin_shift_px > 5.0 * exact.pin_shift_px
    assert walls.outward_95_mm == pytest.approx(0.02 * max(BLOCK.size_mm) / 2.0, abs=0.03)


def test_an_unseen_part_is_unknown() -> None:
    cloud, block, fit = _scan(replace(TRUTH, top_fraction=0.5, walls=()))
    top = top_map(cloud, block, fit, layer_mm=0.2)
    assert 0.4 < top.seen_fraction < 0.6
    assert wall_points(cloud, block, fit).summary is None
    with pytest.raises(InputError, match="no point on the top"):
        top_map(cloud, block, replace(fit, on_top=np.zeros(len(cloud), dtype=bool)), layer_mm=0.2)


def _scan(truth: ScanTruth):  # type: ignore[no-untyped-def]
    cloud, fit = true_scan(BLOCK, truth)
    return cloud, BLOCK, fit
