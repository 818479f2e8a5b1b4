"""Operations on surfaces, and sampled functions."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from helpers.cases import mostly_long

from tacbench_cad.spec.authors_later import later_surface
from tacbench_cad.spec.families import plane_waves
from tacbench_cad.spec.interpolation import height_map, sampled
from tacbench_cad.spec.spline import SplineSurface
from tacbench_cad.spec.storage import surface_from, surface_values
from tacbench_cad.spec.waves import WaveSum
from tacbench_cad.util.errors import InputError

WAVES = plane_waves((1.0, 1.0, 0.5), (0.3, 2.0, -1.0, 0.4))
U, V = np.random.default_rng(0).uniform(0.5, 5.5, (2, 300))
TABLE = np.random.default_rng(1).normal(size=(12, 12))


def smooth(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    return np.exp(np.sin(u)) * np.cos(v)


def test_a_function_is_sampled_within_its_error() -> None:
    surface = sampled(smooth, u=(0.0, 6.0), v=(0.0, 6.0), error=1e-5)
    assert surface.evidence == "measured"
    assert 0.0 < surface.error <= 1e-5
    assert np.abs(surface(U, V) - smooth(U, V)).max() <= surface.error


def test_a_crease_is_followed() -> None:
    def roof(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        return np.abs(u - 2.0) + 0.1 * np.sin(v)

    surface = sampled(roof, u=(0.0, 6.0), v=(0.0, 6.0), creases=([2.0], []))
    assert surface.creases[0].tolist() == [2.0]
    assert surface.poles.size < 1000
    assert np.abs(surface(U, V) - roof(U, V)).max() <= surface.error


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda u, v: np.sqrt(u - 2.0) + 0.0 * v, r"is not a finite number at u = 0, v = 0"),
        (lambda u, v: u[:3], r"returns the shape"),
        (lambda u, v: u.missing, r"fails: .*missing"),
        (lambda u, v: np.sign(u - 2.0) + 0.0 * v, r"cannot be sampled within 0\.0001"),
    ],
)
def test_functions_that_make_no_surface_are_refused(function: object, message: str) -> None:
    with np.errstate(all="ignore"), pytest.raises(InputError, match=message):
        sampled(function, u=(0.0, 6.0), v=(0.0, 6.0))  # type: ignore[arg-type]


def test_sums_of_waves_stay_sums_of_waves() -> None:
    total = WAVES + 2.0 * WAVES
    assert isinstance(total, WaveSum)
    np.testing.assert_allclose(total(U, V), 3.0 * WAVES(U, V), atol=1e-12)
    turned_waves = WAVES.turned(30.0)
    c, s = math.cos(math.radians(30.0)), math.sin(math.radians(30.0))
    np.testing.assert_allclose(turned_waves(c * U - s * V, s * U + c * V), WAVES(U, V), atol=1e-12)


def test_splines_with_the_same_domain_are_added_exactly() -> None:
    first = sampled(smooth, u=(0.0, 6.0), v=(0.0, 6.0), error=1e-3)
    second = sampled(lambda u, v: np.abs(u - 2.0) + v, u=(0.0, 6.0), v=(0.0, 6.0), creases=([2.0], []))
    total = first + second
    np.testing.assert_allclose(total(U, V), first(U, V) + second(U, V), atol=1e-12)
    assert total.creases[0].tolist() == [2.0]
    assert total.error == first.error + second.error


def test_waves_and_a_spline_are_added_within_the_error() -> None:
    spline = height_map(TABLE, mm_per_pixel=0.6)
    with pytest.raises(InputError, match="surfaces: some are in mm and others in units"):
        WAVES + spline
    total = replace(WAVES, unit="mm") + spline
    assert total.unit == "mm"
    assert np.abs(total(U, V) - WAVES(U, V) - spline(U, V)).max() <= total.error
    assert total.evidence == "measured"


def test_a_window_fades_out_towards_the_edges() -> None:
    faded = WAVES.windowed(1.0, ((0.0, 6.0), (0.0, 6.0)))
    inside = (U > 1.0) & (U < 5.0) & (V > 1.0) & (V < 5.0)
    assert np.abs(faded(U, V) - WAVES(U, V))[inside].max() <= faded.error
    edge = np.linspace(0.0, 6.0, 50)
    assert np.abs(faded(edge, np.zeros(50))).max() <= faded.error
    with pytest.raises(InputError, match=r"margin = 4"):
        WAVES.windowed(4.0, ((0.0, 6.0), (0.0, 6.0)))


def test_a_mask_multiplies() -> None:
    disc = WAVES.masked(lambda u, v: np.exp(-((u - 3.0) ** 2) - (v - 3.0) ** 2), ((0.0, 6.0), (0.0, 6.0)))
    expected = WAVES(U, V) * np.exp(-((U - 3.0) ** 2) - (V - 3.0) ** 2)
    assert np.abs(disc(U, V) - expected).max() <= disc.error


def test_a_surface_repeats_only_without_a_step() -> None:
    faded = height_map(TABLE, mm_per_pixel=0.6).windowed(1.0)
    poles = faded.poles.copy()
    poles[[0, -1]] = poles[:, [0, -1]] = 0.0
    tile = SplineSurface(faded.u, faded.v, poles).repeated()
    period = faded.u.ends[1]
    np.testing.assert_allclose(tile(U + period, V - 2.0 * period), tile(U, V), atol=1e-12)
    with pytest.raises(InputError, match=r"repeat = 'u': there would be a step of .*fit_waves"):
        height_map(TABLE).repeated()


def test_a_domain_is_needed_where_none_follows() -> None:
    with pytest.raises(InputError, match=r"domain: is missing"):
        WAVES.windowed(1.0)


def test_a_window_keeps_the_creases() -> None:
    """The bounds of cells, from which a certificate is made, hold between the creases of |sin u| + |cos v|."""
    faded = later_surface("diamond").windowed(2.0, ((0.5, 11.5), (0.3, 10.3)))
    for found, kinks in zip(faded.creases, (math.pi * np.arange(1, 4), math.pi * (np.arange(3) + 0.5)), strict=True):
        assert np.abs(found[:, None] - kinks).min(axis=0).max() < 1e-6
    u, v = np.random.default_rng(2).uniform(2.6, 8.2, (2, 4000))
    assert np.abs(faded(u, v) - np.abs(np.sin(u)) - np.abs(np.cos(v))).max() <= faded.error
    # Without the creases, the same function needs many more samples, and its slope would change over a short length.
    assert faded.poles.size < 10_000


@pytest.mark.parametrize("unit", mostly_long(["units", "mm"], "mm"))
def test_every_operation_keeps_the_unit(unit: Literal["units", "mm"]) -> None:
    waves, spline = replace(WAVES, unit=unit), replace(height_map(TABLE), unit=unit)
    ends = ((0.0, 6.0), (0.0, 6.0))
    tile = replace(spline, poles=np.ones_like(spline.poles) + _bump(spline.poles.shape))
    for surface in (
        *(waves.mapped((2.0, 3.0), 0.5), spline.mapped((2.0, 3.0), 0.5), spline.over((1.0, 5.0), (2.0, 6.0))),
        *(2.0 * waves, spline * 2.0, waves + waves, spline - spline),
        *(waves + spline, waves.turned(20.0), waves.windowed(1.0, ends), spline.windowed(1.0)),
        *(spline.masked(lambda u, v: np.exp(-u) + 0.0 * v), spline.derivative((0, 0))),
        tile.repeated().turned(30.0, ((0.0, 1.0), (0.0, 1.0))),
        surface_from(surface_values(waves)),
        surface_from(surface_values(spline)),
    ):
        assert surface.unit == unit
    assert WAVES.mapped((1.0, 1.0), 1.0, unit="mm").unit == "mm"


def _bump(shape: tuple[int, int]) -> np.ndarray:
    """A table that is 0 at its edge."""
    return np.multiply.outer(*(np.sin(np.linspace(0.0, math.pi, n)) ** 2 for n in shape))
