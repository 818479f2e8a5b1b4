"""Roughness: the parameters of simple surfaces are the ones that NumPy and the closed forms give."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tacbench_cad.extensions.scan.cloud import HeightGrid
from tacbench_cad.extensions.scan.roughness import Roughness, _largest_rectangle, roughness
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats

pytest.importorskip("surfalize")


def wave(amplitude_mm: float = 0.1, columns: int = 401, rows: int = 301) -> Floats:
    """Whole periods of 2 mm along x, with pixels of 0.02 mm."""
    x = 0.02 * np.arange(columns)
    return np.tile(amplitude_mm * np.cos(math.pi * x), (rows, 1))


def by_numpy(heights_mm: Floats, step_mm: tuple[float, float]) -> dict[str, float]:
    z = 1000.0 * (heights_mm - heights_mm.mean())
    sq = math.sqrt(np.mean(z**2))
    a, b, c, d = heights_mm[:-1, :-1], heights_mm[:-1, 1:], heights_mm[1:, :-1], heights_mm[1:, 1:]
    flat = step_mm[0] * step_mm[1]

    def triangle(rise_x: Floats, rise_y: Floats) -> Floats:
        return np.asarray(np.sqrt((rise_x * step_mm[1]) ** 2 + (rise_y * step_mm[0]) ** 2 + flat**2) / 2.0)

    area = sum(triangle(rise_x, rise_y) for rise_x in (b - a, d - c) for rise_y in (c - a, d - b)) / 2.0
    return {
        "sa_um": float(np.mean(np.abs(z))),
        "sq_um": sq,
        "sz_um": float(np.ptp(z)),
        "ssk": float(np.mean(z**3) / sq**3),
        "sku": float(np.mean(z**4) / sq**4),
        "sdr_percent": 100.0 * (float(np.mean(area)) / flat - 1.0),
    }


def test_a_wave_has_the_parameters_of_the_closed_forms() -> None:
    result = roughness(HeightGrid(heights_mm=wave(), step_mm=(0.02, 0.02)), s_filter_mm=0.0, level=False)
    assert result.sa_um == pytest.approx(200.0 / math.pi, rel=5e-3)
    assert result.sq_um == pytest.approx(100.0 / math.sqrt(2.0), rel=5e-3)
    assert result.sz_um == pytest.approx(200.0, rel=1e-3)
    assert result.ssk == pytest.approx(0.0, abs=5e-3)
    assert result.sku == pytest.approx(1.5, rel=1e-2)
    slope = 0.1 * math.pi * np.sin(np.linspace(0.0, 2.0 * math.pi, 20_001))
    assert result.sdr_percent == pytest.approx(100.0 * (np.mean(np.sqrt(1.0 + slope**2)) - 1.0), rel=1e-2)
    assert result.area_mm == pytest.approx((8.0, 6.0))
    assert result.filters == "not levelled, no S-filter, no L-filter"


@pytest.mark.parametrize("step", [(0.02, 0.02), (0.02, 0.05)])
def test_a_rough_surface_has_the_parameters_by_numpy(step: tuple[float, float]) -> None:
    heights = np.random.default_rng(5).gamma(2.0, 0.01, (60, 80))
    result = roughness(HeightGrid(heights_mm=heights, step_mm=step), s_filter_mm=0.0, level=False)
    for name, value in by_numpy(heights, step).items():
        assert getattr(result, name) == pytest.approx(value, rel=1e-9), name


def test_levelling_removes_a_plane_and_the_filter_halves_a_wave_at_its_cutoff() -> None:
    plane = 0.05 * np.arange(401)[None, :] * 0.02 + 0.03 * np.arange(301)[:, None] * 0.02
    level = roughness(HeightGrid(heights_mm=plane + 3.0, step_mm=(0.02, 0.02)))
    assert level.sz_um < 1e-6
    assert (
        level.filters == "the plane of least squares removed, Gaussian S-filter with a cutoff of 0.06 mm, no L-filter"
    )
    halved = roughness(HeightGrid(heights_mm=wave(), step_mm=(0.02, 0.02)), s_filter_mm=2.0, level=False)
    assert halved.sq_um == pytest.approx(50.0 / math.sqrt(2.0), rel=0.02)


def test_small_holes_are_filled_and_large_ones_are_left_out() -> None:
    heights = wave()
    heights[100:103, 50:55] = np.nan
    small: Roughness = roughness(HeightGrid(heights_mm=heights, step_mm=(0.02, 0.02)))
    assert small.area_mm == pytest.approx((8.0, 6.0))
    assert small.filled_fraction == pytest.approx(15 / heights.size)
    assert small.sq_um == pytest.approx(100.0 / math.sqrt(2.0), rel=0.01)
    heights[:, 250:] = np.nan
    half = roughness(HeightGrid(heights_mm=heights, step_mm=(0.02, 0.02)))
    assert half.area_mm == pytest.approx((4.98, 6.0), abs=0.05)
    heights[:, :] = np.nan
    with pytest.raises(InputError, match="no measured rectangle of at least 10 x 10"):
        roughness(HeightGrid(heights_mm=heights, step_mm=(0.02, 0.02)))


def test_the_largest_rectangle_is_the_best_of_all() -> None:
    rng = np.random.default_rng(0)
    for _ in range(10):
        mask = rng.random((14, 13)) < 0.99
        sizes = [
            (bottom - top) * (right - left)
            for top in range(5)
            for bottom in range(top + 10, 15)
            for left in range(4)
            for right in range(left + 10, 14)
            if mask[top:bottom, left:right].all()
        ]
        if sizes:
            rows, columns = _largest_rectangle(mask)
            assert mask[rows, columns].all()
            assert mask[rows, columns].size == max(sizes)
