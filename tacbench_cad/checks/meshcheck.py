"""Checks of a triangle mesh that need only the mesh: edges, winding, degenerate triangles, manifold, intersections.

The order of the checks matters. manifold3d hangs on infinite coordinates, and it accepts solids that are inside out or
have zero thickness. Therefore the readers refuse infinite coordinates, and edges and volume are checked before
manifold3d is used. Only pymeshlab finds triangles that cut each other. It is an optional package, and only
:func:`full_checks` imports it.
"""

from __future__ import annotations

import contextlib
import importlib.util
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tacbench_cad.checks.report import Check
from tacbench_cad.geometry.mesh import Mesh, cross
from tacbench_cad.util.errors import MissingToolError
from tacbench_cad.util.processes import LostProcessError, isolated
from tacbench_cad.util.types import Bools, Floats, Indices, Ints
from tacbench_cad.util.untrusted import limits_factor

#: The time limit of pymeshlab for an untrusted mesh, in s, and the additional time for each triangle, in s.
MAX_SECONDS, MAX_SECONDS_PER_TRIANGLE = 12.0, 4e-5
#: The number of roundings with which triangles that cut each other are confirmed, and the largest number of triangles
#: for which this is done.
ROUNDINGS, MAX_CONFIRMED = 12, 1000
#: The largest height of a degenerate triangle, as a fraction of its longest side.
DEGENERATE_FRACTION = 1e-9


@dataclass(frozen=True, kw_only=True)
class Edges:
    """The numbers of faulty edges of a mesh, and an example of each fault.

    Attributes:
        open: The number of edges that belong to only one triangle.
        same_way: The number of edges along which both triangles run in the same direction. One of them is flipped.
        crowded: The number of edges that belong to more than two triangles.
        open_at: The midpoint of an open edge in mm; None if there is none.
        same_way_at: The midpoint of an edge with inconsistent winding in mm; None if there is none.
        crowded_at: The midpoint of an edge of more than two triangles in mm; None if there is none.
    """

    open: int = 0
    same_way: int = 0
    crowded: int = 0
    open_at: tuple[float, float, float] | None = None
    same_way_at: tuple[float, float, float] | None = None
    crowded_at: tuple[float, float, float] | None = None

    @property
    def ok(self) -> bool:
        """Whether every edge has exactly two triangles, and they run along it in opposite directions."""
        return not (self.open or self.same_way or self.crowded)


def edges(mesh: Mesh) -> Edges:
    """Count the faulty edges of a mesh."""
    count = np.int64(len(mesh.vertices))
    tail = mesh.faces.astype(np.int64).ravel()
    head = np.roll(mesh.faces, -1, axis=1).astype(np.int64).ravel()
    forward, backward = np.sort(tail * count + head), np.sort(head * count + tail)
    if np.array_equal(forward, backward) and not np.any(forward[1:] == forward[:-1]):
        return Edges()
    low, high = np.minimum(tail, head), np.maximum(tail, head)
    _, first, index, used = np.unique(low * count + high, return_index=True, return_inverse=True, return_counts=True)
    turn = np.bincount(index, weights=np.where(tail < head, 1.0, -1.0))

    def place(which: Bools) -> tuple[float, float, float] | None:
        if not which.any():
            return None
        i = first[int(np.argmax(which))]
        x, y, z = (mesh.vertices[low[i]] + mesh.vertices[high[i]]) / 2.0
        return (float(x), float(y), float(z))

    alone, same, crowd = used == 1, (used == 2) & (turn != 0.0), used > 2
    return Edges(
        open=int(alone.sum()),
        same_way=int(same.sum()),
        crowded=int(crowd.sum()),
        open_at=place(alone),
        same_way_at=place(same),
        crowded_at=place(crowd),
    )


def degenerate(mesh: Mesh) -> Bools:
    """Return which triangles have no area, because two corners coincide or all corners are on a line; shape (m,)."""
    points = mesh.triangle_points
    sides = points - np.roll(points, 1, axis=1)
    longest = np.einsum("ijk,ijk->ij", sides, sides).max(axis=1)
    normals = cross(sides[:, 1], sides[:, 2])
    doubled = np.sqrt(np.einsum("ij,ij->i", normals, normals))
    return np.asarray(doubled <= DEGENERATE_FRACTION * longest)


def oriented(mesh: Mesh) -> Mesh | None:
    """Orient all triangles of a closed mesh of one body outwards.

    Args:
        mesh: A mesh in which every edge has exactly two triangles. Their directions along the edge do not matter.

    Returns:
        The mesh. None if it has several bodies, because one of them can be a hollow in another, or if a consistent
        winding is impossible (for example in a Klein bottle).
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    count = np.int64(len(mesh.vertices))
    tail = mesh.faces.astype(np.int64).ravel()
    head = np.roll(mesh.faces, -1, axis=1).astype(np.int64).ravel()
    order = np.argsort(np.minimum(tail, head) * count + np.maximum(tail, head), kind="stable")
    first, second = order[0::2], order[1::2]
    # The graph has two nodes for each triangle: unchanged (i) and flipped (m + i). It links the nodes of neighbours
    # that have a consistent winding.
    m = len(mesh.faces)
    turned = np.where(tail[first] == tail[second], m, 0)
    a, b = first // 3, second // 3
    rows, columns = np.concatenate([a, a + m]), np.concatenate([b + turned, (b + m + turned) % (2 * m)])
    links = coo_matrix((np.ones(len(rows), dtype=np.int8), (rows, columns)), shape=(2 * m, 2 * m))
    components, label = connected_components(links, directed=False)
    if components != 2:
        return None
    triangles = np.where(label[:m, None] == 0, mesh.faces, mesh.faces[:, ::-1])
    outwards = Mesh(mesh.vertices, triangles)
    return outwards if outwards.volume_mm3 >= 0.0 else Mesh(mesh.vertices, triangles[:, ::-1])


def solidity(mesh: Mesh) -> tuple[str, int]:
    """Check a mesh without faulty edges with manifold3d.

    The coordinates must be finite, because manifold3d hangs on infinite coordinates.

    Returns:
        ``NoError`` or the name of manifold3d's error, and the number of through holes (0 after an error).
    """
    body = mesh.as_manifold()
    status = str(body.status()).rpartition(".")[2]
    return status, body.genus() if status == "NoError" else 0


def bodies(mesh: Mesh) -> int:
    """Return the number of pieces that share no vertex."""
    return len(np.unique(_pieces(mesh)))


def hollows(mesh: Mesh) -> int:
    """Return the number of pieces of a closed mesh that are inside out, as hollows in another piece are."""
    corners = mesh.triangle_points - mesh.bounds_mm[0]
    below = np.einsum("ij,ij->i", corners[:, 0], cross(corners[:, 1], corners[:, 2]))
    return int(np.count_nonzero(np.bincount(np.unique(_pieces(mesh), return_inverse=True)[1], weights=below) < 0.0))


def _pieces(mesh: Mesh) -> Ints:
    """Return the number of the piece to which each triangle belongs, shape (m,)."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    tail, head = mesh.faces.ravel(), np.roll(mesh.faces, -1, axis=1).ravel()
    links = coo_matrix((np.ones(len(tail), dtype=np.int8), (tail, head)), shape=(len(mesh.vertices),) * 2)
    _, label = connected_components(links, directed=False)
    return np.asarray(label[mesh.faces[:, 0]])


def edge_checks(edges: Edges) -> list[Check]:
    """Return the checks of the edges: closed, consistent winding, and at most two triangles on each edge."""

    def at(place: tuple[float, float, float] | None) -> str:
        return "" if place is None else " (for example at x {:.4g}, y {:.4g}, z {:.4g} mm)".format(*place)

    flipped = "inconsistent winding along {} edges{}: triangles are flipped"
    crowded = "not manifold: {} edges have more than two triangles{}"
    rows = (
        ("closed", edges.open, edges.open_at, "no open edge", "{} open edges{}"),
        ("winding", edges.same_way, edges.same_way_at, "consistent", flipped),
        ("edges", edges.crowded, edges.crowded_at, "no edge has more than two triangles", crowded),
    )
    return [
        Check(name=name, ok=count == 0, detail=fault.format(count, at(place)) if count else good)
        for name, count, place, good, fault in rows
    ]


def degenerate_check(mesh: Mesh) -> Check:
    """Return the check of degenerate triangles."""
    flat = degenerate(mesh)
    count = int(flat.sum())
    if count == 0:
        return Check(name="triangles", ok=True, detail=f"{len(flat)}, none degenerate")
    x, y, z = mesh.triangle_points[int(np.argmax(flat)), 0]
    return Check(
        name="triangles",
        ok=False,
        detail=f"{count} of {len(flat)} have no area (for example at x {x:.4g}, y {y:.4g}, z {z:.4g} mm)",
    )


def full_checks(*meshes: Mesh) -> list[Check]:
    """Check meshes with pymeshlab: non-manifold edges and vertices, boundary edges, triangles that cut each other.

    pymeshlab is licensed under GPL-3 and is part of the extra ``cad``. No other function of this package uses it.

    Args:
        meshes: The meshes. Their coordinates must be finite.

    Raises:
        MissingToolError: pymeshlab is not installed.
    """
    if importlib.util.find_spec("pymeshlab") is None:
        raise MissingToolError('the full check needs pymeshlab: pip install "tacbench-cad[cad]"')
    faults = (
        ("two-manifold", "non_two_manifold_edges", "non-manifold edges"),
        ("vertices", "non_two_manifold_vertices", "non-manifold vertices"),
        ("boundary", "boundary_edges", "boundary edges"),
        ("self-intersection", "", "triangles that cut each other"),
    )
    counts = dict.fromkeys((key for _, key, _ in faults), 0)
    for mesh in meshes:
        measures, cutting = _by_pymeshlab(mesh.vertices - mesh.bounds_mm[0], mesh.faces)
        measures[""] = _confirmed(mesh, cutting)
        counts = {key: count + int(measures[key]) for key, count in counts.items()}
    return [
        Check(name=name, ok=counts[key] == 0, detail=f"{counts[key] or 'no'} {what} (pymeshlab)")
        for name, key, what in faults
    ]


def _by_pymeshlab(vertices: Floats, faces: Indices) -> tuple[dict[str, Any], Bools]:
    """Return pymeshlab's topological measures of a mesh, and which of its triangles cut another one."""
    import pymeshlab

    with contextlib.ExitStack() as stack:
        meshes: Any = pymeshlab.MeshSet(verbose=False)
        stack.callback(meshes.clear)
        meshes.add_mesh(pymeshlab.Mesh(vertices, faces.astype(np.int32)))
        measures: dict[str, Any] = meshes.get_topological_measures()
        meshes.compute_selection_by_self_intersections_per_face()
        return measures, np.array(meshes.current_mesh().face_selection_array(), dtype=np.bool_)


def _confirmed(mesh: Mesh, cutting: Bools) -> int:
    """Count the triangles that cut another one however their vertices are rounded to float32.

    Of two narrow triangles beside each other on a wall, pymeshlab sometimes says that they cut each other. It does not
    say so again if all vertices move by a rounding error.
    """
    rng, low = np.random.default_rng(0), mesh.bounds_mm[0]
    rounding = 2.0**-23 * float(np.abs(mesh.vertices).max())
    faces = mesh.faces[cutting]
    for _ in range(ROUNDINGS):
        if not 0 < len(faces) <= MAX_CONFIRMED:
            break
        used, inverse = np.unique(faces, return_inverse=True)
        moved = mesh.vertices[used] - low + rng.uniform(-rounding, rounding, (len(used), 3))
        faces = faces[_by_pymeshlab(moved, inverse.reshape(-1, 3).astype(np.int32))[1]]
    return len(faces)


def untrusted_full_checks(meshes: Sequence[Mesh]) -> list[Check]:
    """Same as :func:`full_checks`, but with a limit of time, for untrusted meshes.

    The report says "not tested" if the meshes exceed the limit.
    """
    seconds = limits_factor() * (MAX_SECONDS + MAX_SECONDS_PER_TRIANGLE * sum(len(mesh.faces) for mesh in meshes))
    try:
        checks: list[Check] = isolated(full_checks, Mesh.joined(meshes), seconds=seconds)
        return checks
    except LostProcessError as error:
        reason = f"pymeshlab would need more than {error.seconds:.0f} s" if error.seconds else str(error)
    return [Check(name="self-intersection", ok=True, detail=f"not tested: {reason}")]


def read_mesh(path: Path) -> Mesh:
    """Read an STL or 3MF file; same errors as :func:`.read_stl` and :func:`.read_3mf`."""
    from tacbench_cad.formats import format_of
    from tacbench_cad.formats.stl import read_stl
    from tacbench_cad.formats.threemf import read_3mf

    return read_3mf(path)[0] if format_of(path).name == "3mf" else read_stl(path)
