"""Figures of one texture: its height map with cuts through it, or with the press protocol on it.

Call these functions inside of :func:`tacbench_cad.util.plotting.styled`. :mod:`tacbench_cad.render.pictures` writes the
figures to files.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from tacbench_cad.geometry.block_part import as_part
from tacbench_cad.render.bodies import fine_body
from tacbench_cad.render.raster import render
from tacbench_cad.spec.protocol import FORCES_N, PressGrid, contact_radius_mm
from tacbench_cad.util.plotting import BLUE, DPI, GREEN, INK, ORANGE, colour_bar, new_figure
from tacbench_cad.util.types import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from tacbench_cad.spec.block import Block


_FORCE_COLOURS = (GREEN, ORANGE, BLUE)


def heading(block: Block) -> str:
    """``Texture 4``, with the preset if it is not ``paper``."""
    name = f"Texture {block.texture.number}" if block.texture.number else f"Texture {block.texture.name}"
    return name if block.preset == "paper" else f"{name} ({block.preset})"


def formula(block: Block, width: int) -> str:
    """The texture's formula in lines of about equal length, none longer than ``width`` characters."""
    import textwrap

    text = block.texture.equation.replace("pi", "\u03c0").replace("^2", "\u00b2")
    lines = textwrap.wrap(text, width)
    for narrower in range(width - 1, 10, -1):
        fewer = textwrap.wrap(text, narrower)
        if len(fewer) > len(lines):
            break
        lines = fewer
    return "\n".join(lines)


def _heights(block: Block) -> tuple[Floats, Floats, Floats]:
    """Positions x (n,) and y (m,) in mm, and the formula's heights there (n, m); NaN outside of the block."""
    x, y = (np.linspace(0.0, side, int(np.clip(24 * side, 400, 1600))) for side in block.size_mm)
    z = block.datum_mm + block.surface.grid(x, y)
    if block.region is not None:
        z[block.region.distance(x[:, None], y[None, :]) > 0.0] = np.nan
    return x, y, z


def _outlines(block: Block) -> list[Floats]:
    """The closed loops of the outline of the underside, in mm; shape (n, 2) each."""
    if block.outline is not None:
        loops = block.outline.chords(1e-4 * max(block.size_mm)).loops
        return [np.concatenate([loop.array, loop.array[:1]]) for loop in loops]
    (x, y), key = block.size_mm, block.key_mm
    corner = [(x, 0.0)] if key is None else [(x - key, 0.0), (x, key)]
    return [np.array([(0.0, 0.0), *corner, (x, y), (0.0, y), (0.0, 0.0)])]


def _map(axes: Axes, block: Block, lightness: float) -> Any:
    """Draw the height map with relief shading, its outline and a scale bar.

    Args:
        axes: The axes to draw in.
        block: The block.
        lightness: 0 for full colour, up to 1 for white.

    Returns:
        The mapping of heights to colours, for a colour bar.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    x, y, z = _heights(block)
    scale = ScalarMappable(Normalize(float(np.nanmin(z)), float(np.nanmax(z))), "cividis")
    slope_x, slope_y = np.gradient(z, x, y)
    facing = (1.0 + 0.5 * slope_x - 0.5 * slope_y) / np.sqrt(1.5 * (1.0 + slope_x**2 + slope_y**2))
    colours = np.asarray(scale.to_rgba(z))
    colours[..., :3] *= (0.62 + 0.38 * np.clip(np.nan_to_num(facing, nan=0.8165), 0.0, 1.0) / 0.8165)[..., None]
    colours[..., :3] += lightness * (1.0 - colours[..., :3])
    colours[..., 3] = np.isfinite(z)
    shown = np.clip(colours, 0.0, 1.0).transpose(1, 0, 2)
    axes.imshow(shown, origin="lower", extent=(0.0, x[-1], 0.0, y[-1]), interpolation="antialiased")
    for loop in _outlines(block):
        axes.plot(*loop.T, color=INK, linewidth=1.0)
    axes.set(xlabel="x (mm)", ylabel="y (mm)", aspect="equal")
    _scale_bar(axes, block.size_mm)
    return scale


def _scale_bar(axes: Axes, size_mm: tuple[float, float]) -> None:
    """Draw a scale bar of a round length, about a quarter of the block's side, on white in its lower left corner."""
    from matplotlib.patches import Rectangle

    (x_side, y_side), step = size_mm, size_mm[0] / 40.0
    power = 10.0 ** math.floor(math.log10(x_side / 4.0))
    length = max(part * power for part in (1.0, 2.0, 5.0) if part * power <= x_side / 4.0)
    card = (max(length, 5.0 * step) + 2.0 * step, 3.6 * step)
    axes.add_patch(Rectangle((step, step), *card, facecolor="white", edgecolor="none", alpha=0.85, zorder=3.0))
    left, middle = step + (card[0] - length) / 2.0, step + card[0] / 2.0
    axes.plot([left, left + length], [1.8 * step] * 2, color=INK, linewidth=2.5, solid_capstyle="butt", zorder=4.0)
    axes.text(middle, 3.2 * step, f"{length:g} mm", ha="center", va="center", fontsize=8.0, color=INK, zorder=4.0)
    axes.set(xlim=(0.0, x_side), ylim=(0.0, y_side))


def cuts_figure(block: Block) -> Figure:
    """The height map on the left; on the right the block, and two cuts through a crest, along x and along y."""
    cut_x, cut_y = _crest(block)
    figure = new_figure((9.6, 6.3))
    title = f"{heading(block)}:  z = {formula(block, 100)}"
    figure.text(0.02, 0.975, title, ha="left", va="top", fontsize=11.0, color=INK)
    axes = figure.add_axes((0.06, 0.085, 0.40, 0.82), anchor="SW")
    scale = _map(axes, block, 0.0)
    axes.axhline(cut_y, color=ORANGE, linewidth=1.6, linestyle="--")
    axes.axvline(cut_x, color="white", linewidth=1.6, linestyle=(0, (1, 1)))
    left = colour_bar(axes, scale, "height z (mm)") + 0.128
    _portrait(figure, block, (left, 0.53, 0.985 - left, 0.40))
    x, y = (np.linspace(0.0, side, 4001) for side in block.size_mm)
    _cut_panel(figure, block, (left, 0.335, 0.985 - left, 0.155), "x", x, cut_y, ORANGE, "dashed")
    _cut_panel(figure, block, (left, 0.085, 0.985 - left, 0.155), "y", y, cut_x, BLUE, "dotted")
    return figure


def _portrait(figure: Figure, block: Block, place: tuple[float, float, float, float]) -> None:
    """Draw the shaded block at the resolution of the figure."""
    width, height = (round(part * side * DPI) for part, side in zip(place[2:], figure.get_size_inches(), strict=True))
    axes = figure.add_axes(place)
    axes.imshow(render([fine_body(as_part(block))], width, height), interpolation="none", aspect="auto")
    axes.set_axis_off()


def _cut_panel(
    figure: Figure,
    block: Block,
    place: tuple[float, float, float, float],
    axis: str,
    along: Floats,
    at: float,
    colour: str,
    drawn: str,
) -> None:
    """Draw the formula's height along an axis. Both panels of a figure have the same scale."""
    points = (along, np.full_like(along, at)) if axis == "x" else (np.full_like(along, at), along)
    heights = block.height_at(*points)
    if block.region is not None:
        heights = np.where(block.region.distance(*points) > 0.0, np.nan, heights)
    panel = figure.add_axes(place)
    panel.fill_between(along, 0.0, heights, color=colour, alpha=0.18, linewidth=0.0)
    panel.plot(along, heights, color=colour, linewidth=1.1)
    panel.axhline(block.height_mm, color=INK, linewidth=0.6, linestyle=":")
    panel.set(xlim=(0.0, max(block.size_mm)), ylim=(0.0, 1.1 * block.height_mm))
    panel.set(xlabel=f"{axis} (mm)", ylabel="z (mm)")
    other = "y" if axis == "x" else "x"
    panel.set_title(f"cut along {axis} at {other} = {at:.2f} mm ({drawn})", loc="left", pad=3.0)
    panel.spines[["top", "right"]].set_visible(False)


def _crest(block: Block) -> tuple[float, float]:
    """Place (x, y) of a highest point: of all within 0.1 % of the relief, the nearest to the block's middle."""
    x, y, z = _heights(block)
    i, j = np.nonzero(z >= np.nanmax(z) - 0.001 * block.relief_mm)
    nearest = int(np.argmin(np.hypot(x[i] - block.size_mm[0] / 2.0, y[j] - block.size_mm[1] / 2.0)))
    return float(x[i[nearest]]), float(y[j[nearest]])


def press_figure(block: Block) -> Figure:
    """The block's outline, the 25 press positions, and the contact circle of each force."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Circle

    press = PressGrid.paper(block.scale)
    press.require_on(block)
    positions, radii = press.positions_mm, [contact_radius_mm(force) for force in FORCES_N]
    margin = radii[-1] + 1.0
    low = np.minimum(positions.min(axis=0) - margin, -1.0)
    high = np.maximum(positions.max(axis=0) + margin, np.array(block.size_mm) + 1.0)
    across = 4.6
    down = across * float((high[1] - low[1]) / (high[0] - low[0]))
    inches = (across + 2.6, down + 1.0)
    figure = new_figure(inches)
    axes = figure.add_axes((0.55 / inches[0], 0.5 / inches[1], across / inches[0], down / inches[1]))
    _map(axes, block, 0.6)
    handles = []
    for radius, colour, force in zip(radii, _FORCE_COLOURS, FORCES_N, strict=True):
        axes.add_patch(Circle(positions[len(positions) // 2], radius, fill=False, edgecolor=colour, linewidth=1.8))
        handles.append(Line2D([], [], color=colour, linewidth=1.8, label=f"{force:.2f} N: {radius:.1f} mm"))
    dashes: dict[str, Any] = {"color": BLUE, "linewidth": 0.8, "linestyle": (0, (4, 3))}
    for corner in positions[[0, 4, 20, 24]]:
        axes.add_patch(Circle(corner, radii[-1], fill=False, **dashes))
    handles.append(Line2D([], [], label=f"{FORCES_N[-1]:.2f} N at the corners", **dashes))
    marks: dict[str, Any] = {"linestyle": "", "marker": "+", "markersize": 5.5, "markeredgewidth": 1.1, "color": INK}
    axes.plot(*positions.T, **marks)
    handles.append(Line2D([], [], label="press position", **marks))
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    x, y = press.x_mm, press.y_mm
    title = f"{heading(block)}: 5 x 5 positions, x {x[0]:g} to {x[-1]:g} mm, y {y[0]:g} to {y[-1]:g} mm"
    figure.text(0.02, 1.0 - 0.16 / inches[1], title, ha="left", va="top", fontsize=11.0, color=INK)
    axes.legend(
        handles=handles,
        loc="upper left",
        bbox_to_anchor=(1.02, 1.0),
        frameon=False,
        title="contact radius, flat plate",
        title_fontsize=9.0,
        alignment="left",
        borderaxespad=0.0,
    )
    return figure
