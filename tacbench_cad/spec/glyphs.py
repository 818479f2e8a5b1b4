"""The characters of labels, as straight strokes on a small square grid. Labels therefore need no system font.

A glyph is six units high. Its strokes are polylines between grid points, drawn with a pen of 0.8 mm. One unit is
``(height - pen) / 6``, so the pen has the same width at every height. All strokes run along an axis or at 45 degrees.
Horizontal bars are three units apart, which leaves a gap of ``height / 2 - 1.2`` mm between them. The gap is 0.4 mm,
the width of a nozzle, at a height of 3.2 mm, and 0.3 mm at the smallest height of 3 mm.
"""

from __future__ import annotations

from dataclasses import dataclass

Point = tuple[float, float]

#: The height of every glyph between the centre lines of its strokes, in units.
UNITS_HIGH = 6.0


@dataclass(frozen=True)
class Glyph:
    """One character.

    Args:
        width: The distance between the centre lines of the outermost strokes, in units.
        lines: The polylines as grid points (x to the right, y up), in units.
    """

    width: float
    lines: tuple[tuple[Point, ...], ...]


def _glyph(text: str) -> Glyph:
    """Parse polylines from text such as ``"0,0 0,6 4,6 | 0,3 3,3"``; a bar separates polylines."""
    lines = tuple(
        tuple((float(x), float(y)) for x, y in (point.split(",") for point in line.split())) for line in text.split("|")
    )
    return Glyph(max(x for line in lines for x, _ in line), lines)


_STROKES = {
    "A": "0,0 0,4 2,6 4,4 4,0 | 0,2 4,2",
    "B": "0,0 0,6 4,6 5,5 5,4 4,3 0,3 | 4,3 5,2 5,1 4,0 0,0",
    "C": "4,5 3,6 1,6 0,5 0,1 1,0 3,0 4,1",
    "D": "0,0 0,6 2.5,6 4,4.5 4,1.5 2.5,0 0,0",
    "E": "4,6 0,6 0,0 4,0 | 0,3 3,3",
    "F": "4,6 0,6 0,0 | 0,3 3,3",
    "G": "5,6 1,6 0,5 0,1 1,0 5,0 5,3 3.5,3",
    "H": "0,0 0,6 | 4,0 4,6 | 0,3 4,3",
    "I": "0,6 3,6 | 0,0 3,0 | 1.5,0 1.5,6",
    "J": "3.5,6 3.5,1 2.5,0 1,0 0,1 0,2",
    "K": "0,0 0,6 | 4,6 1,3 4,0 | 0,3 1,3",
    "L": "0,6 0,0 3.5,0",
    "M": "0,0 0,6 3,3 6,6 6,0",
    "N": "0,0 0,6 | 0,5.5 5,0.5 | 5,0 5,6",
    "O": "2,0 4,0 6,2 6,4 4,6 2,6 0,4 0,2 2,0",
    "P": "0,0 0,6 3,6 4,5 4,3.5 3,2.5 0,2.5",
    "Q": "2,0 4,0 6,2 6,4 4,6 2,6 0,4 0,2 2,0 | 4,2 6,0",
    "R": "0,0 0,6 3,6 4,5 4,3.5 3,2.5 0,2.5 | 1.5,2.5 4,0",
    "S": "5,6 1,6 0,5 0,4 1,3 4,3 5,2 5,1 4,0 0,0",
    "T": "0,6 5,6 | 2.5,6 2.5,0",
    "U": "0,6 0,1 1,0 3,0 4,1 4,6",
    "V": "0,6 0,2.5 2.5,0 5,2.5 5,6",
    "W": "0,6 0,0 3,3 6,0 6,6",
    "X": "0,0 0,0.5 5,5.5 5,6 | 0,6 0,5.5 5,0.5 5,0",
    "Y": "0,6 2.5,3.5 5,6 | 2.5,3.5 2.5,0",
    "Z": "0,6 5,6 5,5.5 0,0.5 0,0 5,0",
    "0": "1,0 3,0 4,1 4,5 3,6 1,6 0,5 0,1 1,0",
    "1": "0,4.5 1.5,6 1.5,0",
    "2": "0,5 1,6 3,6 4,5 4,4 0,0 4,0",
    "3": "0,6 3,6 4,5 4,4 3,3 1,3 | 3,3 4,2 4,1 3,0 0,0",
    "4": "0,6 0,2 4.5,2 | 3.5,4 3.5,0",
    "5": "4,6 0,6 0,3 3,3 4,2 4,1 3,0 0,0",
    "6": "4,6 1,6 0,5 0,1 1,0 3,0 4,1 4,2 3,3 0,3",
    "7": "0,6 4,6 4,5 1.5,2.5 1.5,0",
    "8": "1,3 3,3 4,4 4,5 3,6 1,6 0,5 0,4 1,3 0,2 0,1 1,0 3,0 4,1 4,2 3,3",
    "9": "0,0 3,0 4,1 4,5 3,6 1,6 0,5 0,4 1,3 4,3",
    "-": "0,3 2.5,3",
    ".": "0,0",
}

#: The characters that a label may contain.
GLYPHS: dict[str, Glyph] = {character: _glyph(text) for character, text in _STROKES.items()}
