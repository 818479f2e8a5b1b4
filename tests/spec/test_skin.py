"""The deviations that a TacTip feels."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tacbench_cad.lab.simulate.heights import cell_of, centres
from tacbench_cad.lab.simulate.prints import VIRTUAL_PRINTERS, seeded
from tacbench_cad.lab.study.spec import PrintedBlock
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.skin import FELT_PX, pin_shifts_px, shift_px_per_mm
from tacbench_cad.spec.top_points import without_edge

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


@pytest.mark.parametrize(
    ("wavelength_mm", "amplitude_um"),
    [(1.0, 2148), (1.5, 162), (2.0, 52), (3.0, 20), (6.2, 12), (10.0, 14), (20.0, 22)],
)
def test_the_smallest_felt_amplitudes_are_those_of_the_page(wavelength_mm: float, amplitude_um: int) -> None:
    assert round(1000.0 * FELT_PX / float(shift_px_per_mm(wavelength_mm))) == amplitude_um
    page = Path(__file__).parents[2] / "docs" / "scan.md"
    assert f"| {amplitude_um:,} |" in page.read_text(encoding="utf-8")


def test_the_sensor_feels_the_errors_of_every_virtual_printer() -> None:
    block = Block.of(4)
    x, y = centres(block)
    formula = block.surface.grid(x, y) - block.extremes.high
    inside = without_edge(block, x, y, 2.1)
    shifts = {}
    for name, printer in VIRTUAL_PRINTERS.items():
        printed = printer.heights(PrintedBlock(block=block, printer=name, filament="any"), seeded("scan", name)).T
        shifts[name] = float(np.sqrt(np.mean(pin_shifts_px(printed - formula, cell_of(block))[inside] ** 2)))
    assert shifts["form-3"] == pytest.approx(0.3, abs=0.05)
    assert max(shifts.values()) == pytest.approx(1.1, abs=0.1) and min(shifts.values()) > FELT_PX
