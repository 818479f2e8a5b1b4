"""A triangulated net over a surface, how it is measured, and how edges are split and flipped.

All operations treat many triangles at once with NumPy. Their decisions use sampled deviations, which are relative to
the tolerance: 1 means that a point is as far from the surface as allowed. Vertices do not lie on the surface: each has
a lift above it, because the best piecewise-linear fit of a curved surface has half the error of the interpolating one.
"""

from __future__ import annotations

import numpy as np

from tacbench_cad.geometry.meshing.heights import Heights
from tacbench_cad.spec.extremes import Footprint
from tacbench_cad.util.types import Bools, Floats, Ints

#: The number of triangles that are evaluated together. Their arrays fit into the processor's cache.
CHUNK = 1500
#: A triangle must be higher than this fraction of its longest side, and higher than ``MIN_HEIGHT_MM``.
MIN_SLOPE = 1e-3
MIN_HEIGHT_MM = 2e-4

#: The largest deviation of a vertex, in tolerances.
MAX_LIFT = 0.95


def lattice(steps: int, corners: bool) -> Floats:
    """Return the barycentric coordinates of a regular lattice, shape (k, 3), with or without the three corners."""
    i, j = np.meshgrid(np.arange(steps + 1), np.arange(steps + 1), indexing="ij")
    inside = i + j <= steps
    weights = np.column_stack([i[inside], j[inside], steps - i[inside] - j[inside]]) / steps
    return weights if corners else weights[weights.max(axis=1) < 1.0]


#: The points of a triangle at which it is compared with the surface.
_POINTS = lattice(4, corners=True)
#: The points at which the two diagonals of a pair of triangles are compared.
_FLIPPING = np.concatenate([lattice(2, corners=False), np.full((1, 3), 1.0 / 3.0)])


class Net:
    """Triangles over a rectangle.

    Args:
        heights: The table of the surface.
        points: The positions of the vertices, shape (n, 2).
        faces: The vertex indices of each triangle, counter-clockwise, shape (m, 3).
        lines: The number of the straight line on which a vertex must stay, or -1, for lines along y and lines along x,
            shape (n, 2). Lines 0 and 1 are sides, all other lines are creases.
        fixed: The vertices that must not move, shape (n,).
        peak: The vertex at the highest point.
        tolerance: The tolerance of the mesh.
        ceiling: The height that no vertex may exceed.
        region: The part of the rectangle outside of which vertices may exceed this height. They will be cut off.
    """

    def __init__(
        self,
        heights: Heights,
        points: Floats,
        faces: Ints,
        lines: Ints,
        fixed: Bools,
        peak: int,
        tolerance: float,
        ceiling: float,
        region: Footprint | None = None,
    ) -> None:
        self.heights = heights
        self.x, self.y = np.ascontiguousarray(points.T)
        self.lift = np.zeros(len(points))
        self.faces = faces
        self.lines = lines
        self.fixed = fixed
        self.peak = peak
        self.tolerance = tolerance
        self.ceiling = ceiling
        self.region = region
        self.deviation = np.full(len(faces), np.nan)
        #: The proved distance and vertical deviation of each triangle; NaN where they are not known.
        self.proof = np.full((2, len(faces)), np.nan)
        self.limit_lift(np.arange(len(points)))

    def height(self, vertices: Ints | slice = slice(None)) -> Floats:
        """Return the heights of some vertices."""
        return self.heights.height(self.x[vertices], self.y[vertices])[0] + self.lift[vertices]

    def measure(self) -> Floats:
        """Return the largest sampled deviation of each triangle, shape (m,)."""
        stale = np.flatnonzero(np.isnan(self.deviation))
        self.deviation[stale] = self.worst(self.faces[stale], self.height())
        return self.deviation

    def rounded_height(self, datum: float) -> Floats:
        """Round the vertices to float32 values, and return their heights above the underside.

        Args:
            datum: The height of the surface's zero above the underside.
        """
        self.x, self.y = (values.astype(np.float32).astype(np.float64) for values in (self.x, self.y))
        height, _ = self.heights.height(self.x, self.y)
        z = (datum + height + self.lift).astype(np.float32).astype(np.float64)
        # rounding x and y has changed the heights, which may have lifted vertices above the ceiling
        inside = self.below_ceiling(np.arange(len(z)))
        z[inside] = np.minimum(z[inside], float(np.float32(datum + self.ceiling)))
        self.lift = z - datum - height
        return z

    def worst(self, faces: Ints, z: Floats, at: Floats = _POINTS) -> Floats:
        """Return the largest deviation of triangles, in tolerances, shape (m,).

        Args:
            faces: The vertex indices, shape (m, 3).
            z: The heights of all vertices.
            at: The points of each triangle, in barycentric coordinates, shape (k, 3).
        """
        worst = np.empty(len(faces))
        for start in range(0, len(faces), CHUNK):
            part = faces[start : start + CHUNK].T
            height, cosine = self.heights.height(at @ self.x[part], at @ self.y[part])
            worst[start : start + CHUNK] = np.abs((at @ z[part] - height) * cosine).max(axis=0)
        return np.asarray(worst / self.tolerance)

    def turn(self, a: Ints, b: Ints, c: Ints) -> Floats:
        """Return twice the signed area of the triangles (a, b, c)."""
        x, y = self.x, self.y
        return np.asarray((x[b] - x[a]) * (y[c] - y[a]) - (y[b] - y[a]) * (x[c] - x[a]))

    def sound(self, a: Ints, b: Ints, c: Ints) -> Bools:
        """Check that triangles have positive areas and are not too narrow."""
        longest = np.zeros(len(a))
        for i, j in ((a, b), (b, c), (c, a)):
            longest = np.maximum(longest, self._square_length(i, j))
        return self.turn(a, b, c) > np.maximum(MIN_SLOPE * longest, MIN_HEIGHT_MM * np.sqrt(longest))

    def _bend(self, a: Ints, b: Ints) -> Floats:
        """Return ``d |H| d`` of edges d with the absolute Hessian, over the tolerance; the mean of three points."""
        return np.asarray(sum(self._bend_at(a, b, at) for at in (0.15, 0.5, 0.85)) / 3.0)

    def _bend_at(self, a: Ints, b: Ints, at: float) -> Floats:
        u, v = self.x[b] - self.x[a], self.y[b] - self.y[a]
        xx, xy, yy, cosine = self.heights.bends(self.x[a] + at * u, self.y[a] + at * v)
        # the absolute value of a symmetric 2 x 2 matrix H is (H H + |det H| I) / sqrt(tr(H H) + 2 |det H|)
        det = np.abs(xx * yy - xy**2)
        scale = np.sqrt(xx**2 + yy**2 + 2.0 * xy**2 + 2.0 * det) + 1e-300
        square = (xx * u + xy * v) ** 2 + (xy * u + yy * v) ** 2 + det * (u**2 + v**2)
        return np.asarray(square / scale * cosine / self.tolerance)

    def split_long(self, limit: float) -> int:
        """Split the edges on which the surface bends by more than a limit, in tolerances, and return their number."""
        a, b = self._edge_ends()
        long = self._bend(a, b) > limit
        return self._split(a[long], b[long])

    def split_triangles(self, which: Bools, by_length: bool = False) -> int:
        """Split one edge of each of these triangles.

        Args:
            which: A mask of the triangles, shape (m,).
            by_length: Split the longest edge; otherwise the edge on which the surface bends most.
        """
        corners = self.faces[which].T
        pairs = [(corners[k], corners[(k + 1) % 3]) for k in range(3)]
        size = self._square_length if by_length else self._bend
        longest = np.argmax([size(*pair) for pair in pairs], axis=0)
        rows = np.arange(corners.shape[1])
        a, b = (np.stack([pair[k] for pair in pairs])[longest, rows] for k in (0, 1))
        return self._split(np.minimum(a, b), np.maximum(a, b))

    def _square_length(self, a: Ints, b: Ints) -> Floats:
        return np.asarray((self.x[a] - self.x[b]) ** 2 + (self.y[a] - self.y[b]) ** 2)

    def _edge_ends(self) -> tuple[Ints, Ints]:
        keys = np.unique(self._edge_keys(len(self.x)))
        return keys // len(self.x), keys % len(self.x)

    def _edge_keys(self, count: int) -> Ints:
        """Return ``count`` times the smaller index plus the larger index for all edges, shape (m, 3)."""
        a, b = self.faces, self.faces[:, [1, 2, 0]]
        return np.asarray(np.minimum(a, b) * count + np.maximum(a, b))

    def _split(self, a: Ints, b: Ints) -> int:
        """Split edges (a < b) at their middles."""
        count = len(self.x)
        # an edge must stay long enough that its halves can form sound triangles
        enough = self._square_length(a, b) > (8.0 * MIN_HEIGHT_MM) ** 2
        keys = np.unique((a * count + b)[enough])
        if len(keys) == 0:
            return 0
        a, b = keys // count, keys % count
        self.x = np.append(self.x, (self.x[a] + self.x[b]) / 2.0)
        self.y = np.append(self.y, (self.y[a] + self.y[b]) / 2.0)
        self.lift = np.append(self.lift, (self.lift[a] + self.lift[b]) / 2.0)
        self.lines = np.concatenate([self.lines, np.where(self.lines[a] == self.lines[b], self.lines[a], -1)])
        self.fixed = np.append(self.fixed, np.zeros(len(keys), dtype=np.bool_))
        self.limit_lift(np.arange(count, len(self.x)))
        # the new vertex of each edge of each triangle, or -1
        old = self._edge_keys(count)
        place = np.minimum(np.searchsorted(keys, old), len(keys) - 1)
        middle = np.where(keys[place] == old, count + place, -1)
        touched = np.asarray((middle >= 0).any(axis=1))
        self.replace(touched, self._divided(self.faces[touched], middle[touched]))
        return len(keys)

    def _divided(self, faces: Ints, middle: Ints) -> Ints:
        """Divide triangles at the new vertices of one, two or three of their edges."""
        number = (middle >= 0).sum(axis=1)
        parts = []
        for count in (1, 2, 3):
            rows = np.flatnonzero(number == count)
            # turn each triangle so that its first edge is split, and the last one is not if there are two
            turn = (middle[rows] >= 0).argmax(axis=1) if count == 1 else ((middle[rows] < 0).argmax(axis=1) + 1) % 3
            order = (np.arange(3) + turn[:, None]) % 3
            a, b, c = np.take_along_axis(faces[rows], order, axis=1).T
            p, q, r = np.take_along_axis(middle[rows], order, axis=1).T
            if count == 1:
                parts += [(a, p, c), (p, b, c)]
            elif count == 2:
                parts.append((p, b, q))
                short = np.hypot(self.x[a] - self.x[q], self.y[a] - self.y[q]) < np.hypot(
                    self.x[p] - self.x[c], self.y[p] - self.y[c]
                )
                parts += [(a, p, np.where(short, q, c)), (np.where(short, a, p), q, c)]
            else:
                parts += [(a, p, r), (p, b, q), (r, q, c), (p, q, r)]
        return np.concatenate([np.stack(part, axis=1) for part in parts])

    def replace(self, old: Bools, new: Ints) -> None:
        """Replace some triangles by others."""
        self.faces = np.concatenate([self.faces[~old], new])
        self.deviation = np.concatenate([self.deviation[~old], np.full(len(new), np.nan)])
        self.proof = np.concatenate([self.proof[:, ~old], np.full((2, len(new)), np.nan)], axis=1)

    def flip(self, rounds: int, above: float | None = None) -> int:
        """Exchange the diagonals of pairs of triangles where that lowers their deviation.

        Args:
            rounds: The largest number of rounds.
            above: Only treat pairs with a sampled deviation above this, and compare sampled deviations. None treats
                all pairs, and compares estimates from the second derivatives.
        """
        total = 0
        for _ in range(rounds):
            first, second, p, q, c, d = self._pairs(above)
            gain = self._estimated_gain(p, q, c, d) if above is None else self._sampled_gain(p, q, c, d)
            useful = np.flatnonzero(gain > 0.0)
            useful = useful[_best_of_neighbours(first[useful], second[useful], gain[useful], len(self.faces))]
            first, second, p, q, c, d = (part[useful] for part in (first, second, p, q, c, d))
            self.faces[first] = np.stack([p, d, c], axis=1)
            self.faces[second] = np.stack([d, q, c], axis=1)
            for rows in (first, second):
                self.deviation[rows] = self.proof[:, rows] = np.nan
            total += len(useful)
            if len(useful) <= 0.002 * len(self.faces):
                break
        return total

    def _pairs(self, above: float | None) -> tuple[Ints, ...]:
        """Return all pairs of triangles (p, q, c) and (q, p, d) that can be flipped."""
        faces, rows = self.faces, np.arange(len(self.faces))
        if above is not None:
            # pairs with one bad triangle: all triangles with a vertex of a bad triangle are enough
            bad = np.zeros(len(self.x), dtype=np.bool_)
            bad[faces[self.measure() > above]] = True
            rows = np.flatnonzero(bad[faces].sum(axis=1) >= 2)
            faces = faces[rows]
        a, b = faces.ravel(), faces[:, [1, 2, 0]].ravel()
        keys = np.minimum(a, b) * len(self.x) + np.maximum(a, b)
        order = np.argsort(keys, kind="stable")
        same = np.flatnonzero(keys[order[1:]] == keys[order[:-1]])
        one, other = order[same], order[same + 1]
        first, second = rows[one // 3], rows[other // 3]
        p, q = a[one], b[one]
        c, d = (self.faces[t, (half % 3 + 2) % 3] for t, half in ((first, one), (second, other)))
        free = ~((self.lines[p] == self.lines[q]) & (self.lines[p] >= 0)).any(axis=1)
        if above is not None:
            free &= np.maximum(self.deviation[first], self.deviation[second]) > above
        free &= self.sound(p, d, c) & self.sound(d, q, c)
        return tuple(part[free] for part in (first, second, p, q, c, d))

    def _sampled_gain(self, p: Ints, q: Ints, c: Ints, d: Ints) -> Floats:
        z = self.height()
        pairs = np.concatenate([np.stack(part, axis=1) for part in ((p, q, c), (q, p, d), (p, d, c), (d, q, c))])
        worst = self.worst(pairs, z, _FLIPPING).reshape(2, 2, -1).max(axis=1)
        return np.asarray(worst[0] - worst[1] - 1e-3)

    def _estimated_gain(self, p: Ints, q: Ints, c: Ints, d: Ints) -> Floats:
        x, y = self.x, self.y
        corners = (p, q, c, d)
        xx, xy, yy, _ = self.heights.bends(sum(x[k] for k in corners) / 4.0, sum(y[k] for k in corners) / 4.0)
        det = xx * yy - xy**2

        def bend(a: Ints, b: Ints) -> Floats:
            u, v = x[a] - x[b], y[a] - y[b]
            return np.asarray(xx * u**2 + 2.0 * xy * u * v + yy * v**2)

        pq, pc, pd, qc, qd, cd = bend(p, q), bend(p, c), bend(p, d), bend(q, c), bend(q, d), bend(c, d)
        before = np.maximum(
            _estimate(pq, qc, pc, det, self.turn(p, q, c)), _estimate(pq, pd, qd, det, self.turn(q, p, d))
        )
        after = np.maximum(
            _estimate(pd, cd, pc, det, self.turn(p, d, c)), _estimate(qd, qc, cd, det, self.turn(d, q, c))
        )
        return np.asarray(before - after - 1e-3 * before)

    def limit_lift(self, vertices: Ints) -> None:
        """Keep vertices within the tolerance and below the ceiling, and the peak at the ceiling."""
        height, slope_x, slope_y, _ = self.heights.slopes(self.x[vertices], self.y[vertices])
        # along a crease the surface has several slopes, so that the lift is limited as if it were level
        level = (self.lines[vertices] >= 2).any(axis=1)
        most = MAX_LIFT * self.tolerance * np.where(level, 1.0, np.sqrt(1.0 + slope_x**2 + slope_y**2))
        ceiling = np.where(self.below_ceiling(vertices), self.ceiling, np.inf)
        self.lift[vertices] = np.minimum(np.clip(self.lift[vertices], -most, most), ceiling - height)
        self.raise_peak()

    def below_ceiling(self, vertices: Ints) -> Bools:
        """Return which vertices must not exceed the ceiling: those inside the region."""
        if self.region is None:
            return np.ones(len(vertices), dtype=np.bool_)
        # rounding to float32 can move a vertex on the outline outwards
        return np.asarray(self.region.distance(self.x[vertices], self.y[vertices]) <= 1e-5)

    def raise_peak(self) -> None:
        """Put the peak at the ceiling."""
        height, _ = self.heights.height(self.x[[self.peak]], self.y[[self.peak]])
        self.lift[self.peak] = self.ceiling - height[0]


def _estimate(a: Floats, b: Floats, c: Floats, det: Floats, turn: Floats) -> Floats:
    """Estimate the error of triangles by the forms ``d H d`` of their edges.

    Where the Hessian is definite, half of the interpolation error remains, and a triangle that is acute in the metric
    of the Hessian has the error of its circumscribed circle. Elsewhere the largest error is on an edge.
    """
    aa, bb, cc = np.abs(a), np.abs(b), np.abs(c)
    largest = np.maximum(np.maximum(aa, bb), cc)
    definite = det > 0.0
    acute = definite & (2.0 * largest < aa + bb + cc)
    circle = aa * bb * cc / (16.0 * turn**2 * np.maximum(det, 1e-300) + 1e-300)
    return np.asarray(np.where(acute, circle, np.where(definite, largest / 16.0, 0.9 * largest / 8.0)))


def _best_of_neighbours(first: Ints, second: Ints, gain: Floats, count: int) -> Bools:
    """Choose pairs of triangles such that no triangle is in two of them, by the largest gain."""
    gain = gain * (1.0 + 1e-9 * np.arange(len(gain)) / max(len(gain), 1))
    best = np.zeros(count)
    np.maximum.at(best, first, gain)
    np.maximum.at(best, second, gain)
    return np.asarray((gain == best[first]) & (gain == best[second]))
