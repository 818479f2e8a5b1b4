"""Pictures of a scan: the deviation map with the walls, the printed waves, and the three views of one block."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np

from tacbench_cad.extensions.scan.colours import MAP, reach_mm
from tacbench_cad.extensions.scan.comparison import Views
from tacbench_cad.extensions.scan.estimates import WaveEstimate
from tacbench_cad.extensions.scan.result import ScanResult, described
from tacbench_cad.util.plotting import BLUE, GREEN, INK, ORANGE, colour_bar, new_figure, save_figure, styled
from tacbench_cad.util.types import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: The colour of the note on pictures of simulated scans.
_MARK = "#b03a00"
#: The largest number of lost crests that are marked, and of filled valleys. More marks would hide the map.
_MAX_MARKS = 200
#: The largest number of wall points in a picture.
_MAX_WALL_POINTS = 40_000
#: A wave belongs to an axis if its direction differs by at most this angle.
_NEAR_AXIS_DEG = 22.5
#: The smallest range of phases in a picture, on both sides of 0.
_MIN_PHASE_DEG = 1.0


def deviation_picture(result: ScanResult, path: Path) -> None:
    """Draw the deviation of the top and the walls, and how far it moves the sensor's pins.

    Args:
        result: The result.
        path: The file; its name ends in ``.png``, ``.svg`` or ``.pdf``.

    Raises:
        MissingToolError: matplotlib is not installed.
        InputError: The file's name has another ending, or the file cannot be written.
    """
    with styled():
        figure = new_figure((9.6, 8.2))
        reach = 1000.0 * reach_mm(result.top.deviation_mm[result.top.compared])
        _head(figure, described(result), f"{result.verdict}", result.cloud.simulated)
        top, (wide, deep) = result.top, result.block.size_mm
        tall = 0.5
        shown = np.where(top.counts > 0, 1000.0 * top.deviation_mm, np.nan)
        axes = figure.add_axes((0.06, 0.37, 0.37, tall), anchor="SW")
        drawn = _map(axes, shown, (wide, deep), MAP, (-reach, reach))
        colour_bar(axes, drawn, "print minus formula, along the normal (µm)", extend="both")
        axes.set_title("deviation of the top", loc="left")
        _scale_bar(axes, wide)
        marks: dict[str, Any] = {"linestyle": "", "markersize": 3.0, "markeredgewidth": 0.0, "color": INK}
        for marker, extrema, words in (("^", top.peaks, "crests lost"), ("v", top.valleys, "valleys filled")):
            if extrema.missed:
                every = -(-extrema.missed // _MAX_MARKS)
                label = f"{extrema.missed:,} {words}" + (f", 1 of {every} marked" if every > 1 else "")
                axes.plot(*extrema.missed_mm[::every].T, marker=marker, label=label, **marks)
        if axes.get_legend_handles_labels()[0]:
            axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.05), ncols=2, frameon=False, borderaxespad=0.0)
        axes = figure.add_axes((0.56, 0.37, 0.37, tall), anchor="SW")
        shifts = top.pin_shifts_px
        most = float(np.nanquantile(shifts, 0.99)) if np.isfinite(shifts).any() else 1.0
        drawn = _map(axes, shifts, (wide, deep), "viridis", (0.0, max(most, 1e-3)))
        colour_bar(axes, drawn, "shift of a TacTip's pin (px)", extend="max")
        axes.set_title("what the sensor feels", loc="left")
        _scale_bar(axes, wide)
        _walls(figure, result)
        save_figure(figure, path, about=_about(result))


def waves_picture(result: ScanResult, path: Path) -> None:
    """Draw the amplitude ratio and the phase of each wave against its wavelength, for waves along x, y and others.

    Args:
        result: The result. Its fit must have waves that the scan determines.
        path: The file; see :func:`deviation_picture`.

    Raises:
        MissingToolError: matplotlib is not installed.
        InputError: The file's name has another ending, or the file cannot be written.
    """
    with styled():
        figure = new_figure((7.2, 5.8))
        about = "how much of each wave was printed, with intervals of 95 %"
        _head(figure, described(result), about, result.cloud.simulated)
        ratio, phase = figure.add_axes((0.1, 0.45, 0.86, 0.44)), figure.add_axes((0.1, 0.09, 0.86, 0.26))
        for name, colour, marker, waves in _by_direction(result.fit.waves):
            style = {"color": colour, "marker": marker, "linestyle": "", "markersize": 5.0, "linewidth": 1.0}
            ratios = [(w.wavelength_mm, w.amplitude_ratio, w.ratio_low, w.ratio_high) for w in waves]
            error_bars(ratio, ratios, label=name, **style)
            # The phase of a wave that may be missing says nothing.
            printed = [wave for wave in waves if wave.ratio_low > 0.0]
            error_bars(
                phase, [(w.wavelength_mm, w.phase_deg, w.phase_low_deg, w.phase_high_deg) for w in printed], **style
            )
        ratio.axhline(1.0, color=INK, linewidth=0.6, linestyle=":")
        phase.axhline(0.0, color=INK, linewidth=0.6, linestyle=":")
        known = [wave for wave in result.fit.waves if wave.determined]
        ratio.set(
            ylabel="printed amplitude / formula", ylim=(0.0, max(1.15, *(1.1 * w.amplitude_ratio for w in known)))
        )
        most = max(_MIN_PHASE_DEG, *map(abs, phase.get_ylim()))
        phase.set(xlabel="wavelength (mm)", ylabel="phase (degrees)", ylim=(-most, most))
        lengths = [wave.wavelength_mm for wave in known]
        for axes in (ratio, phase):
            wavelength_axis(axes, min(lengths) / 1.2, 1.2 * max(lengths))
            axes.spines[["top", "right"]].set_visible(False)
        ratio.legend(loc="lower right", frameon=False)
        save_figure(figure, path, about=_about(result))


def comparison_picture(views: Views, path: Path) -> None:
    """Draw the formula and the other views with the same colours, their errors, and profiles along x and y.

    Args:
        views: The views.
        path: The file; see :func:`deviation_picture`.

    Raises:
        MissingToolError: matplotlib is not installed.
        InputError: The file's name has another ending, or the file cannot be written.
    """
    with styled():
        top, block = views.top, views.top.block
        count = 1 + len(views.printed_mm)
        figure = new_figure((10.8, 11.6))
        names = ["formula", *views.printed_mm]
        _head(figure, f"{block.name}: {', '.join(names)}", "", views.simulated)
        heights = [
            top.formula_mm,
            *(np.where(printed > 0.0, printed, np.nan) for printed in views.printed_mm.values()),
        ]
        inside = top.formula_mm[top.inside]
        low, high = float(inside.min()), float(inside.max())
        errors = [views.error_mm(name) for name in views.printed_mm]
        reach = 1000.0 * reach_mm(np.concatenate([error.ravel() for error in errors]))
        width, tall = 0.25, 0.255
        i, j = views.cut()
        for column in range(count):
            left = 0.05 + 0.305 * column
            axes = figure.add_axes((left, 0.665, width, tall), anchor="SW")
            drawn = _map(axes, heights[column], block.size_mm, "cividis", (low, high))
            axes.set_title(names[column], loc="left")
            axes.axhline(top.y_mm[j], color=ORANGE, linewidth=1.0, linestyle="--")
            axes.axvline(top.x_mm[i], color=ORANGE, linewidth=1.0, linestyle="--")
            _scale_bar(axes, block.size_mm[0], "white")
            if column == count - 1:
                colour_bar(axes, drawn, "height (mm)")
            if column:
                axes = figure.add_axes((left, 0.345, width, tall), anchor="SW")
                drawn = _map(axes, 1000.0 * errors[column - 1], block.size_mm, MAP, (-reach, reach))
                axes.set_title(f"{names[column]} minus formula", loc="left")
                _scale_bar(axes, block.size_mm[0])
                if column == count - 1:
                    colour_bar(axes, drawn, "height error (µm)", extend="both")
        _numbers(figure, views, names[1:])
        profiles = (
            ("x", top.x_mm, [a[:, j] for a in heights], 0.19),
            ("y", top.y_mm, [a[i] for a in heights], 0.045),
        )
        for axis, along, lines, bottom in profiles:
            axes = figure.add_axes((0.055, bottom, 0.92, 0.1))
            for name, line, colour in zip(names, lines, (INK, BLUE, ORANGE, GREEN), strict=False):
                axes.plot(along, line, color=colour, linewidth=1.0, label=name)
            axes.set(xlim=(0.0, float(along[-1])), ylabel="z (mm)", xlabel=f"{axis} (mm)")
            axes.set_title(f"profile along {axis} (dashed line)", loc="left", pad=3.0)
            axes.spines[["top", "right"]].set_visible(False)
            if axis == "x":
                axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=count, frameon=False, borderaxespad=0.2)
        save_figure(figure, path, about="simulated scan" if views.simulated else "")


def wavelength_axis(axes: Axes, low: float, high: float) -> None:
    """Give a plot a logarithmic axis of wavelengths, with round numbers at its ticks."""
    axes.set_xscale("log")
    axes.set_xlim(low, high)
    digits = (1, 1.5, 2, 3, 5, 7) if high > 5.0 * low else (1, 1.5, 2, 2.5, 3, 4, 5, 6, 7, 8, 9)
    shown = [tick for power in range(-2, 3) for digit in digits if low <= (tick := digit * 10.0**power) <= high]
    axes.set_xticks(shown, [f"{tick:g}" for tick in shown])
    axes.minorticks_off()


def error_bars(axes: Axes, points: Sequence[tuple[float, float, float, float]], **style: Any) -> None:
    """Draw points with their intervals: x, y, and the lower and the upper end of the interval of y."""
    if points:
        x, y, low, high = np.array(points).T
        axes.errorbar(x, y, np.maximum([y - low, high - y], 0.0), **style)


def _about(result: ScanResult) -> str:
    return f"simulated scan: {result.cloud.source}" if result.cloud.simulated else ""


def _head(figure: Figure, title: str, line: str, simulated: bool) -> None:
    tall = float(figure.get_size_inches()[1])
    figure.text(0.02, 1.0 - 0.12 / tall, title, ha="left", va="top", fontsize=11.0, color=INK)
    lines = "\n".join(wrap(line, round(13.0 * float(figure.get_size_inches()[0]))))
    figure.text(0.02, 1.0 - 0.36 / tall, lines, ha="left", va="top", fontsize=8.5, color=INK)
    if simulated:
        mark = figure.text(0.98, 1.0 - 0.12 / tall, "simulated scan", ha="right", va="top", fontsize=9.0, color=_MARK)
        mark.set_fontstyle("italic")


def _map(axes: Axes, values: Floats, size_mm: tuple[float, float], colours: str, limits: tuple[float, float]) -> Any:
    from matplotlib import colormaps

    across, down = size_mm
    colour_map = colormaps[colours].with_extremes(bad="#d9d9d9")
    drawn = axes.imshow(
        values.T,
        origin="lower",
        extent=(0.0, across, 0.0, down),
        cmap=colour_map,
        vmin=limits[0],
        vmax=limits[1],
        interpolation="nearest",
    )
    axes.set(xlabel="x (mm)", ylabel="y (mm)", aspect="equal")
    return drawn


def _scale_bar(axes: Axes, across_mm: float, colour: str = INK) -> None:
    """Draw a bar of a round length into the lower left corner of a map."""
    length = next(
        step for step in (50.0, 20.0, 10.0, 5.0, 2.0, 1.0, 0.5, 0.2, 0.1) if step <= max(0.3 * across_mm, 0.1)
    )
    start = 0.04 * across_mm
    outline = "white" if colour == INK else INK
    for line_colour, width in ((outline, 4.5), (colour, 2.5)):
        axes.plot([start, start + length], [start, start], color=line_colour, linewidth=width, solid_capstyle="butt")
    box = {"facecolor": outline, "alpha": 0.7, "edgecolor": "none", "pad": 1.0}
    middle = start + length / 2.0
    axes.text(middle, 1.6 * start, f"{length:g} mm", ha="center", va="bottom", fontsize=7.5, color=colour, bbox=box)


def _walls(figure: Figure, result: ScanResult) -> None:
    """Draw the walls side by side as if they were unfolded, coloured by their deviation."""
    axes = figure.add_axes((0.06, 0.075, 0.82, 0.2))
    points, deviation = result.walls.points_mm, result.walls.deviation_mm
    axes.set_title("deviation of the walls, unfolded", loc="left")
    axes.spines[["top", "right"]].set_visible(False)
    if len(points) == 0:
        axes.text(0.5, 0.5, "no wall was scanned", ha="center", va="center", transform=axes.transAxes, color=INK)
        axes.set_axis_off()
        return
    every = -(-len(points) // _MAX_WALL_POINTS)
    along, corners = _unfolded(points[::every], result.block.size_mm)
    reach = 1000.0 * reach_mm(deviation)
    look: dict[str, Any] = {"cmap": MAP, "vmin": -reach, "vmax": reach, "s": 2.5, "linewidths": 0.0, "rasterized": True}
    drawn = axes.scatter(along, points[::every, 2], c=1000.0 * deviation[::every], **look)
    colour_bar(axes, drawn, "outwards (µm)", extend="both")
    for corner in corners[1:-1]:
        axes.axvline(corner, color=INK, linewidth=0.5)
    if result.block.outline is None:
        wide, deep = result.block.size_mm
        names = ("y = 0", f"x = {wide:g} mm", f"y = {deep:g} mm", "x = 0")
        for name, left, right in zip(names, corners, corners[1:], strict=False):
            axes.text((left + right) / 2.0, -0.02, name, ha="center", va="top", transform=axes.get_xaxis_transform())
        axes.set_xticks([])
    axes.set(xlim=(corners[0], corners[-1]), ylabel="z (mm)", facecolor="#d9d9d9")


def _unfolded(points_mm: Floats, size_mm: tuple[float, float]) -> tuple[Floats, Sequence[float]]:
    """Return the places of wall points along the sides, counter-clockwise from the corner (0, 0), and the corners."""
    (wide, deep), x, y = size_mm, points_mm[:, 0], points_mm[:, 1]
    off = np.column_stack([np.abs(y), np.abs(wide - x), np.abs(deep - y), np.abs(x)])
    side = np.argmin(off, axis=1)
    along = np.choose(side, [x, wide + y, wide + deep + (wide - x), 2.0 * wide + deep + (deep - y)])
    return np.asarray(along), (0.0, wide, wide + deep, 2.0 * wide + deep, 2.0 * (wide + deep))


def _by_direction(waves: Sequence[WaveEstimate]) -> list[tuple[str, str, str, list[WaveEstimate]]]:
    known = [wave for wave in waves if wave.determined]
    groups: dict[str, list[WaveEstimate]] = {"along x": [], "along y": [], "in other directions": []}
    for wave in known:
        angle = abs(wave.direction_deg)
        near_x, near_y = angle <= _NEAR_AXIS_DEG, angle >= 90.0 - _NEAR_AXIS_DEG
        groups["along x" if near_x else "along y" if near_y else "in other directions"].append(wave)
    looks = zip((BLUE, ORANGE, GREEN), ("o", "s", "^"), groups.items(), strict=True)
    return [(name, colour, marker, members) for colour, marker, (name, members) in looks if members]


def _numbers(figure: Figure, views: Views, names: Sequence[str]) -> None:
    """Write the table of numbers below the formula."""
    axes = figure.add_axes((0.05, 0.36, 0.27, 0.24))
    axes.set_axis_off()
    for i, row in enumerate([("", *names), *views.rows()]):
        for k, cell in enumerate(row):
            # Numbers are aligned to the right of their columns.
            place: dict[str, Any] = {"x": 0.0, "ha": "left"} if k == 0 else {"x": 0.41 + 0.27 * k, "ha": "right"}
            weight = "bold" if i == 0 else "normal"
            axes.text(y=0.95 - 0.11 * i, s=cell, va="top", fontsize=7.5, color=INK, weight=weight, **place)
