"""A printer model for tests."""

from __future__ import annotations

from pathlib import Path

from tacbench_cad.extensions.printer_models.correction import Corrected, corrected_for
from tacbench_cad.extensions.printer_models.model import Measured, PrinterModel, TransferPoint
from tacbench_cad.spec.block import Block


def measured(value: float) -> Measured:
    return Measured(value=value, low=value - 0.001, high=value + 0.001)


def points(*pairs: tuple[float, float]) -> tuple[TransferPoint, ...]:
    return tuple(TransferPoint(wavelength_mm=w, factor=f, low=f, high=f) for w, f in pairs)


#: A printer that loses 30 % of the finest printable wave and shrinks 0.4 %.
PRINTER = PrinterModel(
    name="ender-3_pla-plus",
    printer="ender-3",
    filament="pla-plus",
    nozzle_mm=0.4,
    prints=1,
    scale_x=measured(0.996),
    scale_y=measured(0.995),
    scale_z=measured(1.004),
    offset_mm=measured(0.05),
    transfer_x=points((0.8, 0.7), (8.0, 0.99)),
    transfer_y=points((0.8, 0.6), (8.0, 0.98)),
)


def write_corrected(folder: Path, block: Block, model: PrinterModel = PRINTER) -> Corrected:
    """Correct a block for a printer, and write the texture file of the corrected block."""
    folder.mkdir(exist_ok=True)
    corrected = corrected_for(block, model)
    name = block.texture.name
    (folder / f"{name}.toml").write_text(corrected.toml(name), encoding="utf-8")
    return corrected
