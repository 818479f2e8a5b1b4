"""The sheet itself, drawn with matplotlib: true to scale on A4, as PNG, SVG or PDF."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tacbench_cad import __version__
from tacbench_cad.render.drawing.arrange import (
    LINE_MM,
    MARGIN_MM,
    PITCH_MM,
    SHEET_MM,
    STRIP_MM,
    TAIL_MM,
    Arranged,
    Framed,
    Placed,
    arrange,
)
from tacbench_cad.render.drawing.sheet import Drawing, Side, View, length
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.plotting import SUFFIXES, new_figure, only_style, save_figure
from tacbench_cad.util.types import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


#: Colours of edges and text, of dimension lines, of axes and hatching, and of cut faces.
INK, THIN, PALE, FILL = "#111111", "#333333", "#707070", "#ececec"
#: Dots per inch of a PNG.
DPI = 200
#: Sizes of letters in points: dimensions and notes, captions.
TEXT_PT, CAPTION_PT, SMALL_PT = 9.0, 10.5, 8.0
_ARROW_MM, _ARROW_HALF_MM = 2.4, 0.42
_MM_PER_PT = 25.4 / 72.0
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
        InputError: The suffix is another one, or the file cannot be written.
        MissingToolError: matplotlib is not installed.
    """
    require_drawing(path)
    with only_style("drawings", _STYLE):
        save_figure(drawn(drawing), path, path.suffix.lower().removeprefix("."))


def require_drawing(path: Path) -> None:
    """Refuse a file that cannot be a drawing, before one is made.

    Raises:
        InputError: The suffix is none of :data:`tacbench_cad.util.plotting.SUFFIXES`.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise InputError("out", str(path), f"must end in {', '.join(SUFFIXES[:-1])} or {SUFFIXES[-1]}")


def drawn(drawing: Drawing) -> Figure:
    """The sheet as a figure; call it inside of :func:`tacbench_cad.util.plotting.only_style`."""
    figure = new_figure((SHEET_MM[0] / 25.4, SHEET_MM[1] / 25.4), DPI)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    axes.set_autoscale_on(False)
    arranged = arrange(drawing, text_width_mm)
    pen = _Pen(axes)
    for framed, at in arranged.views:
        _View(pen, framed, at).draw()
    _notes(pen, drawing, arranged)
    _strip(pen, drawing, arranged)
    axes.set(xlim=(0.0, SHEET_MM[0]), ylim=(0.0, SHEET_MM[1]))
    return figure


@cache
def text_width_mm(text: str, points: float = TEXT_PT, weight: str = "normal") -> float:
    """Width of a line of text on paper, in mm."""
    from matplotlib.font_manager import FontProperties, findfont, get_font

    font = get_font(findfont(FontProperties(family="DejaVu Sans", weight=weight)))
    # Measured large, where hinting to whole pixels does not count.
    font.set_size(100.0, 72.0)
    font.set_text(text, 0.0)
    return float(font.get_width_height()[0]) / 64.0 * points / 100.0 * _MM_PER_PT


class _Pen:
    """What is drawn on the paper, in paper mm."""

    def __init__(self, axes: Axes) -> None:
        self.axes = axes

    def line(self, points: Iterable[tuple[float, float]], width: float = 0.5, **more: Any) -> None:
        """A line through points; ``width`` in points."""
        from matplotlib.lines import Line2D

        x, y = np.array(list(points), dtype=np.float64).reshape(-1, 2).T
        style = {"color": THIN, "solid_capstyle": "butt", "zorder": 3.0, **more}
        self.axes.add_line(Line2D(x, y, linewidth=width, **style))

    def shape(self, loops: Sequence[Floats], clip: Any = None, **style: Any) -> None:
        """Closed outlines as one shape with holes."""
        from matplotlib.patches import PathPatch
        from matplotlib.path import Path as Outline

        if not loops:
            return
        paths = [Outline(np.concatenate([one, one[:1]]), closed=True) for one in loops]
        patch = PathPatch(Outline.make_compound_path(*paths), joinstyle="round", **style)
        self.axes.add_patch(patch)
        if clip is not None:
            patch.set_clip_path(clip)

    def circle(self, at: tuple[float, float], radius: float, **style: Any) -> Any:
        """A circle; returned so that something can be clipped by it."""
        from matplotlib.patches import Circle

        return self.axes.add_patch(Circle(at, radius, **style))

    def text(self, at: tuple[float, float], words: str, size: float = TEXT_PT, **more: Any) -> None:
        """Words; a white ground keeps them legible where a thin line passes."""
        style = {"ha": "center", "va": "bottom", "color": INK, "zorder": 6.0, "linespacing": 1.25, **more}
        self.axes.text(*at, words, fontsize=size, **style)

    def arrow(self, tip: tuple[float, float], along: tuple[float, float], **more: Any) -> None:
        """A filled arrow head that points along a unit vector."""
        from matplotlib.patches import Polygon

        (x, y), (u, v) = tip, along
        back = (x - _ARROW_MM * u, y - _ARROW_MM * v)
        wings = [(back[0] - s * _ARROW_HALF_MM * v, back[1] + s * _ARROW_HALF_MM * u) for s in (1, -1)]
        self.axes.add_patch(Polygon([tip, *wings], closed=True, facecolor=THIN, edgecolor="none", zorder=4.0, **more))


class _View:
    """One view on the paper."""

    def __init__(self, pen: _Pen, framed: Framed, at: tuple[float, float]) -> None:
        self.pen, self.framed, self.at = pen, framed, at
        self.view: View = framed.view
        self.scale = framed.scale
        self.low = np.array(self.view.box[0])

    def paper(self, point: Any) -> Any:
        """Paper mm of points of the view."""
        return (np.asarray(point, dtype=np.float64) - self.low) * self.scale + np.array(self.at)

    def draw(self) -> None:
        """Everything of it."""
        self._outlines()
        self._cut_marks()
        for side, placed in self.framed.sides.items():
            for one in placed:
                self._dimension(side, one)
        self._callouts()
        for point, words in self.view.labels:
            ground = {"facecolor": "white", "edgecolor": "none", "pad": 1.2}
            self.pen.text(tuple(self.paper(point)), words, va="center", bbox=ground)
        if self.view.caption:
            x, y = self.at
            below = y - self.framed.room["bottom"] + 2.2
            self.pen.text((x + self.framed.size[0] / 2.0, below), self.view.caption, CAPTION_PT, weight="bold")

    def _outlines(self) -> None:
        view, pen, clip = self.view, self.pen, None
        if view.circle is not None:
            at, radius = self.paper(view.circle.centre), view.circle.radius * self.scale
            clip = pen.circle(tuple(at), radius, facecolor="none", edgecolor=THIN, linewidth=0.5, zorder=2.0)
        if view.shade is not None:
            image, (a0, a1, b0, b1) = view.shade
            (x0, y0), (x1, y1) = self.paper((a0, b0)), self.paper((a1, b1))
            pen.axes.imshow(image, extent=(x0, x1, y0, y1), aspect="auto", interpolation="antialiased", zorder=0.5)
        loops = [self.paper(one) for one in view.cut]
        pen.shape(loops, clip, facecolor=FILL, edgecolor=PALE, hatch="/////", linewidth=0.0, zorder=1.0)
        pen.shape(loops, clip, facecolor="none", edgecolor=INK, linewidth=0.9, zorder=2.2)
        for one in view.seen:
            pen.shape([self.paper(one)], clip, facecolor="none", edgecolor=INK, linewidth=0.9, zorder=2.0)
        for one in view.fine:
            width = 0.8 if self.scale >= 2.0 else 0.45
            pen.shape([self.paper(one)], clip, facecolor="none", edgecolor=INK, linewidth=width, zorder=2.0)
        for one in view.hidden:
            dashes = (0, (4.0, 2.2))
            pen.shape([self.paper(one)], clip, facecolor="none", edgecolor=THIN, ls=dashes, linewidth=0.6, zorder=1.8)
        for one in view.other:
            chain = (0, (14.0, 2.5, 1.5, 2.5, 1.5, 2.5))
            pen.shape([self.paper(one)], clip, facecolor="none", edgecolor=PALE, ls=chain, linewidth=0.6, zorder=1.6)
        for x, y in (self.paper(one) for one in view.crosses):
            pen.line([(x - 1.0, y), (x + 1.0, y)], 0.5)
            pen.line([(x, y - 1.0), (x, y + 1.0)], 0.5)
        for ends in view.axes:
            pen.line([tuple(self.paper(end)) for end in ends], 0.45, linestyle=(0, (9.0, 2.0, 1.5, 2.0)))
        for circle in view.circles:
            x, y = self.paper(circle.centre)
            r = circle.radius * self.scale
            pen.circle((x, y), r, facecolor="none", edgecolor=THIN, linewidth=0.6, zorder=3.0)
            pen.text((x - 0.72 * r - 0.6, y + 0.72 * r + 0.3), circle.letter, CAPTION_PT, weight="bold", ha="right")

    def _cut_marks(self) -> None:
        (x0, y0), (w, h) = self.at, self.framed.size
        for mark in self.view.cut_marks:
            across = mark.across
            place = float(self.paper((mark.at, mark.at))[1 if across else 0])
            low, high = (x0, x0 + w) if across else (y0, y0 + h)

            def at(along: float, aside: float, across: bool = across) -> tuple[float, float]:
                return (along, aside) if across else (aside, along)

            chain = (0, (12.0, 2.0, 1.5, 2.0))
            self.pen.line([at(low - 1.0, place), at(high + 1.0, place)], 0.45, linestyle=chain, color=PALE)
            # Seen from the front one looks towards high y; from the right, towards low x.
            sign = 1.0 if across else -1.0
            for end, out in ((low, -1.0), (high, 1.0)):
                self.pen.line([at(end + out * 0.8, place), at(end + out * 3.4, place)], 1.3, color=INK)
                foot, tip = at(end + out * 3.0, place), at(end + out * 3.0, place + sign * 3.6)
                self.pen.line([foot, tip], 0.5)
                self.pen.arrow(tip, (0.0, sign) if across else (sign, 0.0))
                x, y = at(end + out * 3.0, place - sign * 2.7)
                self.pen.text((x, y), mark.letter, CAPTION_PT, weight="bold", va="center_baseline")

    def _dimension(self, side: Side, one: Placed) -> None:
        dimension, pen = one.dimension, self.pen
        across = dimension.axis == 0
        offset = self.framed.first_mm(side) + PITCH_MM * one.level
        (x0, y0), (w, h) = self.at, self.framed.size
        line = {"left": x0 - offset, "right": x0 + w + offset, "bottom": y0 - offset, "top": y0 + h + offset}[side]
        out = -1.0 if side in ("left", "bottom") else 1.0
        shift = float((self.paper((0.0, 0.0)))[dimension.axis])

        def at(along: float, aside: float) -> tuple[float, float]:
            return (along, aside) if across else (aside, along)

        for end in (dimension.start, dimension.end):
            point = self.paper(end)
            along, aside = float(point[dimension.axis]), float(point[1 - dimension.axis])
            pen.line([at(along, aside + out * 0.8), at(along, line + out * 1.2)], 0.4, color=PALE)
        low, high = one.low + shift, one.high + shift
        middle = one.text_at + shift
        half = one.width / 2.0 + 0.5
        first, last = (low, high) if one.inside else (low - TAIL_MM, high + TAIL_MM)
        if not low <= middle <= high:
            first, last = min(first, middle - half), max(last, middle + half)
        pen.line([at(first, line), at(last, line)], 0.45)
        turn = -1.0 if one.inside else 1.0
        for tip, towards in ((low, turn), (high, -turn)):
            pen.arrow(at(tip, line), at(towards, 0.0))
        ground = {"facecolor": "white", "edgecolor": "none", "pad": 0.3}
        where = at(middle, line + (0.7 if across else -0.7))
        style: dict[str, Any] = {} if across else {"rotation": 90.0, "va": "center", "ha": "right"}
        pen.text(where, dimension.text, bbox=ground, **style)

    def _callouts(self) -> None:
        (x0, y0), (w, _) = self.at, self.framed.size
        column = x0 + w + self.framed.column_mm
        for one, height in self.framed.callout_heights():
            y = y0 + height
            shoulder = (column - 2.5, y)
            tip = self.paper(one.at)
            away = np.array(shoulder) - tip
            away /= float(np.hypot(*away))
            if one.diameter_mm is not None:
                tip = tip + away * one.diameter_mm / 2.0 * self.scale
                self.pen.arrow(tuple(tip), tuple(-away))
            else:
                self.pen.circle(tuple(tip), 0.45, facecolor=THIN, edgecolor="none", zorder=4.0)
            self.pen.line([tuple(tip), shoulder, (column - 0.8, y)], 0.45)
            self.pen.text((column, y), one.text, ha="left", va="center")


def _wrapped(text: str, width: float, points: float) -> list[str]:
    """The words in lines that are no wider."""
    lines: list[str] = []
    for word in text.split():
        if lines and text_width_mm(f"{lines[-1]} {word}", points) <= width:
            lines[-1] += f" {word}"
        else:
            lines.append(word)
    return lines


def _notes(pen: _Pen, drawing: Drawing, arranged: Arranged) -> None:
    x, y = arranged.notes_at
    for note in drawing.notes:
        lines = _wrapped(note, arranged.notes_width - 2.0, TEXT_PT - 0.3)
        pen.text((x, y), "\n".join(lines), TEXT_PT - 0.3, ha="left", va="top")
        y -= LINE_MM * len(lines) + 1.6


def _strip(pen: _Pen, drawing: Drawing, arranged: Arranged) -> None:
    """Frame and title strip."""
    x0, y0, x1 = MARGIN_MM, MARGIN_MM, SHEET_MM[0] - MARGIN_MM
    y1, top = SHEET_MM[1] - MARGIN_MM, MARGIN_MM + STRIP_MM
    pen.line([(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)], 0.9, color=INK)
    pen.line([(x0, top), (x1, top)], 0.9, color=INK)
    edges = [x0, x0 + 99.0, x0 + 193.0, x0 + 253.0, x1]
    for edge in edges[1:-1]:
        pen.line([(edge, y0), (edge, top)], 0.5)
    size = 11.0
    while text_width_mm(drawing.title, size, "bold") > 93.0 and size > 5.0:
        size -= 0.25
    pen.text((x0 + 2.5, top - 3.4), drawing.title, size, ha="left", va="top", weight="bold")
    small = SMALL_PT
    while 1.12 * text_width_mm(drawing.name, small) > 95.0 and small > 3.5:
        small -= 0.2
    pen.text((x0 + 2.5, top - 10.5), drawing.name, small, ha="left", va="top", family="DejaVu Sans Mono")
    pen.text((x0 + 2.5, y0 + 2.6), f"tacbench-cad {__version__}", SMALL_PT, ha="left", color=PALE)
    _facts(pen, drawing.facts, edges[1], top, edges[2] - edges[1])
    within = [
        "All lengths in mm, as in the file.",
        "Accepted in a print: as marked,",
        f"else ±{length(drawing.accepts_mm)} mm.",
    ]
    pen.text((edges[2] + 2.5, top - 3.2), "\n".join(within), TEXT_PT - 0.3, ha="left", va="top")
    pen.text((edges[3] + 2.5, top - 3.2), _ratio(arranged.scale), 12.0, ha="left", va="top", weight="bold")
    pen.text((edges[3] + 2.5, y0 + 2.6), "A4", SMALL_PT, ha="left", color=PALE)
    _third_angle(pen, (x1 - 11.0, y0 + 5.2))


def _facts(pen: _Pen, facts: Sequence[tuple[str, str]], left: float, top: float, width: float) -> None:
    heads = max(text_width_mm(head, SMALL_PT) for head, _ in facts) + 2.5
    for i, (head, value) in enumerate(facts[:5]):
        y = top - 4.6 - 4.3 * i
        size = SMALL_PT
        while text_width_mm(value, size) > width - heads - 4.0 and size > 4.0:
            size -= 0.2
        pen.text((left + 2.5, y), head, SMALL_PT, ha="left", va="baseline", color=PALE)
        pen.text((left + 2.5 + heads, y), value, size, ha="left", va="baseline")


def _ratio(scale: float) -> str:
    """``2:1``, ``3:2``, ``1:5``."""
    ratio = Fraction(scale).limit_denominator(1000)
    return f"{ratio.numerator}:{ratio.denominator}"


def _third_angle(pen: _Pen, at: tuple[float, float]) -> None:
    """The symbol of third-angle projection: a cone's end beside its side, the end on the side that it is seen from."""
    x, y = at
    for radius in (1.1, 2.2):
        pen.circle((x - 4.0, y), radius, facecolor="none", edgecolor=INK, linewidth=0.7, zorder=3.0)
    cone = np.array([(x, y - 1.1), (x + 5.0, y - 2.2), (x + 5.0, y + 2.2), (x, y + 1.1)])
    pen.shape([cone], facecolor="none", edgecolor=INK, linewidth=0.7, zorder=3.0)
    chain = (0, (6.0, 1.5, 1.0, 1.5))
    pen.line([(x - 7.2, y), (x + 6.2, y)], 0.35, linestyle=chain)
    pen.line([(x - 4.0, y - 3.2), (x - 4.0, y + 3.2)], 0.35, linestyle=chain)
