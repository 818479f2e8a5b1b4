"""The picture of a printer's transfer function."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tacbench_cad.extensions.printer_models.correction import MAX_FACTOR
from tacbench_cad.extensions.printer_models.model import PrinterModel
from tacbench_cad.extensions.scan.scan_pictures import error_bars, wavelength_axis
from tacbench_cad.util.plotting import BLUE, INK, ORANGE, new_figure, save_figure, styled


def transfer_picture(model: PrinterModel, path: Path) -> None:
    """Draw how much of a wave is printed, against its wavelength, along x and y.

    Args:
        model: The model.
        path: The file; its name ends in ``.png``, ``.svg`` or ``.pdf``.

    Raises:
        InputError: The model has no transfer function, or the file cannot be written.
        MissingToolError: matplotlib is not installed.
    """
    with styled():
        figure = new_figure((6.4, 3.6), layout="constrained")
        axes = figure.add_subplot()
        lengths = [point.wavelength_mm for point in (*model.transfer_x, *model.transfer_y)] or [1.0]
        span = np.geomspace(min(*lengths, 2.0 * model.nozzle_mm) / 1.3, 1.3 * max(lengths), 300)
        for axis, points, colour, marker, angle in (
            ("x", model.transfer_x, BLUE, "o", 0.0),
            ("y", model.transfer_y, ORANGE, "s", 90.0),
        ):
            if not points:
                continue
            axes.plot(span, [model.transfer(length, angle) for length in span], color=colour, linewidth=1.0)
            bars = [(point.wavelength_mm, point.factor, point.low, point.high) for point in points]
            style = {"color": colour, "fmt": marker, "markersize": 4.0, "capsize": 2.0, "linewidth": 0.8}
            error_bars(axes, bars, label=f"waves along {axis}", **style)
        wavelength_axis(axes, span[0], span[-1])
        axes.set_ylim(0.0, max(1.2, axes.get_ylim()[1]))
        axes.axhline(1.0, color=INK, linewidth=0.5)
        axes.axhline(1.0 / MAX_FACTOR, color=INK, linewidth=0.5, linestyle=":")
        axes.axvspan(span[0], 2.0 * model.nozzle_mm, color="0.9", zorder=0.0)
        axes.text(span[0] * 1.03, 1.03, "ridges narrower\nthan the nozzle", color=INK, fontsize=8.0)
        axes.text(span[-1] / 1.03, 1.0 / MAX_FACTOR + 0.02, "limit of the correction", ha="right", fontsize=8.0)
        axes.set_xlabel("wavelength in the print (mm)")
        axes.set_ylabel("amplitude in the print /\namplitude in the file")
        prints = "1 print" if model.prints == 1 else f"{model.prints} prints"
        simulated = ", simulated scans" if model.simulated else ""
        axes.set_title(f"{model.printer} with {model.filament}: {prints}{simulated}")
        if model.transfer_x or model.transfer_y:
            axes.legend(loc="lower right", frameon=False)
        save_figure(figure, path)
