"""A printer whose prints were measured, for ``tacbench simulate``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tacbench_cad.extensions.printer_models.model import PrinterModel, read_printer_model
from tacbench_cad.extensions.printer_models.prediction import Print
from tacbench_cad.lab.simulate import DRIFT_MM, cell_of, centres, smooth_noise
from tacbench_cad.lab.study import PrintedBlock
from tacbench_cad.util.types import Floats


@dataclass(frozen=True, kw_only=True)
class MeasuredPrinter:
    """A simulated printer with the scales, the offset of the walls and the transfer function of a model.

    A smooth error of the height differs between copies; its size is the repeatability of the model.

    Args:
        model: The model.
    """

    model: PrinterModel
    #: The layer height that the print record states. The model contains the effect of layers.
    layer_mm = 0.05

    @property
    def name(self) -> str:
        """The printer, the filament and the fingerprint of the model."""
        return f"{self.model.printer} with {self.model.filament}, by the model {self.model.fingerprint}"

    @property
    def nozzle_mm(self) -> float:
        """The diameter of the nozzle."""
        return self.model.nozzle_mm

    def heights(self, printed: PrintedBlock, rng: np.random.Generator) -> Floats:
        """See :class:`tacbench_cad.lab.simulate.prints.SimulatedPrinter`."""
        block, result = printed.block, Print(file=printed.in_file, model=self.model)
        x, y = centres(block)
        shift_x, shift_y = result.shift_mm(block)
        z = np.ascontiguousarray(result.heights(x + shift_x, y + shift_y).T) - block.height_mm
        if self.model.repeatability_mm is not None:
            noise = smooth_noise(z.shape, DRIFT_MM / 2.0 / cell_of(block), rng)
            z += self.model.repeatability_mm.value * noise
        return np.asarray(z)


def simulated_printer(path: Path) -> tuple[str, str, MeasuredPrinter]:
    """Read the printer, the filament and the simulated printer from the file of a model.

    Raises:
        InputError: The file cannot be read, or a key or a value is not allowed.
    """
    model = read_printer_model(path)
    return model.printer, model.filament, MeasuredPrinter(model=model)
