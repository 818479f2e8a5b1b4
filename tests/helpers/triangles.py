"""The heights of triangles that another program has read."""

from __future__ import annotations

import numpy as np

from tacbench_cad.util.types import Floats, Ints


def heights_mm(points: Floats, triangles: Ints, places: Floats) -> Floats:
    """Return z of the highest triangle over each place.

    Args:
        points: The vertices in mm, z up, shape (n, 3).
        triangles: The vertex indices of the triangles, shape (m, 3).
        places: The places (x, y), shape (k, 2).
    """
    a, b, c = np.moveaxis(points[triangles], 1, 0)
    twice = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    upward = twice > 0.0  # triangles of the top; walls have no area in this projection
    a, b, c, twice = a[upward], b[upward], c[upward], twice[upward]
    low, high = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
    heights = []
    for x, y in places:
        near = (low[:, 0] <= x) & (x <= high[:, 0]) & (low[:, 1] <= y) & (y <= high[:, 1])
        p, q, r, area = a[near], b[near], c[near], twice[near]
        s = ((x - p[:, 0]) * (r[:, 1] - p[:, 1]) - (y - p[:, 1]) * (r[:, 0] - p[:, 0])) / area
        t = ((q[:, 0] - p[:, 0]) * (y - p[:, 1]) - (q[:, 1] - p[:, 1]) * (x - p[:, 0])) / area
        over = (s >= -1e-9) & (t >= -1e-9) & (s + t <= 1.0 + 1e-9)
        assert over.any(), f"a hole over {x:g}, {y:g} mm"
        z = p[:, 2] + s * (q[:, 2] - p[:, 2]) + t * (r[:, 2] - p[:, 2])
        heights.append(float(z[over].max()))
    return np.array(heights)
