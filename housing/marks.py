"""The engravings of the jig around the press positions: hairs, leaders, numerals and datum lines, in the block frame.

A hair is a thin line along a row or a column of press positions. A leader connects a hair with its numeral. A datum
line shows an edge of the block.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from housing.lettering import HEIGHT_MM, stroke, width_mm, word
from tacbench_cad.spec.protocol import PER_SIDE, PressGrid
from tacbench_cad.util.types import Floats

#: The width of the hairs, in mm. A hair is a gap and not a wall, so its width does not depend on the nozzle.
HAIR_MM = 0.4
#: The length of the shortest piece of a hair, in mm. Shorter pieces are left out.
MIN_PIECE_MM = 0.3
#: The depth of all engravings, in mm.
DEPTH_MM = 0.4
#: Coordinates of grooves are multiples of this length, in mm.
GRID_MM = 1e-8
#: Smaller steps in an outline are removed, in mm. Overlapping strokes cause such steps at their joints.
SIMPLIFY_MM = 0.02
#: The length of the tick beyond the last marker, in mm.
TICK_MM = 1.0
#: The distance between the numerals of neighbouring columns and of neighbouring rows, in mm.
NUMERAL_PITCH_MM = (2.8, 3.4)
#: The length of the leaders from the ticks to the numerals of columns and of rows, in mm.
LEADER_MM = (6.0, 8.0)
#: The gap between the end of a leader and its numeral, in mm.
NUMERAL_GAP_MM = 1.0
#: The length of the lines that mark the block's edges x = 0 and y = 0, in mm.
DATUM_MM = 5.0


def merged(strokes: Iterable[shapely.Polygon]) -> tuple[shapely.Polygon, ...]:
    """Join overlapping strokes into grooves, sorted by their lowest y and then by their lowest x.

    Args:
        strokes: Polygons in mm.

    Returns:
        The grooves. The holes of a polygon are islands that are not engraved.
    """
    joined = shapely.union_all(list(strokes), grid_size=GRID_MM)
    grooves = shapely.get_parts(shapely.simplify(joined, SIMPLIFY_MM))
    return tuple(sorted(grooves, key=lambda groove: (groove.bounds[1], groove.bounds[0])))


def hairs(grid: PressGrid, holes_mm: Floats, keep_off_mm: float, wall_mm: float) -> list[shapely.Polygon]:
    """Return lines along all rows and columns, with a tick beyond both ends and gaps around the holes.

    If one of two hairs has a gap at their crossing, its end has the distance ``wall_mm`` from the other hair. If both
    have a gap there, their ends have this distance from each other.

    Args:
        grid: The press positions. The hairs of a row and a column cross at each position without a hole, if no hole is
            too near.
        holes_mm: The centres of the holes, shape (n, 2).
        keep_off_mm: The smallest distance of a hair's edge from the centre of a hole: the radius of the hole plus
            ``wall_mm``.
        wall_mm: The smallest wall.
    """
    x, y = np.array(grid.x_mm), np.array(grid.y_mm)
    beyond = keep_off_mm + TICK_MM
    rows = [_Hair((x[0] - beyond, x[-1] + beyond), _breaks(place, holes_mm, keep_off_mm)) for place in y]
    columns = [_Hair((y[0] - beyond, y[-1] + beyond), _breaks(place, holes_mm[:, ::-1], keep_off_mm)) for place in x]
    apart: list[tuple[_Hair, tuple[float, float]]] = []
    for row, y_mm in zip(rows, y, strict=True):
        for column, x_mm in zip(columns, x, strict=True):
            passing = row.passes(x_mm), column.passes(y_mm)
            reach = HAIR_MM / 2.0 + (wall_mm if any(passing) else wall_mm / math.sqrt(2.0))
            apart += [(row, (x_mm - reach, x_mm + reach))] if not passing[0] else []
            apart += [(column, (y_mm - reach, y_mm + reach))] if not passing[1] else []
    for hair, gap in apart:
        hair.breaks.append(gap)
    strokes = []
    for row, place in zip(rows, y, strict=True):
        strokes += [stroke((a, place), (b, place), HAIR_MM) for a, b in row.pieces()]
    for column, place in zip(columns, x, strict=True):
        strokes += [stroke((place, a), (place, b), HAIR_MM) for a, b in column.pieces()]
    return strokes


@dataclass(frozen=True)
class _Hair:
    """A hair along its own axis, with its ends and its gaps."""

    ends: tuple[float, float]
    breaks: list[tuple[float, float]]

    def pieces(self) -> list[tuple[float, float]]:
        """Return the pieces between the gaps, without pieces shorter than :data:`MIN_PIECE_MM`."""
        pieces, start = [], self.ends[0]
        for low, high in sorted(self.breaks):
            pieces.append((start, min(low, self.ends[1])))
            start = max(start, high)
        pieces.append((start, self.ends[1]))
        return [(a, b) for a, b in pieces if b - a >= MIN_PIECE_MM]

    def passes(self, place: float) -> bool:
        """Return whether the hair has no gap at a point of its axis."""
        half = MIN_PIECE_MM / 2.0
        return any(a <= place - half and place + half <= b for a, b in self.pieces())


def _breaks(place: float, holes_mm: Floats, keep_off_mm: float) -> list[tuple[float, float]]:
    """Return the gaps of a hair at the holes. ``holes_mm`` contains the positions along and across the hair."""
    aside = np.maximum(np.abs(holes_mm[:, 1] - place) - HAIR_MM / 2.0, 0.0)
    near = aside < keep_off_mm
    along, reach = holes_mm[near, 0], np.sqrt(keep_off_mm**2 - aside[near] ** 2)
    return [(float(a), float(b)) for a, b in zip(along - reach, along + reach, strict=True)]


def numerals(grid: PressGrid, keep_off_mm: float) -> list[shapely.Polygon]:
    """Return the leaders that spread from the ticks at low y and low x, and the numerals 1 to 5 at their ends."""
    strokes: list[shapely.Polygon] = []
    middle = (PER_SIDE - 1) / 2.0
    centre = ((grid.x_mm[0] + grid.x_mm[-1]) / 2.0, (grid.y_mm[0] + grid.y_mm[-1]) / 2.0)
    below = grid.y_mm[0] - keep_off_mm - TICK_MM
    left = grid.x_mm[0] - keep_off_mm - TICK_MM
    for i in range(PER_SIDE):
        x = centre[0] + (i - middle) * NUMERAL_PITCH_MM[0]
        foot = below - LEADER_MM[0]
        strokes.append(stroke(np.array([grid.x_mm[i], below]), np.array([x, foot]), HAIR_MM, longer=True))
        strokes += word(str(i + 1), (x - width_mm(str(i + 1)) / 2.0, foot - NUMERAL_GAP_MM - HEIGHT_MM))
        y = centre[1] + (i - middle) * NUMERAL_PITCH_MM[1]
        foot = left - LEADER_MM[1]
        strokes.append(stroke(np.array([left, grid.y_mm[i]]), np.array([foot, y]), HAIR_MM, longer=True))
        strokes += word(str(i + 1), (foot - NUMERAL_GAP_MM - width_mm(str(i + 1)), y - HEIGHT_MM / 2.0))
    return strokes


def datum_lines(size_mm: tuple[float, float]) -> list[shapely.Polygon]:
    """Return lines over the block's edges x = 0 (near high y) and y = 0, with ``X0`` and ``Y0`` beside them."""
    x, y = size_mm
    gap = NUMERAL_GAP_MM + HAIR_MM / 2.0
    edge_x = stroke((0.0, y - 1.0), (0.0, y - 1.0 + DATUM_MM), HAIR_MM)
    end = x - 4.0
    edge_y = stroke((end - DATUM_MM, 0.0), (end, 0.0), HAIR_MM)
    start = end - (DATUM_MM + width_mm("Y0")) / 2.0
    return [edge_x, *word("X0", (gap, y + 1.0)), edge_y, *word("Y0", (start, -gap - HEIGHT_MM))]


def min_gap_mm(grooves: Sequence[shapely.Polygon]) -> float:
    """Return the smallest distance between any two grooves; infinite for fewer than two."""
    i, j = np.triu_indices(len(grooves), 1)
    each = np.array(grooves, dtype=object)
    return float(shapely.distance(each[i], each[j]).min(initial=math.inf))


def outside_mm2(grooves: Iterable[shapely.Polygon], plate: Floats, edge_mm: float) -> float:
    """Return the area of grooves and their islands outside a plate or within a distance of its edge, in mm^2."""
    room = shapely.Polygon(plate).buffer(-edge_mm, join_style="mitre")
    return float(sum(shapely.Polygon(groove.exterior).difference(room).area for groove in grooves))
