"""Sheets of shaded parts: rows of pictures at one scale, each with its caption, and a scale bar."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tacbench_cad.geometry.mesh import Mesh
from tacbench_cad.render.raster import ABOVE, BELOW, Body, Camera, extent_mm, pixels_across, render
from tacbench_cad.util.plotting import INK, fill_figure, new_figure, save_figure, text_width_mm
from tacbench_cad.util.types import Bytes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: A hollow in the underside that is shallower than this is an engraving, in mm.
_ENGRAVED_MM = 1.0
#: Width of a full sheet, and the largest width of a single picture in it, in pixels.
_SHEET_PX, _PICTURE_PX = 1300, 620
#: Largest height of a sheet as a fraction of its width, and the number of pictures from which on it may be higher.
_ASPECT, _MANY = 0.72, 12
#: Size of captions. A full sheet that is shown 900 pixels wide still has letters of 12 pixels.
_DPI, _FONT_PT, _LINE_PX = 100, 12.5, 24
#: Width below which a caption is not broken, in pixels.
_CAPTION_PX = 160
#: Around the sheet, between parts, between the pictures of one part, between rows, and from a picture to its caption.
_MARGIN_PX, _GAP_PX, _SIDES_PX, _ROW_PX, _BELOW_PX = 22, 20, 14, 24, 8
#: Height of the strip with the scale bar, and the largest length of the bar as a fraction of the sheet's width.
_BAR_PX, _BAR_FRACTION = 34, 0.16
#: Colour of the second and all further lines of a caption.
_GREY = "#555555"
#: Ratio of the scales that are tried one after the other, and how much smaller the scale may become to save a row.
_STEP, _SAVES_ROW = 0.985, 0.85


@dataclass(frozen=True, eq=False)
class Item:
    """A part on a sheet, with its caption.

    Args:
        caption: Lines separated by newlines; the first one is the part's name.
        bodies: The bodies that are drawn together.
        from_below: Whether an engraved underside is shown as well.
    """

    caption: str
    bodies: Sequence[Body]
    from_below: bool = True

    @cached_property
    def cameras(self) -> tuple[Camera, ...]:
        """One camera for each picture of the part."""
        engraved = self.from_below and any(_has_engraving(body.mesh) for body in self.bodies)
        return (ABOVE, BELOW) if engraved else (ABOVE,)

    @cached_property
    def extents_mm(self) -> tuple[tuple[float, float], ...]:
        """Width and height of each of its pictures, in mm."""
        return tuple(extent_mm(self.bodies, camera) for camera in self.cameras)

    @cached_property
    def size_mm(self) -> tuple[float, ...]:
        """Bounding box x, y, z of its first body to a hundredth, in mm."""
        low, high = self.bodies[0].mesh.bounds_mm
        return tuple(np.round(high - low, 2).tolist())

    def sides_px(self, scale: float) -> tuple[int, int]:
        """Width and height of its pictures side by side, at some pixels per mm."""
        sizes = [(pixels_across(w, scale), pixels_across(h, scale)) for w, h in self.extents_mm]
        return sum(w for w, _ in sizes) + _SIDES_PX * (len(sizes) - 1), max(h for _, h in sizes)

    def lines(self, width: int) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """The caption in lines of at most about this width in pixels: the name's lines, and the others."""
        name, *others = self.caption.split("\n")
        rest = [line for text in others for line in _broken(text, width)]
        return _broken(name, width), (*rest, *(["from above, from below"] if len(self.cameras) > 1 else []))


@dataclass(frozen=True)
class _Cell:
    """An item at the scale of the sheet, in pixels.

    Args:
        item: The item.
        width: Width of pictures and caption.
        height: Height of the pictures.
        lines: The caption's lines: the name's, and the others.
    """

    item: Item
    width: int
    height: int
    lines: tuple[tuple[str, ...], tuple[str, ...]]

    @property
    def caption_px(self) -> int:
        """Height of the caption."""
        return _LINE_PX * sum(map(len, self.lines))


@dataclass(frozen=True)
class _Layout:
    """Rows of cells at one scale.

    Args:
        rows: The rows.
        scale: Pixels per mm.
        width: Width of the sheet in pixels.
    """

    rows: Sequence[Sequence[_Cell]]
    scale: float
    width: int

    @property
    def height(self) -> int:
        """Height of the sheet in pixels."""
        rows = sum(_row_px(row) + _ROW_PX for row in self.rows)
        return 2 * _MARGIN_PX - _ROW_PX + rows + (_BAR_PX if self.rows else _ROW_PX)


def draw_sheet(items: Sequence[Item], path: Path) -> None:
    """Write a sheet; call it inside of :func:`tacbench_cad.util.plotting.styled`.

    Args:
        items: The parts.
        path: The file; its name ends in ``.png``, ``.svg`` or ``.pdf``.

    Raises:
        InputError: The file's name has another ending, or the file cannot be written.
    """
    layout = _layout(items)
    image = np.full((layout.height, layout.width, 3), 255, dtype=np.uint8)
    figure = new_figure((layout.width / _DPI, layout.height / _DPI), _DPI)
    top = _MARGIN_PX
    for row in layout.rows:
        pictures_px = max(cell.height for cell in row)
        free = (layout.width - 2 * _MARGIN_PX - sum(cell.width for cell in row)) / len(row)
        left = _MARGIN_PX + free / 2.0
        for cell in row:
            _draw_cell(cell, layout.scale, image, (round(left), top + pictures_px))
            _write_caption(figure, cell, left + cell.width / 2.0, top + pictures_px + _BELOW_PX)
            left += cell.width + free
        top += _row_px(row) + _ROW_PX
    if layout.rows:
        _draw_bar(figure, layout)
    fill_figure(figure, image)
    save_figure(figure, path)


def _draw_cell(cell: _Cell, scale: float, image: Bytes, corner: tuple[int, int]) -> None:
    """Put an item's pictures onto the sheet. ``corner`` is their lower left corner, in pixels from the top left."""
    left, bottom = corner
    left += (cell.width - cell.item.sides_px(scale)[0]) // 2
    for camera, extent in zip(cell.item.cameras, cell.item.extents_mm, strict=True):
        width, height = (pixels_across(side, scale) for side in extent)
        up = bottom - (cell.height - height) // 2
        image[up - height : up, left : left + width] = render(cell.item.bodies, width, height, camera, scale)
        left += width + _SIDES_PX


def _write_caption(figure: Figure, cell: _Cell, middle: float, top: float) -> None:
    width, height = (side * _DPI for side in figure.get_size_inches())
    names, others = cell.lines
    for i, line in enumerate((*names, *others)):
        place = (middle / width, 1.0 - (top + (i + 0.5) * _LINE_PX) / height)
        colour = INK if i < len(names) else _GREY
        figure.text(*place, line, ha="center", va="center_baseline", fontsize=_FONT_PT, color=colour)


def _draw_bar(figure: Figure, layout: _Layout) -> None:
    """Draw a bar of a round length in the lower left corner. It is true for lengths across the picture."""
    from matplotlib.lines import Line2D

    most = _BAR_FRACTION * layout.width / layout.scale
    power = 10.0 ** math.floor(math.log10(most))
    length = max(part * power for part in (1.0, 2.0, 5.0) if part * power <= most)
    left, right = _MARGIN_PX, _MARGIN_PX + length * layout.scale
    y = (_MARGIN_PX + 8.0) / layout.height
    for x, low, high in (((left, right), 0.0, 0.0), ((left, left), -7.0, 7.0), ((right, right), -7.0, 7.0)):
        ends = [at / layout.width for at in x], [y + low / layout.height, y + high / layout.height]
        figure.add_artist(Line2D(*ends, color=INK, linewidth=2.0, solid_capstyle="butt"))
    place = ((right + 12.0) / layout.width, y)
    figure.text(*place, f"{length:g} mm", ha="left", va="center_baseline", fontsize=_FONT_PT, color=INK)


def _layout(items: Sequence[Item]) -> _Layout:
    """The rows at the largest scale at which the sheet is not too wide and not too high.

    A scale that is a little smaller is taken where it saves a row.
    """
    if not items:
        return _Layout((), 1.0, 2 * _MARGIN_PX)
    widest = max(sum(w for w, _ in item.extents_mm) for item in items)
    tallest = max(h for item in items for _, h in item.extents_mm)
    most = _ASPECT * _SHEET_PX * max(1.0, len(items) / _MANY)
    inner, groups = _SHEET_PX - 2 * _MARGIN_PX, _groups(items)
    # A part with two pictures may take twice the width.
    scale = min(min(_PICTURE_PX * len(item.cameras) / item.extents_mm[0][0] for item in items), inner / widest)
    best: _Layout | None = None
    while best is None or scale > _SAVES_ROW * best.scale:
        rows = [row for group in groups for row in _rows([_cell(item, scale) for item in group], inner)]
        width = max(map(_width_px, rows))
        layout = _Layout(rows, scale, width + 2 * _MARGIN_PX)
        # Where a picture is not even as high as a line of its caption, a smaller scale does not help.
        fits = width <= inner and (layout.height <= most or tallest * scale < _LINE_PX)
        if fits and (best is None or len(rows) < len(best.rows)):
            best = layout
        scale *= _STEP
    return best


def _groups(items: Sequence[Item]) -> list[list[Item]]:
    """Neighbours of equal size have rows of their own; all others share rows."""
    runs = [list(run) for _, run in itertools.groupby(items, lambda item: item.size_mm)]
    groups: list[list[Item]] = []
    alone = False
    for run in runs:
        if len(run) == 1 and alone:
            groups[-1] += run
        else:
            groups.append(run)
        alone = len(run) == 1
    return groups


def _rows(cells: Sequence[_Cell], width: int) -> list[list[_Cell]]:
    """Cells in their order in as few rows as the width allows, all rows about equally long."""
    rows = _filled(cells, width)
    while True:
        narrower = _filled(cells, max(map(_width_px, rows)) - 1)
        if len(narrower) > len(rows) or max(map(_width_px, narrower)) >= max(map(_width_px, rows)):
            return rows
        rows = narrower


def _filled(cells: Sequence[_Cell], width: int) -> list[list[_Cell]]:
    """Cells in their order, as many in each row as its width allows."""
    rows: list[list[_Cell]] = [[]]
    for cell in cells:
        if rows[-1] and _width_px([*rows[-1], cell]) > width:
            rows.append([])
        rows[-1].append(cell)
    return rows


def _width_px(row: Sequence[_Cell]) -> int:
    return sum(cell.width for cell in row) + _GAP_PX * (len(row) - 1)


def _row_px(row: Sequence[_Cell]) -> int:
    return max(cell.height for cell in row) + _BELOW_PX + max(cell.caption_px for cell in row)


def _cell(item: Item, scale: float) -> _Cell:
    width, height = item.sides_px(scale)
    lines = item.lines(max(width, _CAPTION_PX))
    caption = max((_text_px(line) for part in lines for line in part), default=0)
    return _Cell(item, max(width, caption), height, lines)


def _text_px(text: str) -> int:
    return math.ceil(text_width_mm(text, _FONT_PT) / 25.4 * _DPI)


def _broken(text: str, width: int) -> tuple[str, ...]:
    """Break a line at spaces and underscores into lines that are no wider than a number of pixels, where possible."""
    lines, line = [], ""
    for piece in text.replace("_", "_\0").replace(" ", " \0").split("\0"):
        if line and _text_px((line + piece).strip()) > width:
            lines.append(line)
            line = ""
        line += piece
    return tuple(part.strip() for part in (*lines, line) if part.strip())


def _has_engraving(mesh: Mesh) -> bool:
    """Whether the underside has a shallow hollow, such as a label."""
    normal = mesh.doubled_normals
    depth = mesh.triangle_points[:, :, 2].min(axis=1) - mesh.vertices[:, 2].min()
    downward = normal[:, 2] < -0.7 * np.linalg.norm(normal, axis=1)
    return bool((downward & (depth > 0.05) & (depth < _ENGRAVED_MM)).any())
