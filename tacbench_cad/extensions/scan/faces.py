"""The faces of a block, and the face to which each point of a scan belongs."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tacbench_cad.extensions.scan.height_model import Relief
from tacbench_cad.spec import Block
from tacbench_cad.util.types import Bools, Floats, Ints

#: The face of a point: nothing, the table or the underside, the top, or 2 plus the index of a wall.
NOTHING, TABLE, TOP, WALL = -2, 0, 1, 2


@dataclass(frozen=True)
class Wall:
    """A plane wall: the points with ``normal . (x, y) = offset``, between two places along it."""

    normal: tuple[float, float]
    offset: float
    between: tuple[float, float]


def walls_of(block: Block) -> tuple[Wall, ...]:
    """Return the walls of a rectangular block; none for another outline."""
    if block.outline is not None:
        return ()
    (x, y), key = block.size_mm, block.key_mm or 0.0
    walls = [
        Wall((-1.0, 0.0), 0.0, (-y, 0.0)),
        Wall((1.0, 0.0), x, (key, y)),
        Wall((0.0, -1.0), 0.0, (0.0, x - key)),
        Wall((0.0, 1.0), y, (-x, 0.0)),
    ]
    if key:
        half = math.sqrt(0.5)
        middle, reach = half * x, half * key
        walls.append(Wall((half, -half), half * (x - key), (middle - half * key, middle - half * key + 2.0 * reach)))
    return tuple(walls)


@dataclass(frozen=True, eq=False)
class Assigned:
    """The faces of points in the block frame.

    Args:
        face: The face of each point, shape (n,).
        error_mm: The height above the formula, or the distance from the printed wall or the table, shape (n,).
        normal: The derivative of the error by the point, shape (n, 3). Its length is 1 except on the top.
        clear: Whether the point is farther than the edge width from every edge of its face, shape (n,).
        slope2: The squared slope of the top, and 0 on other faces, shape (n,).
        scatter: What :meth:`Relief.scatter <tacbench_cad.extensions.scan.height_model.Relief.scatter>` says of the top,
            and 0 on other faces.
    """

    face: Ints
    error_mm: Floats
    normal: Floats
    clear: Bools
    slope2: Floats
    scatter: Floats


def assign(
    points: Floats,
    block: Block,
    relief: Relief,
    limit_mm: float,
    edge_mm: float,
    wall_offsets_mm: tuple[float, float] = (0.0, 0.0),
) -> Assigned:
    """Find the nearest face of each point.

    Args:
        points: Points in the block frame, shape (n, 3).
        block: The block.
        relief: The heights of its top.
        limit_mm: The largest distance from a face. Points farther away belong to nothing.
        edge_mm: The distance from edges within which a point may belong to two faces.
        wall_offsets_mm: How far the walls of the print lie outside of the block along x and along y.
    """
    x, y, z = points.T
    height, gx, gy = relief(x, y)
    slope2 = gx * gx + gy * gy
    above = z - height
    region = block.region
    (sx, sy) = block.size_mm
    outside = np.maximum(np.maximum(-x, x - sx), np.maximum(-y, y - sy))
    if region is not None:
        outside = np.maximum(outside, region.distance(x, y))
    best = np.full(len(x), limit_mm)
    face = np.full(len(x), NOTHING)
    error = np.full(len(x), np.nan)
    normal = np.zeros((len(x), 3))
    clear = np.zeros(len(x), dtype=bool)

    def claim(kind: int, signed: Floats, distance: Floats, allowed: Bools, away: Bools) -> Bools:
        take = allowed & (distance < best)
        best[take] = distance[take]
        face[take], error[take], clear[take] = kind, signed[take], away[take]
        return take

    inward = min(*wall_offsets_mm, 0.0)
    take = claim(TOP, above, np.abs(above) / np.sqrt(1.0 + slope2), outside <= edge_mm, outside < inward - edge_mm)
    normal[take] = np.column_stack([-gx[take], -gy[take], np.ones(np.count_nonzero(take))])
    for index, wall in enumerate(walls_of(block)):
        (nx, ny), (low, high) = wall.normal, wall.between
        signed = nx * x + ny * y - wall.offset - nx * nx * wall_offsets_mm[0] - ny * ny * wall_offsets_mm[1]
        along = -ny * x + nx * y
        near = (np.abs(signed) < limit_mm) & (along > low - edge_mm) & (along < high + edge_mm) & (z > -edge_mm)
        # Whether a point is below the rim must not depend on its noise along the normal, so the rim is computed from
        # its place along the wall. A steep flank of the top may stand at the rim itself.
        rim = np.full(len(x), -np.inf)
        depths = np.array([0.0, 0.5, 1.0]) * edge_mm - inward
        feet = [
            wall.offset * np.array([nx, ny]) + along[near, None] * np.array([-ny, nx]) - d * np.array([nx, ny])
            for d in depths
        ]
        rim[near] = np.min([relief(*np.ascontiguousarray(foot.T))[0] for foot in feet], axis=0)
        below = near & (z < rim - edge_mm)
        away = below & (along > low + edge_mm) & (along < high - edge_mm) & (z > edge_mm)
        take = below & ((np.abs(signed) < best) | (np.abs(signed) <= edge_mm))
        take |= near & (above < edge_mm) & (np.abs(signed) < best)
        best[take] = np.abs(signed[take])
        face[take], error[take], clear[take] = WALL + index, signed[take], away[take]
        normal[take] = (nx, ny, 0.0)
    on_table = outside > -edge_mm
    take = claim(TABLE, z.copy(), np.abs(z), on_table | (above < -0.5 * block.base_mm), outside > edge_mm)
    normal[take] = (0.0, 0.0, 1.0)
    top = face == TOP
    return Assigned(
        face, error, normal, clear, np.where(top, slope2, 0.0), np.where(top, relief.scatter(x, y, slope2), 0.0)
    )
