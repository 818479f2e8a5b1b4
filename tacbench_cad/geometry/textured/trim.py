"""The arrangement of an outline and the lines between patches: which pieces of curves bound which part of a patch."""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tacbench_cad.geometry.splines.curve import Axis
from tacbench_cad.geometry.textured.region import OutlineEdge, Region
from tacbench_cad.util.errors import CheckFailedError
from tacbench_cad.util.types import Floats

Cell = tuple[int, int]


@dataclass(frozen=True, eq=False)
class Piece:
    """A piece of the outline or of a line between patches, in one direction.

    Args:
        start: The number of the first node.
        end: The number of the last node.
        key: ``(loop, edge, piece)`` of the outline, or ``(axis, line, cell, piece)`` of a line.
        forward: Whether it runs along increasing parameters.
        low: The smallest parameter: that of the outline's curve, or the coordinate along the line.
        high: The largest parameter.
        points: Points along the piece in its direction, on its patch, shape (n, 2).
        shift: What is added to s of the outline's curve on its patch: a number of turns around the cylinder, in mm.
    """

    start: int
    end: int
    key: tuple[int | str, ...]
    forward: bool
    low: float
    high: float
    points: Floats
    shift: float = 0.0

    def turned(self) -> Piece:
        """Return the piece in the opposite direction."""
        return Piece(self.end, self.start, self.key, not self.forward, self.low, self.high, self.points[::-1])


class Arrangement:
    """The nodes and pieces of a region on the grid of patches.

    Attributes:
        nodes: The coordinates (s, t) of each node.
        outline: For each loop and edge, its pieces in the direction of the outline, each with its patch.
        cells: For each patch, the pieces around its part of the region. The region is on the left.
    """

    def __init__(self, region: Region, s: Axis, t: Axis) -> None:
        self.nodes: list[tuple[float, float]] = []
        self.outline: dict[tuple[int, int], list[tuple[Cell, Piece]]] = {}
        self.cells: dict[Cell, list[Piece]] = defaultdict(list)
        self._lines = (s.lines, t.lines)
        self._turn = float(s.lines[-1] - s.lines[0]) if region.is_closed else None
        self._crossings: dict[tuple[int, int], list[tuple[float, int]]] = defaultdict(list)
        for number, loop in enumerate(region.loops):
            self._add_loop(number, loop)
        self._corners: dict[Cell, int] = {}
        for axis in (0, 1):
            self._add_lines(axis)

    def cell_at(self, s: float, t: float) -> Cell:
        """Return the patch at a point."""
        i, j = (
            int(np.searchsorted(lines, at)) - 1 for lines, at in zip(self._lines, (self._wrapped(s), t), strict=True)
        )
        return i, j

    def _wrapped(self, s: float) -> float:
        if self._turn is None:
            return s
        low = float(self._lines[0][0])
        return low + (s - low) % self._turn

    def _node(self, at: Floats) -> int:
        self.nodes.append((self._wrapped(float(at[0])), float(at[1])))
        return len(self.nodes) - 1

    def _add_loop(self, number: int, loop: tuple[OutlineEdge, ...]) -> None:
        corners = [self._node(edge.samples[0]) for edge in loop]
        for k, edge in enumerate(loop):
            cuts = sorted(self._cuts(edge), reverse=not edge.forward)
            marks = [(edge.first if edge.forward else edge.last, corners[k])]
            for at, axis, line in cuts:
                node = self._node(edge.at(np.array([at]))[0])
                self._crossings[axis, line].append((self.nodes[node][1 - axis], node))
                marks.append((at, node))
            marks.append((edge.last if edge.forward else edge.first, corners[(k + 1) % len(loop)]))
            pieces = []
            for m, ((a, start), (b, end)) in enumerate(itertools.pairwise(marks)):
                if abs(b - a) < 1e-9 * (edge.last - edge.first):
                    raise CheckFailedError("the outline runs through a corner of a patch; choose another margin_mm")
                points = edge.at(np.linspace(a, b, 3 if edge.kind == "line" else 17))
                middle = points[len(points) // 2]
                shift = self._wrapped(float(middle[0])) - float(middle[0])
                key, points = (number, k, m), points + np.array([shift, 0.0])
                piece = Piece(start, end, key, edge.forward, min(a, b), max(a, b), points, shift)
                cell = self.cell_at(*middle.tolist())
                self.cells[cell].append(piece)
                pieces.append((cell, piece))
            self.outline[number, k] = pieces

    def _cuts(self, edge: OutlineEdge) -> Iterator[tuple[float, int, int]]:
        """Yield the parameters at which an edge crosses lines between patches, with the axis and the line."""
        from scipy.optimize import brentq

        at = np.linspace(edge.first, edge.last, 2 if edge.kind == "line" else 721)
        points = edge.at(at)
        for axis, lines in enumerate(self._lines):
            wraps = axis == 0 and self._turn is not None
            inner = lines[:-1] if wraps else lines
            for line, place in enumerate(inner.tolist()):
                for turn in (-1, 0, 1, 2) if wraps else (0,):
                    value = place + turn * (self._turn or 0.0)
                    off = points[:, axis] - value
                    for k in np.flatnonzero((off[:-1] < 0.0) != (off[1:] < 0.0)).tolist():
                        yield (
                            brentq(
                                lambda p, value=value, axis=axis: float(edge.at(np.array([p]))[0, axis]) - value,
                                at[k],
                                at[k + 1],
                                xtol=1e-14,
                            ),
                            axis,
                            line,
                        )

    def _add_lines(self, axis: int) -> None:
        """Add the pieces of the lines along one axis that lie inside of the region."""
        own, other = self._lines[axis], self._lines[1 - axis]
        closed_own = axis == 0 and self._turn is not None
        closed_along = axis == 1 and self._turn is not None
        for line in range(len(own) - 1 if closed_own else len(own)):
            crossings = sorted(self._crossings[axis, line])
            marks = [(at, node, True) for at, node in crossings]
            for k, at in enumerate(other.tolist()):
                if not (closed_along and k == len(other) - 1):
                    marks.append((at, -1 - k, False))
            marks.sort(key=lambda mark: mark[0])
            if closed_along and not crossings:
                inside = bool(self._inside_band(float(own[line])))
            else:
                inside = False
                if closed_along:
                    raise CheckFailedError("the outline crosses a line around the cylinder")
            run = []
            for at, node, toggles in marks:
                if toggles:
                    run.append((at, node, inside))
                    inside = not inside
                elif inside:
                    k = -1 - node
                    corner = (line, k) if axis == 0 else (k, line)
                    run.append((at, self._corner(corner), True))
            if closed_along and run:
                run.append((run[0][0] + (self._turn or 0.0), run[0][1], True))
            for number, ((a, start, _), (b, end, joined)) in enumerate(itertools.pairwise(run)):
                if joined:
                    self._add_piece(axis, line, number, (a, start), (b, end))

    def _inside_band(self, t: float) -> bool:
        ends = [node[1] for node in self.nodes]
        return min(ends) < t < max(ends)

    def _corner(self, corner: Cell) -> int:
        if corner not in self._corners:
            place = (self._lines[0][corner[0]], self._lines[1][corner[1]])
            self._corners[corner] = self._node(np.array(place))
        return self._corners[corner]

    def _add_piece(self, axis: int, line: int, number: int, a: tuple[float, int], b: tuple[float, int]) -> None:
        across = self._lines[axis]
        middle = (a[0] + b[0]) / 2.0
        along = int(np.searchsorted(self._lines[1 - axis], middle)) - 1
        points = np.empty((2, 2))
        points[:, axis] = across[line]
        points[:, 1 - axis] = a[0], b[0]
        key = ("st"[axis], line, along, number)
        piece = Piece(a[1], b[1], key, True, a[0], b[0], points)
        last = len(across) - 1
        before, after = line - 1, line
        if axis == 0 and self._turn is not None and line == 0:
            before = last - 1
        for k, direct in ((before, axis == 0), (after, axis == 1)):
            if 0 <= k < last:
                shown = piece
                if k == before and line == 0:  # the first line again, at the end of the last patch
                    shifted = points.copy()
                    shifted[:, axis] = across[-1]
                    shown = Piece(a[1], b[1], key, True, a[0], b[0], shifted)
                cell = (k, along) if axis == 0 else (along, k)
                self.cells[cell].append(shown if direct else shown.turned())

    def faces(self) -> Iterator[tuple[Cell, list[list[Piece]]]]:
        """Yield the connected parts of the region on each patch: the outer loop of pieces, then the inner loops."""
        for cell, pieces in sorted(self.cells.items()):
            loops = _chained(pieces)
            outlines = [np.concatenate([piece.points[:-1] for piece in loop]) for loop in loops]
            areas = [_area(points) for points in outlines]
            outer = [k for k, area in enumerate(areas) if area > 0.0]
            if not outer:
                raise CheckFailedError("the outline of the face and the lines between patches do not fit together")
            holes: dict[int, list[list[Piece]]] = {k: [] for k in outer}
            for k, area in enumerate(areas):
                if area <= 0.0:
                    around = [m for m in outer if _contains(outlines[m], outlines[k][0])]
                    holes[min(around or outer, key=lambda m: areas[m])].append(loops[k])
            for k in outer:
                yield cell, [loops[k], *holes[k]]


def _chained(pieces: list[Piece]) -> list[list[Piece]]:
    by_start = {piece.start: piece for piece in pieces}
    if len(by_start) != len(pieces):
        raise CheckFailedError("the outline of the face touches itself; choose another margin_mm")
    loops = []
    while by_start:
        _, piece = by_start.popitem()
        loop = [piece]
        while piece.end != loop[0].start:
            if piece.end not in by_start:
                raise CheckFailedError("the outline of the face is not closed on a patch; choose another margin_mm")
            piece = by_start.pop(piece.end)
            loop.append(piece)
        loops.append(loop)
    return loops


def _area(points: Floats) -> float:
    x, y = points.T
    return float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y) / 2.0)


def _contains(polygon: Floats, point: Floats) -> bool:
    x, y = polygon.T
    x2, y2 = np.roll(x, -1), np.roll(y, -1)
    crosses = (y > point[1]) != (y2 > point[1])
    with np.errstate(divide="ignore", invalid="ignore"):
        at = x + (point[1] - y) / (y2 - y) * (x2 - x)
    return bool(np.count_nonzero(crosses & (point[0] < at)) % 2)
