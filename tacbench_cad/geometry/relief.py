"""Points of a textured top, from triangles, and how far they lie from a formula.

The distance at a point of the top is ``|z - formula| / sqrt(1 + |gradient|^2)`` at its own x and y: to first order
the distance to the surface, and the measure in which the certificates are stated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tacbench_cad.geometry.mesh import Mesh
from tacbench_cad.spec.waves import WaveSum
from tacbench_cad.util.types import Bools, Floats

#: Triangles whose normal has a smaller vertical fraction than this are walls.
WALL_FRACTION = 1e-4
#: Relative rounding of a float32 value.
_FLOAT32 = 2.0**-23
#: About so many points are taken inside the triangles of a top; never fewer than four in each triangle.
POINTS = 200_000
#: The finest lattice of points in one triangle: so many steps along a side, 1,035 points.
MAX_STEPS = 44


@dataclass(frozen=True, kw_only=True)
class Distance:
    """How far points lie from a formula.

    Attributes:
        largest_mm: The largest distance.
        rms_mm: The root mean square.
        at_mm: x, y, z of the point with the largest distance.
    """

    largest_mm: float
    rms_mm: float
    at_mm: tuple[float, float, float]


def upward(mesh: Mesh, normals: Floats) -> Bools:
    """Which triangles face upwards and are no walls, shape (m,); in a block of ours they are the textured top.

    A narrow triangle of a slanting wall, such as the key's, may lean by what float32 rounds its corners: its area seen
    from above is then smaller than that rounding can make it.
    """
    length = np.sqrt(np.einsum("ij,ij->i", normals, normals))
    rounded = 4.0 * _FLOAT32 * np.abs(mesh.vertices).max(initial=0.0) * np.ptp(mesh.triangle_points, axis=1).max(axis=1)
    return np.asarray(normals[:, 2] > WALL_FRACTION * length + rounded)


def points_on(mesh: Mesh, which: Bools, points: int = POINTS) -> Floats:
    """Dense points on triangles: their corners, the middles of their sides, and points inside.

    Every triangle carries a regular lattice with an even number of steps a side (so that side middles, where straight
    lines are worst, belong to it); few triangles carry finer lattices. Each vertex comes once.

    Args:
        mesh: The mesh.
        which: Its triangles to take, shape (m,).
        points: About how many are wanted.

    Returns:
        Points, shape (k, 3).
    """
    triangles = mesh.faces[which]
    per_triangle = points / max(len(triangles), 1)
    steps = int(np.clip(2 * round(np.sqrt(2.0 * per_triangle) / 2.0), 2, MAX_STEPS))
    first, second = np.meshgrid(np.arange(steps + 1), np.arange(steps + 1), indexing="ij")
    corner = (np.maximum(first, second) == steps) | (first + second == 0)
    inside = (first + second <= steps) & ~corner
    a, b = first[inside] / steps, second[inside] / steps
    weights = np.stack([1.0 - a - b, a, b], axis=1)
    if steps == 2:
        weights = np.vstack([weights, [1.0 / 3.0] * 3])
    used = np.zeros(len(mesh.vertices), dtype=bool)
    used[triangles.ravel()] = True
    corners = mesh.vertices[triangles]
    between = np.concatenate([np.einsum("k,mkc->mc", row, corners) for row in weights])
    return np.concatenate([mesh.vertices[used], between])


def distance(points: Floats, surface: WaveSum, datum_mm: float) -> Distance:
    """Distances of points from ``z = datum + surface(x, y)``.

    Args:
        points: Shape (k, 3), in mm, in the surface's frame.
        surface: The formula in mm.
        datum_mm: z of its zero.
    """
    x, y, z = np.ascontiguousarray(points.T)
    vertical = np.abs(z - datum_mm - surface(x, y))
    # The gradient is needed only where it can matter: no distance is larger than the vertical one.
    likely = np.argpartition(vertical, -min(len(vertical), 1000))[-1000:]
    best = float(_slanted(vertical[likely], x[likely], y[likely], surface).max())
    possible = np.nonzero(vertical >= best)[0]
    slanted = _slanted(vertical[possible], x[possible], y[possible], surface)
    i = possible[int(np.argmax(slanted))]
    some = slice(None, None, max(1, len(x) // 20_000))
    sample = _slanted(vertical[some], x[some], y[some], surface)
    return Distance(
        largest_mm=float(slanted.max()),
        rms_mm=float(np.sqrt(np.mean(sample**2))),
        at_mm=(float(x[i]), float(y[i]), float(z[i])),
    )


def _slanted(vertical: Floats, x: Floats, y: Floats, surface: WaveSum) -> Floats:
    along_x, along_y = surface.gradient(x, y)
    return np.asarray(vertical / np.sqrt(1.0 + along_x**2 + along_y**2))
