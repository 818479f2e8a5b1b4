"""Test virtual printers: the effect of each error, and the reproducibility of copies."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.printers import PRINTER, measured

from tacbench_cad.extensions.printer_models.correction import corrected_for
from tacbench_cad.extensions.printer_models.model import write_printer_model
from tacbench_cad.extensions.printer_models.simulated_printer import MeasuredPrinter
from tacbench_cad.lab.simulate.heights import centres
from tacbench_cad.lab.simulate.prints import (
    FILAMENTS,
    VIRTUAL_PRINTERS,
    SimulatedPrinter,
    VirtualPrinter,
    printer_of,
    read_printers,
    require_used,
    seeded,
    stimulus,
)
from tacbench_cad.lab.simulate.study import quick_study
from tacbench_cad.lab.study import names
from tacbench_cad.lab.study.spec import HolderRim, PrintedBlock
from tacbench_cad.spec.block import Block
from tacbench_cad.util.errors import InputError

#: A printer without errors and with very thin layers.
PERFECT = VirtualPrinter(
    name="perfect",
    nozzle_mm=0.1,
    layer_mm=0.005,
    xy_error_mm=0.0,
    layer_error_mm=0.0,
    z_error_mm=0.0,
    tilt_mm=0.0,
    peak_loss=0.0,
    roughness_mm=0.0,
    stringing_per_cm2=0.0,
)


def _design(block: Block) -> np.ndarray:
    x, y = centres(block)
    return np.asarray(block.surface.grid(x, y).T - block.extremes.high)


def _heights(
    block: Block, printer: SimulatedPrinter, rng: np.random.Generator, file: Block | None = None
) -> np.ndarray:
    printed = PrintedBlock(block=block, printer="ender-3", filament="pla-plus", file=file)
    return printer.heights(printed, rng)


def _error(printer: VirtualPrinter, texture: int = 2, seed: int = 1) -> np.ndarray:
    block = Block.of(texture)
    return _heights(block, printer, seeded("test", seed)) - _design(block)


def _printed(printer: str = "bambu-p1p", filament: str = "pla-minus", copy: int = 1, texture: int = 3) -> PrintedBlock:
    return PrintedBlock(block=Block.of(texture), printer=printer, filament=filament, copy=copy)


def test_a_printer_without_errors_prints_the_formula() -> None:
    assert np.max(np.abs(_error(PERFECT))) < 0.004


def test_layers_make_terraces_at_most_half_a_layer_off() -> None:
    block = Block.of(1, mm_per_unit=(6.0, 6.0, 1.0))
    z = _heights(block, replace(PERFECT, layer_mm=0.25), seeded("test"))
    # Only the edges are round. Of random heights only 2 % would be this near to a whole number of layers.
    layers = (z + block.height_mm) / 0.25
    assert np.mean(np.abs(layers - np.round(layers)) < 0.01) > 0.3
    assert np.max(np.abs(z - _design(block))) < 0.5 * 0.25 + 0.01


def test_a_wide_line_removes_narrow_peaks() -> None:
    narrow, wide = _error(PERFECT), _error(replace(PERFECT, nozzle_mm=1.6))
    assert np.max(wide) < 0.01
    assert np.min(wide) < np.min(narrow) - 0.05


def test_peaks_lose_height_and_nothing_gains_height() -> None:
    block = Block.of(2)
    lossy = _error(replace(PERFECT, nozzle_mm=0.4, peak_loss=0.6))
    kept = _error(replace(PERFECT, nozzle_mm=0.4, peak_loss=0.0))
    high = _design(block) > -0.15
    assert np.max(lossy - kept) < 1e-3
    assert np.mean((lossy - kept)[high]) < 4.0 * np.mean((lossy - kept)[~high]) < 0.0


def test_misplaced_walls_have_the_largest_effect_on_steep_relief() -> None:
    block = Block.of(1)
    error = _heights(block, replace(PERFECT, xy_error_mm=0.1), seeded("test")) - _design(block)
    x, _ = centres(block)
    slope = np.abs(block.surface(x, 0.0, (1, 0)))
    column = np.abs(error).mean(axis=0)
    assert column[slope > 0.7].mean() > 3.0 * column[slope < 0.1].mean()


def test_roughness_height_and_tilt_have_the_given_size() -> None:
    assert np.std(_error(replace(PERFECT, nozzle_mm=0.4, roughness_mm=0.03))) == pytest.approx(0.03, rel=0.1)
    heights = [np.mean(_error(replace(PERFECT, z_error_mm=0.1), seed=seed)) for seed in range(40)]
    assert 0.07 < np.std(heights) < 0.13
    tilted = _error(replace(PERFECT, tilt_mm=0.1))
    assert np.mean(tilted) == pytest.approx(0.0, abs=0.003)
    assert np.ptp(tilted.mean(axis=0)) > 0.01


def test_strings_lie_on_the_surface_and_only_add_height() -> None:
    strung = _error(replace(PERFECT, stringing_per_cm2=3.0)) - _error(PERFECT)
    assert np.min(strung) > -1e-9
    assert 0.001 < np.mean(strung > 0.05) < 0.2


def test_a_copy_is_reproducible_and_differs_from_other_copies() -> None:
    first = stimulus(_printed(), HolderRim()).z_mm
    assert np.array_equal(first, stimulus(_printed(), HolderRim()).z_mm)
    there = np.isfinite(first)
    for other in (stimulus(_printed(copy=2), HolderRim()), stimulus(_printed(), HolderRim(), seed=1)):
        assert np.array_equal(np.isfinite(other.z_mm), there)
        assert np.std(first[there] - other.z_mm[there]) > 0.005


def test_every_printer_and_filament_of_the_paper_has_a_preset() -> None:
    assert set(VIRTUAL_PRINTERS) == set(names.PRINTERS)
    assert set(FILAMENTS) == set(names.FILAMENTS)
    for printer, filament in names.COMBINATIONS:
        assert printer_of(_printed(printer, filament)).name == f"{printer} with {filament}"


def test_an_unknown_printer_uses_a_generic_preset_and_reports_it() -> None:
    printer = printer_of(_printed("my-printer", "wood"))
    assert "my-printer with wood, as ender-3-v3-se" in printer.name
    assert printer.peak_loss == VIRTUAL_PRINTERS["ender-3-v3-se"].peak_loss


def test_resin_is_closer_to_the_design_than_filament() -> None:
    block = Block.of(3)
    off = {
        printer: np.std(stimulus_error(block, printer, filament))
        for printer, filament in (("form-3", "grey-v4"), ("bambu-p1p", "pla-minus"), ("ender-3", "petg"))
    }
    assert off["form-3"] < off["bambu-p1p"] < off["ender-3"]


def stimulus_error(block: Block, printer: str, filament: str) -> np.ndarray:
    """Return the height error of a preset's print of a block, in mm."""
    printed = PrintedBlock(block=block, printer=printer, filament=filament)
    return _heights(block, printer_of(printed), seeded(printed.name)) - _design(block)


@pytest.mark.parametrize(
    ("field", "value"), [("nozzle_mm", 0.0), ("layer_mm", float("nan")), ("peak_loss", 1.5), ("tilt_mm", -0.1)]
)
def test_an_impossible_printer_is_refused(field: str, value: float) -> None:
    with pytest.raises(InputError, match=field):
        replace(PERFECT, **{field: value})  # type: ignore[arg-type]


def test_a_measured_printer_prints_by_its_model() -> None:
    printed = _printed("ender-3", "pla-plus", texture=2)
    block, printer = printed.block, MeasuredPrinter(model=PRINTER)
    assert printer_of(printed, {("ender-3", "pla-plus"): printer}) is printer
    assert PRINTER.fingerprint in printer.name and printer_of(printed) != printer
    plain = _heights(block, printer, seeded("a")) - _design(block)
    file = corrected_for(block, PRINTER).file
    # The print of the corrected file is the design, also in its height.
    assert np.max(np.abs(_heights(block, printer, seeded("a"), file) - _design(block))) < 1e-4
    assert np.std(plain) > 0.02
    uneven = MeasuredPrinter(model=replace(PRINTER, repeatability_mm=measured(0.03)))
    first, second = (_heights(block, uneven, seeded(i), file) for i in range(2))
    assert np.std(first - second) == pytest.approx(0.03 * math.sqrt(2.0), rel=0.3)


def test_a_preset_prints_the_file() -> None:
    block = Block.of(2)
    change = _heights(block, PERFECT, seeded("a"), corrected_for(block, PRINTER).file) - _design(block)
    # Waves of the file are higher by the factors of the model, and so is the highest point.
    assert np.max(change) > 0.01 and np.std(change) > 0.01


def test_printers_must_belong_to_the_study() -> None:
    study = quick_study()
    printer = MeasuredPrinter(model=PRINTER)
    require_used({("bambu-p1p", "pla-minus"): printer}, study)
    with pytest.raises(InputError, match="is not in the study"):
        require_used({("ender-3", "pla-plus"): printer}, study)


def test_printers_are_read_by_the_extension_of_their_format(tmp_path: Path) -> None:
    write_printer_model(PRINTER, tmp_path / "a.toml")
    assert read_printers([tmp_path / "a.toml"]) == {("ender-3", "pla-plus"): MeasuredPrinter(model=PRINTER)}
    with pytest.raises(InputError, match="second file of this printer"):
        read_printers([tmp_path / "a.toml"] * 2)
    (tmp_path / "b.toml").write_text('format = "laser"\n')
    with pytest.raises(InputError, match="format = 'laser'"):
        read_printers([tmp_path / "b.toml"])
