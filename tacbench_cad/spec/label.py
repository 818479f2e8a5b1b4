"""The label engraved in the underside of a block. Its outlines are the same in the mesh and in the solid."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeVar

import numpy as np

from tacbench_cad.spec.glyphs import GLYPHS, UNITS_HIGH
from tacbench_cad.spec.outlines import Outline, area_mm2
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Bools, Floats

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
#: For outlines that are not rectangles: the distance between points of a line at which its place is tested, in mm, and
#: the number of places along each side that are tried if the middle has no room.
_TEST_STEP_MM, _PLACES = 0.25, 9
#: The approximate number of points that are tested first.
_FEW_POINTS = 40
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
        key_mm: The leg of the key; 0 for no key.
        along_y: Whether lines run along the block's y axis (otherwise along x).
        outline: The outline of the block; None for a rectangle.
    """

    size_mm: tuple[float, float]
    key_mm: float
    along_y: bool
    outline: Outline | None = None

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

    def place(self, layout: _Layout) -> list[tuple[float, float]] | None:
        """Return the lower left corner of each line on the page, or None if the layout does not fit.

        Lines are centred. If they would cut the key, they move to the opposite corner.
        """
        if layout.width > self.width - 2 * MARGIN_MM + 1e-9 or layout.depth > self.depth - 2 * MARGIN_MM + 1e-9:
            return None
        if self.outline is not None:
            return self._place_inside(self.outline, layout)
        for centred in (True, False):
            corners = self._corners(layout, centred)
            if all(self._clear(layout, line, at) for line, at in zip(layout.lines, corners, strict=True)):
                return corners
        return None

    def _place_inside(self, outline: Outline, layout: _Layout) -> list[tuple[float, float]] | None:
        """Return the corners of the lines nearest to the centre of the page that are inside of an outline."""
        corners = self._corners(layout, True)
        points = []
        for line, (a, b) in zip(layout.lines, corners, strict=True):
            width = _width(line, layout.height)
            across = np.linspace(a, a + width, math.ceil(width / _TEST_STEP_MM) + 1)
            up = np.linspace(b, b + layout.height, math.ceil(layout.height / _TEST_STEP_MM) + 1)
            points.append(np.stack(np.meshgrid(across, up), axis=-1).reshape(-1, 2))
        on_page = np.concatenate(points)
        room = (self.width - layout.width) / 2.0 - MARGIN_MM, (self.depth - layout.depth) / 2.0 - MARGIN_MM
        steps = np.linspace(-1.0, 1.0, _PLACES) if len(outline.loops) > 1 or outline.turns == 1 else np.zeros(1)
        places = np.array([(s * room[0], t * room[1]) for s in steps for t in steps])
        places = places[np.argsort(np.hypot(*places.T), kind="stable")]
        # most places have no room, which a few points show
        few = on_page[:: math.ceil(len(on_page) / _FEW_POINTS)]
        for place in places[self._inside(outline, places[:, None] + few).all(axis=1)]:
            if self._inside(outline, place + on_page).all():
                return [(a + float(place[0]), b + float(place[1])) for a, b in corners]
        return None

    def _inside(self, outline: Outline, points: Floats) -> Bools:
        """Return which points of the page, shape (..., 2), are inside of an outline and not near it."""
        x, y = self.to_block(points[..., 0], points[..., 1])
        excess = outline.distance(x.ravel(), y.ravel()).reshape(x.shape)
        return np.asarray(excess <= 1e-9 - MARGIN_MM)

    def _corners(self, layout: _Layout, centred: bool) -> list[tuple[float, float]]:
        # The key is at large x and small y. On the page, a is large there; b is large if lines run along x, else small.
        bottom = self.depth - MARGIN_MM - layout.depth if self.along_y else MARGIN_MM
        top = (self.depth - layout.depth) / 2.0 + layout.depth if centred else bottom + layout.depth
        step = layout.height * (1.0 + _LINE_GAP)
        corners = []
        for i, line in enumerate(layout.lines):
            room = self.width - _width(line, layout.height)
            a = room / 2.0 if centred else MARGIN_MM
            corners.append((a, top - layout.height - i * step))
        return corners

    def _clear(self, layout: _Layout, line: str, at: tuple[float, float]) -> bool:
        if not self.key_mm:
            return True
        (a, b), width = at, _width(line, layout.height)
        ends = (self.to_block(p, q) for p in (a, a + width) for q in (b, b + layout.height))
        limit = self.size_mm[0] - self.key_mm - MARGIN_MM * math.sqrt(2.0)
        return all(x - y <= limit + 1e-9 for x, y in ends)


def engrave(
    words: tuple[str, ...], size_mm: tuple[float, float], key_mm: float, outline: Outline | None = None
) -> Engraving:
    """Engrave words in the underside with the largest glyphs that fit (3 to 5 mm), to be read from below.

    Words keep their order, and each line has one or more words. Lines run along the side that allows larger glyphs. A
    word may be broken after a hyphen. The text is mirrored: after turning the block over about its x axis (front to
    back), it reads upright if it runs along x. If it runs along y, turn the block clockwise by a quarter as well.

    Args:
        words: The words, with A to Z, 0 to 9, hyphens and full stops. Small letters become capitals.
        size_mm: The sides x, y of the underside, in mm.
        key_mm: The leg of the chamfered corner at (x, 0), in mm; 0 for no key.
        outline: The outline of the underside; None for a rectangle.

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
    placed = _placed("".join(_LIKE.get(character, character) for character in text), size_mm, key_mm, outline)
    if placed is None:
        raise InputError("label", text, _refusal(_breaks(text), _pages(size_mm, key_mm, outline)))
    page, layout, corners = placed
    lines, start = [], 0
    for line in layout.lines:
        start += text[start] == " "
        lines.append(text[start : start + len(line)])
        start += len(line)
    own = _Layout(tuple(lines), layout.height)
    return Engraving(_outlines(own, page, corners), own.height, page.along_y)


def _pages(size_mm: tuple[float, float], key_mm: float, outline: Outline | None) -> tuple[_Page, _Page]:
    return _Page(size_mm, key_mm, False, outline), _Page(size_mm, key_mm, True, outline)


@lru_cache(maxsize=128)
def _placed(
    text: str, size_mm: tuple[float, float], key_mm: float, outline: Outline | None
) -> tuple[_Page, _Layout, list[tuple[float, float]]] | None:
    """Return the page, the lines with the largest glyphs that fit, and the corner of each line; None if none fit."""
    breaks = _breaks(text)
    steps = round((MAX_GLYPH_MM - MIN_GLYPH_MM) / _STEP_MM)
    for step in range(steps + 1):
        height = round(MAX_GLYPH_MM - step * _STEP_MM, 2)
        for page in _pages(size_mm, key_mm, outline):
            for lines in breaks:
                layout = _Layout(lines, height)
                corners = page.place(layout)
                if corners is not None:
                    return page, layout, corners
    return None


def _refusal(breaks: list[tuple[str, ...]], pages: tuple[_Page, _Page]) -> str:
    """Say which size the smallest glyphs need, and which size the underside has."""
    needs = []
    for lines in breaks:
        layout = _Layout(lines, MIN_GLYPH_MM)
        for page in pages:
            need = (layout.width + 2 * MARGIN_MM, layout.depth + 2 * MARGIN_MM)
            needs.append((max(need[0] / page.width, need[1] / page.depth), need[::-1] if page.along_y else need))
    _, (x, y) = min(needs)
    have = f"{pages[0].size_mm[0]:.4g} x {pages[0].size_mm[1]:.4g} mm"
    key = pages[0].key_mm
    if pages[0].outline is not None:
        return (
            f"glyphs of {MIN_GLYPH_MM:g} mm do not fit into the underside of a {pages[0].outline} at a distance of "
            f"{MARGIN_MM:g} mm from the outline; choose a larger outline or no label"
        )
    return (
        f"needs an underside of {math.ceil(10 * x) / 10:g} x {math.ceil(10 * y) / 10:g} mm for glyphs of "
        f"{MIN_GLYPH_MM:g} mm at a distance of {MARGIN_MM:g} mm from the outline; this one has {have}"
        + (f" and a key of {key:g} mm" if key else "")
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
