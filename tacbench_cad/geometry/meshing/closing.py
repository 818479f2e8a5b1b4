"""The walls and the underside, which close a textured sheet. They have no unnecessary vertices."""

from __future__ import annotations

import itertools

import numpy as np

from tacbench_cad.geometry.mesh import Mesh
from tacbench_cad.geometry.meshing.sheet import Sheet
from tacbench_cad.spec.label import LABEL_DEPTH_MM, Engraving
from tacbench_cad.util.types import Floats, Indices

#: A triangle has no area if its height is at most this fraction of its longest side.
_FLAT = 1e-7


def close(sheet: Sheet, engraving: Engraving | None) -> Mesh:
    """Add walls down to z = 0 and an underside.

    Args:
        sheet: The top, with heights above zero.
        engraving: The pockets in the underside, or None.

    Returns:
        A closed mesh whose faces are counter-clockwise seen from outside.
    """
    count = len(sheet.vertices)
    corners = sheet.vertices[[side[0] for side in sheet.sides]]
    corners[:, 2] = 0.0
    faces = [sheet.faces]
    for k, side in enumerate(sheet.sides):
        start, end = count + k, count + (k + 1) % len(sheet.sides)
        faces.append(_wall(sheet.vertices, side, start, end))
    if engraving is None:
        fan = [(count, count + k + 1, count + k) for k in range(1, len(corners) - 1)]
        faces.append(np.array(fan, dtype=np.int32))
        vertices = [sheet.vertices, corners]
    else:
        added, triangles = _engraved_underside(corners, engraving, count)
        faces.append(triangles)
        vertices = [sheet.vertices, added]
    return Mesh(np.concatenate(vertices), np.concatenate(faces))


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


def _engraved_underside(corners: Floats, engraving: Engraving, count: int) -> tuple[Floats, Indices]:
    """Make the underside around the pockets, and the walls and ceilings of the pockets.

    Args:
        corners: The outline, counter-clockwise seen from above, shape (k, 3).
        engraving: The pockets.
        count: The index of the first returned vertex.

    Returns:
        The vertices, beginning with the corners, and the triangles with their final indices.
    """
    from manifold3d import triangulate

    contours = [np.asarray(contour, dtype=np.float64) for contour in engraving.contours]
    points = np.concatenate(contours)
    total = len(points)
    low = np.column_stack([points, np.zeros(total)])
    high = np.column_stack([points, np.full(total, float(np.float32(LABEL_DEPTH_MM)))])
    first_low = count + len(corners)
    first_high = first_low + total
    ends = np.cumsum([len(contour) for contour in contours])
    runs = [np.arange(stop - len(contour), stop) for contour, stop in zip(contours, ends, strict=True)]
    # the underside: seen from above, the outline is counter-clockwise, and the pockets are holes in it
    reversed_runs = [run[::-1] for run in runs]
    outline = [corners[:, :2], *(points[run] for run in reversed_runs)]
    numbers = np.concatenate([count + np.arange(len(corners)), *(first_low + run for run in reversed_runs)])
    flat = numbers[_with_area(np.concatenate(outline), triangulate(outline))][:, ::-1]
    ceilings = (first_high + triangulate(contours))[:, ::-1]
    walls = []
    for run in runs:
        a, b = run, np.roll(run, -1)
        walls.append(np.column_stack([first_low + a, first_high + a, first_high + b]))
        walls.append(np.column_stack([first_low + a, first_high + b, first_low + b]))
    faces = np.concatenate([flat, ceilings, *walls]).astype(np.int32)
    return np.concatenate([corners, low, high]), faces


def _with_area(points: Floats, triangles: Indices) -> Indices:
    """Flip the longest sides of triangles without area, which connect corners of several glyphs on one line.

    Args:
        points: The points in the plane, shape (n, 2).
        triangles: Counter-clockwise triangles, shape (m, 3).
    """
    rounded = points.astype(np.float32).astype(np.float64)
    faces = [tuple(face) for face in np.asarray(triangles).tolist()]
    owner = {(face[k], face[k - 2]): number for number, face in enumerate(faces) for k in range(3)}
    waiting = list(range(len(faces)))
    for _ in range(20 * len(faces)):  # each flip brings two triangles back
        if not waiting:
            break
        number = waiting.pop()
        corners = rounded[list(faces[number])]
        sides = np.roll(corners, -1, axis=0) - corners
        lengths = (sides**2).sum(axis=1)
        k = int(lengths.argmax())
        u, v, w = (faces[number][(k + step) % 3] for step in range(3))
        area = abs(float(sides[0, 0] * sides[1, 1] - sides[0, 1] * sides[1, 0]))
        beside = owner.get((v, u))
        if area > _FLAT * float(lengths[k]) or beside is None:
            continue
        d = next(corner for corner in faces[beside] if corner not in (u, v))
        faces[number], faces[beside] = (u, d, w), (d, v, w)
        owner |= {(u, d): number, (d, w): number, (w, u): number, (d, v): beside, (v, w): beside, (w, d): beside}
        del owner[u, v], owner[v, u]
        waiting += [number, beside]
    return np.array(faces, dtype=np.int32)
