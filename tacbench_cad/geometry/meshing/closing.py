"""The walls and the underside, which close a textured sheet. They have no unnecessary vertices."""

from __future__ import annotations

import itertools

import numpy as np

from tacbench_cad.geometry.mesh import Mesh
from tacbench_cad.geometry.meshing.sheet import Sheet
from tacbench_cad.util.types import Floats, Indices


def close(sheet: Sheet) -> Mesh:
    """Add walls down to z = 0 and an underside.

    Args:
        sheet: The top, with heights above zero.

    Returns:
        A closed mesh whose faces are counter-clockwise seen from outside.
    """
    count, number = len(sheet.vertices), len(sheet.sides)
    corners = sheet.vertices[[side[0] for side in sheet.sides]]
    corners[:, 2] = 0.0
    walls = [_wall(sheet.vertices, side, count + k, count + (k + 1) % number) for k, side in enumerate(sheet.sides)]
    underside = np.array([(count, count + k + 1, count + k) for k in range(1, number - 1)], dtype=np.int32)
    return Mesh(np.concatenate([sheet.vertices, corners]), np.concatenate([sheet.faces, *walls, underside]))


def _wall(vertices: Floats, side: Indices, start: int, end: int) -> Indices:
    """Triangulate the polygon between a side of the top's outline and the straight edge below it.

    The polygon is monotone along the side, so the stack algorithm of Garey and others (1978) needs no new vertices.

    Args:
        vertices: The vertices of the top.
        side: The vertex indices along the side, counter-clockwise seen from above.
        start: The index of the corner below the first of these vertices.
        end: The index of the corner below the last of these vertices.
    """
    run = vertices[side]
    first, last = run[0], run[-1]
    axis = 0 if abs(last[0] - first[0]) >= abs(last[1] - first[1]) else 1
    chain = [start, *side.tolist()]
    along = [0.0, *np.abs(run[:, axis] - first[axis]).tolist()]
    height = [0.0, *run[:, 2].tolist()]
    triangles: list[tuple[int, int, int]] = []
    stack = [0]
    for k in range(1, len(chain)):
        while len(stack) > 1:
            i, j = stack[-2], stack[-1]
            turn = (along[j] - along[i]) * (height[k] - height[i]) - (height[j] - height[i]) * (along[k] - along[i])
            if turn >= 0.0:
                break
            triangles.append((chain[i], chain[k], chain[j]))
            stack.pop()
        stack.append(k)
    # the remaining chain becomes steeper and steeper from the start corner, so the end corner is visible from all of it
    triangles.extend((end, chain[j], chain[i]) for i, j in itertools.pairwise(stack))
    return np.array(triangles, dtype=np.int32)
