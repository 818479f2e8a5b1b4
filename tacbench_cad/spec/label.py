"""The label engraved in the underside of a block. Its outlines are the same in the mesh and in the solid."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeVar

import numpy as np
import shapely

from tacbench_cad.spec.glyphs import GLYPHS, UNITS_HIGH
from tacbench_cad.spec.outlines import LoopRegion, Outline, area_mm2
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats

#: The depth of the engraving, in mm.
LABEL_DEPTH_MM = 0.4
#: The width of a stroke, in mm.
STROKE_MM = 0.8
#: The smallest height of a glyph, in mm.
MIN_GLYPH_MM = 3.0
#: The largest height of a glyph, in mm.
MAX_GLYPH_MM = 5.0
#: The distance between the strokes and the outline of the block, in mm. It equals the thinnest wall of the fixtures.
MARGIN_MM = 1.6
#: The step between the heights that are tried, in mm.
_STEP_MM = 0.05
#: The number of places along each side that are tried if the middle of an outline has no room.
_PLACES = 9
#: The gaps between glyphs, words and lines, as fractions of the glyph's height.
_GLYPH_GAP, _WORD_GAP, _LINE_GAP = 0.2, 0.9, 0.3
#: Coordinates are rounded to _ROUND_MM, and outlines are simplified within _SIMPLIFY_MM, in mm. No edge is therefore
#: shorter than 0.01 mm.
_ROUND_MM = 0.001
_SIMPLIFY_MM = 0.02
#: For each character, the first one of the same width. Text may be broken after a hyphen, which nothing replaces.
_LIKE = {
    character: next(other for other in GLYPHS if GLYPHS[other].width == glyph.width)
    for character, glyph in GLYPHS.items()
    if character != "-"
}
# The coordinates of one point, or of many points.
T = TypeVar("T", float, Floats)


@dataclass(frozen=True, eq=False)
class Engraving:
    """Pockets with a flat bottom in the underside.

    Args:
        contours: The closed outlines in the block frame, each (n, 2) in mm; the first point is not repeated at the
            end. Seen from above, outer outlines run counter-clockwise and islands clockwise.
        glyph_mm: The height of the glyphs, in mm.
        along_y: Whether the lines run along the block's y axis (otherwise along x).
    """

    contours: tuple[Floats, ...]
    glyph_mm: float = MIN_GLYPH_MM
    along_y: bool = False

    @property
    def area_mm2(self) -> float:
        """The area of the pockets without their islands, in mm^2."""
        return area_mm2(*self.contours)

    @property
    def volume_mm3(self) -> float:
        """The volume of the pockets, in mm^3."""
        return self.area_mm2 * LABEL_DEPTH_MM

    def as_read(self, size_mm: tuple[float, float]) -> tuple[tuple[float, float], tuple[Floats, ...]]:
        """Return the underside as a reader sees it, turned so that the lines run to the right.

        Args:
            size_mm: The sides x, y of the underside, in mm.

        Returns:
            The width and height of the picture, and the outlines in mm, with x to the right and y down, as in SVG.
        """
        x, y = size_mm
        if not self.along_y:
            return (x, y), self.contours
        return (y, x), tuple(np.column_stack([y - contour[:, 1], contour[:, 0]]) for contour in self.contours)


@dataclass(frozen=True)
class _Layout:
    """Lines of text with one glyph height, in the reader's frame (a, b): a points to the right and b up.

    Args:
        lines: The lines from top to bottom. Words are separated by spaces.
        height: The height of the glyphs, in mm.
    """

    lines: tuple[str, ...]
    height: float

    @property
    def width(self) -> float:
        return max(_width(line, self.height) for line in self.lines)

    @property
    def depth(self) -> float:
        return self.height * (len(self.lines) + _LINE_GAP * (len(self.lines) - 1))


@dataclass(frozen=True)
class _Page:
    """The underside as the reader sees it, after turning the block over about its x axis so that lines run along a.

    Args:
        size_mm: The sides x, y of the block.
        along_y: Whether lines run along the block's y axis (otherwise along x).
    """

    size_mm: tuple[float, float]
    along_y: bool

    @property
    def width(self) -> float:
        return self.size_mm[1] if self.along_y else self.size_mm[0]

    @property
    def depth(self) -> float:
        return self.size_mm[0] if self.along_y else self.size_mm[1]

    def to_block(self, a: T, b: T) -> tuple[T, T]:
        """Convert points of the page to the block frame. They are mirrored, because the page is seen from below."""
        x, y = self.size_mm
        return (x - b, y - a) if self.along_y else (a, y - b)

    def place(self, layout: _Layout, room: shapely.Polygon) -> list[tuple[float, float]] | None:
        """Return the lower left corner of each line on the page, or None if the lines do not fit.

        Lines are centred. If they do not fit in the middle of the page, they move to the nearest of some other places.
        """
        spare = self.width - layout.width - 2 * MARGIN_MM, self.depth - layout.depth - 2 * MARGIN_MM
        if min(spare) < -1e-9:
            return None
        widths = np.array([_width(line, layout.height) for line in layout.lines])
        step = layout.height * (1.0 + _LINE_GAP)
        a = (self.width - widths) / 2.0
        b = (self.depth + layout.depth) / 2.0 - layout.height - step * np.arange(len(widths))
        steps = np.linspace(-0.5, 0.5, _PLACES)
        places = np.array([(s * spare[0], t * spare[1]) for s in steps for t in steps])
        places = places[np.argsort(np.hypot(*places.T), kind="stable")]
        a, b = a + places[:, :1], b + places[:, 1:]
        (x0, y0), (x1, y1) = self.to_block(a, b), self.to_block(a + widths, b + layout.height)
        lines = shapely.box(np.minimum(x0, x1), np.minimum(y0, y1), np.maximum(x0, x1), np.maximum(y0, y1))
        fitting = np.flatnonzero(shapely.covers(room, lines).all(axis=1))
        if not len(fitting):
            return None
        return list(zip(a[fitting[0]].tolist(), b[fitting[0]].tolist(), strict=True))


def engrave(words: tuple[str, ...], size_mm: tuple[float, float], region: LoopRegion | None = None) -> Engraving:
    """Engrave words in the underside with the largest glyphs that fit (3 to 5 mm), to be read from below.

    Words keep their order, and each line has one or more words. Lines run along the side that allows larger glyphs. A
    word may be broken after a hyphen. The text is mirrored: after turning the block over about its x axis (front to
    back), it reads upright if it runs along x. If it runs along y, turn the block clockwise by a quarter as well.

    Args:
        words: The words, with A to Z, 0 to 9, hyphens and full stops. Small letters become capitals.
        size_mm: The sides x, y of the underside, in mm.
        region: The part of this rectangle that belongs to the block; None for all of it.

    Returns:
        The pockets in the block frame. They are the same on every run, their coordinates are float32 values, and no
        edge is shorter than 0.01 mm.

    Raises:
        InputError: A character has no glyph, or the words do not fit at 3 mm.
    """
    text = " ".join(word for word in " ".join(words).upper().split(" ") if word)
    for character in text:
        if character not in GLYPHS and character != " ":
            raise InputError("label", text, f"has no glyph for {character!r}; allowed: A to Z, 0 to 9, - and .")
    if not text:
        raise InputError("label", text, "needs at least one character")
    # characters of the same width have the same place, so the labels of many copies need only a few searches
    placed = _placed("".join(_LIKE.get(character, character) for character in text), size_mm, region)
    if placed is None:
        raise InputError("label", text, _refusal(_breaks(text), _pages(size_mm), region))
    page, layout, corners = placed
    lines, start = [], 0
    for line in layout.lines:
        start += text[start] == " "
        lines.append(text[start : start + len(line)])
        start += len(line)
    own = _Layout(tuple(lines), layout.height)
    return Engraving(_outlines(own, page, corners), own.height, page.along_y)


def _pages(size_mm: tuple[float, float]) -> tuple[_Page, _Page]:
    return _Page(size_mm, False), _Page(size_mm, True)


@lru_cache(maxsize=128)
def _placed(
    text: str, size_mm: tuple[float, float], region: LoopRegion | None
) -> tuple[_Page, _Layout, list[tuple[float, float]]] | None:
    """Return the page, the lines with the largest glyphs that fit, and the corner of each line; None if none fit."""
    breaks = _breaks(text)
    whole = shapely.box(0.0, 0.0, *size_mm) if region is None else region.polygon
    room = whole.buffer(1e-9 - MARGIN_MM, join_style="mitre")
    shapely.prepare(room)
    steps = round((MAX_GLYPH_MM - MIN_GLYPH_MM) / _STEP_MM)
    for step in range(steps + 1):
        height = round(MAX_GLYPH_MM - step * _STEP_MM, 2)
        for page in _pages(size_mm):
            for lines in breaks:
                layout = _Layout(lines, height)
                corners = page.place(layout, room)
                if corners is not None:
                    return page, layout, corners
    return None


def _refusal(breaks: list[tuple[str, ...]], pages: tuple[_Page, _Page], region: LoopRegion | None) -> str:
    """Say which size the smallest glyphs need, and which size the underside has."""
    needs = []
    for lines in breaks:
        layout = _Layout(lines, MIN_GLYPH_MM)
        for page in pages:
            need = (layout.width + 2 * MARGIN_MM, layout.depth + 2 * MARGIN_MM)
            needs.append((max(need[0] / page.width, need[1] / page.depth), need[::-1] if page.along_y else need))
    _, (x, y) = min(needs)
    have = f"{pages[0].size_mm[0]:.4g} x {pages[0].size_mm[1]:.4g} mm"
    if isinstance(region, Outline):
        return (
            f"glyphs of {MIN_GLYPH_MM:g} mm do not fit into the underside of a {region} at a distance of "
            f"{MARGIN_MM:g} mm from the outline; choose a larger outline or no label"
        )
    return (
        f"needs an underside of {math.ceil(10 * x) / 10:g} x {math.ceil(10 * y) / 10:g} mm for glyphs of "
        f"{MIN_GLYPH_MM:g} mm at a distance of {MARGIN_MM:g} mm from the outline; this one has {have}"
        + (" and a key" if region else "")
    )


def _width(line: str, height: float) -> float:
    """Return the width of a line between the outer edges of its strokes, in mm."""
    unit = (height - STROKE_MM) / UNITS_HIGH
    total, gap = 0.0, 0.0
    for character in line:
        if character == " ":
            gap = _WORD_GAP * height
            continue
        total += gap + GLYPHS[character].width * unit + STROKE_MM
        gap = _GLYPH_GAP * height
    return total


def _breaks(text: str) -> list[tuple[str, ...]]:
    """Return all ways to break a text into lines of some width, starting with those that have the most lines."""
    pieces = [piece for word in text.split() for piece in _at_hyphens(word)]
    widths = {
        _width("".join(pieces[i : j + 1]), MIN_GLYPH_MM) for i in range(len(pieces)) for j in range(i, len(pieces))
    }
    breaks = dict.fromkeys(_fill(pieces, width) for width in sorted(widths))
    return sorted(breaks, key=len, reverse=True)


def _at_hyphens(word: str) -> Iterator[str]:
    """Yield the parts of a word that may be on separate lines: ``HEX-`` and ``WIDE`` for ``HEX-WIDE``."""
    start = 0
    for i, character in enumerate(word):
        if character == "-" and 0 < i < len(word) - 1:
            yield word[start : i + 1]
            start = i + 1
    yield word[start:] + " "


def _fill(pieces: list[str], width: float) -> tuple[str, ...]:
    """Fill lines one after another up to a width in mm, at the smallest height. A longer piece gets its own line."""
    lines = [pieces[0]]
    for piece in pieces[1:]:
        if _width(lines[-1] + piece, MIN_GLYPH_MM) <= width + 1e-9:
            lines[-1] += piece
        else:
            lines.append(piece)
    return tuple(line.strip() for line in lines)


def _outlines(layout: _Layout, page: _Page, corners: list[tuple[float, float]]) -> tuple[Floats, ...]:
    """Return the union of all strokes in the block frame, sorted by coordinates."""
    from manifold3d import CrossSection, FillRule

    strokes = [
        _stroke(page.to_block(*start), page.to_block(*end))
        for line, at in zip(layout.lines, corners, strict=True)
        for start, end in _segments(line, layout.height, at)
    ]
    union = CrossSection(strokes, FillRule.NonZero).simplify(_SIMPLIFY_MM)
    return tuple(sorted((_settled(np.asarray(c)) for c in union.to_polygons()), key=lambda c: c.tolist()))


def _settled(contour: Floats) -> Floats:
    """Return the contour with rounded float32 coordinates, starting at its smallest x (and y)."""
    steps = np.rint(contour / _ROUND_MM)
    first = int(np.lexsort((steps[:, 1], steps[:, 0]))[0])
    return (np.roll(steps, -first, axis=0) * _ROUND_MM).astype(np.float32).astype(np.float64)


def _segments(line: str, height: float, at: tuple[float, float]) -> Iterator[tuple[tuple[float, float], ...]]:
    """Yield the two ends of each stroke's centre line on the page, in mm."""
    unit, half = (height - STROKE_MM) / UNITS_HIGH, STROKE_MM / 2.0
    for i, character in enumerate(line):
        if character == " ":
            continue
        before = line[: i + 1].rstrip()
        left = at[0] + _width(before, height) - GLYPHS[character].width * unit - half
        for points in GLYPHS[character].lines:
            placed = [(left + x * unit, at[1] + half + y * unit) for x, y in points]
            yield from zip(placed, placed[1:] or placed, strict=False)


def _stroke(start: tuple[float, float], end: tuple[float, float]) -> Floats:
    """Return the outline of a stroke, counter-clockwise: the convex hull of two octagons.

    The sides of the octagons run along the axes and at 45 degrees, as all strokes do. The stroke is therefore exactly
    as wide as the pen.

    Returns:
        The points in mm, shape (8, 2).
    """
    along = math.atan2(end[1] - start[1], end[0] - start[0])
    radius = STROKE_MM / 2.0 / math.cos(math.pi / 8.0)
    turns = along + math.pi / 8.0 * np.arange(-3, 13, 2)  # first half about the far end, second half about the near one
    octagon = radius * np.column_stack([np.cos(turns), np.sin(turns)])
    return np.concatenate([octagon[:4] + end, octagon[4:] + start])
