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
from tacbench_cad.spec.outlines import area_mm2
from tacbench_cad.spec.protocol import PER_SIDE, PressGrid
from tacbench_cad.util.types import Floats

#: The width of the hairs, in mm. A hair is a gap and not a wall, so its width does not depend on the nozzle.
HAIR_MM = 0.4
#: The length of the shortest piece of a hair, in mm. Shorter pieces are left out.
MIN_PIECE_MM = 0.3
#: The depth of all engravings, in mm.
DEPTH_MM = 0.4
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


@dataclass(frozen=True, eq=False)
class Groove:
    """One connected engraving.

    Args:
        outer: The outer outline, counter-clockwise, shape (n, 2), in mm.
        islands: The outlines of the parts inside that are not engraved, clockwise.
    """

    outer: Floats
    islands: tuple[Floats, ...]

    @property
    def area_mm2(self) -> float:
        """The area of the groove's floor, in mm^2."""
        return area_mm2(self.outer, *self.islands)


def merged(strokes: Iterable[Floats]) -> tuple[Groove, ...]:
    """Join overlapping strokes into grooves, sorted by their lowest y and then by their lowest x.

    Args:
        strokes: Convex outlines, counter-clockwise, shape (n, 2), in mm.
    """
    from manifold3d import CrossSection, FillRule

    pieces = CrossSection(list(strokes), FillRule.NonZero).simplify(SIMPLIFY_MM).decompose()
    grooves = []
    for piece in pieces:
        loops = [np.asarray(loop, dtype=np.float64) for loop in piece.to_polygons()]
        outer = [loop for loop in loops if area_mm2(loop) > 0.0]
        islands = tuple(loop for loop in loops if area_mm2(loop) < 0.0)
        grooves.append(Groove(outer[0], islands))
    return tuple(sorted(grooves, key=lambda groove: (float(groove.outer[:, 1].min()), float(groove.outer[:, 0].min()))))


def hairs(grid: PressGrid, holes_mm: Floats, keep_off_mm: float, wall_mm: float) -> list[Floats]:
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
        strokes += [stroke(np.array([a, place]), np.array([b, place]), HAIR_MM) for a, b in row.pieces()]
    for column, place in zip(columns, x, strict=True):
        strokes += [stroke(np.array([place, a]), np.array([place, b]), HAIR_MM) for a, b in column.pieces()]
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


def numerals(grid: PressGrid, keep_off_mm: float) -> list[Floats]:
    """Return the leaders that spread from the ticks at low y and low x, and the numerals 1 to 5 at their ends."""
    strokes: list[Floats] = []
    middle = (PER_SIDE - 1) / 2.0
    centre = ((grid.x_mm[0] + grid.x_mm[-1]) / 2.0, (grid.y_mm[0] + grid.y_mm[-1]) / 2.0)
    below = grid.y_mm[0] - keep_off_mm - TICK_MM
    left = grid.x_mm[0] - keep_off_mm - TICK_MM
    for i in range(PER_SIDE):
        x = centre[0] + (i - middle) * NUMERAL_PITCH_MM[0]
        foot = below - LEADER_MM[0]
        strokes.append(stroke(np.array([grid.x_mm[i], below]), np.array([x, foot]), HAIR_MM, HAIR_MM / 2.0))
        strokes += word(str(i + 1), (x - width_mm(str(i + 1)) / 2.0, foot - NUMERAL_GAP_MM - HEIGHT_MM))
        y = centre[1] + (i - middle) * NUMERAL_PITCH_MM[1]
        foot = left - LEADER_MM[1]
        strokes.append(stroke(np.array([left, grid.y_mm[i]]), np.array([foot, y]), HAIR_MM, HAIR_MM / 2.0))
        strokes += word(str(i + 1), (foot - NUMERAL_GAP_MM - width_mm(str(i + 1)), y - HEIGHT_MM / 2.0))
    return strokes


def datum_lines(size_mm: tuple[float, float]) -> list[Floats]:
    """Return lines over the block's edges x = 0 (near high y) and y = 0, with ``X0`` and ``Y0`` beside them."""
    x, y = size_mm
    gap = NUMERAL_GAP_MM + HAIR_MM / 2.0
    edge_x = stroke(np.array([0.0, y - 1.0]), np.array([0.0, y - 1.0 + DATUM_MM]), HAIR_MM)
    end = x - 4.0
    edge_y = stroke(np.array([end - DATUM_MM, 0.0]), np.array([end, 0.0]), HAIR_MM)
    start = end - (DATUM_MM + width_mm("Y0")) / 2.0
    return [edge_x, *word("X0", (gap, y + 1.0)), edge_y, *word("Y0", (start, -gap - HEIGHT_MM))]


def is_engraved(point: Floats, grooves: Iterable[Groove]) -> bool:
    """Return whether a point, shape (2,), is in a groove."""
    return any(shapely.contains_xy(shapely.Polygon(groove.outer, groove.islands), *point) for groove in grooves)


def min_gap_mm(outlines: Sequence[Floats]) -> float:
    """Return the smallest distance between any two outlines, which must not overlap; infinite for fewer than two."""
    boxes = np.array([[*outline.min(axis=0), *outline.max(axis=0)] for outline in outlines])
    min_gap = math.inf
    for i in range(len(outlines)):
        for j in range(i + 1, len(outlines)):
            away = np.maximum(np.maximum(boxes[j, :2] - boxes[i, 2:], boxes[i, :2] - boxes[j, 2:]), 0.0)
            if np.hypot(*away) < min_gap:
                a, b = outlines[i], outlines[j]
                min_gap = min(min_gap, _to_outline(a, b), _to_outline(b, a))
    return min_gap


def gap_to_circle_mm(outline: Floats, centre_mm: tuple[float, float], radius_mm: float) -> float:
    """Return the distance from an outline to a circle outside it, in mm."""
    return _to_outline(np.array([centre_mm]), outline) - radius_mm


def outside_mm2(outlines: Iterable[Floats], plate: Floats, edge_mm: float) -> float:
    """Return the area of outlines outside a plate or within a distance of its edge, in mm^2."""
    from manifold3d import CrossSection, FillRule, JoinType

    room = CrossSection([plate], FillRule.NonZero).offset(-edge_mm, JoinType.Miter)
    return float((CrossSection(list(outlines), FillRule.NonZero) - room).area())


def _to_outline(points: Floats, outline: Floats) -> float:
    """Return the smallest distance from points to the edges of an outline."""
    start, end = outline, np.roll(outline, -1, axis=0)
    edge = end - start
    length2 = np.maximum(np.einsum("ij,ij->i", edge, edge), 1e-300)
    offset = points[:, None, :] - start[None, :, :]
    fraction = np.clip(np.einsum("pij,ij->pi", offset, edge) / length2, 0.0, 1.0)
    return float(np.linalg.norm(offset - fraction[..., None] * edge, axis=2).min())
