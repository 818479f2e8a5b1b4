"""The figures of a variance table that are maps: of pixels, of positions, of the region, and of mean numbers."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from tacbench_cad.lab.analysis.figures import COLUMN_IN, INK, PAGE_IN, new_figure
from tacbench_cad.lab.analysis.variance.cells import ALL_LEVELS, CELL, groups
from tacbench_cad.lab.analysis.variance.figure_parts import (
    colour_bar,
    compared,
    name_panels,
    panel_title,
    squared_unit,
)
from tacbench_cad.lab.analysis.variance.variance_data import VarianceData
from tacbench_cad.util.types import Floats

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: The percentile of the values at the end of a colour scale, so that a few extreme pixels do not darken all others.
_SPAN = 99.5


def pixel_figure(result: VarianceData) -> Figure:
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


def region_figure(result: VarianceData) -> Figure:
    """Draw the region of interest in a frame, if possible without contact."""
    region = result.feature.region_
    assert region is not None  # the figure is only drawn with a region
    figure = new_figure(COLUMN_IN, COLUMN_IN * region.mask.shape[0] / region.mask.shape[1] + 0.1)
    axes = figure.add_subplot()
    for frame in result.design.runs[0].resting_frames(1):
        axes.imshow(region.drawn(frame)[..., ::-1])
    axes.set_axis_off()
    return figure


def exhibit_figure(result: VarianceData) -> Figure:
    """Draw the mean numbers at the largest force, as the feature does, for each combination and texture."""
    exhibit = result.feature.exhibit
    assert exhibit is not None  # the figure is only drawn with an exhibit
    textures, combinations = result.design.textures, compared(result)
    level = max(at for at, _ in result.means)
    side = min(2.4, (PAGE_IN - 0.9) / len(textures))
    figure = new_figure(max(4.0, 0.9 + side * len(textures)), 0.5 + side * len(combinations))
    panels = figure.subplots(len(combinations), len(textures), squeeze=False, sharex=True, sharey=True)
    for axes in panels.flat:
        axes.set(xticks=[], yticks=[])
        axes.spines[:].set_visible(False)
    cells = zip(panels.flat, product(combinations, textures), strict=True)
    label = exhibit.draw([(axes, result.means[level, key]) for axes, key in cells if (level, key) in result.means])
    name_panels(panels, textures, combinations)
    drawn = [collection for axes in figure.axes for collection in axes.collections]
    bar = figure.colorbar(drawn[-1], ax=figure.axes, pad=0.01, shrink=0.9)
    bar.set_label(label)
    bar.outline.set_linewidth(0.5)
    figure.suptitle(panel_title(result, level), x=0.01, ha="left", fontsize=8.0)
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


def position_figure(result: VarianceData) -> Figure:
    """Draw the variance at the positions: the press grid for each combination and texture, mean over forces."""
    grid = result.design.grid
    # Positions with unknown coordinates are drawn in one row.
    shape = (len(grid.y_mm), len(grid.x_mm)) if grid else (1, len(result.design.positions_mm))
    pictures: dict[tuple[str, str], Floats] = {}
    table = result.table[result.table["force_level"] != ALL_LEVELS]
    drawn = table[table["prints"] == table.groupby(list(CELL[:3]))["prints"].transform("max")]
    rows = result.tables["positions"].merge(drawn[list(CELL)])
    for (printer, filament, texture), of_cell in groups(rows, CELL[:3]):
        if f"{printer}_{filament}" in compared(result):
            values = of_cell.groupby("position")["variance"].mean().reindex(range(1, shape[0] * shape[1] + 1))
            # The rows start at low y, so they go upwards in the figure, as on the block.
            pictures[f"{printer}_{filament}", texture] = values.to_numpy().reshape(shape)[::-1]
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


def _mosaic(
    result: VarianceData, pictures: dict[tuple[str, str], Floats], what: str, *, ratio: float, outline: bool
) -> Figure:
    """Draw pictures with one colour scale: a row for each combination, a column for each texture."""
    textures, combinations = result.design.textures, compared(result)
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
    name_panels(panels, textures, combinations)
    above = "max" if everything.size and everything.max() > high else "neither"
    colour_bar(figure, what, shrink=0.9, aspect=max(12.0, 9.0 * rows), extend=above, extendfrac=0.03)
    return figure
