"""The figures of the variance table: the table itself, heat maps of pixels and positions, matrices between textures."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.figures import COLOURS, COLUMN_IN, INK, PAGE_IN, new_figure, save, styled
from tacbench_cad.lab.analysis.variance.cells import (
    Cell,
    Level,
    name_of,
    short_texture,
    shown_levels,
)
from tacbench_cad.lab.analysis.variance.components import LEVELS
from tacbench_cad.lab.analysis.variance.streaming import levels_with_most_prints
from tacbench_cad.lab.analysis.variance.table import VarianceResult
from tacbench_cad.util.text import counted
from tacbench_cad.util.types import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


#: The percentile of the values at the end of a colour scale, so that a few extreme pixels do not darken all others.
_SPAN = 99.5
#: The axis ends at this multiple of the largest estimate; longer intervals are cut and end in an arrow.
MAX_OVER_ESTIMATE = 6.0
_MARKERS = "osD^vP*X<>"


def draw_all(result: VarianceResult, folder: Path) -> list[Path]:
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
    if result.steps:
        figures["variance_motion"] = motion_figure
    if result.feature.exhibit is not None:
        figures[result.feature.exhibit.name] = exhibit_figure
    if result.protocol == "as-published":
        figures = {"variance": table_figure}
    if result.feature.region is not None:
        figures["region"] = region_figure
    simulated = result.collection.simulated
    with styled():
        return [path for stem, draw in figures.items() for path in save(draw(result), folder / stem, simulated)]


def squared_unit(result: VarianceResult) -> str:
    """Return the unit of a variance for labels."""
    return f"{result.units}$^2$"


def compared_levels(result: VarianceResult) -> tuple[Level, ...]:
    """Return the levels at which figures compare prints: those with two prints of a texture, maybe their mean."""
    singles = sorted(set().union(*result.sums.values()))
    with_prints = [
        level for level in singles if any(cell.prints > 1 for cell in result.cells if cell.force_level == level)
    ]
    if len(with_prints) in (0, len(singles)):
        return shown_levels(result.cells)
    return tuple(with_prints)


def compared(result: VarianceResult) -> list[str]:
    """Return the combinations that figures compare: those with two prints of a texture, or all if there are none.

    A single print shows how well the sensor repeats, but not how prints differ.
    """
    if result.protocol == "as-published":
        return list(dict.fromkeys(cell.combination for cell in result.cells))
    prints: dict[str, int] = {}
    for cell in result.cells:
        prints[cell.combination] = max(prints.get(cell.combination, 0), cell.prints)
    most = max(prints.values())
    return [combination for combination in result.collection.combinations if prints.get(combination, 0) > (most > 1)]


def _title(result: VarianceResult, level: Level) -> str:
    """Return the title of a panel: its level, and the number of combinations that are not shown."""
    count = len({cell.combination for cell in result.cells}) - len(compared(result))
    hidden = f" ({counted(count, 'printer-filament')} with one print not shown)" if count else ""
    return f"{result.collection.pressing.level_name(level)}{hidden}"


def table_figure(result: VarianceResult) -> Figure:
    """Draw the table as points with intervals, one panel for each force, with noise and the paper's own figures."""
    levels, combinations = compared_levels(result), compared(result)
    figure, panels = _panels(len(levels), 2, (PAGE_IN, 0.55), (0.0, 2.35), sharex=True, sharey=True)
    cells = [cell for cell in result.cells if cell.force_level in levels]
    top = MAX_OVER_ESTIMATE * max(cell.variance for cell in cells)
    top = max([top, *(1.3 * cell.published for cell in cells if cell.published is not None)])
    for axes, level in zip(panels, levels, strict=True):
        _table_panel(axes, result, level, combinations, top)
        axes.set_title(_title(result, level), loc="left")
    what = "variance" if result.protocol == "paper" else "variance of repeats\non one print"
    figure.supylabel(f"{what} ({squared_unit(result)})", fontsize=8.0)
    figure.supxlabel("texture", fontsize=8.0)
    figure.legend(handles=_table_legend(result, combinations), loc="outside upper left", ncols=3)
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


def _table_panel(axes: Axes, result: VarianceResult, level: Level, combinations: Sequence[str], top: float) -> None:
    textures = result.collection.textures
    step = 0.8 / len(combinations)
    lowest = math.inf
    for i, combination in enumerate(combinations):
        look, papers = look_of(i), []
        for j, texture in enumerate(textures):
            cell = result.cell(level, combination, texture)
            if cell is None:
                continue
            x = j + (i - (len(combinations) - 1) / 2.0) * step
            lowest = min([lowest, *(value for value in (cell.variance, cell.noise_alone) if value)])
            draw_point(axes, cell, x, step, look, top)
            if cell.published is not None:
                papers.append((x + 0.32 * step, cell.published))
        for place in papers:
            axes.plot(*place, **look, linestyle="", markersize=4.0, markerfacecolor="none")
    log_axes(axes, [short_texture(texture) for texture in textures])
    if math.isfinite(lowest):
        axes.set_ylim(0.7 * lowest, top)
    axes.grid(axis="y", color="#dddddd", linewidth=0.4)
    axes.set_axisbelow(True)


def draw_point(axes: Axes, cell: Cell, x: float, step: float, look: Mapping[str, Any], top: float) -> None:
    """Draw a cell: its variance, its interval, and the variance expected from sensor noise alone.

    An interval that leaves the panel is cut there and ends in an arrow.
    """
    if cell.low is not None and cell.high is not None:
        ends = [max(cell.low, 1e-12), min(cell.high, top)]
        axes.plot([x, x], ends, color=look["color"], linewidth=0.9, alpha=0.6, zorder=2.0)
        if cell.high > top:
            axes.plot(x, top / 1.04, "^", markersize=3.0, color=look["color"], zorder=2.0, clip_on=False)
    if cell.noise_alone:
        axes.plot([x - 0.4 * step, x + 0.4 * step], [cell.noise_alone] * 2, color=INK, linewidth=1.0, zorder=1.5)
    if cell.variance > 0.0:
        axes.plot(x, cell.variance, **look, linestyle="", markersize=4.5, zorder=3.0)


def look_of(i: int) -> dict[str, Any]:
    """Return the colour and marker of the printer-filament with index ``i``."""
    return {"color": COLOURS[i % (len(COLOURS) - 1)], "marker": _MARKERS[i % len(_MARKERS)]}


def _table_legend(result: VarianceResult, combinations: Sequence[str]) -> list[Any]:
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], **look_of(i), markersize=4.5, label=name_of(combination))
        for i, combination in enumerate(combinations)
    ]
    if any(cell.floor for cell in result.cells):
        handles.append(Line2D([], [], color=INK, linewidth=1.0, label="expected from sensor noise alone"))
    if any(cell.published is not None for cell in result.cells):
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


def pixel_figure(result: VarianceResult) -> Figure:
    """Draw the variance of the pixels: a map for each combination and texture, mean over positions and forces."""
    pictures = _cropped({key: picture for key, picture in result.maps.items() if key[0] in compared(result)})
    height, width = next(iter(pictures.values())).shape
    ratio = min(2.0, max(0.25, height / width))  # the limits fit on a page
    return _mosaic(
        result,
        pictures,
        f"variance of a {result.feature.words.one} ({squared_unit(result)})",
        ratio=ratio,
        outline=False,
    )


def region_figure(result: VarianceResult) -> Figure:
    """Draw the region of interest in a frame, if possible without contact."""
    region = result.feature.region
    assert region is not None  # the figure is only drawn with a region
    figure = new_figure(COLUMN_IN, COLUMN_IN * region.mask.shape[0] / region.mask.shape[1] + 0.1)
    axes = figure.add_subplot()
    for frame in result.collection.runs[0].resting_frames(1):
        axes.imshow(region.drawn(frame)[..., ::-1])
    axes.set_axis_off()
    return figure


def exhibit_figure(result: VarianceResult) -> Figure:
    """Draw the mean numbers at the largest force, as the feature does, for each combination and texture."""
    exhibit = result.feature.exhibit
    assert exhibit is not None  # the figure is only drawn with an exhibit
    textures, combinations = result.collection.textures, compared(result)
    level = max(at for at, _ in result.means)
    side = min(2.4, (PAGE_IN - 0.9) / len(textures))
    figure = new_figure(max(4.0, 0.9 + side * len(textures)), 0.5 + side * len(combinations))
    panels = figure.subplots(len(combinations), len(textures), squeeze=False, sharex=True, sharey=True)
    for axes in panels.flat:
        axes.set(xticks=[], yticks=[])
        axes.spines[:].set_visible(False)
    cells = zip(panels.flat, product(combinations, textures), strict=True)
    label = exhibit.draw([(axes, result.means[level, key]) for axes, key in cells if (level, key) in result.means])
    _name_panels(panels, textures, combinations)
    drawn = [collection for axes in figure.axes for collection in axes.collections]
    bar = figure.colorbar(drawn[-1], ax=figure.axes, pad=0.01, shrink=0.9)
    bar.set_label(label)
    bar.outline.set_linewidth(0.5)
    figure.suptitle(_title(result, level), x=0.01, ha="left", fontsize=8.0)
    return figure


def _cropped(pictures: dict[tuple[str, str], Floats]) -> dict[tuple[str, str], Floats]:
    """Remove the margins in which no pixel of any picture varies."""
    largest = np.fmax.reduce(list(pictures.values()))  # NaN lies outside of the region of interest
    strong = largest > 0.05 * np.nanpercentile(largest, _SPAN)
    ranges = []
    for axis in (0, 1):
        inside = np.flatnonzero(strong.any(axis=1 - axis))
        margin = max(1, len(inside) // 40)
        ends = (max(0, inside[0] - margin), inside[-1] + margin + 1) if len(inside) else (0, largest.shape[axis])
        ranges.append(slice(*ends))
    return {key: picture[ranges[0], ranges[1]] for key, picture in pictures.items()}


def position_figure(result: VarianceResult) -> Figure:
    """Draw the variance at the positions: the press grid for each combination and texture, mean over forces."""
    pressing = result.collection.pressing
    grid = pressing.grid
    # Positions with unknown coordinates are drawn in one row.
    shape = (len(grid.y_mm), len(grid.x_mm)) if grid else (1, len(pressing.positions_mm))
    pictures: dict[tuple[str, str], Floats] = {}
    drawn = levels_with_most_prints(
        {(level, key): cell.design.tolist() for key, of in result.sums.items() for level, cell in of.items()}
    )
    for key in (cell for cell in result.maps if cell[0] in compared(result)):
        levels = [result.positions[level, key] for level in drawn[key]]
        if levels:
            # The rows start at low y, so they go upwards in the figure, as on the block.
            pictures[key] = np.mean(levels, axis=0).reshape(shape)[::-1]
    figure = _mosaic(result, pictures, f"variance ({squared_unit(result)})", ratio=1.0, outline=True)
    if grid is None:
        return figure
    first = figure.axes[0]
    arrow = {"arrowstyle": "->", "linewidth": 0.6, "color": INK, "shrinkA": 0.0, "shrinkB": 0.0}
    for end, start in (((1.0, -0.06), (0.0, -0.06)), ((-0.06, 1.0), (-0.06, 0.0))):
        first.annotate("", end, start, xycoords="axes fraction", arrowprops=arrow, annotation_clip=False)
    sides = f"x {grid.x_mm[0]:g} to {grid.x_mm[-1]:g} mm, y {grid.y_mm[0]:g} to {grid.y_mm[-1]:g} mm"
    figure.suptitle(f"press grid (arrows): {sides}", x=0.01, ha="left", fontsize=8.0)
    return figure


def motion_figure(result: VarianceResult) -> Figure:
    """Draw the variance along the motion: a panel for each force and combination, a line for each texture."""
    levels = sorted({level for level, _ in result.steps})
    combinations, textures = compared(result), result.collection.textures
    label, course = _course(result.collection)
    figure = new_figure(max(COLUMN_IN, 0.7 + 2.3 * len(levels)), 0.5 + 1.6 * len(combinations))
    panels = figure.subplots(len(combinations), len(levels), squeeze=False, sharex=True, sharey=True)
    for axes, (combination, level) in zip(panels.flat, product(combinations, levels), strict=True):
        for i, texture in enumerate(textures):
            values = result.steps.get((level, (combination, texture)))
            if values is not None:
                axes.plot(course, values, color=COLOURS[i % len(COLOURS)], label=short_texture(texture))
        cells = [cell for cell in result.cells if (cell.combination, cell.force_level) == (combination, level)]
        noise = [cell.noise_alone for cell in cells if cell.noise_alone]
        if noise:
            axes.axhline(np.mean(noise), color=INK, linewidth=0.8, linestyle=(0, (4, 3)), label="noise alone")
        axes.set_title(f"{name_of(combination)}, {result.collection.pressing.level_name(level)}", loc="left")
        axes.set_ylim(bottom=0.0)
    figure.supxlabel(label, fontsize=8.0)
    figure.supylabel(f"variance ({squared_unit(result)})", fontsize=8.0)
    shown = {name: line for axes in panels.flat for line, name in zip(*axes.get_legend_handles_labels(), strict=True)}
    figure.legend(shown.values(), shown.keys(), loc="outside right upper", title="texture")
    return figure


def _course(collection: Collection) -> tuple[str, Floats]:
    """Return the label and the values of the axis along a motion: its distance, its rotation, or else its time."""
    courses = collection.courses
    of_axes = {"distance (mm)": courses.distance_mm, "rotation (degrees)": courses.rotation_deg}
    for label, values in of_axes.items():
        if values.max() > 0.0:
            return label, values.mean(axis=0)
    return "time (s)", courses.time_s.mean(axis=0)


def _mosaic(
    result: VarianceResult, pictures: dict[tuple[str, str], Floats], what: str, *, ratio: float, outline: bool
) -> Figure:
    """Draw pictures with one colour scale: a row for each combination, a column for each texture."""
    textures, combinations = result.collection.textures, compared(result)
    columns, rows = len(textures), len(combinations)
    width = min(1.05, (PAGE_IN - 1.6) / columns)
    figure = new_figure(max(4.0, 1.9 + width * columns), max(1.8, 0.3 + rows * (width * ratio + 0.05)))
    panels = figure.subplots(rows, columns, squeeze=False)
    everything = np.concatenate([picture[np.isfinite(picture)].ravel() for picture in pictures.values()])
    high = float(np.percentile(everything, _SPAN)) if everything.size else 1.0
    low = float(everything.min()) if outline and everything.size else 0.0
    for axes, (combination, texture) in zip(panels.flat, product(combinations, textures), strict=True):
        picture = pictures.get((combination, texture))
        if picture is None:
            axes.text(0.5, 0.5, "none", ha="center", va="center", transform=axes.transAxes, color="#888888")
        else:
            aspect = ratio * picture.shape[1] / picture.shape[0]  # 1 for square pixels
            axes.imshow(picture, vmin=low, vmax=max(high, low + 1e-12), aspect=aspect)
        axes.set(xticks=[], yticks=[])
        axes.spines[:].set_visible(False)
    _name_panels(panels, textures, combinations)
    above = "max" if everything.size and everything.max() > high else "neither"
    _colour_bar(figure, what, shrink=0.9, aspect=max(12.0, 9.0 * rows), extend=above, extendfrac=0.03)
    return figure


def _name_panels(panels: Any, textures: Sequence[str], combinations: Sequence[str]) -> None:
    """Name the columns of panels by texture, the rows by printer and filament."""
    for axes, texture in zip(panels[0], textures, strict=True):
        axes.set_title(f"texture {short_texture(texture)}" if short_texture(texture).isdigit() else texture)
    for axes, combination in zip(panels[:, 0], combinations, strict=True):
        name = "\n".join(name_of(combination).rsplit(" ", 1))
        axes.set_ylabel(name, rotation=0, ha="right", va="center", labelpad=6.0)


def _colour_bar(figure: Figure, label: str, **options: Any) -> None:
    """Add the colour scale of all pictures of a figure, if there are any."""
    pictures = [picture for axes in figure.axes for picture in axes.images]
    if pictures:
        bar = figure.colorbar(pictures[-1], ax=figure.axes, pad=0.01, **options)
        bar.set_label(label)
        bar.outline.set_linewidth(0.5)


def texture_figure(result: VarianceResult) -> Figure:
    """Draw the matrices between textures, one for each combination, with one colour scale; mean over the forces."""
    level, shown = compared_levels(result)[-1], compared(result)
    matrices = [matrix for matrix in result.matrices if matrix.force_level == level and matrix.combination in shown]
    side = min(2.6, (PAGE_IN - 0.8) / min(3, len(matrices)))
    figure, panels = _panels(len(matrices), 3, (0.9, 0.5), (side, side * 1.1))
    figure.set_layout_engine("constrained", h_pad=0.08)
    values = np.concatenate([matrix.variance[np.isfinite(matrix.variance)] for matrix in matrices])
    high = float(values.max()) if values.size and values.max() > 0.0 else 1.0
    names = [short_texture(texture) for texture in result.collection.textures]
    for axes, matrix in zip(panels, matrices, strict=True):
        axes.imshow(matrix.variance, vmin=0.0, vmax=high)
        axes.set_xticks(range(len(names)), names)
        axes.set_yticks(range(len(names)), names)
        axes.tick_params(length=0.0)
        axes.set_title(name_of(matrix.combination), loc="left")
        axes.spines[:].set_visible(False)
        if len(names) <= 10:
            _numbers(axes, matrix.variance, high)
    figure.supxlabel("texture", fontsize=8.0)
    figure.supylabel("texture", fontsize=8.0)
    _colour_bar(figure, f"variance over both textures ({squared_unit(result)})", shrink=0.8, aspect=25.0)
    figure.suptitle(_title(result, level), x=0.01, ha="left", fontsize=8.0)
    return figure


def _numbers(axes: Axes, values: Floats, high: float) -> None:
    for (i, j), value in np.ndenumerate(values):
        if np.isfinite(value):
            colour = "white" if value < 0.6 * high else INK
            text = f"{value:.0f}" if value >= 99.5 else f"{value:.1f}" if value >= 0.995 else f"{value:.2g}"
            axes.text(j, i, text, ha="center", va="center", fontsize=6.5, color=colour)


def component_figure(result: VarianceResult) -> Figure:
    """Draw the sources of the variance: the components of the nested design at each force, with their intervals."""
    from matplotlib.lines import Line2D

    levels = shown_levels(result.cells)
    rows = {(component["force_level"], component["component"]): component for component in result.components}
    figure = new_figure(PAGE_IN, 2.5)
    axes = figure.add_subplot()
    floor = float(np.mean([cell.floor for cell in result.cells if cell.floor is not None] or [np.nan]))
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
    log_axes(axes, [result.collection.pressing.level_name(level) for level in levels])
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
