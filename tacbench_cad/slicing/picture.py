"""The picture of an as-sliced check: the printed top, its error, and cuts where the formula and the print part most."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tacbench_cad.slicing.compare import STEEP, AsSliced
from tacbench_cad.util.plotting import BLUE, INK, ORANGE, new_figure, save_figure, styled
from tacbench_cad.util.types import Floats

if TYPE_CHECKING:
    from matplotlib.figure import Figure


#: Errors beyond this many layers have the last colour.
_LAYERS_SHOWN = 2.0
#: Length of the lower cut, in mm.
_CLOSE_MM = 6.0


def as_sliced_picture(found: AsSliced, path: Path) -> None:
    """Draw the printed top, its error, and a cut along x through the highest peak, whole and close.

    Args:
        found: The comparison.
        path: The PNG file.

    Raises:
        MissingToolError: matplotlib is not installed.
        InputError: The file cannot be written.
    """
    with styled():
        save_figure(_figure(found), path)


def _figure(found: AsSliced) -> Figure:
    figure = new_figure((9.6, 9.8))
    block, sliced = found.block, found.sliced
    title = f"{block.texture.name} ({block.preset}, scale {block.scale:g}) as sliced; G-code: {sliced.dialect}"
    figure.text(0.02, 0.986, title, ha="left", va="top", fontsize=11.0, color=INK)
    figure.text(0.02, 0.961, _numbers(found), ha="left", va="top", fontsize=8.5, color=INK)
    height = np.where(found.printed_mm > 0.0, found.printed_mm, np.nan)
    _map(figure, found, (0.06, 0.475), height, "cividis", None, "printed height (mm)")
    error = 1000.0 * (found.printed_mm - found.formula_mm)
    error[~found.inside] = np.nan
    reach = 1000.0 * _LAYERS_SHOWN * sliced.layer_mm
    _map(figure, found, (0.55, 0.475), error, "RdBu_r", (-reach, reach), "printed above the formula (µm)")
    _cuts(figure, found)
    return figure


def _numbers(found: AsSliced) -> str:
    parts = [f"layers of {found.sliced.layer_mm:.3g} mm"]
    if found.rms_mm is not None and found.ideal_rms_mm is not None:
        parts.append(
            f"height error {1000 * found.rms_mm:.0f} µm rms where the slope is below {STEEP:g} "
            f"(ideal staircase {1000 * found.ideal_rms_mm:.0f})"
        )
    if found.sideways is not None:
        steep = found.sideways
        parts.append(f"steep walls {1000 * steep.rms_mm:.0f} µm rms sideways ({1000 * steep.ideal_rms_mm:.0f})")
    first = "; ".join(parts)
    second = (
        f"peaks lost: {found.peaks.missed} of {found.peaks.count} (\u25b2); "
        f"valleys filled: {found.valleys.missed} of {found.valleys.count} (\u25bc)"
    )
    return f"{first}\n{second}"


def _map(
    figure: Figure,
    found: AsSliced,
    corner: tuple[float, float],
    values: Floats,
    colours: str,
    limits: tuple[float, float] | None,
    label: str,
) -> None:
    axes = figure.add_axes((*corner, 0.37, 0.45), anchor="SW")
    x, y = found.block.size_mm
    low, high = limits or (float(np.nanmin(values[found.inside])), float(np.nanmax(values[found.inside])))
    drawn = axes.imshow(
        values.T, origin="lower", extent=(0.0, x, 0.0, y), cmap=colours, vmin=low, vmax=high, interpolation="nearest"
    )
    axes.set(xlabel="x (mm)", ylabel="y (mm)", aspect="equal")
    axes.apply_aspect()
    box = axes.get_position()
    bar_axes = figure.add_axes((box.x1 + 0.012, box.y0, 0.014, box.height))
    figure.colorbar(drawn, cax=bar_axes, extend="neither" if limits is None else "both").set_label(label)
    if limits is None:
        axes.axhline(_cut(found)[0], color=ORANGE, linewidth=1.2, linestyle="--")
        return
    marks: dict[str, Any] = {"linestyle": "", "markersize": 3.0, "markeredgewidth": 0.0, "color": INK}
    for marker, extrema in (("^", found.peaks), ("v", found.valleys)):
        if 0 < extrema.missed <= 200:  # more would hide the map
            axes.plot(*extrema.missed_mm.T, marker=marker, **marks)


def _cut(found: AsSliced) -> tuple[float, int]:
    """Where the cut lies, y in mm and column: through the highest point away from the edge, nearest to the middle."""
    inside = np.where(found.inside, found.formula_mm, -np.inf)
    columns = inside.max(axis=0)
    best = np.nonzero(columns >= columns.max() - 0.001 * found.block.relief_mm)[0]
    column = int(best[np.argmin(np.abs(best - len(columns) / 2))])
    return float(found.y_mm[column]), column


def _cuts(figure: Figure, found: AsSliced) -> None:
    """The whole cut, and below it the part where print and formula are furthest apart."""
    at, column = _cut(found)
    x, printed = found.x_mm, found.printed_mm[:, column]
    formula, ideal = found.formula_mm[:, column], found.ideal_mm[:, column]
    error = np.where(found.inside[:, column], np.abs(printed - formula), 0.0)
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
        words = f"cut along x at y = {at:.2f} mm (dashed)" if i == 0 else f"the {_CLOSE_MM:g} mm of it with most error"
        axes.set_title(words, loc="left", pad=3.0)
        axes.spines[["top", "right"]].set_visible(False)
        if i == 0:
            axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, frameon=False, borderaxespad=0.2)
