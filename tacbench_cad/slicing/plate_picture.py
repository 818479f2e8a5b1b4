"""The picture of a plate: the bed from above, with the label of each block where it lies."""

from __future__ import annotations

from pathlib import Path

from tacbench_cad.slicing.plates import Plate
from tacbench_cad.util.plotting import INK, new_figure, save_figure, styled

#: Light colours that people with any colour vision tell apart; beyond eight textures they come again.
_COLOURS = ("#8ec8ea", "#f3b48a", "#8fd3bd", "#e6b9d3", "#f2d27c", "#c9c9c9", "#a9b5f2", "#d9e68a")


def plate_picture(plate: Plate, filament: str, path: Path) -> None:
    """Draw a plate.

    Args:
        plate: The plate.
        filament: What it is printed of.
        path: The PNG file.

    Raises:
        MissingToolError: matplotlib is not installed.
        InputError: The file cannot be written.
    """
    with styled():
        from matplotlib.patches import Rectangle

        across, down = plate.printer.bed_mm
        figure = new_figure((7.0, 7.0 * down / across + 0.5))
        axes = figure.add_axes((0.09, 0.07, 0.88, 0.86))
        axes.add_patch(Rectangle((0.0, 0.0), across, down, facecolor="#f6f6f4", edgecolor=INK, linewidth=1.2))
        edge = plate.printer.margin_mm
        inner = (across - 2.0 * edge, down - 2.0 * edge)
        axes.add_patch(Rectangle((edge, edge), *inner, fill=False, edgecolor=INK, linewidth=0.6, linestyle=(0, (4, 3))))
        for x0, y0, x1, y1 in plate.printer.keep_out_mm:
            corner, sides = (x0, y0), (x1 - x0, y1 - y0)
            axes.add_patch(Rectangle(corner, *sides, facecolor="white", edgecolor=INK, hatch="////", linewidth=0.6))
        textures = sorted({one.block.texture.name for one in plate.blocks})
        for one in plate.blocks:
            x, y = one.block.size_mm
            colour = _COLOURS[textures.index(one.block.texture.name) % len(_COLOURS)]
            axes.add_patch(Rectangle((one.x_mm, one.y_mm), x, y, facecolor=colour, edgecolor=INK, linewidth=0.8))
            middle = (one.x_mm + x / 2.0, one.y_mm + y / 2.0)
            *first, scale, copy = one.block.label_words
            lines = (" ".join(first), f"{scale} {copy}")
            # About as large as its block allows: 0.75 of the font size a letter, 72 points an inch.
            room = x / across * 7.0 * 0.88 * 72.0 / (0.75 * max(map(len, lines)))
            axes.text(*middle, "\n".join(lines), ha="center", va="center", fontsize=min(9.0, room), color=INK)
        axes.set(xlim=(-2.0, across + 2.0), ylim=(-2.0, down + 2.0), xlabel="x (mm)", ylabel="y (mm)", aspect="equal")
        axes.set_title(
            f"{plate.printer.name}, plate {plate.number}, {filament}: {len(plate.blocks)} blocks", loc="left"
        )
        save_figure(figure, path)
