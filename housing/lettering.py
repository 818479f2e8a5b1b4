"""Numerals and letters for engravings on fixtures: the glyphs of the labels, with thinner lines."""

from __future__ import annotations

import itertools

import numpy as np
import shapely
from numpy.typing import ArrayLike

from tacbench_cad.spec.glyphs import GLYPHS, UNITS_HIGH

#: The height of a glyph, in mm.
HEIGHT_MM = 2.6
#: The width of the lines, in mm.
PEN_MM = 0.4
#: The distance between two glyphs of a word, in mm.
SPACE_MM = 0.8
_UNIT_MM = (HEIGHT_MM - PEN_MM) / UNITS_HIGH
#: The thinnest wall between two bars of a glyph, in mm. The bars are three units apart.
COUNTER_MM = 3.0 * _UNIT_MM - PEN_MM


def stroke(start: ArrayLike, end: ArrayLike, width_mm: float, *, longer: bool = False) -> shapely.Polygon:
    """Return a straight stroke in mm.

    Args:
        start: The start point, shape (2,).
        end: The end point, shape (2,).
        width_mm: The width of the stroke.
        longer: Whether the stroke extends beyond both points by half of its width, so that strokes that meet at a
            corner fill it.
    """
    return shapely.LineString([start, end]).buffer(width_mm / 2.0, cap_style="square" if longer else "flat")


def width_mm(letters: str) -> float:
    """Return the width of a word, in mm."""
    return sum(GLYPHS[letter].width * _UNIT_MM + PEN_MM for letter in letters) + (len(letters) - 1) * SPACE_MM


def word(letters: str, low_mm: tuple[float, float]) -> list[shapely.Polygon]:
    """Return the strokes of a word, which overlap, in mm.

    Args:
        letters: The word, in characters that a label may contain.
        low_mm: The lower left corner of the word.
    """
    strokes, x = [], low_mm[0]
    for letter in letters:
        first = np.array([x, low_mm[1]]) + PEN_MM / 2.0
        for line in GLYPHS[letter].lines:
            points = [first + np.array(point) * _UNIT_MM for point in line]
            strokes += [stroke(a, b, PEN_MM, longer=True) for a, b in itertools.pairwise(points)]
        x += width_mm(letter) + SPACE_MM
    return strokes
