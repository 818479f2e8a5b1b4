"""The model of a printer from documents of scans with a known truth."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.printers import PRINTER
from helpers.scan_documents import scan_document, write_scan

from tacbench_cad.extensions.printer_models.correction import corrected_for
from tacbench_cad.extensions.printer_models.fitting import (
    PrintScan,
    find_scans,
    print_scan,
    printer_model,
    read_print_scan,
)
from tacbench_cad.extensions.printer_models.model import PrinterModel
from tacbench_cad.extensions.printer_models.picture import transfer_picture
from tacbench_cad.extensions.printer_models.prediction import Print
from tacbench_cad.spec.block import Block
from tacbench_cad.util.errors import InputError

BLOCK = Block.of("4")


def model_of(folder: Path, *documents: dict[str, Any], **options: Any) -> PrinterModel:
    for i, document in enumerate(documents):
        write_scan(folder / f"s{i}", document)
    return printer_model([read_print_scan(path) for path in find_scans([folder])], **options)


def document_scan(document: dict[str, Any]) -> PrintScan:
    return print_scan(document, f"scan {document['copy']}")


def test_the_truth_of_a_single_print_lies_in_the_intervals(tmp_path: Path) -> None:
    model = model_of(tmp_path, scan_document(BLOCK, PRINTER))
    for measured, truth in (
        (model.scale_x, 0.996),
        (model.scale_y, 0.995),
        (model.scale_z, 1.004),
        (model.offset_mm, 0.05),
    ):
        assert measured is not None and measured.value == pytest.approx(truth, abs=0.01)
        assert measured.low - 0.002 <= truth <= measured.high + 0.002
    assert (model.name, model.prints, model.simulated) == ("ender-3_pla-plus", 1, True)
    assert model.skew_xy_deg is None and model.repeatability_mm is None
    inside = [p.low <= PRINTER.transfer(p.wavelength_mm / 0.996, 0.0) <= p.high for p in model.transfer_x]
    assert len(inside) == 13 and np.mean(inside) >= 0.8
    longest = 0.996 * 23.3 / (6 * np.pi + 0.5) * 2 * np.pi
    assert model.transfer_x[-1].wavelength_mm == pytest.approx(longest, rel=1e-3)


def test_the_model_corrects_the_print_that_it_was_measured_on(tmp_path: Path) -> None:
    model = model_of(tmp_path, *(scan_document(BLOCK, PRINTER, copy=copy) for copy in range(1, 5)))
    # A texture without waves below the nozzle. The print is that of the true printer.
    block = Block.of("2")
    plain, printed = (
        Print(file=file, model=PRINTER).deviation_mm(block) for file in (block, corrected_for(block, model).file)
    )
    assert np.std(printed) < np.std(plain) / 5.0


@pytest.mark.long
def test_intervals_contain_the_difference_between_prints_and_cover_the_truth() -> None:
    covered = []
    for study in range(60):
        scans = [document_scan(scan_document(BLOCK, PRINTER, copy=5 * study + i, between=0.02)) for i in range(5)]
        model = printer_model(scans)
        covered += [p.low <= PRINTER.transfer(p.wavelength_mm / 0.996, 0.0) <= p.high for p in model.transfer_x]
    assert 0.92 <= np.mean(covered) <= 0.99


def test_the_repeatability_is_the_spread_of_the_height_between_copies() -> None:
    scans = [document_scan(scan_document(BLOCK, PRINTER, copy=i, between=0.05, error=0.001)) for i in range(40)]
    measured = printer_model(scans).repeatability_mm
    amplitudes = np.array([wave.amplitude for wave in BLOCK.surface.waves])  # type: ignore[attr-defined]
    truth = 0.05 * np.sqrt(np.sum(amplitudes**2) / 2.0)
    assert measured is not None and measured.low < truth < measured.high
    assert measured.value == pytest.approx(truth, rel=0.3)


def test_scans_of_one_print_count_once(tmp_path: Path) -> None:
    twice = [scan_document(BLOCK, PRINTER, seed=seed) for seed in range(2)]
    other = scan_document(BLOCK, PRINTER, copy=2)
    model = model_of(tmp_path, *twice, other)
    assert (model.prints, len(model.scans)) == (2, 3)
    assert model.repeatability_mm is not None


@pytest.mark.parametrize(
    ("change", "options", "message"),
    [
        ({"printer": "bambu-p1p"}, {}, "differs from 'ender-3' ("),
        ({"filament": "petg"}, {}, "one printer, one filament and one nozzle"),
        ({"nozzle_mm": 0.6}, {}, "one nozzle"),
        ({}, {"printer": "form-3"}, "--printer NAME"),
        ({"printed_from": "t4-corr_paper_x1"}, {}, "prints of plain files"),
        ({"kind": "something"}, {}, "tacbench scan"),
        ({"waves": [{"wavelength_mm": "long"}]}, {}, "wavelength_mm = 'long'"),
    ],
)
def test_mixed_and_unusable_scans_are_refused(
    tmp_path: Path, change: dict[str, Any], options: dict[str, Any], message: str
) -> None:
    first, second = (scan_document(BLOCK, PRINTER, copy=copy) for copy in (1, 2))
    with pytest.raises(InputError) as error:
        model_of(tmp_path, first, second | change, **options)
    assert message in str(error.value)


def test_an_unknown_printer_must_be_given(tmp_path: Path) -> None:
    unknown = scan_document(BLOCK, PRINTER) | {"printer": None, "nozzle_mm": None}
    with pytest.raises(InputError, match="--printer NAME: is missing"):
        model_of(tmp_path / "a", unknown)
    model = model_of(tmp_path / "b", unknown, printer="mine", nozzle_mm=0.6)
    assert (model.printer, model.nozzle_mm) == ("mine", 0.6)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"has no scan\.json"):
        find_scans([tmp_path / "empty"])


def test_the_picture_of_the_transfer_function(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    transfer_picture(PRINTER, tmp_path / "a.png")
    assert (tmp_path / "a.png").stat().st_size > 10_000
