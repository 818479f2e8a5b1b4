"""Moving and lifting the vertices of a net so that the deviations become smaller and more even."""

from __future__ import annotations

import numpy as np

from tacbench_cad.geometry.meshing.net import CHUNK, Net, lattice
from tacbench_cad.util.types import Floats, Ints

#: The points of a triangle whose deviations decide where its vertices move.
_MOVING = np.concatenate([lattice(2, corners=True), (1.0 + 3.0 * np.eye(3)) / 6.0, np.full((1, 3), 1.0 / 3.0)])


def relax(net: Net, power: int, steps: int, above: float | None = None) -> None:
    """Move and lift vertices so that the sum of a power of the deviations becomes smaller.

    Each step is a damped Gauss-Newton step of each vertex alone.

    Args:
        net: The net, which is changed.
        power: The power. High powers lower the largest deviations.
        steps: The number of steps.
        above: Only move vertices of triangles with a sampled deviation above this, and only if no deviation
            becomes larger than it and than before. None moves all vertices.
    """
    for _ in range(steps):
        active = np.ones(len(net.x), dtype=np.bool_)
        if above is not None:
            active[:] = False
            active[net.faces[net.measure() > above]] = True
            if not active.any():
                return
        rows = np.arange(len(net.faces)) if above is None else np.flatnonzero(active[net.faces].any(axis=1))
        shift = _shift(net, net.faces[rows], power)
        shift[:, ~active] = 0.0
        _move(net, rows, shift, above)


def _shift(net: Net, faces: Ints, power: int) -> Floats:
    """Return the changes of x, y and lift of each vertex, shape (3, n)."""
    count, weights = len(net.x), _MOVING.T
    sums = np.empty((9, 3, len(faces)))
    height, gx, gy, _ = net.heights.slopes(net.x, net.y)
    z = height + net.lift
    for start in range(0, len(faces), CHUNK):
        part = faces[start : start + CHUNK].T
        value, sx, sy, cosine = net.heights.slopes(_MOVING @ net.x[part], _MOVING @ net.y[part])
        scale = cosine / net.tolerance
        deviation = (_MOVING @ z[part] - value) * scale
        pull = np.abs(deviation) ** (power - 2) * scale
        force, stiff = pull * deviation, pull * scale
        along_x, along_y = stiff * sx, stiff * sy
        terms = (force, force * sx, force * sy, stiff, along_x, along_y, along_x * sx, along_x * sy, along_y * sy)
        for row, term in enumerate(terms):
            sums[row, :, start : start + CHUNK] = weights @ term
    corner = faces.T.ravel()
    f, fx, fy, k, kx, ky, kxx, kxy, kyy = (np.bincount(corner, row.ravel(), count) for row in sums)
    # forces and stiffness along the lift z and along x and y, on which the slope changes the height
    forces = np.stack([gx * f - fx, gy * f - fy, f])
    xx, yy = gx**2 * k - 2.0 * gx * kx + kxx, gy**2 * k - 2.0 * gy * ky + kyy
    xy = gx * gy * k - gx * ky - gy * kx + kxy
    xz, yz = gx * k - kx, gy * k - ky
    least = 1e-12 * (float(k.max(initial=0.0)) + 1e-300)
    damping = 0.1 * (xx + yy) + least
    matrix = np.empty((count, 3, 3))
    matrix[:, 0], matrix[:, 1] = np.stack([xx + damping, xy, xz], 1), np.stack([xy, yy + damping, yz], 1)
    matrix[:, 2] = np.stack([xz, yz, 1.05 * k + least], 1)
    shift = np.asarray(-np.linalg.solve(matrix, forces.T[:, :, None])[:, :, 0].T, dtype=np.float64)
    _keep_on_lines(net, shift, forces, matrix)
    return shift


def _keep_on_lines(net: Net, shift: Floats, force: Floats, matrix: Floats) -> None:
    """Let vertices on a line move only along it, and fixed vertices not at all."""
    for family, direction in enumerate(((0.0, 1.0), (1.0, 0.0))):
        on = np.flatnonzero(net.lines[:, family] >= 0)
        u, v = direction
        bend = u * u * matrix[on, 0, 0] + 2.0 * u * v * matrix[on, 0, 1] + v * v * matrix[on, 1, 1]
        along = -(u * force[0, on] + v * force[1, on]) / bend
        shift[0, on], shift[1, on] = u * along, v * along
        shift[2, on] = -force[2, on] / matrix[on, 2, 2]
    still = net.fixed | ((net.lines >= 0).sum(axis=1) >= 2)
    shift[:2, still] = 0.0


def _move(net: Net, rows: Ints, shift: Floats, above: float | None) -> None:
    """Change vertices by 0.7 times their shifts, as far as the triangles stay sound."""
    faces = net.faces[rows]
    a, b, c = faces.T
    before = net.turn(a, b, c)
    x, y, lift = net.x.copy(), net.y.copy(), net.lift.copy()
    deviation = None if above is None else np.maximum(net.measure()[rows], 0.98 * above)
    step = np.full(len(x), 0.7)
    for attempt in range(12):
        net.x, net.y, net.lift = x + step * shift[0], y + step * shift[1], lift + step * shift[2]
        net.limit_lift(np.flatnonzero(step > 0.0))
        movable = (step[faces] > 0.0).any(axis=1)
        bad = ((net.turn(a, b, c) < 0.3 * before) | ~net.sound(a, b, c)) & movable
        if deviation is not None and (attempt > 0 or not bad.any()):
            bad |= (net.worst(faces, net.height()) > deviation) & movable
        if not bad.any():
            break
        step[faces[bad]] *= 0.4 if attempt < 2 else 0.0
    moved = (step * np.abs(shift).max(axis=0) > 0.0)[faces].any(axis=1)
    net.deviation[rows[moved]] = net.proof[:, rows[moved]] = np.nan
