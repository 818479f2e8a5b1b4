"""The deviations that a TacTip feels."""

from __future__ import annotations

import numpy as np
import pytest

from tacbench_cad.spec.skin import pin_shifts_px, shift_px_per_mm

STEP_MM = 0.1
X = np.arange(0.0, 20.0, STEP_MM)[:, None]
Y = np.arange(0.0, 24.0, STEP_MM)[None, :]


def test_the_skin_is_most_sensitive_to_waves_of_six_mm() -> None:
    lengths = np.linspace(0.5, 30.0, 2000)
    assert lengths[np.argmax(shift_px_per_mm(lengths))] == pytest.approx(6.2, abs=0.1)
    assert float(shift_px_per_mm(1.0)) < 0.01 * float(shift_px_per_mm(6.2))


def test_a_wave_moves_the_pins_by_its_formula_and_the_mean_and_holes_do_not() -> None:
    wave = 0.05 * np.sin(2.0 * np.pi * (0.6 * X + 0.8 * Y) / 5.0)
    shifts = pin_shifts_px(wave, STEP_MM)
    inner = shifts[40:-40, 40:-40]
    assert inner.max() == pytest.approx(0.05 * float(shift_px_per_mm(5.0)), rel=0.02)
    np.testing.assert_allclose(pin_shifts_px(wave + 1.0, STEP_MM)[40:-40, 40:-40], inner, atol=1e-9)
    holed = wave.copy()
    holed[100, 100] = np.nan
    filled = pin_shifts_px(holed, STEP_MM)
    assert np.nanmax(np.abs(filled - shifts)) < 0.02
    holed[:, 50:] = np.nan
    assert np.isnan(pin_shifts_px(holed, STEP_MM)[:, 80:]).all()


def test_an_empty_map_has_no_shifts() -> None:
    assert np.isnan(pin_shifts_px(np.full((5, 5), np.nan), STEP_MM)).all()
