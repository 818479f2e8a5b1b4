"""The loop in simulation: print, scan, model, correct, print and scan again."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tacbench_cad.extensions.printer_models.correction import corrected_for
from tacbench_cad.extensions.printer_models.fitting import print_scan, printer_model
from tacbench_cad.extensions.printer_models.model import PrinterModel
from tacbench_cad.extensions.scan import Cloud, PrintOrigin, ScanOptions, analyse, fit_scan
from tacbench_cad.extensions.scan.pose import Pose
from tacbench_cad.extensions.scan.simulating import ScanTruth, simulate_scan, stretch
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.families import plane_waves
from tacbench_cad.spec.textures import Texture

BENCHMARK = Path(__file__).parents[3] / "benchmarks" / "compensation.py"
#: The printer shrinks 0.4 % and loses 30 % of the finest wave that a nozzle of 0.4 mm can print.
SCALE, FINEST_MM, NOISE_MM = 0.996, 0.8, 0.005


def transfer(wavelength_mm: float) -> float:
    return float(0.7 ** ((FINEST_MM / wavelength_mm) ** 2))


def printed_scan(file: Block, seed: int) -> Cloud:
    pose = Pose(rotation=np.eye(3), shift_mm=np.array([3.0, -2.0, 1.0]), stretch=stretch((SCALE,) * 3))
    truth = ScanTruth(
        pose=pose, transfer_x=transfer, transfer_y=transfer, noise_mm=NOISE_MM, points=8_000, table_mm=2.0, seed=seed
    )
    return simulate_scan(file, truth)


def measured_model(block: Block) -> PrinterModel:
    options = ScanOptions(origin=PrintOrigin(printer="virtual", filament="pla", copy=1, nozzle_mm=0.4))
    result = analyse(printed_scan(block, 1), [block], options)
    return printer_model([print_scan(result.as_dict(), "scan")])


def test_one_round_of_scan_and_correction_reduces_the_deviation_by_more_than_3_times() -> None:
    # A texture with the finest printable wave along x, and a longer wave along y.
    per_unit = 23.3 / (6 * np.pi + 0.5)
    waves = plane_waves((0.7, 1.0, 0.0), (0.6, 0.0, 1.0), (0.1, 2.0 * np.pi * per_unit / (FINEST_MM + 0.005), 0.0))
    block = Block.of(Texture(name="fine", surface=waves), key_mm=3.0)

    def deviation(file: Block, seed: int) -> float:
        result = fit_scan(printed_scan(file, seed), block, "pose")
        top = result.deviation_mm[result.on_top & result.used]
        return float(np.sqrt(max(np.mean((top - top.mean()) ** 2) - NOISE_MM**2, 1e-8)))

    model = measured_model(block)
    assert np.allclose(model.scale, SCALE, atol=1e-3)
    file = corrected_for(block, model).file
    assert deviation(file, 2) < deviation(block, 3) / 3.0


@pytest.mark.long
def test_a_free_relief_reduces_the_printable_error_of_all_six_textures_at_two_scales(tmp_path: Path) -> None:
    result = tmp_path / "rows.json"
    words = [sys.executable, str(BENCHMARK), "--textures", "1,2,3,4,5,6", "--scales", "1,2", "--save", str(result)]
    subprocess.run(words, check=True, capture_output=True)
    rows = json.loads(result.read_text())
    assert len(rows) == 12
    for row in rows:
        assert row["printable"]["ratio"] >= 3.0, row
        assert row["all"]["free"] < row["all"]["plain"], row
        assert row["pins_px"]["free"] <= row["pins_px"]["formula"] < row["pins_px"]["plain"] / 2.0, row
        assert all(abs(row["scanned"][name] - error) < 3.0 for name, error in row["normal"].items() if name != "scaled")
        assert row["relief_mm"]["formula"] == pytest.approx(row["relief_mm"]["design"], rel=2e-3), row
