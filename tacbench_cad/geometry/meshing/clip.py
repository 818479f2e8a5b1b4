"""Triangles of a faceted top, without the corner that the key cuts off, and the outline divided into its sides."""

from __future__ import annotations

import numpy as np

from tacbench_cad.geometry.meshing.sheet import Sheet
from tacbench_cad.geometry.meshing.top import Top, cut_excess, single
from tacbench_cad.util.types import Bools, Floats, Indices


def sheet(top: Top, key_mm: float | None, height_mm: float) -> Sheet:
    """Triangulate a top.

    Args:
        top: The top.
        key_mm: The leg of the corner at (X, 0) that is cut off, or None.
        height_mm: The height of the highest vertex, a float32 value. Vertices on the cut are limited to this height.
    """
    if key_mm is not None:
        return _keyed(top, key_mm, height_mm)
    n, m = len(top.x), len(top.y)
    index = np.arange(n * m, dtype=np.int32).reshape(n, m)
    sides = (index[:, 0], index[-1, :], index[::-1, -1], index[0, ::-1])
    return Sheet(_vertices(top), _cell_triangles(index, top.rising, None), sides)


def _vertices(top: Top) -> Floats:
    n, m = len(top.x), len(top.y)
    vertices = np.empty((n, m, 3))
    vertices[:, :, 0] = top.x[:, None]
    vertices[:, :, 1] = top.y[None, :]
    vertices[:, :, 2] = top.z
    return vertices.reshape(-1, 3)


def _cell_triangles(index: Indices, rising: Bools | None, chosen: Bools | None) -> Indices:
    """Return two triangles for each cell or each chosen cell, which is divided along its diagonal."""
    corners = (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:])
    a, b, c, d = (part.ravel() if chosen is None else part[chosen] for part in corners)
    triangles = np.empty((len(a), 2, 3), dtype=np.int32)
    for slot, pair in enumerate(((a, b), (b, c), (d, d))):
        triangles[:, 0, slot], triangles[:, 1, slot] = pair
    if rising is not None:
        turned = rising.ravel() if chosen is None else rising[chosen]
        triangles[turned, 0, 2], triangles[turned, 1, 0] = c[turned], a[turned]
    return triangles.reshape(-1, 3)


def _keyed(top: Top, key_mm: float, height_mm: float) -> Sheet:
    n, m = len(top.x), len(top.y)
    index = np.arange(n * m, dtype=np.int32).reshape(n, m)
    excess = cut_excess(top.x, top.y, key_mm)
    whole = (excess[1:, :-1] <= 0.0) & (excess[:-1, 1:] < 0.0)
    crossed = (excess[1:, :-1] > 0.0) & (excess[:-1, 1:] < 0.0)
    cutter = _Cutter(_vertices(top), excess.ravel())
    faces = [_cell_triangles(index, top.rising, whole)]
    for i, j in np.argwhere(crossed):
        corners = [int(index[k]) for k in ((i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1))]
        faces.extend(_fan(cutter.keep(polygon)) for polygon in _pieces(top, int(i), int(j), corners))
    added = np.array(cutter.added).reshape(-1, 3)
    vertices = np.concatenate([cutter.vertices, added])
    keyed = _compact(vertices, np.concatenate(faces), np.append(excess.ravel(), np.zeros(len(added))), top)
    _crown(keyed.vertices, height_mm)
    return keyed


def _pieces(top: Top, i: int, j: int, corners: list[int]) -> list[tuple[int, ...]]:
    """Return the planar pieces of a cell: the whole cell, or its two triangles."""
    a, b, c, d = corners
    if top.profiles is not None:
        return [(a, b, c, d)]
    if top.rising is not None and top.rising[i, j]:
        return [(a, b, c), (a, c, d)]
    return [(a, b, d), (b, c, d)]


def _crown(vertices: Floats, height_mm: float) -> None:
    """Limit the vertices to a height, and set the highest vertex to exactly this height in spite of rounding."""
    z = vertices[:, 2]
    np.minimum(z, height_mm, out=z)
    z[np.argmax(z)] = height_mm


class _Cutter:
    """Clips polygons by the cut. An edge that several polygons share gets only one new vertex."""

    def __init__(self, vertices: Floats, excess: Floats) -> None:
        self.vertices = vertices
        self.excess = excess
        self.added: list[Floats] = []
        self._on_edge: dict[tuple[int, int], int] = {}

    def keep(self, polygon: tuple[int, ...]) -> list[int]:
        """Return the part of a convex polygon that is not cut off. It is an empty list if no area is left."""
        kept: list[int] = []
        for first, second in zip(polygon, (*polygon[1:], polygon[0]), strict=True):
            e0, e1 = self.excess[first], self.excess[second]
            if e0 <= 0.0:
                kept.append(first)
            if e0 * e1 < 0.0:
                kept.append(self._crossing(min(first, second), max(first, second)))
        return kept if any(v < len(self.excess) and self.excess[v] < 0.0 for v in kept) else []

    def _crossing(self, first: int, second: int) -> int:
        vertex = self._on_edge.get((first, second))
        if vertex is None:
            p, q = self.vertices[first], self.vertices[second]
            fraction = self.excess[first] / (self.excess[first] - self.excess[second])
            place = single(p + fraction * (q - p))
            # the height is taken at the rounded position, so that an edge along a grid line stays straight
            along = 0 if abs(q[0] - p[0]) >= abs(q[1] - p[1]) else 1
            fraction = (place[along] - p[along]) / (q[along] - p[along])
            place[2] = single(p[2] + fraction * (q[2] - p[2]))
            vertex = len(self.vertices) + len(self.added)
            self.added.append(place)
            self._on_edge[first, second] = vertex
        return vertex


def _fan(polygon: list[int]) -> Indices:
    fan = [(polygon[0], polygon[k], polygon[k + 1]) for k in range(1, len(polygon) - 1)]
    return np.array(fan, dtype=np.int32).reshape(-1, 3)


def _compact(vertices: Floats, triangles: Indices, excess: Floats, top: Top) -> Sheet:
    """Remove unused vertices and find the five sides."""
    used = np.zeros(len(vertices), dtype=np.bool_)
    used[triangles] = True
    number = np.cumsum(used, dtype=np.int32) - 1
    kept, on_cut = vertices[used], excess[used] == 0.0
    x, y = kept[:, 0], kept[:, 1]
    runs = (
        (y == 0.0, x),
        (on_cut, x + y),
        (x == top.x[-1], y),
        (y == top.y[-1], -x),
        (x == 0.0, -y),
    )
    sides = []
    for chosen, order in runs:
        members = np.flatnonzero(chosen)
        sides.append(members[np.argsort(order[members], kind="stable")].astype(np.int32))
    return Sheet(kept, number[triangles], tuple(sides))
