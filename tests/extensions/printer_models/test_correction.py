"""The correction of files for a printer: the predicted print equals the formula, within the limits."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.cases import mostly_long
from helpers.printers import PRINTER, measured, points, write_corrected

from tacbench_cad.extensions.printer_models.correction import MAX_FACTOR, corrected_for
from tacbench_cad.extensions.printer_models.effect import effect_of
from tacbench_cad.extensions.printer_models.model import PrinterModel
from tacbench_cad.extensions.printer_models.prediction import Print, is_correctable, transfers
from tacbench_cad.lab.study.plate import block_in_file
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.families import plane_waves
from tacbench_cad.spec.outlines import Disc, Outline, Polygon, RegularPolygon, Ring
from tacbench_cad.spec.textures import Texture
from tacbench_cad.spec.waves import WaveSum
from tacbench_cad.util.errors import InputError


@pytest.mark.parametrize(("texture", "preset"), [("3", "paper"), ("4", "paper"), ("1", "released")])
def test_the_predicted_print_has_the_sides_the_height_and_the_relief_of_the_formula(texture: str, preset: str) -> None:
    block = Block.of(texture, preset, key_mm=3.0, scale=1.5)
    printed = Print(file=corrected_for(block, PRINTER).file, model=PRINTER)
    assert printed.size_mm == pytest.approx(block.size_mm, abs=ROUNDING_MM)
    top = block.datum_mm + block.extremes.high
    assert printed.height_mm == pytest.approx(top, abs=ROUNDING_MM)
    assert printed.relief_mm == pytest.approx(block.relief_mm, abs=2e-5)
    assert printed.datum_mm + printed.extremes.high == pytest.approx(top, abs=ROUNDING_MM)


def test_a_texture_of_long_waves_is_corrected_completely() -> None:
    block = Block.of("2")
    file = corrected_for(block, PRINTER).file
    # The print of the file is the formula, point by point, in the frame of the print.
    x, y = np.linspace(0.0, 23.3, 30), np.linspace(0.0, 30.0, 30)
    printed = Print(file=file, model=PRINTER)
    assert np.max(np.abs(printed.surface.grid(x, y) - block.surface.grid(x, y))) < 1e-5
    plain = Print(file=block, model=PRINTER)
    assert plain.size_mm == pytest.approx((0.996 * 23.3 + 0.1, 0.995 * 30.0 + 0.1))
    assert np.nanstd(plain.deviation_mm(block)) > 0.02 > 1e-5 > np.nanstd(printed.deviation_mm(block))


def test_no_wave_is_changed_beyond_the_limit_or_below_the_nozzle() -> None:
    weak = replace(PRINTER, transfer_x=points((0.8, 0.3), (8.0, 0.9)), transfer_y=points((0.5, 0.05), (9.0, 1.0)))
    block = Block.of("4")
    file = corrected_for(block, weak).file
    design = block.surface
    assert isinstance(design, WaveSum) and isinstance(file.surface, WaveSum)
    factors = file.surface.table[:, 0] / design.table[:, 0]
    free = is_correctable(design, weak)
    assert np.all(factors[~free] == 1.0) and np.all(factors <= MAX_FACTOR + 1e-12)
    wavelengths = 2.0 * math.pi / np.hypot(design.table[:, 1], design.table[:, 2])
    assert np.all(wavelengths[free] >= 0.8) and np.any(wavelengths[~free] < 0.8)
    notes = {wave.note for wave in effect_of(corrected_for(block, weak)).waves}
    assert notes == {"", "limit 2", "narrower than the nozzle"}


def test_the_effect_has_the_amplitudes_and_the_deviation_before_and_after() -> None:
    effect = effect_of(corrected_for(Block.of("5"), PRINTER))
    first = effect.waves[0]
    assert first.plain_mm == pytest.approx(first.amplitude_mm * PRINTER.transfer(first.wavelength_mm * 0.996, 0.0))
    assert first.plain_mm < first.amplitude_mm < first.corrected_mm + 0.01 < first.file_mm + 0.01
    plain, corrected, free = effect.plain, effect.corrected, effect.free
    assert plain is not None and corrected is not None and free is not None
    assert corrected.rms_mm < plain.rms_mm / 3.0 and corrected.normal_rms_mm < corrected.rms_mm
    assert free.rms_mm < corrected.rms_mm and free.printable_rms_mm < corrected.printable_rms_mm / 10.0
    assert effect.size_mm == pytest.approx(effect.corrected_size_mm, abs=ROUNDING_MM) and effect.helps


#: Sides and heights of corrected files are rounded to four digits.
ROUNDING_MM = 1e-4
#: A printer that loses most of the waves below its nozzle.
LOW = replace(PRINTER, transfer_x=points((0.3, 0.1), (0.8, 0.7), (8.0, 1.0)), transfer_y=points((0.3, 0.1), (8.0, 1.0)))


def test_with_a_free_relief_each_wave_is_only_corrected_for_its_own_error() -> None:
    block = Block.of("4", key_mm=3.0)
    file = corrected_for(block, replace(LOW, relief_rule="free")).file
    design = block.surface
    assert isinstance(design, WaveSum) and isinstance(file.surface, WaveSum)
    inverse = np.clip(1.0 / transfers(design, LOW), 1.0 / MAX_FACTOR, MAX_FACTOR)
    expected = np.where(is_correctable(design, LOW), inverse, 1.0)
    assert file.surface.table[:, 0] / design.table[:, 0] == pytest.approx(expected)
    printed = Print(file=file, model=LOW)
    assert printed.height_mm == pytest.approx(block.height_mm, abs=ROUNDING_MM)
    assert printed.relief_mm < block.relief_mm - 0.1


def test_an_oblique_wave_gets_the_mean_of_both_directions() -> None:
    surface = plane_waves((1.0, 1.0, 1.0))
    x, y = (PRINTER.transfer(2.0 * math.pi / math.sqrt(2.0), angle) for angle in (0.0, 90.0))
    assert transfers(surface, PRINTER) == pytest.approx((x + y) / 2.0)
    oblique = Texture(name="oblique", surface=plane_waves((0.5, 1.0, 1.0), (0.5, 2.0, -1.0)))
    effect = effect_of(corrected_for(Block.of(oblique), PRINTER))
    assert effect.corrected_relief_mm == pytest.approx(effect.relief_mm, abs=1e-4)


def test_a_spline_gets_its_sides_and_its_height_only() -> None:
    block = Block.of("ridges")
    effect = effect_of(corrected_for(block, PRINTER))
    assert effect.corrected_size_mm == pytest.approx((*block.size_mm, block.height_mm), abs=ROUNDING_MM)
    assert effect.corrected_relief_mm == pytest.approx(block.relief_mm)
    assert effect.waves == () and effect.corrected is None and effect.helps


def test_names_and_labels_say_that_a_block_is_corrected() -> None:
    block = Block.of("4", key_mm=3.0, copy=2)
    corrected = corrected_for(block, PRINTER)
    file = corrected.file
    assert file.name.startswith("t4-corr_paper_x1_23.2932x30.0503x") and file.name.endswith("_key3.0136_copy02")
    assert file.label_words == ("T4-CORR", "PAPER", "X1", "02") and file.engraving is not None
    assert corrected_for(block, replace(PRINTER, relief_rule="free")).file.texture.name == "t4-free"
    assert corrected.print is block and block.name == "texture-4_paper_x1_key3_copy02"
    part = corrected.part()
    assert part.spec["corrected_for"] == PRINTER.fingerprint and part.spec["print"]["size_mm"] == [23.3, 30.0]
    assert part.name == file.name and "corrected for ender-3_pla-plus" in part.title


@pytest.mark.parametrize(
    ("texture", "options"),
    [
        ("3", {"scale": 1.5, "key_mm": 3.0}),
        ("5", {"preset": "released"}),
        ("rock", {}),
        ("2", {"outline": RegularPolygon(sides=6, diameter_mm=24.0)}),
    ],
)
def test_the_texture_file_of_a_corrected_block_gives_the_same_block(
    texture: str, options: dict[str, Any], tmp_path: Path
) -> None:
    block = Block.of(texture, **options)
    file = write_corrected(tmp_path, block).file
    read = block_in_file(block, tmp_path / f"{block.texture.name}.toml")
    assert read.texture.surface == file.texture.surface and read.texture.name == file.texture.name
    assert (read.size_mm, read.height_mm, read.outline) == (file.size_mm, file.height_mm, file.outline)
    assert (read.origin_uv, read.mm_per_unit, read.sampling) == (file.origin_uv, file.mm_per_unit, file.sampling)


def test_the_texture_file_of_a_height_map_stretches_it(tmp_path: Path) -> None:
    x, y = np.meshgrid(np.linspace(0.0, 1.0, 31), np.linspace(0.0, 1.0, 41))
    np.save(tmp_path / "hill.npy", np.sin(5.0 * x + 3.0 * y))
    own = tmp_path / "hill.toml"
    own.write_text('[texture]\nname = "hill"\nfamily = "image"\nfile = "hill.npy"\nmm_per_pixel = 0.5\n')
    block = Block.of(own)
    corrected = corrected_for(block, PRINTER)
    (tmp_path / "corrected.toml").write_text(corrected.toml(str(own)))
    read = block_in_file(block, tmp_path / "corrected.toml")
    assert read.size_mm == pytest.approx(corrected.file.size_mm) and read.height_mm == corrected.file.height_mm
    x, y = np.linspace(0.0, read.size_mm[0], 20), np.linspace(0.0, read.size_mm[1], 20)
    assert read.surface.grid(x, y) == pytest.approx(corrected.file.surface.grid(x, y), abs=1e-9)
    assert Print(file=read, model=PRINTER).height_mm == pytest.approx(block.height_mm, abs=ROUNDING_MM)


OUTLINES = {
    "disc": Disc(diameter_mm=20.0),
    "ring": Ring(outer_mm=22.0, inner_mm=9.0),
    "hexagon": RegularPolygon(sides=6, diameter_mm=24.0),
    "arrow": Polygon(points_mm=((0.0, 0.0), (20.0, 8.0), (0.0, 16.0), (5.0, 8.0))),
}


@pytest.mark.parametrize(
    ("name", "texture", "scale"),
    mostly_long(
        product(OUTLINES, ["2", "4", "ridges"], [1.0, 1.5]),
        *[("disc", "2", 1.5), ("ring", "ridges", 1.0), ("arrow", "2", 1.0)],
    ),
)
def test_the_print_of_an_outline_has_its_sides_and_the_height_of_the_formula(
    name: str, texture: str, scale: float
) -> None:
    model = replace(PRINTER, scale_y=PRINTER.scale_x) if name in ("disc", "ring") else PRINTER
    block = Block.of(texture, outline=OUTLINES[name], scale=scale)
    corrected = corrected_for(block, model)
    printed = Print(file=corrected.file, model=model)
    assert printed.size_mm == pytest.approx(block.size_mm, abs=1e-5)
    assert block.outline is not None and printed.outline is not None
    for own, loop in zip(printed.outline.loops, block.outline.loops, strict=True):
        points = own.chords(0.01, None)[0].array
        assert np.max(np.abs(loop.distance(*points.T))) < 1e-5
    assert printed.height_mm == pytest.approx(block.height_mm, abs=ROUNDING_MM)
    assert printed.shift_mm(block) == pytest.approx((0.0, 0.0), abs=1e-5 if texture != "ridges" else 0.1)
    assert corrected.for_fixtures.outline == corrected.file.outline
    effect = effect_of(corrected)
    if texture == "2":
        assert effect.plain is not None and effect.corrected is not None
        assert effect.corrected.rms_mm < 1e-4 < 0.01 < effect.plain.rms_mm


@pytest.mark.parametrize(
    ("outline", "model", "needle"),
    [
        (Disc(diameter_mm=21.0), PRINTER, r"prints the disc of 21 mm as an oval whose sides differ by 0\.021 mm"),
        (RegularPolygon(sides=40, diameter_mm=2.0), replace(PRINTER, offset_mm=measured(1.0)), "loses a side"),
    ],
)
def test_outlines_that_cannot_be_corrected_are_refused(outline: Outline, model: PrinterModel, needle: str) -> None:
    with pytest.raises(InputError, match=needle):
        corrected_for(Block.of("1", outline=outline), model)
