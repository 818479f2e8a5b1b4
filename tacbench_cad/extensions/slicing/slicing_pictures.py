"""Pictures of plates (the bed from above) and of G-code checks (the printed top, its error, and cuts through it)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tacbench_cad.extensions.slicing.comparison import STEEP, AsSliced
from tacbench_cad.extensions.slicing.plates import Plate
from tacbench_cad.util.plotting import BLUE, INK, ORANGE, colour_bar, new_figure, save_figure, styled
from tacbench_cad.util.text import counted
from tacbench_cad.util.types import Floats

if TYPE_CHECKING:
    from matplotlib.figure import Figure


#: The range of the colour scale of errors, in layers.
_LAYERS_SHOWN = 2.0
#: The length of the lower cut, in mm.
_CLOSE_MM = 6.0
#: Light colours that people with any colour vision can distinguish. They repeat after eight textures.
_COLOURS = ("#8ec8ea", "#f3b48a", "#8fd3bd", "#e6b9d3", "#f2d27c", "#c9c9c9", "#a9b5f2", "#d9e68a")


def as_sliced_picture(comparison: AsSliced, path: Path) -> None:
    """Draw the printed top, its error, and a cut along x through the highest peak, complete and enlarged.

    Args:
        comparison: The comparison.
        path: The file; its name ends in ``.png``, ``.svg`` or ``.pdf``.

    Raises:
        MissingToolError: matplotlib is not installed.
        InputError: The file's name has another ending, or the file cannot be written.
    """
    with styled():
        save_figure(_figure(comparison), path)


def _figure(comparison: AsSliced) -> Figure:
    figure = new_figure((9.6, 9.8))
    block, sliced = comparison.block, comparison.sliced
    title = f"{block.texture.name} ({block.preset}, scale {block.scale:g}) as sliced; G-code: {sliced.dialect}"
    figure.text(0.02, 0.986, title, ha="left", va="top", fontsize=11.0, color=INK)
    figure.text(0.02, 0.961, _numbers(comparison), ha="left", va="top", fontsize=8.5, color=INK)
    height = np.where(comparison.printed_mm > 0.0, comparison.printed_mm, np.nan)
    _map(figure, comparison, (0.06, 0.475), height, "cividis", None, "printed height (mm)")
    error = 1000.0 * (comparison.printed_mm - comparison.formula_mm)
    error[~comparison.inside] = np.nan
    reach = 1000.0 * _LAYERS_SHOWN * sliced.layer_mm
    _map(figure, comparison, (0.55, 0.475), error, "RdBu_r", (-reach, reach), "print minus formula (µm)")
    _cuts(figure, comparison)
    return figure


def _numbers(comparison: AsSliced) -> str:
    parts = [f"layers of {comparison.sliced.layer_mm:.3g} mm"]
    if comparison.rms_mm is not None and comparison.ideal_rms_mm is not None:
        parts.append(
            f"height error {1000 * comparison.rms_mm:.0f} µm rms where the slope is below {STEEP:g} "
            f"(ideal staircase {1000 * comparison.ideal_rms_mm:.0f})"
        )
    if comparison.sideways is not None:
        steep = comparison.sideways
        parts.append(f"steep walls {1000 * steep.rms_mm:.0f} µm rms sideways ({1000 * steep.ideal_rms_mm:.0f})")
    first = "; ".join(parts)
    peaks, valleys = comparison.peaks, comparison.valleys
    second = (
        f"peaks lost: {peaks.missed} of {peaks.count} (\u25b2); "
        f"valleys filled: {valleys.missed} of {valleys.count} (\u25bc)"
    )
    return f"{first}\n{second}"


def _map(
    figure: Figure,
    comparison: AsSliced,
    corner: tuple[float, float],
    values: Floats,
    colours: str,
    limits: tuple[float, float] | None,
    label: str,
) -> None:
    axes = figure.add_axes((*corner, 0.37, 0.45), anchor="SW")
    x, y = comparison.block.size_mm
    low, high = limits or (float(np.nanmin(values[comparison.inside])), float(np.nanmax(values[comparison.inside])))
    drawn = axes.imshow(
        values.T, origin="lower", extent=(0.0, x, 0.0, y), cmap=colours, vmin=low, vmax=high, interpolation="nearest"
    )
    axes.set(xlabel="x (mm)", ylabel="y (mm)", aspect="equal")
    colour_bar(axes, drawn, label, extend="neither" if limits is None else "both")
    if limits is None:
        axes.axhline(_cut(comparison)[0], color=ORANGE, linewidth=1.2, linestyle="--")
        return
    marks: dict[str, Any] = {"linestyle": "", "markersize": 3.0, "markeredgewidth": 0.0, "color": INK}
    for marker, extrema in (("^", comparison.peaks), ("v", comparison.valleys)):
        if 0 < extrema.missed <= 200:  # more would hide the map
            axes.plot(*extrema.missed_mm.T, marker=marker, **marks)


def _cut(comparison: AsSliced) -> tuple[float, int]:
    """Return y in mm and the column of the cut, which goes through the highest point (the nearest to the middle)."""
    inside = np.where(comparison.inside, comparison.formula_mm, -np.inf)
    columns = inside.max(axis=0)
    best = np.nonzero(columns >= columns.max() - 0.001 * comparison.block.relief_mm)[0]
    column = int(best[np.argmin(np.abs(best - len(columns) / 2))])
    return float(comparison.y_mm[column]), column


def _cuts(figure: Figure, comparison: AsSliced) -> None:
    """Draw the complete cut, and below it the part with the largest error."""
    at, column = _cut(comparison)
    x, printed = comparison.x_mm, comparison.printed_mm[:, column]
    formula, ideal = comparison.formula_mm[:, column], comparison.ideal_mm[:, column]
    error = np.where(comparison.inside[:, column], np.abs(printed - formula), 0.0)
    wide = max(1, round(_CLOSE_MM / (x[1] - x[0])))
    sums = np.convolve(error, np.ones(min(wide, len(x))), mode="valid")
    first = int(np.argmax(sums))
    close = (float(x[first]), float(x[min(first + wide, len(x)) - 1]))
    panels = (((0.06, 0.255), (0.0, float(x[-1]))), ((0.06, 0.055), close))
    for i, ((left, bottom), span) in enumerate(panels):
        axes = figure.add_axes((left, bottom, 0.915, 0.13 if i == 0 else 0.15))
        axes.fill_between(x, 0.0, printed, step="mid", color=BLUE, alpha=0.22, linewidth=0.0)
        axes.plot(x, printed, drawstyle="steps-mid", color=BLUE, linewidth=1.0, label="printed")
        axes.plot(x, formula, color=ORANGE, linewidth=1.2, label="formula")
        axes.plot(x, ideal, drawstyle="steps-mid", color=INK, linewidth=0.6, linestyle=":", label="ideal staircase")
        shown = (x >= span[0]) & (x <= span[1])
        low = float(min(formula[shown].min(), printed[shown].min()))
        high = float(max(formula[shown].max(), printed[shown].max()))
        room = 0.1 * (high - low) + 0.05
        axes.set(xlim=span, ylim=(max(0.0, low - room), high + room), xlabel="x (mm)", ylabel="z (mm)")
        words = f"cut along x at y = {at:.2f} mm (dashed)" if i == 0 else f"the {_CLOSE_MM:g} mm with the largest error"
        axes.set_title(words, loc="left", pad=3.0)
        axes.spines[["top", "right"]].set_visible(False)
        if i == 0:
            axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, frameon=False, borderaxespad=0.2)


def plate_picture(plate: Plate, filament: str, path: Path) -> None:
    """Draw a plate.

    Args:
        plate: The plate.
        filament: The name of the filament.
        path: The file; its name ends in ``.png``, ``.svg`` or ``.pdf``.

    Raises:
        MissingToolError: matplotlib is not installed.
        InputError: The file's name has another ending, or the file cannot be written.
    """
    with styled():
        from matplotlib.patches import Rectangle

        across, down = plate.printer.bed_mm
        wide = 6.2
        tall = wide * (down + 4.0) / (across + 4.0)
        inches = (wide + 0.75, tall + 1.05)
        figure = new_figure(inches)
        axes = figure.add_axes((0.62 / inches[0], 0.5 / inches[1], wide / inches[0], tall / inches[1]))
        axes.add_patch(Rectangle((0.0, 0.0), across, down, facecolor="#f6f6f4", edgecolor=INK, linewidth=1.2))
        edge = plate.printer.margin_mm
        inner = (across - 2.0 * edge, down - 2.0 * edge)
        axes.add_patch(Rectangle((edge, edge), *inner, fill=False, edgecolor=INK, linewidth=0.6, linestyle=(0, (4, 3))))
        for x0, y0, x1, y1 in plate.printer.keep_out_mm:
            corner, sides = (x0, y0), (x1 - x0, y1 - y0)
            axes.add_patch(Rectangle(corner, *sides, facecolor="white", edgecolor=INK, hatch="////", linewidth=0.6))
        textures = sorted({placed.block.texture.name for placed in plate.blocks})
        for placed in plate.blocks:
            x, y = placed.block.size_mm
            colour = _COLOURS[textures.index(placed.block.texture.name) % len(_COLOURS)]
            axes.add_patch(Rectangle((placed.x_mm, placed.y_mm), x, y, facecolor=colour, edgecolor=INK, linewidth=0.8))
            middle = (placed.x_mm + x / 2.0, placed.y_mm + y / 2.0)
            *first, scale, copy = placed.block.label_words
            lines = (" ".join(first), f"{scale} {copy}")
            # The font is as large as the block allows: a letter is 0.75 of the font size wide, an inch has 72 points.
            room = x / across * wide * 72.0 / (0.75 * max(map(len, lines)))
            axes.text(*middle, "\n".join(lines), ha="center", va="center", fontsize=min(9.0, room), color=INK)
        axes.set(xlim=(-2.0, across + 2.0), ylim=(-2.0, down + 2.0), xlabel="x (mm)", ylabel="y (mm)", aspect="equal")
        axes.spines[:].set_visible(False)
        title = f"{plate.printer.name}, plate {plate.number}, {filament}: {counted(len(plate.blocks), 'block')}"
        axes.text(0.0, down + 8.0 * down / 256.0, title, ha="left", va="bottom", fontsize=11.0, color=INK)
        hatched = "; hatched: the printer's keep-out areas" if plate.printer.keep_out_mm else ""
        note = f"dashed: margin of {edge:g} mm{hatched}"
        axes.text(0.0, down + 1.5 * down / 256.0, note, ha="left", va="bottom", fontsize=8.0, color=INK)
        save_figure(figure, path)
