"""The splines of sines: exact at the ends, and within the proved bounds."""

from __future__ import annotations

import numpy as np
import pytest

from tacbench_cad.geometry.splines.curve import Axis, Basis, basis
from tacbench_cad.spec.sines import Sines

CASES = [(3, 1), (5, 1), (5, 5), (5, 26), (7, 12), (9, 3)]


@pytest.mark.parametrize(("degree", "spans"), CASES)
def test_the_basis_sums_to_one_and_reproduces_lines(degree: int, spans: int) -> None:
    splines = Basis(degree, spans)
    t = np.concatenate([np.linspace(0.0, 1.0, 101), splines.breaks])
    ours = splines.values(t)
    assert np.abs(ours.sum(axis=1) - 1.0).max() < 1e-14
    assert np.abs(ours @ splines.greville - t).max() < 1e-14


@pytest.mark.parametrize(("degree", "spans"), CASES)
def test_ends_keep_value_and_slope(degree: int, spans: int) -> None:
    turn = np.array([0.0, 0.7, 5.0, -9.0])
    poles = basis(degree, spans).poles(turn)
    for at, pole in ((0.0, 0), (1.0, -1)):
        value = np.exp(1j * turn * at)
        assert np.abs(poles[pole] - value).max() < 1e-13
        step = (poles[1] - poles[0]) if at == 0.0 else (poles[-1] - poles[-2])
        assert np.abs(step * degree * spans - 1j * turn * value).max() < 1e-11
    assert np.all(poles[:, 0] == 1.0)


@pytest.mark.parametrize(("degree", "spans"), CASES)
@pytest.mark.parametrize("fineness", [0.3, 1.0, 3.0, 40.0])
def test_error_is_never_below_the_truth(degree: int, spans: int, fineness: float) -> None:
    rng = np.random.default_rng(degree * 100 + spans)
    splines = basis(degree, spans)
    t = np.linspace(0.0, 1.0, 20_001)
    values = splines.values(t)
    for _ in range(6):
        turn = rng.uniform(-1.0, 1.0, 4) * fineness * np.pi * spans
        weight = rng.uniform(0.0, 1.0, 4)
        truth = float((np.abs(np.exp(1j * np.outer(t, turn)) - values @ splines.poles(turn)) @ weight).max())
        proved = splines.error(turn, weight)
        assert truth <= proved
        if fineness <= 1.0:
            assert proved <= 1.15 * truth + 1e-10, (
                "the bound must not be much too high, otherwise too many poles are used"
            )


def test_error_bounds_each_sum_of_sines_on_an_axis() -> None:
    rng = np.random.default_rng(7)
    for _ in range(10):
        lines = np.concatenate([[0.0], np.cumsum(rng.choice([1.3, 2.1], 6))])
        axis = Axis(lines, basis(5, 9))
        sines = Sines(rng.uniform(-1.0, 1.0, 5), rng.uniform(0.0, 9.0, 5), rng.uniform(0.0, 6.0, 5))
        profile = axis.sines(sines)
        t = np.linspace(0.0, 1.0, 2001)
        worst = 0.0
        for patch in range(axis.patches):
            x = lines[patch] + t * (lines[patch + 1] - lines[patch])
            worst = max(worst, float(np.abs(axis.basis.values(t) @ profile[patch] - sines(x)).max()))
        assert worst <= axis.error(sines.frequency, np.abs(sines.amplitude))


def test_neighbours_share_their_pole_and_their_slope() -> None:
    axis = Axis(np.array([0.0, 1.0, 2.5, 3.1]), basis(5, 6))
    profile = axis.sines(Sines.of([(1.0, 2.0, 0.3), (0.4, 7.0, 1.0)]))
    widths = np.diff(axis.lines)
    assert np.array_equal(profile[1:, 0], profile[:-1, -1])
    left = (profile[:-1, -1] - profile[:-1, -2]) / widths[:-1]
    right = (profile[1:, 1] - profile[1:, 0]) / widths[1:]
    assert np.abs(left - right).max() < 1e-12


def test_many_waves_take_no_more_memory_than_few() -> None:
    """A long series is projected in parts. The sum must not depend on the size of the parts."""
    i = np.arange(1.0, 1400.0, 2.0)
    whole = Sines(1.0 / i**3, i, np.zeros_like(i))
    axis = Axis(np.linspace(0.0, 3.0, 4), basis(5, 8))
    halves = [Sines(whole.amplitude[k::2], whole.frequency[k::2], whole.phase[k::2]) for k in (0, 1)]
    assert np.abs(axis.sines(whole) - axis.sines(halves[0]) - axis.sines(halves[1])).max() < 1e-12
