"""The model of a printer: its file, its errors, and the interpolation of its transfer function."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from tacbench_cad.extensions.printer_models.model import (
    Measured,
    PrinterModel,
    TransferPoint,
    read_printer_model,
    toml_text,
    write_printer_model,
)
from tacbench_cad.util.errors import InputError

MODEL = PrinterModel(
    name="ender-3_pla-plus",
    printer="ender-3",
    filament="pla-plus",
    nozzle_mm=0.4,
    prints=3,
    scans=('a "b".json', "c.json"),
    scale_x=Measured(value=0.996, low=0.9955, high=0.9965),
    scale_z=Measured(value=1.002, low=1.0, high=1.004),
    offset_mm=Measured(value=0.05, low=0.04, high=0.06),
    transfer_x=(
        TransferPoint(wavelength_mm=1.0, factor=0.7, low=0.65, high=0.75),
        TransferPoint(wavelength_mm=4.0, factor=1.0, low=0.99, high=1.01),
    ),
)


def test_a_model_is_the_same_after_writing_and_reading(tmp_path: Path) -> None:
    path = tmp_path / "my-printer.toml"
    write_printer_model(MODEL, path)
    assert read_printer_model(path) == MODEL
    assert read_printer_model(path).relief_rule == "formula"
    path.write_text(path.read_text().replace('relief_rule = "formula"\n', ""))
    assert read_printer_model(path) == MODEL  # the rule of files without this key
    write_printer_model(replace(MODEL, relief_rule="free"), path)
    assert read_printer_model(path) == replace(MODEL, relief_rule="free") != MODEL
    assert replace(MODEL, relief_rule="free").fingerprint != MODEL.fingerprint
    assert path.read_text().startswith('format = "tacbench-printer-model-1"\nname = "ender-3_pla-plus"\n')


def test_an_axis_without_measured_waves_has_the_factor_1_and_an_oblique_wave_the_weighted_mean() -> None:
    assert MODEL.transfer(1.0, 90.0) == pytest.approx(1.0)
    assert MODEL.transfer(1.0, 45.0) == pytest.approx(0.85)
    assert MODEL.scale == (0.996, 1.0, 1.002)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('format = "tacbench-printer-model-1"\n', "", "format: is missing"),
        ("prints = 3", "prints = 0", "prints = 0: must be at least 1"),
        ("nozzle_mm", "nozle_mm", "nozle_mm"),
        ("value = 0.996", "value = 0.99", "from low 0.9955 to high 0.9965"),
        ("factor = 0.7", 'factor = "a"', "must be a finite number"),
        ("wavelength_mm = 4.0", "wavelength_mm = 0.5", "must increase"),
        ("value = 1.002, low = 1.0, high = 1.004", "value = 25.4, low = 25.0, high = 26.0", "from 0.8 to 1.2"),
        ("ender-3_pla-plus", "my printer", "letters, digits"),
        ('relief_rule = "formula"', 'relief_rule = "fre"', "relief_rule = 'fre'"),
    ],
)
def test_errors_name_the_file_and_the_field(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = tmp_path / "my-printer.toml"
    text = toml_text(MODEL)
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(InputError, match=r"my-printer\.toml") as error:
        read_printer_model(path)
    assert message in str(error.value)
