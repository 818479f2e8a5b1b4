"""Numerals and letters for engravings on fixtures: the glyphs of the labels, with thinner lines."""

from __future__ import annotations

import itertools

import numpy as np

from tacbench_cad.spec.glyphs import GLYPHS, UNITS_HIGH
from tacbench_cad.util.types import Floats

#: The height of a glyph, in mm.
HEIGHT_MM = 2.6
#: The width of the lines, in mm.
PEN_MM = 0.4
#: The distance between two glyphs of a word, in mm.
SPACE_MM = 0.8
_UNIT_MM = (HEIGHT_MM - PEN_MM) / UNITS_HIGH
#: The thinnest wall between two bars of a glyph, in mm. The bars are three units apart.
COUNTER_MM = 3.0 * _UNIT_MM - PEN_MM


def stroke(start: Floats, end: Floats, width_mm: float, overrun_mm: float = 0.0) -> Floats:
    """Return a straight stroke as a counter-clockwise quadrilateral, shape (4, 2), in mm.

    Args:
        start: The start point, shape (2,).
        end: The end point, shape (2,).
        width_mm: The width of the stroke.
        overrun_mm: The extension of the stroke beyond both points, so that strokes that meet at a corner fill it.
    """
    along = (end - start) / np.linalg.norm(end - start)
    across = np.array([-along[1], along[0]]) * width_mm / 2.0
    first, last = start - along * overrun_mm, end + along * overrun_mm
    return np.array([first - across, last - across, last + across, first + across])


def width_mm(letters: str) -> float:
    """Return the width of a word, in mm."""
    return sum(GLYPHS[letter].width * _UNIT_MM + PEN_MM for letter in letters) + (len(letters) - 1) * SPACE_MM


def word(letters: str, low_mm: tuple[float, float]) -> list[Floats]:
    """Return the strokes of a word as overlapping counter-clockwise quadrilaterals, each of shape (4, 2), in mm.

    Args:
        letters: The word, in characters that a label may contain.
        low_mm: The lower left corner of the word.
    """
    strokes, x = [], low_mm[0]
    for letter in letters:
        first = np.array([x, low_mm[1]]) + PEN_MM / 2.0
        for line in GLYPHS[letter].lines:
            points = [first + np.array(point) * _UNIT_MM for point in line]
            strokes += [stroke(a, b, PEN_MM, PEN_MM / 2.0) for a, b in itertools.pairwise(points)]
        x += width_mm(letter) + SPACE_MM
    return strokes
