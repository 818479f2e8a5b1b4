"""Spline surfaces against SciPy, quadrature and dense sampling."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import NdBSpline

from tacbench_cad.spec.outlines import LoopRegion, without_key
from tacbench_cad.spec.spline import SplineAxis, SplineSurface
from tacbench_cad.spec.storage import surface_from, surface_values
from tacbench_cad.util.errors import InputError


def axis(rng: np.random.Generator, count: int, degree: int = 3) -> SplineAxis:
    inner = np.sort(rng.uniform(0.5, 9.5, count - degree - 1))
    return SplineAxis(np.concatenate([np.zeros(degree + 1), inner, np.full(degree + 1, 10.0)]), degree)


@pytest.fixture(params=[0, 1, 2])
def surface(request: pytest.FixtureRequest) -> SplineSurface:
    rng = np.random.default_rng(request.param)
    return SplineSurface(axis(rng, 11), axis(rng, 14), rng.normal(size=(11, 14)))


def creased() -> SplineSurface:
    """``|u - 2| + v`` over 0 to 5: a crease along u = 2."""
    u = SplineAxis(np.array([0.0, 0.0, 2.0, 5.0, 5.0]), 1)
    v = SplineAxis(np.array([0.0, 0.0, 5.0, 5.0]), 1)
    return SplineSurface(u, v, np.array([[2.0, 7.0], [0.0, 5.0], [3.0, 8.0]]))


def test_values_and_derivatives_are_those_of_scipy(surface: SplineSurface) -> None:
    points = np.random.default_rng(5).uniform(0.0, 10.0, (200, 2))
    reference = NdBSpline((surface.u.knots, surface.v.knots), surface.poles, 3)
    for order in [(0, 0), (1, 0), (1, 1), (0, 2), (3, 0)]:
        expected = reference(points, nu=order)
        np.testing.assert_allclose(surface(*points.T, order), expected, atol=1e-9 * max(1.0, np.abs(expected).max()))
        grid = surface.grid(points[:9, 0], points[:7, 1], order)
        np.testing.assert_allclose(grid, surface(points[:9, 0][:, None], points[:7, 1][None, :], order), atol=1e-9)
        assert np.abs(expected).max() <= surface.bound(*order)


@pytest.mark.parametrize("order", [(0, 0), (1, 0), (2, 0), (1, 1), (0, 2)])
def test_derivatives_stay_below_the_bounds_of_their_cells(surface: SplineSurface, order: tuple[int, int]) -> None:
    u, v = np.linspace(0.0, 10.0, 7), np.linspace(0.0, 10.0, 9)
    fine = np.abs(surface.grid(np.linspace(0.0, 10.0, 241), np.linspace(0.0, 10.0, 321), order))
    bounds = surface.cell_bounds(u, v, order)
    for i in range(6):
        for j in range(8):
            assert fine[40 * i : 40 * i + 41, 40 * j : 40 * j + 41].max() <= bounds[i, j] * (1.0 + 1e-12)


def test_a_cell_with_a_crease_inside_has_no_bound_of_its_second_derivative() -> None:
    surface = creased()
    assert surface.creases[0].tolist() == [2.0]
    v = np.array([0.0, 5.0])
    assert surface.cell_bounds(np.array([0.0, 2.0, 5.0]), v, (2, 0)).tolist() == [[0.0], [0.0]]
    assert surface.cell_bounds(np.array([0.0, 1.0, 3.0, 5.0]), v, (2, 0)).tolist() == [[0.0], [np.inf], [0.0]]
    assert surface.cell_bounds(np.array([0.0, 1.0, 3.0, 5.0]), v, (1, 0)).tolist() == [[1.0], [1.0], [1.0]]


def test_integrals_agree_with_quadrature(surface: SplineSurface) -> None:
    at, weight = np.polynomial.legendre.leggauss(400)
    u, v = 1.0 + 3.0 * (at + 1.0), 2.0 + 3.5 * (at + 1.0)
    expected = 3.0 * 3.5 * weight @ surface.grid(u, v) @ weight
    assert surface.integral((1.0, 7.0), (2.0, 9.0)) == pytest.approx(expected, abs=1e-4)
    # a triangle by the substitution of Duffy
    s, t = (at[:, None] + 1.0) / 2.0, (at[None, :] + 1.0) / 2.0
    a, b, c = np.array([2.0, 1.0]), np.array([9.0, 3.0]), np.array([4.0, 8.0])
    points = a + s[..., None] * ((b - a) + t[..., None] * (c - b))
    values = surface(points[..., 0], points[..., 1]) * s
    area = abs((b - a)[0] * (c - a)[1] - (b - a)[1] * (c - a)[0])
    expected = area * weight @ values @ weight / 4.0
    for corners in ([a, b, c], [a, c, b]):
        triangle = [(float(p[0]), float(p[1])) for p in corners]
        assert surface.integral_triangle(triangle) == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize("region", [None, without_key((10.0, 10.0), 4.0)])
def test_extremes_are_proved(surface: SplineSurface, region: LoopRegion | None) -> None:
    extremes = surface.extremes((0.0, 10.0), (0.0, 10.0), region)
    lines = np.linspace(0.0, 10.0, 301)
    z = surface.grid(lines, lines)
    if region is not None:
        z = z[region.distance(lines[:, None], lines[None, :]) <= 0.0]
    assert extremes.high >= z.max() - extremes.error
    assert z.max() >= extremes.high - 0.01
    assert extremes.low <= z.min() + extremes.error
    assert extremes.error < 2e-5
    assert float(surface(*extremes.at_high)) == pytest.approx(extremes.high, abs=1e-9)


def test_a_part_is_the_same_surface(surface: SplineSurface) -> None:
    part = surface.over((1.3, 7.2), (2.0, 9.0))
    u, v = np.random.default_rng(1).uniform([1.3, 2.0], [7.2, 9.0], (100, 2)).T
    np.testing.assert_allclose(part(u, v), surface(u, v), atol=1e-12)
    assert part.u.ends == (1.3, 7.2)
    with pytest.raises(
        InputError, match=r"domain = 'u 0 to 12': is larger than the surface, which is known from 0 to 10"
    ):
        surface.over((0.0, 12.0), (0.0, 10.0))


def test_a_surface_that_repeats_covers_any_rectangle(surface: SplineSurface) -> None:
    poles = np.vstack([surface.poles[:-1], surface.poles[:1]])
    repeating = SplineSurface(SplineAxis(surface.u.knots, 3, True), surface.v, poles)
    part = repeating.over((-13.0, 24.0), (0.0, 10.0))
    u, v = np.random.default_rng(1).uniform([-13.0, 0.0], [24.0, 10.0], (100, 2)).T
    np.testing.assert_allclose(part(u, v), repeating(u, v), atol=1e-12)
    np.testing.assert_allclose(part(u, v), repeating(u + 30.0, v), atol=1e-12)


def test_other_coordinates(surface: SplineSurface) -> None:
    scaled = surface.mapped((2.0, 0.5), 3.0, (1.0, 2.0))
    assert float(scaled(4.0, 1.0)) == pytest.approx(3.0 * float(surface(3.0, 4.0)))


def test_a_spline_survives_json(surface: SplineSurface) -> None:
    assert surface_from(surface_values(surface)) == surface
    broken = surface_values(surface)
    broken["spline"]["data"] = "AAAA"
    with pytest.raises(InputError, match=r"is not a spline that this program wrote"):
        surface_from(broken)
