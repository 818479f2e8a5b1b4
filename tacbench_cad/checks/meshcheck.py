"""What can be wrong with a closed triangle mesh, found from the triangles alone.

The order of the checks matters. manifold3d hangs on infinite coordinates and calls an inside-out or zero-thickness
solid sound, so finite values (the readers), edges and volume come before it. pymeshlab sees what none of these do,
triangles that cut each other, and is an extra: it stands behind one function.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tacbench_cad.checks.report import Check
from tacbench_cad.geometry.mesh import Mesh, cross
from tacbench_cad.util.door import limits_factor
from tacbench_cad.util.errors import MissingToolError
from tacbench_cad.util.processes import LostProcessError, isolated
from tacbench_cad.util.types import Bools

#: Triangles that cut each other are looked for where at most so many pairs have overlapping boxes ...
MAX_PAIRS = 5e7
#: ... and for so many seconds, and for so many more for each triangle.
MAX_SECONDS, MAX_SECONDS_PER_TRIANGLE = 12.0, 4e-5
#: A triangle whose height is below this fraction of its longest side has no area to speak of.
DEGENERATE_FRACTION = 1e-9


@dataclass(frozen=True, kw_only=True)
class Edges:
    """How the edges of a mesh are used.

    Attributes:
        open: Edges of one triangle only.
        same_way: Edges of two triangles that both run along them the same way: one of the two is flipped.
        crowded: Edges of three triangles or more.
        open_at: The midpoint of an open edge; None without one.
        same_way_at: The midpoint of an edge with inconsistent winding; None without one.
        crowded_at: The midpoint of a crowded edge; None without one.
    """

    open: int = 0
    same_way: int = 0
    crowded: int = 0
    open_at: tuple[float, float, float] | None = None
    same_way_at: tuple[float, float, float] | None = None
    crowded_at: tuple[float, float, float] | None = None

    @property
    def sound(self) -> bool:
        """Whether every edge has exactly two triangles that run along it in opposite ways."""
        return not (self.open or self.same_way or self.crowded)


def edges(mesh: Mesh) -> Edges:
    """Look at every edge.

    Args:
        mesh: The mesh.
    """
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
    """Which triangles have no area: two corners in one place, or all three on a line; shape (m,)."""
    corners = mesh.triangle_points
    sides = corners - np.roll(corners, 1, axis=1)
    longest = np.einsum("ijk,ijk->ij", sides, sides).max(axis=1)
    normals = cross(sides[:, 1], sides[:, 2])
    doubled = np.sqrt(np.einsum("ij,ij->i", normals, normals))
    return np.asarray(doubled <= DEGENERATE_FRACTION * longest)


def oriented(mesh: Mesh) -> Mesh | None:
    """A closed mesh of one body with all triangles wound alike, outwards.

    Args:
        mesh: A mesh of which every edge has two triangles, whichever way they run along it.

    Returns:
        The mesh; None where it has several bodies (one may be the hollow of another), or no such winding (a Klein
        bottle).
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    count = np.int64(len(mesh.vertices))
    tail = mesh.faces.astype(np.int64).ravel()
    head = np.roll(mesh.faces, -1, axis=1).astype(np.int64).ravel()
    order = np.argsort(np.minimum(tail, head) * count + np.maximum(tail, head), kind="stable")
    first, second = order[0::2], order[1::2]
    # Each triangle is there twice: as it is (i) and flipped (m + i). Neighbours are linked in the way that fits.
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
    """What manifold3d says of a mesh with sound edges. Only for finite coordinates: it hangs on infinite ones.

    Returns:
        ``NoError`` or the name of what it found, and the number of through holes (0 where it refuses the mesh).
    """
    body = mesh.as_manifold()
    status = str(body.status()).rpartition(".")[2]
    return status, body.genus() if status == "NoError" else 0


def bodies(mesh: Mesh) -> int:
    """Number of pieces that share no vertex."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    tail, head = mesh.faces.ravel(), np.roll(mesh.faces, -1, axis=1).ravel()
    links = coo_matrix((np.ones(len(tail), dtype=np.int8), (tail, head)), shape=(len(mesh.vertices),) * 2)
    _, label = connected_components(links, directed=False)
    return len(np.unique(label[mesh.faces[:, 0]]))


def edge_checks(found: Edges) -> list[Check]:
    """The report's lines on edges: closed, wound, two triangles an edge."""

    def at(place: tuple[float, float, float] | None) -> str:
        return "" if place is None else " (one at x {:.4g}, y {:.4g}, z {:.4g} mm)".format(*place)

    flipped, crowd = (
        "inconsistent winding along {} edges{}: triangles are flipped",
        "edges have more than two triangles",
    )
    rows = (
        ("closed", found.open, found.open_at, "no open edge", "{} open edges{}"),
        ("winding", found.same_way, found.same_way_at, "consistent", flipped),
        (
            "edges",
            found.crowded,
            found.crowded_at,
            "no edge has more than two triangles",
            f"not manifold: {{}} {crowd}{{}}",
        ),
    )
    return [
        Check(name=name, ok=count == 0, detail=fault.format(count, at(place)) if count else good)
        for name, count, place, good, fault in rows
    ]


def degenerate_check(mesh: Mesh) -> Check:
    """The report's line on triangles without area."""
    flat = degenerate(mesh)
    count = int(flat.sum())
    if count == 0:
        return Check(name="triangles", ok=True, detail=f"{len(flat)}, none degenerate")
    x, y, z = mesh.triangle_points[int(np.argmax(flat)), 0]
    return Check(
        name="triangles",
        ok=False,
        detail=f"{count} of {len(flat)} are degenerate (no area; one at x {x:.4g}, y {y:.4g}, z {z:.4g} mm)",
    )


def full_checks(mesh: Mesh) -> list[Check]:
    """What only pymeshlab finds: non-manifold edges and vertices, triangles that cut each other, boundary.

    pymeshlab is GPL-3 and part of the extra ``cad``; nothing else of the package uses it.

    Args:
        mesh: The mesh; its coordinates must be finite.

    Raises:
        MissingToolError: pymeshlab is not installed.
    """
    try:
        import pymeshlab
    except ImportError:
        raise MissingToolError('the full check needs pymeshlab: pip install "tacbench-cad[cad]"') from None
    with contextlib.ExitStack() as stack:
        meshes: Any = pymeshlab.MeshSet(verbose=False)
        stack.callback(meshes.clear)
        meshes.add_mesh(pymeshlab.Mesh(mesh.vertices, mesh.faces.astype(np.int32)))
        shape: dict[str, Any] = meshes.get_topological_measures()
        meshes.compute_selection_by_self_intersections_per_face()
        cut = int(meshes.current_mesh().selected_face_number())
    rows = (
        ("two-manifold", int(shape["non_two_manifold_edges"]), "non-manifold edges"),
        ("vertices", int(shape["non_two_manifold_vertices"]), "non-manifold vertices"),
        ("boundary", int(shape["boundary_edges"]), "boundary edges"),
        ("self-intersection", cut, "triangles that cut each other"),
    )
    return [
        Check(name=name, ok=count == 0, detail=f"{'no' if count == 0 else count} {what} (pymeshlab)")
        for name, count, what in rows
    ]


def foreign_full_checks(mesh: Mesh) -> list[Check]:
    """The same for a mesh that anybody made, within limits of pairs and time; beyond them it is not tested.

    Args:
        mesh: As of :func:`full_checks`, and its errors are the same.
    """
    pairs, factor = overlapping_pairs(mesh), limits_factor()
    seconds = factor * (MAX_SECONDS + MAX_SECONDS_PER_TRIANGLE * len(mesh.faces))
    reason = f"the boxes of about {pairs:.1g} pairs of triangles overlap"
    if pairs <= factor * MAX_PAIRS:
        try:
            checks: list[Check] = isolated(full_checks, mesh, seconds=seconds)
            return checks
        except LostProcessError as error:
            reason = f"it would take pymeshlab longer than {error.seconds:.0f} s" if error.seconds else str(error)
    return [Check(name="self-intersection", ok=True, detail=f"not tested: {reason}")]


def overlapping_pairs(mesh: Mesh) -> float:
    """About how many pairs of triangles have overlapping boxes, counted for a sample of the triangles."""
    points = mesh.triangle_points
    low, high = points.min(axis=1), points.max(axis=1)
    count = len(points)
    sample = np.random.default_rng(0).choice(count, min(count, int(np.clip(2e7 // count, 16, 400))), replace=False)
    beside = [np.count_nonzero(((low <= high[i]) & (high >= low[i])).all(axis=1)) - 1 for i in sample]
    return count * float(np.mean(beside)) / 2.0


def read_mesh(path: Path) -> Mesh:
    """Read an STL or a 3MF by the end of its name; see the two readers for what they refuse."""
    from tacbench_cad.formats import format_of
    from tacbench_cad.formats.stl import read_stl
    from tacbench_cad.formats.threemf import read_3mf

    return read_3mf(path)[0] if format_of(path).name == "3mf" else read_stl(path)
