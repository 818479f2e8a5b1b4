"""The volume below a faceted top, computed in another way than by adding up the triangles of the mesh.

For a separable top it follows in closed form from the lines and heights alone. For any other top it is the closed
form of the formula plus the integral of the deviation of each triangle. That sum is only equal to the volume of the
mesh if the triangles cover each point of the block exactly once.
"""

from __future__ import annotations

import math

import numpy as np

from tacbench_cad.geometry.meshing.top import Profiles, Top
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.outlines import Polygons
from tacbench_cad.util.types import Floats, Indices

#: The number of triangles that are evaluated together.
CHUNK = 20_000
#: The approximate number of parts into which all triangles together are divided for an integral.
PARTS = 30_000
#: Points and weights of a quadrature on a triangle that is exact for polynomials up to degree 5 (Radon, 1948).
_A, _B = (6.0 - math.sqrt(15.0)) / 21.0, (6.0 + math.sqrt(15.0)) / 21.0
_POINTS = np.array(
    [[1.0 / 3.0] * 3, *(np.roll([1.0 - 2.0 * t, t, t], shift).tolist() for t in (_A, _B) for shift in range(3))]
)
_WEIGHTS = np.array([0.225] + [(155.0 - math.sqrt(15.0)) / 1200.0] * 3 + [(155.0 + math.sqrt(15.0)) / 1200.0] * 3)


def deviation_mm3(block: Block, vertices: Floats, faces: Indices) -> tuple[float, float]:
    """Return the integral of the height of triangles above the formula, and an estimate of the error of this integral.

    The estimate compares the integral with one of half the step, for some or all of the triangles.
    """
    parts = int(np.clip(math.sqrt(PARTS / len(faces)), 1, 8))
    stride = max(1, len(faces) * parts**2 // PARTS)
    total = _integrals(block, vertices, faces, parts)
    change = _integrals(block, vertices, faces[::stride], 2 * parts) - total[::stride]
    error = abs(float(change.sum())) + 3.0 * math.sqrt(float(change @ change))
    if stride == 1:
        return float(total.sum() + change.sum()), error
    return float(total.sum()), stride * error


def _integrals(block: Block, vertices: Floats, faces: Indices, parts: int) -> Floats:
    """Integrate the height above the formula over triangles, each of them divided into ``parts^2`` triangles."""
    points = _composite(parts)
    weights = np.tile(_WEIGHTS, parts**2) / parts**2
    step = max(1, CHUNK // parts**2)
    runs = []
    for start in range(0, len(faces), step):
        corners = vertices[faces[start : start + step]].transpose(2, 1, 0)
        x, y, z = (points @ values for values in corners)
        u, v = corners[:2, 1] - corners[:2, 0], corners[:2, 2] - corners[:2, 0]
        runs.append((weights @ (z - block.height_at(x, y))) * (u[0] * v[1] - u[1] * v[0]) / 2.0)
    return np.concatenate(runs)


def _composite(parts: int) -> Floats:
    """Return the barycentric points of the quadrature on each part of a divided triangle."""
    points = []
    for i in range(parts):
        for j in range(parts - i):
            corners = [np.array([[i, j], [i + 1, j], [i, j + 1]])]
            if i + j < parts - 1:
                corners.append(np.array([[i + 1, j], [i + 1, j + 1], [i, j + 1]]))
            points += [_POINTS @ corner for corner in corners]
    place = np.concatenate(points) / parts
    return np.column_stack([1.0 - place.sum(axis=1), place])


def profiles_mm3(datum_mm: float, top: Top, profiles: Profiles, chords: Polygons) -> float:
    """Return the volume below ``datum + a(x) + b(y)`` inside of polygons, as integrals along their sides.

    With the antiderivatives A and B, these are the integrals of ``A(x) dy`` and of ``-B(y) dx``.
    """
    volume = datum_mm * chords.area_mm2
    for number, loop in enumerate(chords.loops):
        sign = 1.0 if number == 0 else -1.0
        x, y = loop.array.T
        volume += sign * _along_sides(top.x, profiles.a, x, y)
        volume -= sign * _along_sides(top.y, profiles.b, y, x)
    return volume


def _along_sides(lines: Floats, heights: Floats, t: Floats, s: Floats) -> float:
    """Return the integral of ``A(t) ds`` along a closed polygon, where A is the antiderivative of a linear spline."""
    steps = np.diff(lines)
    sums = np.append(0.0, np.cumsum(steps * (heights[1:] + heights[:-1]) / 2.0))

    def antiderivative(at: Floats) -> Floats:
        at = np.clip(at, lines[0], lines[-1])
        i = np.clip(np.searchsorted(lines, at, side="right") - 1, 0, len(steps) - 1)
        run = at - lines[i]
        return np.asarray(sums[i] + run * (heights[i] + run * (heights[i + 1] - heights[i]) / (2.0 * steps[i])))

    total = 0.0
    for t0, t1, s0, s1 in zip(t, np.roll(t, -1), s, np.roll(s, -1), strict=True):
        low, high = min(t0, t1), max(t0, t1)
        inner = lines[(lines > low) & (lines < high)]
        points = np.concatenate([[low], inner, [high]])
        middle = (points[:-1] + points[1:]) / 2.0
        if high == low:
            total += float(antiderivative(np.array([low]))[0]) * (s1 - s0)
            continue
        # Simpson's rule is exact between lines.
        values = antiderivative(points[:-1]) + 4.0 * antiderivative(middle) + antiderivative(points[1:])
        total += float(np.diff(points) @ values) / 6.0 / (high - low) * (s1 - s0)
    return total
