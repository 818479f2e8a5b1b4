"""Removing the vertices of a net that are not needed."""

from __future__ import annotations

import numpy as np

from tacbench_cad.geometry.meshing.net import Net
from tacbench_cad.util.types import Floats, Ints


def collapse(net: Net, limit: float) -> int:
    """Remove vertices by collapsing an edge where all deviations stay below a limit, and return their number."""
    count, faces = len(net.x), net.faces
    deviation = net.measure()
    around = np.bincount(faces.ravel(), minlength=count)
    mean = np.bincount(faces.ravel(), np.repeat(deviation, 3), count) / np.maximum(around, 1)
    rank = np.where(net.fixed | ((net.lines >= 0).sum(axis=1) >= 2) | (mean > 0.8 * limit), np.inf, mean)
    rank += 1e-12 * np.arange(count)
    lowest = np.full(count, np.inf)
    for k in range(3):
        others = np.minimum(rank[faces[:, (k + 1) % 3]], rank[faces[:, (k + 2) % 3]])
        np.minimum.at(lowest, faces[:, k], others)
    chosen = (rank < lowest) & np.isfinite(rank)
    inside = chosen[faces]
    rows = np.flatnonzero(inside.any(axis=1))
    slot = inside[rows].argmax(axis=1)
    vertex, b, c = (faces[rows, (slot + k) % 3] for k in range(3))
    order = np.argsort(vertex, kind="stable")
    vertex, b, c = vertex[order], b[order], c[order]
    starts = np.flatnonzero(np.append(True, vertex[1:] != vertex[:-1]))[: len(vertex)]
    numbers = np.diff(np.append(starts, len(vertex)))
    star = np.repeat(np.arange(len(starts)), numbers)
    # a vertex can move to each neighbour on its own lines; at a side, the last neighbour only occurs as c
    source, target, of = np.tile(vertex, 2), np.append(b, c), np.tile(star, 2)
    on = net.lines[source]
    allowed = ((on < 0) | (net.lines[target] == on)).all(axis=1)
    allowed[len(b) :] &= (on[len(b) :] >= 0).any(axis=1)
    source, target, of = source[allowed], target[allowed], of[allowed]
    cost = _costs(net, target, of, b, c, starts, numbers)
    best = np.full(len(starts), np.inf)
    np.minimum.at(best, of, cost)
    taken = np.flatnonzero((cost == best[of]) & (cost <= limit))
    onto = np.arange(count)
    onto[source[taken]] = target[taken]
    new = onto[faces]
    changed = (new != faces).any(axis=1)
    whole = (new[:, 0] != new[:, 1]) & (new[:, 1] != new[:, 2]) & (new[:, 2] != new[:, 0])
    net.replace(changed, new[changed & whole])
    return net.compact()


def _costs(net: Net, target: Ints, of: Ints, b: Ints, c: Ints, starts: Ints, numbers: Ints) -> Floats:
    """Return the largest deviation after each candidate for a collapse; infinite if it is not possible."""
    repeats = numbers[of]
    candidate = np.repeat(np.arange(len(target)), repeats)
    within = np.arange(len(candidate)) - np.repeat(np.cumsum(repeats) - repeats, repeats)
    row = starts[of][candidate] + within
    u, v, w = target[candidate], b[row], c[row]
    remaining = (u != v) & (u != w)
    candidate, u, v, w = candidate[remaining], u[remaining], v[remaining], w[remaining]
    cost = np.zeros(len(target))
    cost[candidate[~net.sound(u, v, w)]] = np.inf
    cost[np.bincount(candidate, minlength=len(target)) == 0] = np.inf
    possible = np.isfinite(cost[candidate])
    candidate, u, v, w = candidate[possible], u[possible], v[possible], w[possible]
    np.maximum.at(cost, candidate, net.worst(np.stack([u, v, w], axis=1), net.height()))
    return cost
