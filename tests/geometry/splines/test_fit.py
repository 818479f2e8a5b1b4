"""Fitted splines of one axis: within the proved bounds, smooth at the joints, and with rounded knots and poles."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import BSpline

from tacbench_cad.geometry.splines.curve import Axis, basis
from tacbench_cad.geometry.splines.fit import Fit, Task, fit_both, short_decimal
from tacbench_cad.spec.sines import Sines

LINES = np.array([0.0, 1.3, 2.6, 4.0])


def task(rng: np.random.Generator, waves: int, finest: float, unit_mm: float = 1e-6) -> Task:
    table = np.column_stack([rng.normal(size=waves), rng.uniform(0.0, finest, waves), rng.uniform(0.0, 6.3, waves)])
    return Task(Sines.of(map(tuple, table)), 3.2, LINES, 5, unit_mm)


def largest_error(task: Task, fit: Fit) -> float:
    worst = 0.0
    for piece, poles in zip(fit.axis.pieces, fit.poles_mm, strict=True):
        x = np.linspace(*piece.ends, 20_001)
        worst = max(worst, float(np.abs(BSpline(piece.knots, poles, 5)(x) - 3.2 - task.function(x)).max()))
    return worst


@pytest.mark.parametrize("finest", [0.5, 5.0, 20.0, 200.0])
@pytest.mark.parametrize("spans", [5, 12])
def test_the_bound_is_never_below_the_error(finest: float, spans: int) -> None:
    rng = np.random.default_rng(int(finest) + spans)
    for _ in range(4):
        one = task(rng, 4, finest)
        fit = one.fit(spans)
        truth = largest_error(one, fit)
        assert truth <= fit.error_mm
        if finest <= 5.0:
            assert fit.error_mm <= 1.2 * truth + 1e-9


def test_value_and_slope_are_continuous() -> None:
    one = task(np.random.default_rng(3), 3, 6.0)
    fit = one.fit(8)
    splines = [BSpline(p.knots, c, 5) for p, c in zip(fit.axis.pieces, fit.poles_mm, strict=True)]
    for left, right, at in zip(splines, splines[1:], LINES[1:-1], strict=False):
        for order in (0, 1):
            assert left(at, nu=order) == pytest.approx(float(right(at, nu=order)), abs=1e-9)


def test_knots_and_poles_have_few_decimals() -> None:
    fit = task(np.random.default_rng(3), 3, 6.0, unit_mm=1e-5).fit(10)
    inner = fit.poles_mm[:, 1:-1]
    assert np.abs(inner - np.round(inner, 5)).max() < 1e-12
    for piece in fit.axis.pieces:
        assert np.abs(piece.breaks - np.round(piece.breaks, 3)).max() < 1e-12


def test_the_error_is_smaller_than_with_equal_spans() -> None:
    function = Sines.of([(1.0, 9.5, 0.0), (1.0, 10.5, 0.0)])
    fit = Task(function, 0.0, LINES, 5, 1e-6).fit(10)
    equal = Axis(LINES, basis(5, 10)).error(function.frequency, function.amplitude)
    assert fit.error_mm < 0.5 * equal


def test_both_axes_stay_within_the_limit_with_few_spans() -> None:
    rng = np.random.default_rng(5)
    tasks = (task(rng, 3, 8.0), task(rng, 3, 12.0))
    first, second = fit_both(tasks, 1e-3, (9, 9), (5, 5), 64) or pytest.fail("no fit")
    assert first.error_mm + second.error_mm <= 1e-3
    spans = [len(fit.axis.pieces[0].breaks) - 1 for fit in (first, second)]
    fewer = [one.fit(max(count - 2, 1)).error_mm for one, count in zip(tasks, spans, strict=True)]
    assert sum(fewer) > 1e-3
    assert fit_both(tasks, 1e-9, (5, 5), (5, 5), 6) is None


def test_a_constant_function_is_exact() -> None:
    fit = Task(Sines.of([]), 1.25, LINES, 5, 1e-5).fit(5)
    assert np.all(fit.poles_mm == 1.25)
    assert fit.error_mm < 1e-12


def test_short_decimals() -> None:
    assert short_decimal(0.0194) == pytest.approx(0.01)
    assert short_decimal(0.0074, 5) == pytest.approx(0.005)
    assert short_decimal(1e-5) == pytest.approx(1e-5)
