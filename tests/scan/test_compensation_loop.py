"""The loop in simulation: print, scan, model, correct, print and scan again."""

from __future__ import annotations

import numpy as np

from tacbench_cad.scan.fitting import fit_scan
from tacbench_cad.scan.pose import Pose
from tacbench_cad.scan.printerfit import printer_model, scan_of_fit
from tacbench_cad.scan.simulating import ScanTruth, simulate_scan, stretch
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.compensation import corrected_for, in_file
from tacbench_cad.spec.textures import Texture, plane_waves

#: The printer shrinks 0.4 % and loses 30 % of the finest wave that a nozzle of 0.4 mm can print.
SCALE, FINEST_MM = 0.996, 0.8


def transfer(wavelength_mm: float) -> float:
    return float(0.7 ** ((FINEST_MM / wavelength_mm) ** 2))


def test_one_round_of_scan_and_correction_reduces_the_deviation_by_more_than_3_times() -> None:
    # A texture with the finest printable wave along x, and a longer wave along y.
    per_unit = 23.3 / (6 * np.pi + 0.5)
    waves = plane_waves((0.7, 1.0, 0.0), (0.6, 0.0, 1.0), (0.1, 2.0 * np.pi * per_unit / (FINEST_MM + 0.005), 0.0))
    block = Block.of(Texture(name="fine", surface=waves), key_mm=3.0)
    pose = Pose(rotation=np.eye(3), shift_mm=np.array([3.0, -2.0, 1.0]), stretch=stretch((SCALE,) * 3))

    def scan(file: Block, seed: int) -> object:
        truth = ScanTruth(
            pose=pose, transfer_x=transfer, transfer_y=transfer, noise_mm=0.005, points=8_000, table_mm=2.0, seed=seed
        )
        return simulate_scan(file, truth)

    def deviation(file: Block, seed: int) -> float:
        result = fit_scan(scan(file, seed), block, "pose")  # type: ignore[arg-type]
        top = result.deviation_mm[result.on_top & result.used]
        return float(np.sqrt(max(np.mean((top - top.mean()) ** 2) - 0.005**2, 1e-8)))

    measured = fit_scan(scan(block, 1), block, "scale")  # type: ignore[arg-type]
    about = scan_of_fit(measured, block, printer="virtual", filament="pla", copy=1, nozzle_mm=0.4)
    model = printer_model([about])
    assert np.allclose(model.scale, SCALE, atol=1e-3)
    file = in_file(corrected_for(block, model))
    assert deviation(file, 2) < deviation(block, 3) / 3.0
