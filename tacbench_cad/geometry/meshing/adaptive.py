"""The textured top as a net of triangles of any shape: for surfaces that are not separable.

A coarse grid is refined where the surface bends. Then diagonals are flipped, and vertices are moved and lifted, until
the deviation is about the same everywhere. In the end, the coordinates are rounded to float32, and the distance of each
triangle is proved. Triangles without a proof are divided again.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from tacbench_cad.geometry.mesh import MAX_TRIANGLES, Certificate, refuse_too_many
from tacbench_cad.geometry.meshing.certify_triangles import prove, refuse_long_proof
from tacbench_cad.geometry.meshing.heights import Heights
from tacbench_cad.geometry.meshing.net import MIN_HEIGHT_MM, Net
from tacbench_cad.geometry.meshing.relaxing import relax
from tacbench_cad.geometry.meshing.sheet import Sheet
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.surface import Surface
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats

#: The bend of an edge, in tolerances, above which it is split. 12 is the bend of the edges of an equilateral triangle
#: with the largest allowed deviation.
LONGEST_BEND = 19.0
#: The number of triangles that a mesh has for each triangle of an ideal mesh.
TRIANGLES_PER_IDEAL = 2.0
#: Vertices get a sampled deviation of at most this many tolerances, so that the proof has a reserve.
RESERVE = 0.97
#: The largest number of rounds of repairs. Each round divides the triangles without a proof. The first rounds also move
#: vertices.
MAX_ROUNDS = 40
MAX_ADAPTED_ROUNDS = 6
#: Grid lines of the coarse grid are at least this far apart.
NEAR_MM = 4.0 * MIN_HEIGHT_MM
#: A mesh with more triangles than this gets fewer steps of adaptation.
MANY = 150_000


@dataclass(frozen=True, eq=False)
class NetTop:
    """A top that consists of triangles of any shape.

    Args:
        sheet: The triangles and the outline.
        certificate: The proved bounds.
    """

    sheet: Sheet
    certificate: Certificate


def ideal_triangles(block: Block, heights: Heights, tolerance: float) -> float:
    """Estimate the number of triangles of an ideal mesh.

    An ideal triangle has the area ``c tolerance / (cos sqrt(|det H|))`` with the Hessian H and the cosine of the slope.
    The factor c is ``3 sqrt(3)`` where H is definite, and about 4.3 elsewhere.
    """
    xx, xy, yy, cosine = heights.cells[3:7]
    det = xx * yy - xy**2
    density = np.sqrt(np.abs(det)) * cosine / np.where(det > 0.0, 3.0 * math.sqrt(3.0), 4.3)
    return float(density.mean()) * block.footprint_mm2 / tolerance


def adaptive_top(block: Block, tolerance: float) -> NetTop:
    """Make a top of triangles within a tolerance.

    Args:
        block: The block.
        tolerance: The tolerance in mm.

    Raises:
        InputError: The top would need too many triangles, or the distance of some triangles could not be proved.
    """
    x, y = (float(np.float32(side)) for side in block.size_mm)
    heights = Heights(block.surface, (x, y), tolerance)
    ideal = ideal_triangles(block, heights, tolerance)
    needed = TRIANGLES_PER_IDEAL * ideal
    refuse_too_many("tolerance", tolerance, needed, f"use about {tolerance * needed / MAX_TRIANGLES:.2g} mm")
    net = _start(block, heights, tolerance, ideal)
    # flipping can make an edge long again, so a few long edges remain
    while net.split_long(LONGEST_BEND) > 0.01 * len(net.faces):
        if len(net.faces) > MANY / 3:
            refuse_long_proof(heights.bounds, net.x[net.faces], net.y[net.faces], tolerance)
        net.flip(3)
    if len(net.faces) < MANY:
        relax(net, 4, 2)
        for _ in range(4):
            net.flip(2)
            relax(net, 6, 2)
        net.flip(2, above=0.7)
        net.flip(1, above=0.8)
        relax(net, 8, 1, above=0.8)
    else:
        relax(net, 4, 2)
        net.flip(1)
        relax(net, 6, 1)
    for k in range(4):
        net.split_triangles(net.measure() > 1.15 - 0.05 * k)
        net.flip(2, above=0.9)
        relax(net, 8, 2, above=0.9)
    return _proved(block, net, tolerance)


def _start(block: Block, heights: Heights, tolerance: float, ideal: float) -> Net:
    """Make a coarse grid whose lines contain the creases and the highest point."""
    sides = [float(np.float32(side)) for side in block.size_mm]
    wanted = [3.0 + k * side / 1.2 for k, side in zip(block.surface.highest_frequency, sides, strict=True)]
    shrink = min(1.0, math.sqrt(max(16.0, ideal / 8.0) / (wanted[0] * wanted[1])))
    steps = [side / (number * shrink) for side, number in zip(sides, wanted, strict=True)]
    peak = np.array([float(np.float32(place)) for place in block.extremes.at_high])
    creases = [
        set(at[(at > NEAR_MM) & (at < side - NEAR_MM)].tolist())
        for at, side in zip(block.surface.creases, sides, strict=True)
    ]
    marks = [[0.0, side, *sorted(at), float(place)] for side, at, place in zip(sides, creases, peak, strict=True)]
    x, y = (_filled(mark, step) for mark, step in zip(marks, steps, strict=True))
    n, m = len(x), len(y)
    i, j = (part.ravel() for part in np.meshgrid(np.arange(n - 1), np.arange(m - 1), indexing="ij"))
    a, b, c, d = i * m + j, (i + 1) * m + j, (i + 1) * m + j + 1, i * m + j + 1
    triangles = np.concatenate([np.stack([a, c, d], axis=1), np.stack([a, b, c], axis=1)])
    lines = np.full((n * m, 2), -1)
    for family, (at, side, sharp) in enumerate(zip((x, y), sides, creases, strict=True)):
        straight = [0.0, side, *sorted(sharp)]
        index = np.array([_index(value, straight) for value in at])
        at[index >= 0] = np.array(straight)[index[index >= 0]]
        lines[:, family] = np.repeat(index, m) if family == 0 else np.tile(index, n)
    points = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    highest = int(np.argmin(((points - peak) ** 2).sum(axis=1)))
    fixed = np.zeros(len(points), dtype=np.bool_)
    fixed[highest] = True
    ceiling = float(np.float32(block.height_mm)) - block.formula_datum_mm
    return Net(heights, points, triangles, lines, fixed, highest, tolerance, ceiling, block.region)


def _index(value: float, places: list[float]) -> int:
    """Return the index of the place at which a value is, or -1."""
    return next((k for k, place in enumerate(places) if abs(value - place) < NEAR_MM / 10.0), -1)


def _filled(marks: list[float], step: float) -> Floats:
    """Return lines through marks, and further lines between them. Of two marks close together, the first one counts."""
    kept: list[float] = []
    for mark in marks:
        if all(abs(mark - other) > NEAR_MM for other in kept):
            kept.append(mark)
    kept.sort()
    runs = [np.linspace(a, b, max(1, math.ceil((b - a) / step)) + 1)[:-1] for a, b in itertools.pairwise(kept)]
    return np.append(np.concatenate(runs), kept[-1])


def _proved(block: Block, net: Net, tolerance: float) -> NetTop:
    """Round the vertices, and divide triangles until the distance of all is proved."""
    surface, datum = block.surface, block.formula_datum_mm
    adapted, before = True, len(net.faces)
    for attempt in range(MAX_ROUNDS):
        z = net.rounded_height(datum)
        rows = np.flatnonzero(np.isnan(net.proof[0]))
        faces = net.faces[rows]
        points = np.stack([net.x[faces], net.y[faces], z[faces] - datum], axis=-1)
        net.proof[:, rows] = prove(surface, net.heights.bounds, points, tolerance)
        failed = np.isinf(net.proof[0])
        if not failed.any():
            distance, vertical = net.proof.max(axis=1).tolist()
            sheet = _sheet(net, z)
            return NetTop(sheet, Certificate(distance_mm=distance, vertical_mm=vertical))
        # the longest edge is the safe choice: the triangles become small in all directions
        adapted = adapted and attempt < MAX_ADAPTED_ROUNDS and failed.sum() < before
        before = failed.sum()
        net.split_triangles(failed, by_length=not adapted)
        if adapted:
            net.flip(1, above=RESERVE)
            relax(net, 8, 1, above=RESERVE)
        else:
            _flattened(net, surface)
    raise InputError(
        "tolerance", tolerance, f"cannot be proved for {int(failed.sum())} triangles of the top; use a larger tolerance"
    )


def _flattened(net: Net, surface: Surface) -> None:
    """Move the vertices of triangles without a proof onto the surface. The table may be too coarse to judge them."""
    vertices = np.unique(net.faces[~np.isfinite(net.proof[0])])
    height, _ = net.heights.height(net.x[vertices], net.y[vertices])
    exact = surface(net.x[vertices], net.y[vertices])
    net.lift[vertices] = np.where(net.below_ceiling(vertices), np.minimum(exact, net.ceiling), exact) - height
    net.raise_peak()
    touched = np.isin(net.faces, vertices).any(axis=1)
    net.proof[:, touched] = net.deviation[touched] = np.nan


def _sheet(net: Net, z: Floats) -> Sheet:
    """Make a sheet, with the vertices along each side in counter-clockwise order."""
    x, y, on = net.x, net.y, net.lines
    runs = [(on[:, 1] == 0, x), (on[:, 0] == 1, y), (on[:, 1] == 1, -x), (on[:, 0] == 0, -y)]
    sides = []
    for chosen, order in runs:
        members = np.flatnonzero(chosen)
        sides.append(members[np.argsort(order[members], kind="stable")].astype(np.int32))
    return Sheet(np.stack([x, y, z], axis=1), net.faces.astype(np.int32), tuple(sides))
