"""Every picture of parts: the sheet of a print set, a texture with its cuts, the press protocol on a block.

Needs matplotlib (extra ``plot``), which is imported when a picture is made. Pictures are PNG files, written whole or
not at all, with no date in them.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tacbench_cad.files import replacing
from tacbench_cad.mesh import Mesh
from tacbench_cad.part import COLOURS, Part
from tacbench_cad.plotting import only_style
from tacbench_cad.protocol import FORCES_N, PressGrid, contact_radius_mm
from tacbench_cad.render import BELOW, render
from tacbench_cad.sampling import Tolerance

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from tacbench_cad.block import Block
    from tacbench_cad.making.assembly import Assembly

Floats = NDArray[np.float64]
Image = NDArray[np.uint8]

#: Colours that people with any colour vision tell apart (after Okabe and Ito).
ORANGE, BLUE, GREEN, INK = "#d55e00", "#0072b2", "#009e73", "#222222"
_FORCE_COLOURS = (GREEN, ORANGE, BLUE)
_STYLE = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.linewidth": 0.7,
    "axes.edgecolor": INK,
    "axes.titlesize": 9.0,
    "xtick.direction": "out",
}
#: Dots per inch of a picture.
DPI = 150
#: A hollow in the underside that is shallower than this is an engraving, in mm.
_ENGRAVED_MM = 1.0


class _Tile(NamedTuple):
    """A place on a sheet: width and height in pixels, and the size of its caption's letters."""

    width: int
    height: int
    font: float


#: For the picture of a single part, for the catalogue, for sheets of up to 16 parts, and for longer ones.
_LARGE, _CATALOGUE = _Tile(1080, 620, 15.0), _Tile(420, 320, 12.0)
_MIDDLE, _SMALL = _Tile(420, 320, 10.0), _Tile(300, 230, 7.5)


def preview_sheet(items: Sequence[tuple[str, Mesh]], path: Path) -> None:
    """Draw a sheet of shaded parts with captions. A part with something in its underside shows that as well, smaller.

    Args:
        items: Caption (its lines separated by newlines) and mesh of each part.
        path: The PNG file.

    Raises:
        MissingToolError: matplotlib is not installed.
        InputError: The file cannot be written.
    """
    tile = _MIDDLE if _columns(len(items)) <= 4 else _SMALL
    with styled():
        _draw_sheet([(caption, partial(_both_sides, mesh)) for caption, mesh in items], path, tile)


def part_picture(part: Part, path: Path) -> None:
    """Draw one part, large, with its title and its size; where its underside is engraved, that side as well.

    Args:
        part: The part.
        path: The PNG file.

    Raises:
        MissingToolError: matplotlib is not installed, or a fixture's CAD kernel.
        InputError: The file cannot be written.
    """
    mesh = part.mesh[0] if part.block is None else _fine_mesh(part.block)
    with styled():
        _draw_sheet([(f"{part.title}\n{part.name}", partial(_both_sides, mesh))], path, _LARGE)


def assembly_picture(assembly: Assembly, path: Path, apart_mm: float = 0.0) -> None:
    """Draw holder, blocks and jig where they are used, each kind of part in its own colour.

    Args:
        assembly: What goes together.
        path: The PNG file.
        apart_mm: How far the blocks are lifted off the holder, and the jig off the blocks, in mm.

    Raises:
        MissingToolError: matplotlib or the CAD kernel is not installed.
        InputError: The file cannot be written.
    """
    meshes, colours = [], []
    for part, matrix in assembly.placed():
        mesh = part.mesh[0] if part.block is None else _fine_mesh(part.block)
        lift = np.eye(4)
        lift[2, 3] = apart_mm * ("holder", "block", "jig").index(part.kind)
        meshes.append(mesh.moved(lift @ matrix))
        colour = np.array([COLOURS[part.kind] >> shift & 0xFF for shift in (16, 8, 0)])
        colours.append(np.tile((colour / 255.0) ** 2.2, (len(mesh.triangles), 1)))
    whole = Mesh.joined(meshes)

    def draw(width: int, height: int) -> Image:
        return render(whole, width, height, materials=np.concatenate(colours))

    with styled():
        _draw_sheet([(f"{assembly.title}\n{assembly.name}", draw)], path, _LARGE)


def _draw_sheet(items: Sequence[tuple[str, Callable[[int, int], Image]]], path: Path, tile: _Tile) -> None:
    """A sheet of pictures with captions, each picture drawn at the width and height of a tile in pixels."""
    columns = _columns(len(items))
    rows = max(1, math.ceil(len(items) / columns))
    width, height, font = tile
    lines = max((caption.count("\n") + 1 for caption, _ in items), default=1)
    band, gap, dpi = round(max(18.0, 1.9 * font)) * lines + 10, 22, 100
    total = (columns * (width + gap) + gap, rows * (height + band + gap) + gap)
    sheet = np.full((total[1], total[0], 3), 255, dtype=np.uint8)
    figure = new_figure((total[0] / dpi, total[1] / dpi), dpi)
    for i, (caption, draw) in enumerate(items):
        left, top = gap + (i % columns) * (width + gap), gap + (i // columns) * (height + band + gap)
        sheet[top : top + height, left : left + width] = draw(width, height)
        x, y = (left + width / 2) / total[0], 1.0 - (top + height + 8) / total[1]
        figure.text(x, y, caption, ha="center", va="top", fontsize=font, color=INK, linespacing=1.35)
    figure.figimage(sheet, 0, 0, origin="upper")
    save_picture(figure, path, dpi)


def texture_picture(block: Block, path: Path, press: bool = False) -> None:
    """Draw a block's surface from above with cuts through it, or with the press protocol on it.

    Args:
        block: The block.
        path: The PNG file.
        press: Show the block's outline, the 25 positions and the contact circles at the paper's forces.

    Raises:
        MissingToolError: matplotlib is not installed.
        InputError: The file cannot be written, or the press grid leaves the block.
    """
    with styled():
        figure = _press_figure(block) if press else _cuts_figure(block)
        save_picture(figure, path, DPI)


def catalogue_picture(blocks: Sequence[Block], path: Path) -> None:
    """Draw several blocks in one figure, each with its name, its formula and its relief.

    Args:
        blocks: The blocks, three in a row.
        path: The PNG file.

    Raises:
        MissingToolError: matplotlib is not installed.
        InputError: The file cannot be written.
    """
    items = []
    for block in blocks:
        x, y = block.size_mm
        size = f"{x:g} x {y:g} x {block.height_mm:g} mm, relief {block.relief_mm:.2f} mm"
        draw = partial(_both_sides, _fine_mesh(block))
        items.append((f"{_title(block)}\n{_equation(block, 42)}\n{size}", draw))
    with styled():
        _draw_sheet(items, path, _CATALOGUE)


@contextlib.contextmanager
def styled() -> Iterator[None]:
    """Draw in our own style, whatever the user's settings say.

    Raises:
        MissingToolError: matplotlib is not installed.
    """
    with only_style("pictures", _STYLE):
        yield


def _columns(count: int) -> int:
    """Columns of a sheet: up to four large tiles a row, six smaller ones from 17 parts on."""
    if count > 16:
        return 6
    return 3 if count in (3, 5, 6, 9) else max(1, min(4, count))


def _both_sides(mesh: Mesh, width: int, height: int) -> Image:
    """The part from above; where its underside is engraved, that side as well, to the right."""
    corners = mesh.corners
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    depth = corners[:, :, 2].min(axis=1) - mesh.vertices[:, 2].min()
    downward = normal[:, 2] < -0.7 * np.linalg.norm(normal, axis=1)
    if not (downward & (depth > 0.05) & (depth < _ENGRAVED_MM)).any():
        return render(mesh, width, height)
    picture = np.full((height, width, 3), 255, dtype=np.uint8)
    left, right = round(0.56 * width), round(0.42 * width)
    picture[:, :left] = render(mesh, left, height)
    picture[:, width - right :] = render(mesh, right, height, BELOW)
    return picture


def _fine_mesh(block: Block) -> Mesh:
    """A mesh to look at: where the block has a tolerance, fine enough that no facet shows."""
    from tacbench_cad.block_mesh import mesh_block

    if isinstance(block.sampling, Tolerance):
        block = replace(block, sampling=Tolerance(mm=min(block.sampling.mm, 5e-5 * max(block.size_mm))))
    return mesh_block(block)[0]


def new_figure(inches: tuple[float, float], dpi: int) -> Figure:
    """A figure of its own, which no window knows of."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=inches, dpi=dpi, facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def save_picture(figure: Figure, path: Path, dpi: int = DPI) -> None:
    """Write a figure as a PNG, whole or not at all, without a date.

    Raises:
        InputError: The file cannot be written.
    """
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=dpi, format="png", metadata={"Software": None})


def _title(block: Block) -> str:
    name = f"Texture {block.texture.number}" if block.texture.number else f"Texture {block.texture.name}"
    return name if block.preset == "paper" else f"{name} ({block.preset})"


def _equation(block: Block, width: int) -> str:
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
    """Sample positions x (n,), y (m,) in mm and the formula's height there (n, m), NaN in the key's corner."""
    x, y = (np.linspace(0.0, side, int(np.clip(24 * side, 400, 1600))) for side in block.size_mm)
    z = block.datum_mm + block.surface.grid(x, y)
    if block.keep is not None:
        z[block.keep.excess(x[:, None], y[None, :]) > 0.0] = np.nan
    return x, y, z


def _outline(block: Block) -> Floats:
    """The underside's outline, closed; shape (n, 2) in mm."""
    (x, y), key = block.size_mm, block.key_mm
    corner = [(x, 0.0)] if key is None else [(x - key, 0.0), (x, key)]
    return np.array([(0.0, 0.0), *corner, (x, y), (0.0, y), (0.0, 0.0)])


def _map(axes: Axes, block: Block, lightness: float) -> Any:
    """Draw the height map with relief shading, its outline and a scale bar.

    Args:
        axes: Where to draw.
        block: The block.
        lightness: 0 for full colour, up to 1 for white.

    Returns:
        What a colour bar can be made from.
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
    axes.plot(*_outline(block).T, color=INK, linewidth=1.0)
    axes.set(xlabel="x (mm)", ylabel="y (mm)", aspect="equal")
    _scale_bar(axes, block.size_mm)
    return scale


def _scale_bar(axes: Axes, size_mm: tuple[float, float]) -> None:
    """A bar of a round length in the lower left corner of the block, about a quarter of its side, on a white card."""
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


def _cuts_figure(block: Block) -> Figure:
    """Map on the left; on the right the block itself and the cuts along x and along y through a crest."""
    cut_x, cut_y = _crest(block)
    figure = new_figure((9.6, 6.3), DPI)
    title = f"{_title(block)}:  z = {_equation(block, 100)}"
    figure.text(0.02, 0.975, title, ha="left", va="top", fontsize=11.0, color=INK)
    axes = figure.add_axes((0.06, 0.085, 0.40, 0.82), anchor="SW")
    scale = _map(axes, block, 0.0)
    axes.axhline(cut_y, color=ORANGE, linewidth=1.6, linestyle="--")
    axes.axvline(cut_x, color="white", linewidth=1.6, linestyle=(0, (1, 1)))
    axes.apply_aspect()
    box = axes.get_position()
    bar = figure.colorbar(scale, cax=figure.add_axes((box.x1 + 0.012, box.y0, 0.014, box.height)))
    bar.set_label("height z (mm)")
    left = box.x1 + 0.14
    _portrait(figure, block, (left, 0.53, 0.985 - left, 0.40))
    x, y = (np.linspace(0.0, side, 4001) for side in block.size_mm)
    _cut_panel(figure, block, (left, 0.335, 0.985 - left, 0.155), "x", x, cut_y, ORANGE, "dashed")
    _cut_panel(figure, block, (left, 0.085, 0.985 - left, 0.155), "y", y, cut_x, BLUE, "dotted")
    return figure


def _portrait(figure: Figure, block: Block, place: tuple[float, float, float, float]) -> None:
    """The block itself, rendered at the figure's own resolution."""
    width, height = (round(share * side * DPI) for share, side in zip(place[2:], figure.get_size_inches(), strict=True))
    axes = figure.add_axes(place)
    axes.imshow(render(_fine_mesh(block), width, height), interpolation="none", aspect="auto")
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
    """The formula's height along one axis; both panels of a figure share their scale, the block's longer side."""
    points = (along, np.full_like(along, at)) if axis == "x" else (np.full_like(along, at), along)
    heights = block.height_at(*points)
    if block.keep is not None:
        heights = np.where(block.keep.excess(*points) > 0.0, np.nan, heights)
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
    """Place (x, y) of the crest nearest to the block's middle, of those within 0.1 % of the relief of the highest."""
    x, y, z = _heights(block)
    i, j = np.nonzero(z >= np.nanmax(z) - 0.001 * block.relief_mm)
    nearest = int(np.argmin(np.hypot(x[i] - block.size_mm[0] / 2.0, y[j] - block.size_mm[1] / 2.0)))
    return float(x[i[nearest]]), float(y[j[nearest]])


def _press_figure(block: Block) -> Figure:
    """The block's outline, the 25 positions and where the sensor touches at each force."""
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
    figure = new_figure(inches, DPI)
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
    handles.append(Line2D([], [], label="position", **marks))
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    x, y = press.x_mm, press.y_mm
    title = f"{_title(block)}: 5 x 5 positions, x {x[0]:g} to {x[-1]:g} mm, y {y[0]:g} to {y[-1]:g} mm"
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
