"""Comparison of wave sums with direct evaluation, finite differences, quadrature and sampling."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import dblquad

from tacbench_cad.spec.families import catalogue
from tacbench_cad.spec.outlines import without_key
from tacbench_cad.spec.sines import EXTREMES_ERROR, Wave
from tacbench_cad.spec.waves import EXTREMES_FRACTION, WaveSum
from tacbench_cad.util.errors import InputError

PERIOD = (0.0, 2.0 * math.pi)


def random_waves(rng: np.random.Generator, kind: str) -> WaveSum:
    """Return a sum of one to six waves of the kind ``separable``, ``parallel`` or ``oblique``."""
    count = int(rng.integers(1, 7))
    angle = rng.uniform(0.0, math.pi)
    waves = []
    for _ in range(count):
        f, g = rng.uniform(-9.0, 9.0, 2)
        if kind == "separable":
            f, g = (f, 0.0) if rng.random() < 0.5 else (0.0, g)
        elif kind == "parallel":
            f, g = f * math.cos(angle), f * math.sin(angle)
        amplitude = rng.normal() * 10.0 ** rng.uniform(-3.0, 0.0)
        waves.append(Wave(amplitude=float(amplitude), f=float(f), g=float(g), phase=float(rng.uniform(0.0, 6.3))))
    return WaveSum(tuple(waves))


@pytest.fixture(params=["separable", "parallel", "oblique"])
def kind(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def seeds(small: int, full: int) -> list[object]:
    """Return seeds for ``parametrize``. All but the first few are only used with --long."""
    return [pytest.param(i, marks=[] if i < small else [pytest.mark.long]) for i in range(full)]


@pytest.mark.parametrize("seed", seeds(6, 60))
def test_the_value_is_the_sum_of_the_waves(kind: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    waves = random_waves(rng, kind)
    u, v = rng.uniform(-20, 20, (2, 50))
    points = zip(u, v, strict=True)
    direct = [sum(w.amplitude * math.sin(w.f * a + w.g * b + w.phase) for w in waves.waves) for a, b in points]
    np.testing.assert_allclose(waves(u, v), direct, atol=1e-12)
    np.testing.assert_allclose(waves.grid(u, v), waves(u[:, None], v[None, :]), atol=1e-11)


@pytest.mark.parametrize("seed", seeds(4, 40))
def test_derivatives_agree_with_differences_and_stay_below_their_bounds(kind: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    waves = random_waves(rng, kind)
    u, v = rng.uniform(-20, 20, (2, 200))
    step = 1e-5
    for order in [(1, 0), (0, 1), (1, 1), (2, 0), (0, 2), (3, 1)]:
        lower = (order[0] - 1, order[1]) if order[0] else (0, order[1] - 1)
        du, dv = (step, 0.0) if order[0] else (0.0, step)
        difference = (waves(u + du, v + dv, lower) - waves(u - du, v - dv, lower)) / (2 * step)
        bound = waves.bound(*order)
        assert np.max(np.abs(waves(u, v, order) - difference)) <= 1e-5 * (1.0 + waves.bound(order[0] + 1, order[1] + 1))
        assert np.max(np.abs(waves(u, v, order))) <= bound * (1 + 1e-12)


@pytest.mark.parametrize("seed", seeds(3, 30))
def test_derivatives_on_a_grid_stay_below_the_bounds_of_their_cells(kind: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    waves = random_waves(rng, kind)
    u, v = (np.sort(rng.uniform(-5, 5, 12)) for _ in range(2))
    inside = np.linspace(0.0, 1.0, 9)
    for order in [(0, 0), (1, 0), (1, 1), (0, 2)]:
        np.testing.assert_allclose(waves.grid(u, v, order), waves(u[:, None], v[None, :], order), atol=1e-9)
        bounds = waves.cell_bounds(u, v, order)
        points_u = u[:-1, None] + np.diff(u)[:, None] * inside
        points_v = v[:-1, None] + np.diff(v)[:, None] * inside
        values = np.abs(waves(points_u[:, None, :, None], points_v[None, :, None, :], order)).max(axis=(2, 3))
        assert np.all(values <= bounds * (1 + 1e-12))
        assert np.all(bounds <= waves.bound(*order) * (1 + 1e-12))


@pytest.mark.parametrize("seed", seeds(3, 30))
def test_integral_over_a_rectangle_agrees_with_quadrature(kind: str, seed: int) -> None:
    waves = random_waves(np.random.default_rng(seed), kind)
    expected, error = dblquad(lambda b, a: float(waves(a, b)), -0.4, 1.3, 0.2, 2.1, epsabs=1e-10)
    assert waves.integral((-0.4, 1.3), (0.2, 2.1)) == pytest.approx(expected, abs=1e-8 + error)


@pytest.mark.parametrize("seed", seeds(3, 30))
def test_integral_over_a_triangle_agrees_with_quadrature(kind: str, seed: int) -> None:
    waves = random_waves(np.random.default_rng(seed), kind)
    expected, error = dblquad(lambda b, a: float(waves(a, b)), 1.0, 2.5, lambda a: 0.3, lambda a: a - 0.7, epsabs=1e-10)
    corners = [(1.0, 0.3), (2.5, 0.3), (2.5, 1.8)]
    assert waves.integral_triangle(corners) == pytest.approx(expected, abs=1e-8 + error)


@pytest.mark.parametrize("seed", seeds(8, 200))
def test_extremes_are_proved(kind: str, seed: int) -> None:
    rng = np.random.default_rng(1000 + seed)
    waves = random_waves(rng, kind)
    u, v = (0.0, float(rng.uniform(1, 20))), (-3.0, float(rng.uniform(1, 20)))
    extremes = waves.extremes(u, v)
    allowed = max(EXTREMES_ERROR, EXTREMES_FRACTION * waves.amplitude_sum) if kind == "oblique" else EXTREMES_ERROR
    assert extremes.error <= allowed * (1 + 1e-12)
    sampled = waves.grid(np.linspace(*u, 801), np.linspace(*v, 803))
    assert sampled.max() <= extremes.high + extremes.error + 1e-12
    assert sampled.min() >= extremes.low - extremes.error - 1e-12
    for place, value in ((extremes.at_low, extremes.low), (extremes.at_high, extremes.high)):
        assert float(waves(*place)) == pytest.approx(value, abs=1e-9)
        assert u[0] - 1e-9 <= place[0] <= u[1] + 1e-9
        assert v[0] - 1e-9 <= place[1] <= v[1] + 1e-9


@pytest.mark.parametrize("seed", seeds(2, 50))
def test_extremes_in_a_region_ignore_other_points(kind: str, seed: int) -> None:
    rng = np.random.default_rng(2000 + seed)
    waves = random_waves(rng, kind)
    region = without_key((5.0, 4.0), 3.0)
    extremes = waves.extremes((0.0, 5.0), (0.0, 4.0), region)
    uu, vv = np.meshgrid(np.linspace(0, 5, 250), np.linspace(0, 4, 250))
    counts = region.distance(uu, vv) <= 0
    assert waves(uu[counts], vv[counts]).max() <= extremes.high + extremes.error + 1e-12
    assert float(region.distance(*extremes.at_high)) <= 1e-9
    assert float(waves(*extremes.at_high)) == pytest.approx(extremes.high, abs=1e-9)
    assert extremes.error <= max(EXTREMES_ERROR, EXTREMES_FRACTION * waves.amplitude_sum) * (1 + 1e-12)


def test_the_extremes_of_the_papers_textures_over_a_whole_period() -> None:
    expected = [1.0, 2.0, 1.9688396, 2.3589463, 0.9844198, 1.1794732]
    for texture, value in zip(catalogue(), expected, strict=True):
        extremes = texture.surface.extremes(PERIOD, PERIOD)
        assert extremes.high == pytest.approx(value, abs=1e-7)
        assert extremes.low == pytest.approx(-value, abs=1e-7)


@pytest.mark.parametrize("value", [math.nan, math.inf, "1", True, None])
def test_a_wave_refuses_values_that_are_not_numbers(value: object) -> None:
    with pytest.raises(InputError, match="wave f"):
        Wave(amplitude=1.0, f=value, g=0.0)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("waves", "text"),
    [
        (((1.0, 1.0, 0.0, 0.0),), "sin u"),
        (((-0.5, 0.0, -1.0, 0.0),), "-0.5 sin(-v)"),
        (((1.0, 2.0, -1.0, 0.5), (-1.0, 0.0, 1.0, 0.0)), "sin(2u - v + 0.5) - sin v"),
        (((0.0, 1.0, 1.0, 0.0), (0.25, 0.0, 0.0, 1.5)), "0.25 sin(1.5)"),
        ((), "0"),
        (((1.0, 1.0, 0.0, 0.0),) * 5, "sin u + sin u + sin u + 2 more waves"),
    ],
)
def test_a_sum_of_waves_is_written_as_a_formula(waves: tuple[tuple[float, ...], ...], text: str) -> None:
    wave_sum = WaveSum(tuple(Wave(amplitude=a, f=f, g=g, phase=phase) for a, f, g, phase in waves))
    assert str(wave_sum) == text
