"""Documents of ``tacbench scan`` with a known truth, without a scan."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from tacbench_cad.extensions.printer_models.model import PrinterModel
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.waves import WaveSum


def scan_document(
    block: Block,
    model: PrinterModel,
    *,
    copy: int | None = 1,
    seed: int = 0,
    error: float = 0.002,
    between: float = 0.0,
) -> dict[str, Any]:
    """Return the document of a scan of a print by a printer.

    Args:
        block: The block.
        model: The true printer.
        copy: The copy of the print.
        seed: The seed of the scan's errors; the seed of the print is the copy.
        error: The standard error of every number.
        between: The standard deviation of the scales and of the factors between prints.
    """
    scan, printed = np.random.default_rng((seed, copy or 0)), np.random.default_rng((77, copy or 0))
    assert isinstance(block.surface, WaveSum)

    def parameter(name: str, value: float, error: float = error, between: float = between) -> dict[str, Any]:
        value += between * printed.standard_normal() + error * scan.standard_normal()
        return {"name": name, "value": value, "standard_error": error, "determined": True}

    # As in a real fit, the scale along z is that of the first wave.
    waves = [wave for wave in block.surface.waves if wave.amplitude]
    factors = []
    for wave in waves:
        length, angle = 2.0 * math.pi / math.hypot(wave.f, wave.g), math.degrees(math.atan2(wave.g, wave.f))
        factors.append(model.transfer(length, angle) + between * printed.standard_normal())
    scale_z = factors[0]
    # The base in the frame of the block, in which the scale along z is undone.
    datum = model.scale[2] * block.datum_mm / scale_z
    return {
        "kind": "tacbench scan",
        "schema": 1,
        "file": f"scan{seed}.ply",
        "simulated": True,
        "block": block.name,
        "printer": model.printer,
        "filament": model.filament,
        "copy": copy,
        "nozzle_mm": model.nozzle_mm,
        "geometry": {
            "size_mm": [*block.size_mm, block.height_mm],
            "base_mm": block.base_mm,
            "datum_mm": block.datum_mm,
            "relief_mm": block.relief_mm,
        },
        "parameters": [
            parameter("scale_x", model.scale[0], error / 10.0, between / 10.0),
            parameter("scale_y", model.scale[1], error / 10.0, between / 10.0),
            parameter("scale_z", scale_z, error / 10.0, 0.0),
            parameter("wall_offset_mm", model.wall_offset_mm),
            parameter("base_mm", block.base_mm + datum - block.datum_mm),
            {"name": "skew_xy", "value": 0.0, "standard_error": None, "determined": False},
        ],
        "waves": [
            {
                "wavelength_mm": 2.0 * math.pi / math.hypot(wave.f, wave.g),
                "direction_deg": math.degrees(math.atan2(wave.g, wave.f)),
                "amplitude_mm": abs(wave.amplitude),
                "amplitude_ratio": factor / scale_z + error * scan.standard_normal(),
                "standard_error": error,
                "phase_deg": 0.0,
                "determined": True,
            }
            for wave, factor in zip(waves, factors, strict=True)
        ],
    }


def write_scan(folder: Path, document: dict[str, Any]) -> Path:
    """Write a document as ``scan.json`` into a new folder, and return the file."""
    folder.mkdir(parents=True)
    path = folder / "scan.json"
    path.write_text(json.dumps(document), encoding="utf-8")
    return path
