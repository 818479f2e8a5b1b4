"""Drawing the sheet with matplotlib: A4, true to scale, as PNG, SVG or PDF."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tacbench_cad import __version__
from tacbench_cad.extensions.drawings.arrange import (
    LINE_MM,
    MARGIN_MM,
    SHEET_MM,
    STRIP_MM,
    TEXT_PT,
    DrawingFrame,
    DrawingSheet,
    Placed,
    arrange,
)
from tacbench_cad.extensions.drawings.sheet import ACCEPTED_MM, Drawing, Outlines, Point, Side, length
from tacbench_cad.util.plotting import new_figure, only_style, save_figure, text_width_mm

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Colours of edges and text, of dimension lines, of axes and hatching, and of cut faces.
INK, THIN, PALE, FILL = "#111111", "#333333", "#707070", "#ececec"
#: Dots per inch of a PNG.
DPI = 200
#: Sizes of letters in points: captions, notes, the title strip.
_CAPTION_PT, _NOTES_PT, _SMALL_PT = 10.5, 8.7, 8.0
_ARROW_MM, _ARROW_HALF_MM = 2.4, 0.42
#: Distance from the lowest dimension line of a view to the base of its caption, in mm.
_CAPTION_MM = 4.8
#: Mean width of a character of the notes in mm, and the largest number of characters in a line of a title.
_CHARACTER_MM, _TITLE_WIDTH = 1.55, 42
_CHAIN = (0, (12.0, 2.0, 1.5, 2.0))
_WHITE = {"facecolor": "white", "edgecolor": "none"}
#: Style of each kind of outline: colour, width in points, dashes and order.
_LINES: dict[str, tuple[str, float, Any, float]] = {
    "cut": (INK, 0.9, "solid", 2.2),
    "seen": (INK, 0.9, "solid", 2.0),
    "fine": (INK, 0.6, "solid", 2.0),
    "hidden": (THIN, 0.6, (0, (4.0, 2.2)), 1.8),
    "other": (PALE, 0.6, (0, (14.0, 2.5, 1.5, 2.5, 1.5, 2.5)), 1.6),
    "axis": (THIN, 0.45, _CHAIN, 3.0),
}
#: The letter of a detail.
_DETAIL = "C"
_STYLE = {
    "font.family": "DejaVu Sans",
    "font.size": TEXT_PT,
    "hatch.linewidth": 0.35,
    "pdf.fonttype": 42,
    "svg.hashsalt": "tacbench-cad",
}


def save_drawing(drawing: Drawing, path: Path) -> None:
    """Write a drawing on A4, true to its scale: print it at 100 %.

    Args:
        drawing: The drawing.
        path: The file: ``.png``, ``.svg`` or ``.pdf``. It is written whole or not at all, without a date.

    Raises:
        InputError: The file's name has another ending, or the file cannot be written.
        MissingToolError: matplotlib is not installed.
    """
    with only_style("drawings", _STYLE):
        save_figure(drawn(drawing), path)


def drawn(drawing: Drawing) -> Figure:
    """Draw the sheet as a figure. Call it inside of :func:`tacbench_cad.util.plotting.only_style`."""
    figure = new_figure((SHEET_MM[0] / 25.4, SHEET_MM[1] / 25.4), DPI)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    axes.set_autoscale_on(False)
    pen, sheet = _Pen(axes), arrange(drawing)
    detail = drawing.side.within
    captions = ("", "A–A", "B–B" if detail is None else f"{_DETAIL} ({length(detail.scale)}:1)")
    for frame, caption in zip(sheet.frames, captions, strict=True):
        _View(pen, frame).draw(caption)
    _notes(pen, drawing, sheet)
    _strip(pen, drawing, sheet.frames[0].scale)
    axes.set(xlim=(0.0, SHEET_MM[0]), ylim=(0.0, SHEET_MM[1]))
    return figure


class _Pen:
    """Draws lines, shapes and text on the paper, in mm of the paper.

    Args:
        axes: The paper.
        axis: 1 if points are given with y before x, so that the same code draws across and up.
    """

    def __init__(self, axes: Axes, axis: int = 0) -> None:
        self.axes, self.order = axes, (1, -1)[axis]

    def line(self, points: Iterable[Point], width: float = 0.45, **style: Any) -> None:
        """Draw a line through some points; ``width`` in points."""
        x, y = tuple(zip(*points, strict=True))[:: self.order]
        self.axes.plot(x, y, linewidth=width, **{"color": THIN, "solid_capstyle": "butt", "zorder": 3.0, **style})

    def shape(self, loops: Outlines, clip: Any = None, **style: Any) -> Any:
        """Outlines as a single shape with holes. An outline of two points stays open."""
        from matplotlib.patches import PathPatch
        from matplotlib.path import Path as Outline

        if not loops:
            return None
        paths = [Outline(np.concatenate([a, a[:1]]), closed=True) if len(a) > 2 else Outline(a) for a in loops]
        style = {"facecolor": "none", "edgecolor": INK, "joinstyle": "round", **style}
        patch = self.axes.add_patch(PathPatch(Outline.make_compound_path(*paths), **style))
        if clip is not None:
            patch.set_clip_path(clip)
        return patch

    def circle(self, centre: Point, radius: float, **style: Any) -> Any:
        """A circle as a shape, by which other shapes can be clipped."""
        turn = np.linspace(0.0, 2.0 * np.pi, 180, endpoint=False)
        return self.shape([centre + radius * np.column_stack([np.cos(turn), np.sin(turn)])], **style)

    def text(self, at: Point, words: str, size: float = TEXT_PT, **style: Any) -> None:
        style = {"ha": "center", "va": "bottom", "color": INK, "zorder": 6.0, "linespacing": 1.25, **style}
        x, y = at[:: self.order]
        self.axes.text(x, y, words, fontsize=size, **style)

    def arrow(self, tip: Point, along: Point) -> None:
        """Draw a filled arrow head that points along a unit vector."""
        (u, v), back = along, np.subtract(tip, np.multiply(_ARROW_MM, along))
        wings = [back + side * _ARROW_HALF_MM * np.array([-v, u]) for side in (1.0, -1.0)]
        self.shape([np.array([tip, *wings])[:, :: self.order]], facecolor=THIN, edgecolor="none", zorder=4.0)


class _View:
    """Draws a view on the paper."""

    def __init__(self, pen: _Pen, frame: DrawingFrame) -> None:
        self.pen, self.frame, self.at, self.view, self.paper = pen, frame, frame.at, frame.view, frame.paper

    def draw(self, caption: str) -> None:
        """Draw the view with its lines, texts and caption."""
        self._outlines()
        for axis, (letter, place) in enumerate(zip("AB", self.view.cuts, strict=True)):
            if place is not None:
                self._cut(letter, float(self.paper((place, place))[1 - axis]), axis)
        for side, stack in self.frame.sides.items():
            for line in stack:
                self._dimension(side, line)
        self._callouts()
        for point, words in self.view.labels:
            self.pen.text(tuple(self.paper(point)), words, va="center", bbox={**_WHITE, "pad": 1.2})
        below = (self.at[0] + self.frame.width / 2.0, self.at[1] - self.frame.room["bottom"] - _CAPTION_MM)
        self.pen.text(below, caption, _CAPTION_PT, weight="bold")

    def _outlines(self) -> None:
        view, pen, scale, clip = self.view, self.pen, self.frame.scale, None
        if view.within is not None:
            at = tuple(self.paper(view.within.centre))
            clip = pen.circle(at, view.within.radius * scale, edgecolor=THIN, linewidth=0.5, zorder=2.0)
        if view.shade is not None:
            image, (a0, a1, b0, b1) = view.shade
            (x0, y0), (x1, y1) = self.paper([(a0, b0), (a1, b1)])
            pen.axes.imshow(image, extent=(x0, x1, y0, y1), aspect="auto", interpolation="antialiased", zorder=0.5)
        # A cut face is one shape with holes. Other outlines are drawn separately, because some lie inside of others.
        faces = [self.paper(loop) for loop in view.outlines.get("cut", ())]
        pen.shape(faces, clip, facecolor=FILL, edgecolor=PALE, hatch="/////", linewidth=0.0, zorder=1.0)
        for name, (colour, width, dashes, order) in _LINES.items():
            for loop in view.outlines.get(name, ()):
                loops = [self.paper(loop)]
                pen.shape(loops, clip, edgecolor=colour, linewidth=width, linestyle=dashes, zorder=order)
        crosses = [tuple(self.paper(cross)[0]) for cross in view.outlines.get("cross", ())]
        if crosses:
            pen.line(crosses, 0.0, linestyle="none", marker="+", markersize=2.0 * 72.0 / 25.4, markeredgewidth=0.5)
        if view.circle is not None:
            (x, y), r = self.paper(view.circle.centre), view.circle.radius * scale
            pen.circle((x, y), r, edgecolor=THIN, linewidth=0.6, zorder=3.0)
            pen.text((x - 0.72 * r - 0.6, y + 0.72 * r + 0.3), _DETAIL, _CAPTION_PT, weight="bold", ha="right")

    def _cut(self, letter: str, line: float, axis: int) -> None:
        """Draw the line of a section with an arrow and a letter at each end."""
        pen, low = _Pen(self.pen.axes, axis), self.at[axis]
        high = low + (self.frame.width, self.frame.height)[axis]
        # The front view looks towards high y, the view from the right towards low x.
        view = (1.0, -1.0)[axis]
        pen.line([(low - 1.0, line), (high + 1.0, line)], linestyle=_CHAIN, color=PALE)
        for end, out in ((low, -1.0), (high, 1.0)):
            foot, tip = (end + out * 3.0, line), (end + out * 3.0, line + view * 3.6)
            pen.line([(end + out * 0.8, line), (end + out * 3.4, line)], 1.3, color=INK)
            pen.line([foot, tip], 0.5)
            pen.arrow(tip, (0.0, view))
            pen.text((foot[0], line - view * 2.7), letter, _CAPTION_PT, weight="bold", va="center_baseline")

    def _dimension(self, side: Side, place: Placed) -> None:
        dimension, axis = place.dimension, place.dimension.axis
        pen, out = _Pen(self.pen.axes, axis), -1.0 if side in ("left", "bottom") else 1.0
        edge = self.at[1 - axis] + (0.0 if out < 0.0 else (self.frame.height, self.frame.width)[axis])
        line, low = edge + out * self.frame.offset_mm(side, place.level), self.at[axis]
        for along, aside in self.paper([dimension.start, dimension.end])[:, :: pen.order]:
            pen.line([(along, aside + out * 0.8), (along, line + out * 1.2)], 0.4, color=PALE, zorder=1.5)
        pen.line([(low + end, line) for end in place.line])
        turn = -1.0 if place.inside else 1.0
        for tip, towards in ((place.low, turn), (place.high, -turn)):
            pen.arrow((low + tip, line), (towards, 0.0))
        style: dict[str, Any] = {"rotation": 90.0, "va": "center", "ha": "right"} if axis else {}
        middle = (low + place.text_at, line + (0.7, -0.7)[axis])
        pen.text(middle, dimension.text, bbox={**_WHITE, "pad": 0.3}, **style)

    def _callouts(self) -> None:
        column = self.at[0] + self.frame.width + self.frame.column_mm
        for callout, height in self.frame.callouts():
            tip, y = self.paper(callout.at), self.at[1] + height
            # The line is level for as long as possible, and oblique only near the place.
            bend = np.array([min(tip[0] + 6.0, column - 2.0), y])
            if callout.diameter_mm is None:
                self.pen.circle(tuple(tip), 0.45, facecolor=THIN, edgecolor="none", zorder=4.0)
            else:
                away = (bend - tip) / np.hypot(*(bend - tip))
                tip = tip + away * callout.diameter_mm / 2.0 * self.frame.scale
                self.pen.arrow(tuple(tip), tuple(-away))
            self.pen.line([tuple(tip), tuple(bend), (column - 0.8, y)])
            self.pen.text((column, y), callout.text, ha="left", va="center")


def _notes(pen: _Pen, drawing: Drawing, sheet: DrawingSheet) -> None:
    x, y = sheet.notes_at
    for note in drawing.notes:
        lines = textwrap.wrap(note, int(sheet.notes_width / _CHARACTER_MM))
        pen.text((x, y), "\n".join(lines), _NOTES_PT, ha="left", va="top")
        y -= LINE_MM * len(lines) + 1.6


def _strip(pen: _Pen, drawing: Drawing, scale: float) -> None:
    """Draw the border of the sheet and its title strip."""
    x0, y0, x1, y1 = MARGIN_MM, MARGIN_MM, SHEET_MM[0] - MARGIN_MM, SHEET_MM[1] - MARGIN_MM
    top = y0 + STRIP_MM
    pen.line([(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)], 0.9, color=INK)
    pen.line([(x0, top), (x1, top)], 0.9, color=INK)
    edges = [x0 + 99.0, x0 + 193.0, x0 + 253.0]
    for edge in edges:
        pen.line([(edge, y0), (edge, top)], 0.5)
    ratio = Fraction(scale).limit_denominator(1000)
    accepted = f"All lengths in mm, as in the file.\nAccepted in a print: as marked,\nelse ±{length(ACCEPTED_MM)} mm."
    shrunk = min(1.0, 1.8 * _TITLE_WIDTH / len(drawing.title))  # to two lines
    small, name = {"color": PALE, "va": "baseline"}, drawing.name
    rows: list[tuple[float, float, str, float, dict[str, Any]]] = [
        (x0, 3.4, textwrap.fill(drawing.title, int(_TITLE_WIDTH / shrunk)), shrunk * _CAPTION_PT, {"weight": "bold"}),
        (x0, 14.5, name, _fitting(name, _SMALL_PT, 84.0), {"family": "DejaVu Sans Mono"}),
        (x0, 21.4, f"tacbench-cad {__version__}", _SMALL_PT, small),
        (edges[1], 3.2, accepted, _NOTES_PT, {}),
        (edges[2], 3.2, f"{ratio.numerator}:{ratio.denominator}", 12.0, {"weight": "bold"}),
        (edges[2], 21.4, "A4", _SMALL_PT, small),
    ]
    heads = max(text_width_mm(head, _SMALL_PT) for head in drawing.facts) + 2.5
    for i, head in enumerate(drawing.facts):
        down, value = 4.6 + LINE_MM * i, drawing.rows[head]
        size = _fitting(value, _SMALL_PT, edges[1] - edges[0] - heads - 4.0)
        rows += [(edges[0], down, head, _SMALL_PT, small), (edges[0] + heads, down, value, size, {"va": "baseline"})]
    for x, down, words, size, style in rows:
        pen.text((x + 2.5, top - down), words, size, **{"ha": "left", "va": "top", **style})
    _third_angle(pen, (x1 - 11.0, y0 + 5.2))


def _fitting(text: str, points: float, width_mm: float) -> float:
    """The size of letters, at most ``points``, at which a line of text is no wider than its place."""
    return points * min(1.0, width_mm / text_width_mm(text, points))


def _third_angle(pen: _Pen, at: Point) -> None:
    """Draw the symbol of third-angle projection: the end of a cone to the left of its side view."""
    x, y = at
    for radius in (1.1, 2.2):
        pen.circle((x - 4.0, y), radius, linewidth=0.7)
    pen.shape([np.array([(x, y - 1.1), (x + 5.0, y - 2.2), (x + 5.0, y + 2.2), (x, y + 1.1)])], linewidth=0.7)
    for ends in ([(x - 7.2, y), (x + 6.2, y)], [(x - 4.0, y - 3.2), (x - 4.0, y + 3.2)]):
        pen.line(ends, 0.35, linestyle=(0, (6.0, 1.5, 1.0, 1.5)))
