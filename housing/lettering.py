"""Numerals and letters for engraving fixtures: the glyphs of the labels, with a finer pen."""

from __future__ import annotations

import itertools

import numpy as np

from tacbench_cad.spec.glyphs import GLYPHS, UNITS_HIGH
from tacbench_cad.util.types import Floats

#: Height of a glyph, in mm.
HEIGHT_MM = 2.6
#: Width of the pen, in mm.
PEN_MM = 0.4
#: Between two glyphs of a word, in mm.
SPACE_MM = 0.8
_UNIT_MM = (HEIGHT_MM - PEN_MM) / UNITS_HIGH
#: Least wall between two bars of one glyph, which are three units apart, in mm.
COUNTER_MM = 3.0 * _UNIT_MM - PEN_MM


def stroke(start: Floats, end: Floats, width_mm: float, overrun_mm: float = 0.0) -> Floats:
    """A straight stroke as a counter-clockwise quadrilateral, shape (4, 2), in mm.

    Args:
        start: Where it begins, (2,).
        end: Where it ends, (2,).
        width_mm: Its width.
        overrun_mm: How far it runs on past both ends, so that strokes meeting at a corner fill it.
    """
    along = (end - start) / np.linalg.norm(end - start)
    across = np.array([-along[1], along[0]]) * width_mm / 2.0
    first, last = start - along * overrun_mm, end + along * overrun_mm
    return np.array([first - across, last - across, last + across, first + across])


def width_mm(letters: str) -> float:
    """Width of a word, in mm."""
    return sum(GLYPHS[one].width * _UNIT_MM + PEN_MM for one in letters) + (len(letters) - 1) * SPACE_MM


def word(letters: str, low_mm: tuple[float, float]) -> list[Floats]:
    """The strokes of a word as overlapping counter-clockwise quadrilaterals, each (4, 2), in mm.

    Args:
        letters: Characters that a label may have.
        low_mm: Lower left corner of the word's box.
    """
    strokes, x = [], low_mm[0]
    for letter in letters:
        first = np.array([x, low_mm[1]]) + PEN_MM / 2.0
        for line in GLYPHS[letter].lines:
            points = [first + np.array(point) * _UNIT_MM for point in line]
            strokes += [stroke(a, b, PEN_MM, PEN_MM / 2.0) for a, b in itertools.pairwise(points)]
        x += width_mm(letter) + SPACE_MM
    return strokes
