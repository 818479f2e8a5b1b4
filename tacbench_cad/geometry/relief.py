"""Points on the triangles of a textured top, and their distances from a formula.

The distance of a point is the length of the shortest way to the surface of the formula. The proved bounds use the same
definition.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from tacbench_cad.geometry.mesh import Mesh
from tacbench_cad.util.types import Bools, Floats

#: A triangle is a wall if the z component of its unit normal is smaller than this.
WALL_FRACTION = 1e-4
#: The relative rounding of a float32 value.
_FLOAT32 = 2.0**-23
#: The approximate number of points in the triangles of a top. Every triangle gets at least four points.
POINTS = 200_000
#: The largest number of steps along a side of the lattice in a triangle. It gives 1,035 points.
MAX_STEPS = 44
#: The number of steps of the search for the nearest point of the surface.
STEPS = 6


@dataclass(frozen=True, kw_only=True)
class Distance:
    """The distances of points from a formula.

    Attributes:
        largest_mm: The largest distance.
        rms_mm: The root mean square of the distances.
        at_mm: The x, y and z of the point with the largest distance.
    """

    largest_mm: float
    rms_mm: float
    at_mm: tuple[float, float, float]


class Formula(Protocol):
    """A surface: heights and slopes over (x, y)."""

    def __call__(self, x: Floats, y: Floats, /) -> Floats:
        """Return the heights, shape (n,)."""
        ...

    def gradient(self, x: Floats, y: Floats, /) -> tuple[Floats, Floats]:
        """Return the slopes along x and along y, shape (n,) each."""
        ...


def upward(mesh: Mesh, normals: Floats) -> Bools:
    """Return which triangles face upwards and are not walls, shape (m,). In a block, these form the textured top."""
    return np.asarray((normals[:, 2] > 0.0) & ~walls(mesh, normals))


def walls(mesh: Mesh, normals: Floats) -> Bools:
    """Return which triangles are walls, shape (m,).

    The float32 rounding of its corners can tilt a narrow triangle of a wall, for example of the key's wall. A triangle
    therefore counts as a wall if its area seen from above is not larger than the effect of this rounding.
    """
    length = np.sqrt(np.einsum("ij,ij->i", normals, normals))
    rounded = 4.0 * _FLOAT32 * np.abs(mesh.vertices).max(initial=0.0) * np.ptp(mesh.triangle_points, axis=1).max(axis=1)
    return np.asarray(np.abs(normals[:, 2]) <= WALL_FRACTION * length + rounded)


def points_on(mesh: Mesh, which: Bools, points: int = POINTS) -> Floats:
    """Return dense points on triangles: their corners, the middles of their sides, and points inside.

    Every triangle gets a regular lattice with an even number of steps along each side. The lattice therefore includes
    the middles of the sides, where the error of straight lines is largest. If there are few triangles, the lattice is
    finer. Each vertex is returned once.

    Args:
        mesh: The mesh.
        which: A mask of the triangles to use, shape (m,).
        points: The approximate number of points.

    Returns:
        The points, shape (k, 3).
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


def distance(points: Floats, surface: Formula, datum_mm: float) -> Distance:
    """Return the distances of points from ``z = datum + surface(x, y)``.

    Args:
        points: The points in the frame of the surface, shape (k, 3), in mm. Only points of the surface within the
            rectangle around them count.
        surface: The formula in mm.
        datum_mm: The z of the formula's zero.
    """
    points = points - np.array([0.0, 0.0, datum_mm])
    nearest = np.abs(points[:, 2] - surface(points[:, 0], points[:, 1]))
    box = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    # A distance is never larger than the previous estimate. So the next steps are only for points whose estimate is
    # larger than the distance of the most likely points.
    for steps in (1, STEPS):
        likely = np.argpartition(nearest, -min(len(nearest), 1000))[-1000:]
        nearest[likely] = np.minimum(nearest[likely], _nearest(points[likely], surface, box, STEPS))
        possible = np.flatnonzero(nearest >= nearest[likely].max())
        nearest[possible] = np.minimum(nearest[possible], _nearest(points[possible], surface, box, steps))
    i = int(np.argmax(nearest))
    some = slice(None, None, max(1, len(points) // 20_000))
    x, y, z = points[i]
    return Distance(
        largest_mm=float(nearest[i]),
        rms_mm=float(np.sqrt(np.mean(_nearest(points[some], surface, box, 1) ** 2))),
        at_mm=(float(x), float(y), float(z + datum_mm)),
    )


def _nearest(points: Floats, surface: Formula, box: tuple[Floats, Floats], steps: int) -> Floats:
    """Return the distances to the nearest points of a surface that a few damped steps of Gauss and Newton find."""
    place, z = np.ascontiguousarray(points[:, :2].T), points[:, 2]
    low, high = (end[:, None] - place for end in box)
    shift, rest = np.zeros_like(place), z - surface(*place)
    nearest, step = np.abs(rest), np.ones(len(points))
    for _ in range(steps):
        slope = np.stack(surface.gradient(*(place + shift)))
        drop = rest + (slope * shift).sum(axis=0)
        full = slope * (drop / (1.0 + (slope**2).sum(axis=0)))
        # a coordinate that would leave the box stays at its side, and the other one follows from that
        bounded = np.clip(full, low, high)
        free = np.where(bounded == full, slope, 0.0)
        drop -= (slope * np.where(bounded == full, 0.0, bounded)).sum(axis=0)
        full = np.where(bounded == full, free * (drop / (1.0 + (free**2).sum(axis=0))), bounded)
        trial = np.clip(shift + step * (full - shift), low, high)
        left = z - surface(*(place + trial))
        length = np.sqrt((trial**2).sum(axis=0) + left**2)
        nearer = length < nearest
        shift, rest = np.where(nearer, trial, shift), np.where(nearer, left, rest)
        nearest, step = np.minimum(length, nearest), np.where(nearer, 1.0, 0.4 * step)
    return np.asarray(nearest)
