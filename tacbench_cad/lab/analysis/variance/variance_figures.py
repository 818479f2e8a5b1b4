"""The figures of the variance table: the table itself, its components, the motion, and matrices between textures."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tacbench_cad.lab.analysis.figures import COLOURS, COLUMN_IN, INK, PAGE_IN, new_figure, save, styled
from tacbench_cad.lab.analysis.tables import records
from tacbench_cad.lab.analysis.variance.cells import CELL, Level, cells_of, groups, name_of, short_texture, shown_levels
from tacbench_cad.lab.analysis.variance.components import LEVELS
from tacbench_cad.lab.analysis.variance.figure_parts import (
    colour_bar,
    compared,
    compared_levels,
    panel_title,
    squared_unit,
)
from tacbench_cad.lab.analysis.variance.map_figures import exhibit_figure, pixel_figure, position_figure, region_figure
from tacbench_cad.lab.analysis.variance.variance_data import VarianceData
from tacbench_cad.lab.runs.press_table import TIME
from tacbench_cad.util.types import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: The axis ends at this multiple of the largest estimate; longer intervals are cut and end in an arrow.
MAX_OVER_ESTIMATE = 6.0
_MARKERS = "osD^vP*X<>"


def draw_all(result: VarianceData, folder: Path) -> list[Path]:
    """Draw every figure into a folder, each as PNG and as PDF.

    Args:
        result: The variance table.
        folder: The folder, which must exist.

    Returns:
        The paths of the files.

    Raises:
        MissingToolError: matplotlib is not installed.
        InputError: A file cannot be written.
    """
    figures = {
        "variance": table_figure,
        "variance_pixels": pixel_figure,
        "variance_positions": position_figure,
        "between_textures": texture_figure,
        "components": component_figure,
    }
    if "motion" in result.tables:
        figures["variance_motion"] = motion_figure
    if result.feature.exhibit is not None:
        figures[result.feature.exhibit.name] = exhibit_figure
    if result.protocol == "as-published":
        figures = {"variance": table_figure}
    if result.feature.region_ is not None:
        figures["region"] = region_figure
    simulated = result.design.simulated
    with styled():
        return [path for stem, draw in figures.items() for path in save(draw(result), folder / stem, simulated)]


def table_figure(result: VarianceData) -> Figure:
    """Draw the table as points with intervals, one panel for each force, with noise and the paper's own figures."""
    levels, combinations = compared_levels(result), compared(result)
    figure, panels = _panels(len(levels), 2, (PAGE_IN, 0.55), (0.0, 2.35), sharex=True, sharey=True)
    cells = result.table[result.table["force_level"].isin(levels)]
    top = np.fmax(MAX_OVER_ESTIMATE * cells["variance"].max(), 1.3 * cells["published"].max())
    for axes, level in zip(panels, levels, strict=True):
        table_panel(axes, result, level, combinations, top)
        axes.set_title(panel_title(result, level), loc="left")
    what = "variance" if result.protocol == "paper" else "variance of repeats\non one print"
    figure.supylabel(f"{what} ({squared_unit(result)})", fontsize=8.0)
    figure.supxlabel("texture", fontsize=8.0)
    figure.legend(handles=table_legend(result, combinations), loc="outside upper left", ncols=3)
    return figure


def _panels(
    count: int, max_columns: int, margins: tuple[float, float], size: tuple[float, float], **options: Any
) -> tuple[Figure, list[Axes]]:
    """Return a figure with ``count`` panels, at most ``max_columns`` in a row; sizes in inches."""
    columns = min(max_columns, count)
    rows = math.ceil(count / columns)
    figure = new_figure(margins[0] + size[0] * columns, margins[1] + size[1] * rows)
    panels = figure.subplots(rows, columns, squeeze=False, **options).ravel()
    for axes in panels[count:]:
        axes.set_visible(False)
    for axes in panels[max(0, count - columns) : count]:
        axes.tick_params(axis="x", labelbottom=True)  # the last panel of each column, in the last row or above
    return figure, panels[:count].tolist()


def table_panel(axes: Axes, result: VarianceData, level: Level, combinations: Sequence[str], top: float) -> None:
    """Draw the cells at a force level as points with intervals; the axis ends at ``top``."""
    textures, cells = result.design.textures, cells_of(result.table)
    step = 0.8 / len(combinations)
    lowest = math.inf
    for i, combination in enumerate(combinations):
        look, papers = look_of(i), []
        for j, texture in enumerate(textures):
            cell = cells.get((level, (combination, texture)))
            if cell is None:
                continue
            x = j + (i - (len(combinations) - 1) / 2.0) * step
            lowest = min([lowest, *(value for value in (cell.variance, cell.noise_alone) if value > 0.0)])
            draw_point(axes, cell, x, step, look, top)
            if not math.isnan(cell.published):
                papers.append((x + 0.32 * step, cell.published))
        for place in papers:
            axes.plot(*place, **look, linestyle="", markersize=4.0, markerfacecolor="none")
    log_axes(axes, [short_texture(texture) for texture in textures])
    if math.isfinite(lowest):
        axes.set_ylim(0.7 * lowest, top)
    axes.grid(axis="y", color="#dddddd", linewidth=0.4)
    axes.set_axisbelow(True)


def draw_point(axes: Axes, cell: Any, x: float, step: float, look: Mapping[str, Any], top: float) -> None:
    """Draw a cell: its variance, its interval, and the variance expected from sensor noise alone.

    An interval that leaves the panel is cut there and ends in an arrow.

    Args:
        axes: The panel.
        cell: A row of the variance table.
        x: The place of the point.
        step: The distance to the next point.
        look: The colour and the marker, see :func:`look_of`.
        top: The end of the panel's axis.
    """
    if not math.isnan(cell.low):
        ends = [max(cell.low, 1e-12), min(cell.high, top)]
        axes.plot([x, x], ends, color=look["color"], linewidth=0.9, alpha=0.6, zorder=2.0)
        if cell.high > top:
            axes.plot(x, top / 1.04, "^", markersize=3.0, color=look["color"], zorder=2.0, clip_on=False)
    if cell.noise_alone > 0.0:
        axes.plot([x - 0.4 * step, x + 0.4 * step], [cell.noise_alone] * 2, color=INK, linewidth=1.0, zorder=1.5)
    if cell.variance > 0.0:
        axes.plot(x, cell.variance, **look, linestyle="", markersize=4.5, zorder=3.0)


def look_of(i: int) -> dict[str, Any]:
    """Return the colour and marker of the printer-filament with index ``i``."""
    return {"color": COLOURS[i % (len(COLOURS) - 1)], "marker": _MARKERS[i % len(_MARKERS)]}


def table_legend(result: VarianceData, combinations: Sequence[str]) -> list[Any]:
    """Return the handles of a legend of :func:`table_panel`."""
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], **look_of(i), markersize=4.5, label=name_of(combination))
        for i, combination in enumerate(combinations)
    ]
    if (result.table["floor"] > 0.0).any():
        handles.append(Line2D([], [], color=INK, linewidth=1.0, label="expected from sensor noise alone"))
    if result.table["published"].notna().any():
        hollow: dict[str, Any] = {"linestyle": "", "marker": "o", "markersize": 4.0, "markerfacecolor": "none"}
        handles.append(Line2D([], [], color=INK, label="hollow: the paper's table", **hollow))
    return handles


def log_axes(axes: Axes, names: Sequence[str]) -> None:
    """Set up a logarithmic axis with plain numbers, and named groups side by side with lines between them."""
    axes.set_yscale("log")
    axes.set_xticks(range(len(names)), names)
    axes.set_xlim(-0.5, len(names) - 0.5)
    for i in range(1, len(names)):
        axes.axvline(i - 0.5, color="#dddddd", linewidth=0.4)
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.yaxis.set_minor_formatter(_plain_minor)


def _plain_minor(value: float, _: float) -> str:
    """Return labels for 2 and 5 between powers of ten, and no other labels."""
    lead = value / 10.0 ** math.floor(math.log10(value))
    return f"{value:g}" if round(lead) in (2, 5) else ""


def motion_figure(result: VarianceData) -> Figure:
    """Draw the variance along the motion: a panel for each force and combination, a line for each texture."""
    motion, combinations, textures = result.tables["motion"], compared(result), result.design.textures
    levels = sorted(motion["force_level"].unique())
    # The axis along the motion is its distance, or else its time.
    label, name = ("distance (mm)", "distance_mm") if motion["distance_mm"].max() > 0.0 else ("time (s)", TIME)
    course = motion.groupby("frame")[name].mean()
    figure = new_figure(max(COLUMN_IN, 0.7 + 2.3 * len(levels)), 0.5 + 1.6 * len(combinations))
    panels = figure.subplots(len(combinations), len(levels), squeeze=False, sharex=True, sharey=True)
    for axes, (combination, level) in zip(panels.flat, product(combinations, levels), strict=True):
        of_panel, cells = (
            table[(table["printer"] + "_" + table["filament"] == combination) & (table["force_level"] == level)]
            for table in (motion, result.table)
        )
        for i, texture in enumerate(textures):
            values = of_panel.loc[of_panel["texture"] == texture, "variance"]
            if len(values):
                axes.plot(course, values, color=COLOURS[i % len(COLOURS)], label=short_texture(texture))
        noise = cells["noise_alone"].mean()
        if noise > 0.0:
            axes.axhline(noise, color=INK, linewidth=0.8, linestyle=(0, (4, 3)), label="noise alone")
        axes.set_title(f"{name_of(combination)}, {result.design.level_name(level)}", loc="left")
        axes.set_ylim(bottom=0.0)
    figure.supxlabel(label, fontsize=8.0)
    figure.supylabel(f"variance ({squared_unit(result)})", fontsize=8.0)
    shown = {name: line for axes in panels.flat for line, name in zip(*axes.get_legend_handles_labels(), strict=True)}
    figure.legend(shown.values(), shown.keys(), loc="outside right upper", title="texture")
    return figure


def texture_figure(result: VarianceData) -> Figure:
    """Draw the matrices between textures, one for each combination, with one colour scale; mean over the forces."""
    level, shown = compared_levels(result)[-1], compared(result)
    rows, textures = result.tables["between_textures"], list(result.design.textures)
    matrices: dict[str, Floats] = {}
    for (printer, filament), of_level in groups(rows[rows["force_level"] == level], CELL[:2]):
        half = of_level.pivot(index="texture", columns="other_texture", values="variance")
        whole = half.combine_first(half.T).reindex(index=textures, columns=textures)
        matrices[f"{printer}_{filament}"] = whole.to_numpy(np.float64)
    matrices = {name: matrix for name, matrix in matrices.items() if name in shown}
    side = min(2.6, (PAGE_IN - 0.8) / min(3, len(matrices)))
    figure, panels = _panels(len(matrices), 3, (0.9, 0.5), (side, side * 1.1))
    figure.set_layout_engine("constrained", h_pad=0.08)
    high = max((float(np.nanmax(matrix, initial=0.0)) for matrix in matrices.values()), default=0.0) or 1.0
    names = list(map(short_texture, textures))
    for axes, (combination, matrix) in zip(panels, matrices.items(), strict=True):
        axes.imshow(matrix, vmin=0.0, vmax=high)
        axes.set_xticks(range(len(names)), names)
        axes.set_yticks(range(len(names)), names)
        axes.tick_params(length=0.0)
        axes.set_title(name_of(combination), loc="left")
        axes.spines[:].set_visible(False)
        if len(names) <= 10:
            _numbers(axes, matrix, high)
    figure.supxlabel("texture", fontsize=8.0)
    figure.supylabel("texture", fontsize=8.0)
    colour_bar(figure, f"variance over both textures ({squared_unit(result)})", shrink=0.8, aspect=25.0)
    figure.suptitle(panel_title(result, level), x=0.01, ha="left", fontsize=8.0)
    return figure


def _numbers(axes: Axes, values: Floats, high: float) -> None:
    for (i, j), value in np.ndenumerate(values):
        if np.isfinite(value):
            colour = "white" if value < 0.6 * high else INK
            text = f"{value:.0f}" if value >= 99.5 else f"{value:.1f}" if value >= 0.995 else f"{value:.2g}"
            axes.text(j, i, text, ha="center", va="center", fontsize=6.5, color=colour)


def component_figure(result: VarianceData) -> Figure:
    """Draw the sources of the variance: the components of the nested design at each force, with their intervals."""
    from matplotlib.lines import Line2D

    levels = shown_levels(result.table)
    rows = {(row["force_level"], row["component"]): row for row in records(result.tables["components"])}
    figure = new_figure(PAGE_IN, 2.5)
    axes = figure.add_subplot()
    floor = float(result.table["floor"].mean())
    shown = [row["truncated"] for key, row in rows.items() if key[1] in LEVELS and row["truncated"]]
    if not shown:
        axes.text(0.5, 0.5, "this design cannot separate any components", ha="center", transform=axes.transAxes)
        axes.set_axis_off()
        return figure
    if floor > 0.0:
        shown.append(floor)
        axes.axhline(floor, color=INK, linewidth=0.8, linestyle=(0, (4, 3)), label="mean noise floor", zorder=1.0)
    bottom, top = 0.4 * min(shown), 3.0 * max(shown)
    for j, name in enumerate(LEVELS):
        for i, level in enumerate(levels):
            _component(axes, rows[level, name], i + 0.2 * (j - 1.5), j, (bottom, top))
    handles = [
        Line2D([], [], linestyle="", marker=_MARKERS[j], markersize=5.0, color=COLOURS[j], label=name)
        for j, name in enumerate(("texture", "printer-filament", "print", "repeat"))
    ]
    log_axes(axes, [result.design.level_name(level) for level in levels])
    axes.set_ylim(bottom, top)
    axes.tick_params(axis="x", length=0.0)
    axes.set_ylabel(f"variance component ({squared_unit(result)})")
    figure.legend(handles=[*handles, *axes.get_legend_handles_labels()[0]], loc="outside upper left", ncols=5)
    return figure


def _component(axes: Axes, row: Mapping[str, Any], x: float, number: int, ends: tuple[float, float]) -> None:
    """Draw one component: its estimate and its interval, or a text if there is no point."""
    value = row["truncated"]
    if not value:
        text = "not separable" if value is None else "0"
        axes.text(x, 1.15 * ends[0], text, ha="center", va="bottom", fontsize=6.5, rotation=90 if value is None else 0)
        return
    above = value
    if row["low"] is not None:
        interval = [max(row["low"], ends[0]), min(row["high"], ends[1])]
        axes.plot([x, x], interval, color=COLOURS[number], linewidth=1.0, alpha=0.6)
        above = max(value, interval[1])
    axes.plot(x, value, _MARKERS[number], markersize=5.0, color=COLOURS[number])
    card = {"facecolor": "white", "edgecolor": "none", "pad": 0.6, "alpha": 0.85}
    place: dict[str, Any] = {"textcoords": "offset points", "ha": "center", "va": "bottom", "bbox": card}
    axes.annotate(f"{value:.3g}", (x, above), (0.0, 4.5), fontsize=6.5, **place)
